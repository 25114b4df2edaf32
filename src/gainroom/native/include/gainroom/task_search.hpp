// The search for crossings of gain matrices: at every slice of a count all factors −1/μ at which a root would lie at jω are there, μ the
// eigenvalues of M, and those that become real within a step are starts.
#pragma once

#include <cmath>
#include <cstddef>

#include "block.hpp"
#include "crossing_search.hpp"
#include "task_loop.hpp"

namespace gainroom {

class TaskSearch final : public CrossingSearch {
public:
    TaskSearch(TaskLoop& loop, CrossingSet& known, std::size_t contacts)
        : CrossingSearch(known), loop_(loop), looked_at_(contacts), values_(loop.channels()) {
        matrix_.resize(loop.channels(), loop.channels());
        slope_ = inverse_ = matrix_;
        exchanged_.resize(loop.channels());
    }

    double begin(ContactState& state) override {
        looked_at_[state.number] = 0.0;
        return 0.0;
    }

    double look(ContactState& state) override {
        const double from = looked_at_[state.number], omega = state.sweep.omega();
        if (!(omega > from)) return 0.0;  // a step that was shortened
        looked_at_[state.number] = omega;
        return look_here(state, omega, kReach * std::max(omega - from, kLeast * omega));
    }

    double look_at(ContactState& state, double omega) override {
        Complex slope;
        loop_.phase(state.posture.data(), omega, state.sweep.gain(), &slope);
        return 1.0 + look_here(state, omega, kAround * omega);
    }

private:
    static constexpr double kEigenvalues = 2.5, kMode = 0.5;               // work
    static constexpr double kReach = 2.0, kLeast = 0.02, kAside = 1.5;     // of a step, of ω, of Im γ/Re γ
    static constexpr double kAround = 0.05;                                // of ω
    static constexpr double kBesides = 1e-9;                               // of μ, where nothing is singular
    static constexpr double kSame = 0.01, kAlike = 0.9;

    // Where the loop's `phase` was last: starts up to `reach` from there.
    double look_here(ContactState& state, double omega, double reach) {
        double work = kEigenvalues;
        if (!loop_.find_eigenvalues()) return work;
        values_ = loop_.eigenvalues();
        matrix_.re = loop_.matrix().re;
        matrix_.im = loop_.matrix().im;
        slope_.re = loop_.slope().re;
        slope_.im = loop_.slope().im;
        for (std::size_t k = 0; k < values_.size(); k++) {
            const Complex factor = over(-1.0, values_[k]);
            const double most = kBeyond * state.sweep.gain();
            if (!(factor.real() > 0.0 && factor.real() < 2.0 * most && std::fabs(factor.imag()) < kAside * factor.real())) continue;
            work += kMode;
            Complex turned;
            if (!mode(values_[k], k, turned)) continue;
            // dγ/dω = μ'/μ² of γ = −1/μ
            const Complex slope = over(turned, times(values_[k], values_[k]));
            const double step = -factor.imag() / slope.imag(), gain = factor.real() + step * slope.real();
            if (!(std::fabs(step) < reach && gain > 0.0 && gain < most)) continue;
            trial_.begin(omega + step, gain);
            if (!known(state)) take(state, work);
        }
        return work;
    }

    // trial_'s mode and left mode of the eigenvalue μ, and dμ/dω.
    bool mode(Complex value, std::size_t number, Complex& turned) {
        const std::size_t r = values_.size();
        inverse_.shape(r, r);
        for (std::size_t i = 0; i < r; i++)
            for (std::size_t j = 0; j < r; j++) inverse_.set(i, j, matrix_.at(i, j) - (i == j ? (1.0 + kBesides) * value : Complex(0.0)));
        LogDeterminant unused;
        if (!invert(inverse_, exchanged_, unused)) return false;
        Complex *y = trial_.mode.data(), *z = y + r;
        // columns and rows of the inverse are the modes, but for other eigenvalues' shares
        std::size_t row = number % r, column = row;
        double most = 0.0;
        for (std::size_t i = 0; i < r; i++)
            for (std::size_t j = 0; j < r; j++)
                if (const double size = std::norm(inverse_.at(i, j)); size > most) most = size, row = i, column = j;
        for (std::size_t i = 0; i < r; i++) {
            y[i] = inverse_.at(i, column);
            z[i] = inverse_.at(row, i);
        }
        Complex size = 0.0, change = 0.0;
        double right = 0.0, left = 0.0;
        for (std::size_t i = 0; i < r; i++) {
            right += std::norm(y[i]);
            left += std::norm(z[i]);
            size += times(z[i], y[i]);
            for (std::size_t j = 0; j < r; j++) change += times(z[i], times(slope_.at(i, j), y[j]));
        }
        turned = over(change, size);
        const double large = std::sqrt(std::norm(size));
        if (!std::isfinite(turned.real() + turned.imag()) || !(large > 0.0)) return false;
        const Complex turn = std::conj(size) / (large * std::sqrt(2.0 * left));
        for (std::size_t i = 0; i < r; i++) {
            y[i] /= std::sqrt(2.0 * right);
            z[i] = std::conj(times(z[i], turn));
        }
        return true;
    }

    // Whether trial_ leads to a crossing that is known.
    bool known(const ContactState& state) const {
        for (std::size_t k = 0; k < state.count; k++) {
            const TrackedCrossing& one = *state.order[k];
            if (std::fabs(one.gain - trial_.gain) < kSame * one.gain && std::fabs(one.omega - trial_.omega) < kSame * one.omega &&
                std::norm(CrossingSet::product(one.mode, trial_.mode)) > kAlike)
                return true;
        }
        return false;
    }

    TaskLoop& loop_;
    Vector<double> looked_at_;
    Vector<Complex> values_;
    Vector<std::size_t> exchanged_;
    Dense matrix_, slope_, inverse_;
};

}  // namespace gainroom
