// How many pairs of unstable roots the closed loop has at a factor g, counted slice by slice along jω.
//
// The phase of a function of the closed loop rises by π past every stable root of the upper half plane and falls by π past every unstable
// one, so its way from a frequency below which nothing crosses, to one above which control does next to nothing, counts the unstable ones.
// At both ends the phase is known as such, not only up to turns (tracked_loop.hpp). Between them one slice adds the increment over one step,
// which its ends' slopes predict: a step is taken only where prediction and phase agree, else it is shortened. Two roots of equal limbs that
// are passed closely in one step turn the phase by 2π, which cannot be told from none: but the slope of its logarithm's real part then rises
// from steep to steep, by at least 4 over the step per root, so that a step is shortened for that too.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "tracked_loop.hpp"

namespace gainroom {

class PhaseSweep {
public:
    enum class State { running, done, failed };

    double gain() const { return gain_; }
    double omega() const { return omega_; }
    double top() const { return top_; }
    std::size_t slices() const { return slices_; }
    // Pairs of unstable roots; right after `done`.
    long pairs() const { return pairs_; }

    // The first slice, at the factor g.
    State begin(TrackedLoop& loop, const double* posture, double gain) {
        gain_ = gain;
        slices_ = 0;
        part_ = 0;
        omega_ = loop.lowest();
        resonance_ = loop.resonance(posture);
        const double step = loop.sample_time();
        top_ = step > 0.0 ? (1.0 - 1e-6) * kPi / step : loop.top(posture, gain, std::max(1.3 * resonance_, 2.0 * omega_));
        evaluate(loop, posture, omega_);
        total_ = loop.whole_phase();
        step_ = 0.25 * longest(loop, omega_);
        return std::isfinite(total_ + slope_) && top_ > omega_ ? State::running : State::failed;
    }

    // One more slice.
    State advance(TrackedLoop& loop, const double* posture) {
        if (++slices_ > kMostSlices) return State::failed;
        if (omega_ >= top_) return finish(loop, posture);
        const double before = phase_, slope = slope_, growth = growth_, from = omega_, to = std::min(from + step_, top_);
        evaluate(loop, posture, to);
        const double predicted = 0.5 * (slope + slope_) * (to - from);
        const double off = wrapped(phase_ - before - predicted);
        if (!(std::fabs(off) < kAgreed) || !((growth_ - growth) * (to - from) < kClose)) {
            phase_ = before;
            slope_ = slope;
            growth_ = growth;
            step_ = 0.4 * (to - from);
            return step_ > kShortest * from ? State::running : State::failed;
        }
        total_ += predicted + off;
        omega_ = to;
        step_ = std::min((to - from) * (std::fabs(off) < 0.2 * kAgreed ? 1.6 : std::fabs(off) < 0.5 * kAgreed ? 1.1 : 0.7),
                         longest(loop, to));
        return State::running;
    }

private:
    static constexpr std::size_t kMostSlices = 2000;
    static constexpr double kAgreed = 0.9, kClose = 2.0, kShortest = 1e-5;

    double longest(const TrackedLoop& loop, double omega) const {
        return omega * (omega < resonance_ ? loop.resolution(omega) : TrackedLoop::kWidest);
    }

    // The phase, and where it leads.
    void evaluate(TrackedLoop& loop, const double* posture, double omega) {
        Complex slope;
        phase_ = loop.phase(posture, omega, gain_, &slope);
        slope_ = slope.imag();
        growth_ = slope.real();
    }

    // Where control is so weak that nothing turns any more: the phase there, from that without control, in parts.
    State finish(TrackedLoop& loop, const double* posture) {
        if (part_ == 0) {
            phase_ = loop.phase(posture, top_, 0.0, nullptr);
            known_ = loop.whole_phase();
        }
        for (int k = 0; k < 2 && part_ < kParts; k++) {  // two cost as much as a slice
            const double before = phase_;
            phase_ = loop.phase(posture, top_, gain_ * double(++part_) / kParts, nullptr);
            const double turned = wrapped(phase_ - before);
            if (!(std::fabs(turned) < 1.5)) return State::failed;
            known_ += turned;
        }
        if (part_ < kParts) return State::running;
        const double turns = (known_ - total_) / (2 * kPi);
        pairs_ = std::lround(turns);
        return std::fabs(turns - double(pairs_)) < 0.1 ? State::done : State::failed;
    }

    static constexpr int kParts = 6;
    double gain_ = 0.0, omega_ = 0.0, top_ = 0.0, resonance_ = 0.0, step_ = 0.0;
    double phase_ = 0.0, slope_ = 0.0, growth_ = 0.0, total_ = 0.0, known_ = 0.0;  // growth: d ln|F|/dω
    std::size_t slices_ = 0;
    int part_ = 0;
    long pairs_ = 0;
};

}  // namespace gainroom
