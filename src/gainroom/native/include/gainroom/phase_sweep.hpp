// The number of pairs of unstable closed-loop roots at a factor g, counted slice by slice along jω.
//
// The phase of a function of the closed loop rises by π past every stable root of the upper half plane and falls by π past every unstable
// one, so its way from a frequency below which nothing crosses, to one above which control does next to nothing, counts the unstable ones.
// At both ends the phase is known as such, not only up to turns (tracked_loop.hpp). Between them one slice adds the increment over one step,
// which its ends' slopes predict: a step is taken only where prediction and phase agree, else it is shortened. So it is where the slopes differ
// so much that what they predict may be a turn off: a phase whose slope lies between them is within half their difference over the step.
// Two roots of equal limbs that are passed closely in one step turn the phase by 2π, which cannot be told from none: but the slope of its
// logarithm's real part then rises from steep to steep, by at least 4 over the step per root, so that a step is shortened for that too; as it is
// for poles of the plant, where the function has them.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

#include "tracked_loop.hpp"

namespace gainroom {

class PhaseSweep {
public:
    // failed: nothing is known; crossed: something crosses at the factor or lower ones, where nothing must.
    enum class State { running, done, failed, crossed };

    double gain() const { return gain_; }
    double omega() const { return omega_; }
    double top() const { return top_; }
    // Right after `crossed`: up to which factor nothing does there.
    double clear_gain() const { return clear_; }
    // Cost of the last slice, in slices, and of all.
    double cost() const { return cost_; }
    double spent() const { return spent_; }
    // Pairs of unstable roots; right after `done`.
    long pairs() const { return pairs_; }
    // The same at lower factors, others at the next count; kUnclear: not known. Three at every count where they cost little, else one at every third.
    std::size_t lower() const { return lower_; }
    double lower_gain(std::size_t k) const { return gain_ * double(below_[k].part) / parts_; }
    long lower_pairs(std::size_t k) const { return below_[k].pairs; }
    static constexpr long kUnclear = std::numeric_limits<long>::min();
    // Where the phase fell the fastest, once for each fall: at unstable roots that are near the boundary, or others.
    std::size_t falls() const { return falls_; }
    double fall(std::size_t k) const { return fall_[k].omega; }

    // The first slice, at the factor g: from `lowest` on, or `slow`, up to there.
    State begin(TrackedLoop& loop, const double* posture, double gain, bool slow = false) {
        gain_ = gain;
        slices_ = 0;
        spent_ = 1.0;
        part_ = 0;
        slow_ = slow;
        omega_ = slow ? loop.slowest() : loop.lowest();
        resonance_ = loop.resonance(posture);
        const double step = loop.sample_time();
        if (slow) top_ = loop.lowest();
        else top_ = step > 0.0 ? (1.0 - 1e-6) * kPi / step : loop.top(posture, gain, std::max(1.3 * resonance_, 2.0 * omega_));
        evaluate(loop, posture, omega_);
        total_ = loop.whole_phase();
        choose_lower(loop.lower_cost());
        for (std::size_t k = 0; k < lower_; k++) {
            below_[k].phase = loop.phase_at(lower_gain(k));
            below_[k].total = loop.whole_phase_at(lower_gain(k));
            below_[k].pairs = kUnclear;
        }
        step_ = 0.25 * longest(loop, omega_);
        next_ = ahead_ = falls_ = 0;
        before_ = slope_.imag();
        if (slow && !is_clear(loop)) return State::crossed;
        return std::isfinite(total_ + slope_.imag()) && top_ > omega_ ? State::running : State::failed;
    }

    // Counts the next slice.
    State advance(TrackedLoop& loop, const double* posture) {
        const State now = step(loop, posture);
        spent_ += cost_;
        return now;
    }

private:
    State step(TrackedLoop& loop, const double* posture) {
        if (++slices_ > kMostSlices) return State::failed;
        cost_ = 1.0;
        if (slow_ && leap(loop, posture)) return State::running;
        if (omega_ >= top_) return finish(loop, posture);
        cost_ = next_ < ahead_ ? kSeen : look_ahead(loop, posture);
        const Slice& now = slices_ahead_[next_++];
        const double from = omega_, to = now.omega, growth = now.slope.real();  // d ln|F|/dω
        const double predicted = 0.5 * (slope_.imag() + now.slope.imag()) * (to - from);
        const double off = wrapped(now.phase - phase_ - predicted), grown = (growth - slope_.real()) * (to - from);
        const double bent = (now.slope.imag() - slope_.imag()) * (to - from);
        if (!(std::fabs(off) < kAgreed) || !(std::fabs(bent) < kBent) || !(grown < kClose) || (loop.has_poles() && !(-grown < kClose))) {
            next_ = ahead_;
            step_ = 0.4 * (to - from);
            return step_ > kShortest * from ? State::running : State::failed;
        }
        note_fall(from, before_, slope_.imag(), now.slope.imag());
        before_ = slope_.imag();
        phase_ = now.phase;
        slope_ = now.slope;
        if (slow_) {
            cost_ = 2.0;
            if (!is_clear(loop)) return State::crossed;
        }
        cost_ += double(lower_) * loop.lower_cost();
        for (std::size_t k = 0; k < lower_; k++) {
            const double phase = loop.phase_at(lower_gain(k));
            below_[k].total += wrapped(phase - below_[k].phase);
            below_[k].phase = phase;
        }
        total_ += predicted + off;
        omega_ = to;
        step_ = std::min((to - from) * (std::fabs(off) < 0.2 * kAgreed ? 1.6 : std::fabs(off) < 0.5 * kAgreed ? 1.1 : 0.7),
                         longest(loop, to));
        return State::running;
    }

    static constexpr std::size_t kMostSlices = 2000;
    static constexpr double kAgreed = 0.9, kBent = 4.0, kClose = 2.0, kShortest = 1e-7, kLeap = 1.2, kCheap = 0.15;
    static constexpr double kGrows = 1.2, kSeen = 0.05;  // steps of slices seen at once; what one costs that was seen before

    // At a slice, between those before and after it.
    void note_fall(double omega, double before, double here, double after) {
        if (!(here < 0.0 && here < before && here <= after)) return;
        if (falls_ < fall_.size()) {
            fall_[falls_++] = {omega, here};
            return;
        }
        Fall* flattest = &fall_[0];
        for (Fall& one : fall_)
            if (one.slope > flattest->slope) flattest = &one;
        if (here < flattest->slope) *flattest = {omega, here};
    }

    // Which lower factors this count looks at, of which one costs so many slices.
    void choose_lower(double cost) {
        const std::size_t turn = turn_++, most = below_.size();
        const bool counted = cost < 1.0, cheap = cost < kCheap;
        parts_ = counted ? kFine : kParts;
        lower_ = slow_ || !counted ? 0 : cheap ? most : turn % most == 0;
        for (std::size_t k = 0; k < most; k++) below_[k].part = kLowest + (cheap ? 2 * int(k) + int(turn % 2) : int(turn / most % kLower));
    }

    // Over a band in which nothing crosses.
    bool leap(TrackedLoop& loop, const double* posture) {
        const double to = loop.clear_until(posture, omega_, gain_);
        if (!(to > kLeap * omega_)) return false;
        loop.phase(posture, omega_, gain_, nullptr);
        total_ -= loop.whole_phase();
        evaluate(loop, posture, to);
        total_ += loop.whole_phase();
        omega_ = to;
        step_ = longest(loop, to);
        cost_ = 5.0;
        return true;
    }

    bool is_clear(TrackedLoop& loop) {
        clear_ = loop.clear_gain();
        return gain_ < clear_;
    }

    double longest(const TrackedLoop& loop, double omega) const {
        return omega * (omega < resonance_ ? loop.resolution(omega) : TrackedLoop::kWidest);
    }

    // The phase, and where it leads.
    void evaluate(TrackedLoop& loop, const double* posture, double omega) { phase_ = loop.phase(posture, omega, gain_, &slope_); }

    // The next slices, as many as the loop gives at once, at steps that grow as they do where nothing is in the way; what they cost.
    double look_ahead(TrackedLoop& loop, const double* posture) {
        next_ = ahead_ = 0;
        double omega = omega_, step = step_;
        while (ahead_ < loop.at_once() && omega < top_) {
            omega = std::min(omega + step, top_);
            slices_ahead_[ahead_++].omega = omega;
            step = std::min(kGrows * step, longest(loop, omega));
        }
        return loop.phases(posture, gain_, slices_ahead_.data(), ahead_);
    }

    // Where control is so weak that nothing turns any more: the phase there, from that without control, in parts.
    State finish(TrackedLoop& loop, const double* posture) {
        if (slow_) {
            loop.phase(posture, top_, gain_, nullptr);
            known_ = loop.whole_phase();
            part_ = parts_;
        } else if (part_ == 0) {
            phase_ = loop.phase(posture, top_, 0.0, nullptr);
            known_ = loop.whole_phase();
        }
        for (int k = 0; k < 2 && part_ < parts_; k++) {  // two cost as much as a slice
            const double before = phase_;
            phase_ = loop.phase(posture, top_, gain_ * double(++part_) / parts_, nullptr);
            const double turned = wrapped(phase_ - before);
            if (!(std::fabs(turned) < 1.5)) return State::failed;
            known_ += turned;
            for (std::size_t m = 0; m < lower_; m++)
                if (below_[m].part == part_) count_pairs(known_ - below_[m].total, below_[m].pairs);
        }
        if (part_ < parts_) return State::running;
        return count_pairs(known_ - total_, pairs_) ? State::done : State::failed;
    }

    static bool count_pairs(double phase, long& pairs) {
        const double turns = phase / (2 * kPi);
        const bool clear = std::fabs(turns - std::round(turns)) < 0.1 && turns > -0.5;
        pairs = clear ? std::lround(turns) : kUnclear;
        return clear;
    }

    // At a lower factor, so many parts of `gain`: the phase at the last slice, and all of its way.
    struct Below {
        int part = 0;
        double phase = 0.0, total = 0.0;
        long pairs = kUnclear;
    };

    struct Fall {
        double omega = 0.0, slope = 0.0;
    };

    static constexpr int kParts = 6, kFine = 12;  // kFine: where lower factors are counted
    static constexpr int kLowest = 4, kLower = 6;  // of these parts those of lower factors: the first, and how many
    std::array<Below, 3> below_;
    std::array<Fall, 16> fall_;
    std::size_t falls_ = 0;
    double before_ = 0.0;  // slope at the slice before the last one
    std::size_t lower_ = 0, turn_ = 0;
    double gain_ = 0.0, omega_ = 0.0, top_ = 0.0, resonance_ = 0.0, step_ = 0.0, cost_ = 1.0, spent_ = 0.0, clear_ = 0.0;
    double phase_ = 0.0, total_ = 0.0, known_ = 0.0;
    Complex slope_;
    std::array<Slice, TrackedLoop::kMostAtOnce> slices_ahead_;
    std::size_t next_ = 0, ahead_ = 0;  // of those: the next one, and how many there are
    std::size_t slices_ = 0;
    int part_ = 0, parts_ = kParts;
    bool slow_ = false;
    long pairs_ = 0;
};

}  // namespace gainroom
