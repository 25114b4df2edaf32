// Crossings of joint-space control followed as W changes.
//
// The mode x of (W + diag(β)) x = 0 gives g and ω by xᵀWx + Σ β_i x_i² = 0, wrong by the square of the mode's own error, as the matrix is
// symmetric; the mode is mended by residual inverse iteration with the factors of an earlier posture (Neumaier, SIAM J. Numer. Anal. 22,
// 1985). Factors are made anew where that is slow.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "block.hpp"
#include "link_inertia.hpp"
#include "symmetric_factor.hpp"
#include "tracked_loop.hpp"

namespace gainroom {

class CrossingFollower {
public:
    explicit CrossingFollower(const JointLaws& laws)
        : laws_(laws), values_(laws.size()),
          moved_(laws.size()), extra_(laws.size()), trial_(laws.size()), factors_(kKept, {SymmetricFactor(laws.size())}) {}

    // Follows `crossing` to W; `work` is counted in slices of a PhaseSweep. True where it has converged: `converged` says so too. Where it need
    // only be `rough`, true as soon as its mode is within that, and gain and frequency within the square.
    bool follow(const double* w, TrackedCrossing& crossing, int steps, double& work, bool rough) {
        double last = 1.0, step_size = 1.0;
        crossing.converged = current_ = false;
        for (int k = 0; k < steps; k++) {
            const double residual = balance(w, crossing, step_size);
            work += kBalance;
            if (!std::isfinite(residual)) return false;
            if (residual < kResidual && step_size < 1e-6) {
                sensitivity(w, crossing);
                return crossing.converged = true;
            }
            if (rough && residual < kRough && step_size < kRough) return true;
            Factors* own = factors_of(crossing);
            if (!own || residual > (k > 0 ? 0.1 * last : kOld)) {  // a step with fresh factors squares the error
                own = &refactored(w, crossing);
                work += kFactor;
            }
            last = residual;
            own->used = ++uses_;
            own->factor.solve(extra_.data());
            for (std::size_t i = 0; i < extra_.size(); i++) crossing.mode[i] -= extra_[i];
            if (!crossing.normalize()) return false;
        }
        return false;
    }

    // A gain that the crossing, followed `ahead` of the path before, is above at W, from its mode as it would go on. What that is off by leaves
    // the gain wrong by its square, times how sharp the sharpest resonance beside it is: damped by 1e-5. NaN where it is off by much.
    double least_gain(const double* w, const TrackedCrossing& crossing, double ahead, double& work) {
        crossing.extrapolate(ahead, trial_.omega, trial_.gain, trial_.mode);
        double step_size = 1.0;
        current_ = false;
        const double residual = balance(w, trial_, step_size);
        near_ = current_ = false;
        work += kBalance;
        const double doubt = kDoubt * residual + kSharpest * residual * residual;
        return residual < kRough && step_size < kRough ? (1.0 - doubt) * trial_.gain : std::numeric_limits<double>::quiet_NaN();
    }

    // Towards the direction in which the matrix of `factor` is smallest.
    static bool sharpen(const SymmetricFactor& factor, TrackedCrossing& crossing) {
        factor.solve(crossing.mode.data());
        return crossing.normalize();
    }
    // The matrix at a place of its own, until the next crossing is followed.
    const SymmetricFactor& at(const double* w, double omega, double gain) { return fresh(w, omega, gain).factor; }

    // The matrix of a crossing, at its place or nearly, as it has been followed.
    const SymmetricFactor& beside(const double* w, TrackedCrossing& crossing, double& work) {
        if (const Factors* own = factors_of(crossing)) return own->factor;
        near_ = current_ = false;
        work += kFactor;
        return refactored(w, crossing).factor;
    }

private:
    static constexpr std::size_t kKept = 4;
    static constexpr double kBalance = 0.3, kFactor = 0.7;  // work
    static constexpr double kResidual = 1e-7, kRough = 1e-3, kSmall = 1e-5, kOld = 1e-5, kDoubt = 3.0, kSharpest = 1e5;
    static constexpr double kExact = 1e-6;   // of ω and g: a step so small changes β as its slope says; what is left is of its square
    static constexpr double kBeside = 1e-7;  // of g, beside the root, where nothing is singular

    struct Factors {
        SymmetricFactor factor;
        std::uint64_t of = 0, used = 0;  // `factored` of its crossing; when it was used
    };

    Factors* factors_of(const TrackedCrossing& crossing) {
        for (Factors& one : factors_)
            if (one.of == crossing.factored && one.of != 0) return &one;
        return nullptr;
    }

    // Those that have not been used for the longest.
    Factors& oldest() {
        Factors* found = &factors_[0];
        for (Factors& one : factors_)
            if (one.used < found->used) found = &one;
        return *found;
    }

    Factors& fresh(const double* w, double omega, double gain) {
        Factors& found = oldest();
        laws_.at(omega, gain, values_.data());
        current_ = false;
        return factored(w, found);
    }

    Factors& factored(const double* w, Factors& found) {
        found.factor.factor(w, values_.data());
        found.of = 0;
        return found;
    }

    Factors& refactored(const double* w, TrackedCrossing& crossing) {
        if (Factors* own = factors_of(crossing)) own->used = 0;
        if (!near_) laws_.at(crossing.omega, crossing.gain, values_.data());
        for (JointValue& value : values_) value.beta += kBeside * crossing.gain * value.beta_gain;
        Factors& found = factored(w, oldest());
        for (JointValue& value : values_) value.beta -= kBeside * crossing.gain * value.beta_gain;
        crossing.factored = found.of = ++uses_;
        return found;
    }

    // ω and g for the mode as it is, the residual in extra_; its size, relative.
    double balance(const double* w, TrackedCrossing& crossing, double& step_size) {
        const std::size_t n = crossing.mode.size();
        const Complex* x = crossing.mode.data();
        Complex inertia = 0.0;
        product(w, x, n, moved_.data());
        for (std::size_t i = 0; i < n; i++) inertia += times(moved_[i], x[i]);
        near_ = false;
        for (int k = 0; k < 4; k++) {
            if (!current_) laws_.at(crossing.omega, crossing.gain, values_.data());
            current_ = false;
            Complex f = inertia, slope = 0.0, by_gain = 0.0;
            for (std::size_t i = 0; i < n; i++) {
                const Complex square = times(x[i], x[i]);
                f += times(square, values_[i].beta);
                slope += times(square, values_[i].beta_omega);
                by_gain += times(square, values_[i].beta_gain);
            }
            const double det = slope.real() * by_gain.imag() - slope.imag() * by_gain.real();
            double d_omega = (f.imag() * by_gain.real() - f.real() * by_gain.imag()) / det;
            double d_gain = (slope.imag() * f.real() - slope.real() * f.imag()) / det;
            const double size = std::fabs(d_omega / crossing.omega) + std::fabs(d_gain / crossing.gain);
            if (!std::isfinite(size)) return size;
            if (size > 0.2) {
                d_omega *= 0.2 / size;
                d_gain *= 0.2 / size;
            }
            crossing.omega += d_omega;
            crossing.gain += d_gain;
            crossing.rising = det;  // of the sign of Im f_g/f_ω
            if (k == 0) step_size = size;
            if (size < kSmall) {  // what the next step would change is of its square
                for (std::size_t i = 0; i < n; i++) values_[i].beta += d_omega * values_[i].beta_omega + d_gain * values_[i].beta_gain;
                near_ = true;
                current_ = size < kExact;
                break;
            }
        }
        double left = 0.0, whole = 0.0;
        for (std::size_t i = 0; i < n; i++) {
            extra_[i] = moved_[i] + times(values_[i].beta, x[i]);
            left += std::norm(extra_[i]);
            whole += std::norm(x[i]) * (w[i * n + i] * w[i * n + i] + 1.0 / std::norm(values_[i].outer));  // β itself may be 0
        }
        return std::sqrt(left / whole);
    }

    // |d ln g| under a change of W by δ(W + 1/J), of any shape.
    void sensitivity(const double* w, TrackedCrossing& crossing) const {
        const std::size_t n = crossing.mode.size();
        Complex slope = 0.0, by_gain = 0.0;
        double size = 0.0;
        for (std::size_t i = 0; i < n; i++) {
            const Complex square = times(crossing.mode[i], crossing.mode[i]);
            slope += times(square, values_[i].beta_omega);
            by_gain += times(square, values_[i].beta_gain);
            size += std::norm(crossing.mode[i]) * (w[i * n + i] + 1.0 / laws_.joint(i).motor_inertia);
        }
        // Real ω and g balance a complex change f: Im(f conj(slope)) = dg Im(by_gain conj(slope)), up to signs.
        const double across = std::fabs(by_gain.imag() * slope.real() - by_gain.real() * slope.imag());
        crossing.spread = size * std::abs(slope) / (across * crossing.gain);
    }

    const JointLaws& laws_;
    Vector<JointValue> values_;
    Vector<Complex> moved_, extra_;
    TrackedCrossing trial_;  // one that is looked at
    Vector<Factors> factors_;  // of the few crossings that are followed often: all of them would not stay in the cache
    bool near_ = false, current_ = false;  // whether values_ are those of where the crossing is, nearly and within kExact
    std::uint64_t uses_ = 0;
};

}  // namespace gainroom
