// Newton's method for factors on all gains of coupled joints that put a root on the boundary.
//
// F = Q + v diag(d_i), v = 1/g, is singular where a root crosses (modal_loop.hpp). With a border b, the solution of
//
//   [F b; bᵀ 0] [x; μ] = [0; 1]   has   μ = 0 exactly there, and   dμ = −xᵀ dF x,
//
// as F is complex symmetric: in (ω, v) one factorisation is taken per step. (Where F is half of a twofold one, the same from either side:
// dμ = −yᵀ dF x.)
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "modal_loop.hpp"

namespace gainroom {

struct Crossing {
    double omega = 0.0, gain = 0.0;
    double growth = 0.0;  // Re of how the root moves with ln g, over its size: > 0 towards instability
    std::vector<Complex> vector;  // x: torques; positions are x_i/c_i. Twofold: z of exclusion.hpp
};

class CrossingNewton {
   public:
    explicit CrossingNewton(const ModalLoop& loop) : loop_(loop), n_(loop.size), half_(loop.twofold ? n_ / 2 : n_), border_(half_ + 1) {
        matrix_.resize(border_ * border_);
        solution_.resize(border_);
        functions_.resize(loop.modes);
        later_.resize(loop.modes);
        laws_.resize(n_);
        later_laws_.resize(n_);
        scale_.resize(n_);
        mobility_.resize(n_ * n_);
    }

    // From ω, g and x; false where it leads nowhere.
    bool polish(Crossing& at) {
        double omega = at.omega, v = 1 / at.gain;
        std::vector<Complex>& x = at.vector;
        rescale(omega);
        for (std::size_t i = 0; i < n_; i++) x[i] = over(x[i], scale_[i]);
        for (int step = 0; step < kSteps; step++) {
            const double ahead = omega * (1 + kDifference);
            Complex mu, slope_v = 0.0;
            if (!(loop_.twofold ? bordered_twofold(omega, v, x, mu) : bordered(omega, v, x, mu))) return false;
            for (std::size_t i = 0; i < n_; i++) slope_v -= times(times(x[i], x[i]), times(laws_[i], Complex(scale_[i] * scale_[i])));
            const Complex slope_omega = -over(form(ahead, v, x) - form(omega, v, x), Complex(ahead - omega));
            const double determinant = slope_omega.real() * slope_v.imag() - slope_omega.imag() * slope_v.real();
            double step_omega = (mu.real() * slope_v.imag() - mu.imag() * slope_v.real()) / determinant;
            double step_v = (slope_omega.real() * mu.imag() - slope_omega.imag() * mu.real()) / determinant;
            const double far = std::max(std::fabs(step_omega) / (kFar * omega), std::fabs(step_v) / (kFar * v));
            if (!std::isfinite(far)) return false;
            if (far > 1) {
                step_omega /= far;
                step_v /= far;
            }
            omega -= step_omega;
            v -= step_v;
            if (!(omega > 0) || !(v > 0)) return false;
            if (far * kFar < kSettled) {
                at.omega = omega;
                at.gain = 1 / v;
                at.growth = -v * over(times({0.0, -1.0}, slope_v), slope_omega).real() / omega;
                for (std::size_t i = 0; i < n_; i++) x[i] *= scale_[i];
                return true;
            }
        }
        return false;
    }

   protected:
    const ModalLoop& loop_;
    std::size_t n_, half_;  // of F, and of what is left of it where it is twofold
    std::vector<Complex> mobility_, laws_;
    std::vector<double> scale_;

    void rescale(double omega) {
        loop_.inverse_laws(omega, laws_.data());
        for (std::size_t i = 0; i < n_; i++) scale_[i] = 1 / std::sqrt(std::abs(laws_[i]));
    }

    // Q at ω, lower triangle.
    void respond(double omega) {
        Complex f0;
        loop_.functions(omega, f0, functions_.data());
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = 0; j <= i; j++) mobility_[i * n_ + j] = times(loop_.rigid_at(i * n_ + j), f0);
        for (std::size_t k = 0; k < loop_.modes; k++) {
            const Complex* shape = &loop_.shapes[k * n_];
            for (std::size_t i = 0; i < n_; i++) {
                const Complex f = times(functions_[k], shape[i]);
                for (std::size_t j = 0; j <= i; j++) mobility_[i * n_ + j] += times(f, shape[j]);
            }
        }
    }

    // xᵀ F x at (ω, v).
    Complex form(double omega, double v, const std::vector<Complex>& x) {
        Complex f0, value = 0.0;
        loop_.functions(omega, f0, later_.data());
        loop_.inverse_laws(omega, later_laws_.data());
        for (std::size_t i = 0; i < n_; i++) {
            const Complex own = x[i] * scale_[i];
            Complex rest = 0.0;
            for (std::size_t j = 0; j < n_; j++) rest += times(loop_.rigid_at(i * n_ + j), scale_[j] * x[j]);
            value += times(own, times(f0, rest) + v * times(later_laws_[i], own));
        }
        for (std::size_t k = 0; k < loop_.modes; k++) {
            Complex along = 0.0;
            for (std::size_t i = 0; i < n_; i++) along += times(loop_.shapes[k * n_ + i], x[i] * scale_[i]);
            value += times(later_[k], times(along, along));
        }
        return value;
    }

   private:
    static constexpr int kSteps = 24;
    static constexpr double kDifference = 1e-6, kFar = 0.3, kSettled = 1e-13;

    std::size_t border_;
    std::vector<Complex> matrix_, solution_, functions_, later_, later_laws_;

    // x at (ω, v) from one nearby, in the units of `scale_`; false where there is none.
    bool bordered(double omega, double v, std::vector<Complex>& x, Complex& mu) {
        fill(omega, v);
        if (!border(x, x, false) || !solve()) return false;
        std::copy(solution_.begin(), solution_.end() - 1, x.begin());
        mu = solution_[half_];
        return true;
    }

    // z likewise.
    bool bordered_twofold(double omega, double v, std::vector<Complex>& z, Complex& mu) {
        std::vector<Complex> x(half_), y(half_);
        for (std::size_t i = 0; i < half_; i++) {
            const Complex turned = times({0.0, 1.0}, z[half_ + i]);
            x[i] = z[i] + turned;
            y[i] = z[i] - turned;
        }
        std::vector<Complex> right, left;
        fill(omega, v);
        if (!border(x, y, false) || !solve()) return false;
        right = solution_;
        fill(omega, v);
        if (!border(y, x, true) || !solve()) return false;
        left = solution_;
        mu = right[half_];
        double sizes[2] = {0.0, 0.0};
        for (std::size_t i = 0; i < half_; i++) {
            sizes[0] += std::norm(right[i]);
            sizes[1] += std::norm(left[i]);
        }
        const double balance = std::pow(sizes[0] / sizes[1], 0.25);  // dμ is of their product
        for (std::size_t i = 0; i < half_; i++) {
            const Complex one = right[i] / balance, other = left[i] * balance;
            z[i] = 0.5 * (other + one);
            z[half_ + i] = times({0.0, 0.5}, other - one);
        }
        return true;
    }

    // F (r, r) at (ω, v), or all of it, in the corner of the bordered matrix.
    void fill(double omega, double v) {
        respond(omega);
        loop_.inverse_laws(omega, laws_.data());
        for (std::size_t i = 0; i < half_; i++) {
            for (std::size_t j = 0; j < half_; j++) {
                Complex value = mobility_[std::max(i, j) * n_ + std::min(i, j)];
                if (loop_.twofold) value -= times({0.0, 1.0}, mobility_[(half_ + j) * n_ + i]);
                matrix_[i * border_ + j] = value * (scale_[i] * scale_[j]);
            }
            matrix_[i * border_ + i] += v * laws_[i] * (scale_[i] * scale_[i]);
        }
    }

    // The borders of F, or of Fᵀ: conjugates of `row` below and of `column` beside it; false where these are nothing.
    bool border(const std::vector<Complex>& row, const std::vector<Complex>& column, bool transposed) {
        double sizes[2] = {0.0, 0.0};
        for (std::size_t i = 0; i < half_; i++) {
            sizes[0] += std::norm(row[i]);
            sizes[1] += std::norm(column[i]);
            for (std::size_t j = 0; j < i && transposed; j++) std::swap(matrix_[i * border_ + j], matrix_[j * border_ + i]);
            solution_[i] = 0.0;
        }
        if (!(sizes[0] > 0 && sizes[1] > 0) || !std::isfinite(sizes[0] + sizes[1])) return false;
        for (std::size_t i = 0; i < half_; i++) {
            matrix_[half_ * border_ + i] = std::conj(row[i]) / std::sqrt(sizes[0]);
            matrix_[i * border_ + half_] = std::conj(column[i]) / std::sqrt(sizes[1]);
        }
        matrix_[half_ * border_ + half_] = 0.0;
        solution_[half_] = 1.0;
        return true;
    }

    // Gauss with row exchanges, in place.
    bool solve() {
        for (std::size_t k = 0; k < border_; k++) {
            std::size_t pivot = k;
            for (std::size_t i = k + 1; i < border_; i++)
                if (std::norm(matrix_[i * border_ + k]) > std::norm(matrix_[pivot * border_ + k])) pivot = i;
            if (!(std::norm(matrix_[pivot * border_ + k]) > 0)) return false;
            if (pivot != k) {
                for (std::size_t j = k; j < border_; j++) std::swap(matrix_[k * border_ + j], matrix_[pivot * border_ + j]);
                std::swap(solution_[k], solution_[pivot]);
            }
            const Complex inverse = over(1.0, matrix_[k * border_ + k]);
            for (std::size_t i = k + 1; i < border_; i++) {
                const Complex factor = times(matrix_[i * border_ + k], inverse);
                for (std::size_t j = k + 1; j < border_; j++) matrix_[i * border_ + j] -= times(factor, matrix_[k * border_ + j]);
                solution_[i] -= times(factor, solution_[k]);
            }
        }
        for (std::size_t i = border_; i-- > 0;) {
            for (std::size_t j = i + 1; j < border_; j++) solution_[i] -= times(matrix_[i * border_ + j], solution_[j]);
            solution_[i] = over(solution_[i], matrix_[i * border_ + i]);
        }
        return true;
    }
};

}  // namespace gainroom
