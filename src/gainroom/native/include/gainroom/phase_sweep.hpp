// How many pairs of unstable roots the closed loop has at a factor g, counted slice by slice along jω.
//
// The phase of F = Π α_i · det(W + diag β) rises by π past every stable root of the upper half plane and falls by π past every unstable
// one, so its way from a frequency below which all joints' controllers only take energy out, to one above which they do next to nothing,
// counts the unstable ones. At both ends the phase is known as such, not only up to turns: where Im β > 0, every pivot of L D Lᵀ lies in
// the upper half plane, and so does β of a robot without control. Between them one slice adds the increment over one step, which
// its ends' slopes predict: a step is taken only where prediction and phase agree, else it is shortened. Two roots of equal limbs that are
// passed closely in one step turn the phase by 2π, which cannot be told from none: but the slope of ln|F| then rises from steep to
// steep, by at least 4 over the step per root, so that a step is shortened for that too.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "symmetric_factor.hpp"

namespace gainroom {

class PhaseSweep {
public:
    enum class State { running, done, failed };

    explicit PhaseSweep(const JointLaws& laws) : laws_(laws), values_(laws.size()), factor_(laws.size()), work_(2 * laws.size() * laws.size()) {}

    double gain() const { return gain_; }
    double omega() const { return omega_; }
    double top() const { return top_; }
    std::size_t slices() const { return slices_; }
    const SymmetricFactor& factor() const { return factor_; }
    const JointValue* values() const { return values_.data(); }
    // Pairs of unstable roots; right after `done`.
    long pairs() const { return pairs_; }

    // The first slice, at the factor g.
    State begin(const double* w, double gain, double passive_end) {
        gain_ = gain;
        slices_ = 0;
        part_ = 0;
        omega_ = passive_end;
        top_ = top(w);
        evaluate(w, omega_, gain_);
        total_ = known_phase();
        step_ = 0.25 * resolution(omega_);
        return std::isfinite(total_ + slope_) && top_ > omega_ ? State::running : State::failed;
    }

    // One more slice.
    State advance(const double* w) {
        if (++slices_ > kMostSlices) return State::failed;
        if (omega_ >= top_) return finish(w);
        const double before = phase_, slope = slope_, growth = growth_, from = omega_, to = std::min(from + step_, top_);
        evaluate(w, to, gain_);
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
        step_ = std::min((to - from) * (std::fabs(off) < 0.2 * kAgreed ? 1.6 : std::fabs(off) < 0.5 * kAgreed ? 1.1 : 0.7), resolution(to));
        return State::running;
    }

private:
    static constexpr std::size_t kMostSlices = 2000;
    static constexpr double kAgreed = 0.9, kClose = 2.0, kShortest = 1e-5;

    // Steps beyond which a resonance could hide: its half width is about ζω with ζ = ωB/2K.
    double resolution(double omega) const {
        double share = 0.15;
        for (std::size_t i = 0; i < laws_.size(); i++) {
            const JointData& joint = laws_.joint(i);
            if (omega < resonance_ && std::isfinite(joint.stiffness))
                share = std::min(share, std::max(0.35 * omega * joint.damping / joint.stiffness, 2e-3));
        }
        return share * omega;
    }

    // The phase, and where it leads: the slope of ln F.
    void evaluate(const double* w, double omega, double gain) {
        evaluate_phase(w, omega, gain);
        Complex slope = factor_.trace(values_.data(), work_.data());
        for (std::size_t i = 0; i < laws_.size(); i++) slope += over(values_[i].outer_omega, values_[i].outer);
        slope_ = slope.imag();
        growth_ = slope.real();
    }

    void evaluate_phase(const double* w, double omega, double gain) {
        laws_.at(omega, gain, values_.data());
        factor_.factor(w, values_.data());
        Complex product = 1.0;
        for (std::size_t i = 0; i < laws_.size(); i++) {
            const Complex one = times(factor_.pivot(i), times(values_[i].outer, values_[i].factor));
            product = times(product, one * (1.0 / (std::fabs(one.real()) + std::fabs(one.imag()))));
        }
        phase_ = std::arg(product);
    }

    // The phase at which `evaluate` was last, not only up to turns, where every joint's controller takes energy out: α = a (1/a + e)/β,
    // each factor in a half plane that is known.
    double known_phase() const {
        double sum = 0.0;
        for (std::size_t i = 0; i < laws_.size(); i++) {
            const JointValue& value = values_[i];
            const Complex beside = times(value.outer, over(value.beta, value.inner));  // 1/a + e
            sum += upper(factor_.pivot(i)) - upper(std::conj(value.inner)) + upper(beside) - upper(value.beta) + std::arg(value.factor);
        }
        return sum;
    }

    // arg in [0, π] of what is in the upper half plane but for round-off; elsewhere arg in (−π, 0).
    static double upper(Complex z) {
        if (z.imag() < 0.0 && -z.imag() < 1e-9 * std::fabs(z.real())) return z.real() > 0.0 ? 0.0 : kPi;
        return std::arg(z);
    }

    // Where control is so weak that nothing turns any more: the phase there, from that without control, in parts.
    State finish(const double* w) {
        if (part_ == 0) {
            evaluate_phase(w, top_, 0.0);
            known_ = known_phase();
        }
        for (int k = 0; k < 2 && part_ < kParts; k++) {  // two cost as much as a slice
            const double before = phase_;
            evaluate_phase(w, top_, gain_ * double(++part_) / kParts);
            const double turned = wrapped(phase_ - before);
            if (!(std::fabs(turned) < 1.5)) return State::failed;
            known_ += turned;
        }
        if (part_ < kParts) return State::running;
        const double turns = (known_ - total_) / (2 * kPi);
        pairs_ = std::lround(turns);
        return std::fabs(turns - double(pairs_)) < 0.1 ? State::done : State::failed;
    }

    double top(const double* w) {
        const std::size_t n = laws_.size();
        resonance_ = 0.0;
        for (std::size_t i = 0; i < n; i++) {
            const JointData& joint = laws_.joint(i);
            if (!std::isfinite(joint.stiffness)) continue;
            double row = 1.0 / joint.motor_inertia;
            for (std::size_t j = 0; j < n; j++) row += std::fabs(w[i * n + j]);
            resonance_ = std::max(resonance_, std::sqrt(joint.stiffness * row));
        }
        if (laws_.sample_time() > 0.0) return (1.0 - 1e-6) * kPi / laws_.sample_time();
        double omega = std::max(1.3 * resonance_, 2.0 * omega_);
        for (int k = 0; k < 100; k++, omega *= 1.3) {
            double strongest = 0.0;
            for (std::size_t i = 0; i < n; i++)
                strongest = std::max(strongest, std::abs(laws_.control(i, omega, gain_)) / (laws_.joint(i).motor_inertia * omega * omega));
            if (strongest < 0.1) break;
        }
        return omega;
    }

    static constexpr int kParts = 6;
    const JointLaws& laws_;
    std::vector<JointValue> values_;
    SymmetricFactor factor_;
    std::vector<double> work_;
    double gain_ = 0.0, omega_ = 0.0, top_ = 0.0, step_ = 0.0, resonance_ = 0.0;
    double phase_ = 0.0, slope_ = 0.0, growth_ = 0.0, total_ = 0.0, known_ = 0.0;  // growth: d ln|F|/dω
    std::size_t slices_ = 0;
    int part_ = 0;
    long pairs_ = 0;
};

}  // namespace gainroom
