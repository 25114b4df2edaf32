// The structured singular value μ of a complex matrix for n independent complex factors, bounded from above and below (Packard and Doyle
// 1993): μ(M) = 1 / min{ max|δ_i| : det(I − M diag(δ)) = 0 }.
//
// From above: μ ≤ min σ_max(D M D⁻¹) over D = diag(e^x) > 0, convex in x (Sezginer and Overton 1990) and equal to μ for n ≤ 3. σ_max has
// kinks where the largest singular values meet, which equal legs make the rule. Schatten norms have none: log‖D M D⁻¹‖_q = log(Σ σ_k^q)/q
// is convex in x as well (Hadamard's three lines), lies above log σ_max by log(n)/q at most, and is balancing (Osborne 1960) at q = 2.
// So Newton's method follows its minimum while q rises.
//
// From below: any eigenvalue of M diag(q) with |q_i| = 1; the power iteration of Packard, Fan and Doyle 1988 finds a large one.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "balancing.hpp"
#include "eigenvalues.hpp"
#include "hermitian.hpp"

namespace gainroom {

class StructuredValue {
public:
    explicit StructuredValue(std::size_t n)
        : n_(n), gram_(n), balancing_(n), up_(n), down_(n), trial_(n), anchor_(n), best_(n), slope_(n), step_(n), weight_(n), share_(n),
          lambda_(n), log_(n), pair_(4 * n), curvature_(n * n), filled_(n * n), values_(n), a_(n), b_(n), w_(n) {
        scaled_.resize(n, n);
        product_.resize(n, n);
        right_.resize(n, n);
    }

    // σ_max(D M D⁻¹), D = e^x; infinite where that is not a number.
    double largest(const Dense& m, const double* x) {
        return decompose(m, x, false) ? size_ * std::sqrt(std::max(gram_.values[0], 0.0)) : kNone;
    }

    // x, from where it is, to where the Frobenius norm of D M D⁻¹ is nearly least.
    void balance(const Dense& m, double* x) { balancing_.run(m, x); }

    // x, from where it is, to where σ_max(D M D⁻¹) is least, and that: within `tolerance` (relative) where Newton's method gets there.
    double improve(const Dense& m, double* x, double tolerance) {
        const std::size_t n = n_;
        double best = kNone, height = kNone, power = kFirstPower, damping = 1e-3;
        int levels = 0;
        std::copy_n(x, n, trial_.begin());
        std::copy_n(x, n, anchor_.begin());
        std::copy_n(x, n, best_.begin());
        for (int round = 0; round < kNewtonSteps; round++) {
            if (!decompose(m, trial_.data(), true)) break;
            const double sharp = std::log(std::max(size_, kSmallest)) + 0.5 * std::log(std::max(gram_.values[0], kSmallest));
            if (size_ * std::sqrt(gram_.values[0]) < best) {
                best = size_ * std::sqrt(gram_.values[0]);
                std::copy_n(trial_.begin(), n, best_.begin());
            }
            const double fresh = sharp + excess(power);
            const bool down = fresh <= height + 1e-15;
            if (down) {
                std::copy_n(trial_.begin(), n, x);
                height = fresh;
                damping = std::max(damping / 10, 1e-9);
                derivatives(power);
            } else {
                damping *= 8;
            }
            newton_step(damping);
            double promise = 0.0;  // about twice what the step gains
            for (std::size_t i = 0; i < n; i++) promise -= slope_[i] * step_[i];
            const double above = fresh - sharp;
            const bool reached = down && promise < 0.3 * std::max(above, tolerance);
            if ((reached && promise + above < tolerance) || !(damping <= 1e9)) break;
            if (reached) {
                power *= kSharpen;
                height = sharp + excess(power);
                derivatives(power);
                newton_step(damping);
                if (levels >= kLate) {  // the minima approach the last one as 1/q
                    for (std::size_t i = 0; i < n; i++) step_[i] = (x[i] - anchor_[i]) / kSharpen;
                    height = kNone;
                }
                std::copy_n(x, n, anchor_.begin());
                levels++;
            }
            for (std::size_t i = 0; i < n; i++) trial_[i] = x[i] + step_[i];
        }
        std::copy_n(best_.begin(), n, x);
        centre(x, n);
        return best;
    }

    // The largest |eigenvalue| of M diag(q) found, from up to `kStarts` mixtures of the singular vectors, and q (n). It ends at `enough`.
    double from_below(const Dense& m, Complex* phases, double enough) {
        const std::size_t n = n_;
        std::fill(best_.begin(), best_.end(), 0.0);
        std::fill(phases, phases + n, Complex(1.0));
        if (!decompose(m, best_.data(), true)) return 0.0;
        double best = 0.0;
        for (int start = 0; start < kStarts && best < enough; start++) {
            begin(start);
            for (int round = 0; round < kPowerSteps && power_step(m); round++) {}
            for (std::size_t i = 0; i < n; i++) w_[i] = times(sign(w_[i]), std::conj(sign(a_[i])));
            turned_.resize(n * n);
            for (std::size_t k = 0; k < n * n; k++) turned_[k] = times({m.re[k], m.im[k]}, w_[k % n]);
            double radius = 0.0;
            if (!eigenvalues_.find(turned_.data(), n, values_.data())) continue;
            for (const Complex value : values_) radius = std::max(radius, size_of_any(value));
            if (radius > best) {
                best = radius;
                std::copy_n(w_.begin(), n, phases);
            }
        }
        return best;
    }

private:
    static constexpr double kNone = std::numeric_limits<double>::infinity(), kSmallest = 1e-300;
    static constexpr double kFirstPower = 64.0, kSharpen = 4.0;  // of q: at first, and by which it rises once its minimum has been reached
    static constexpr int kLate = 3;  // after so many rises the path of minima is followed straight on
    static constexpr int kNewtonSteps = 80, kPowerSteps = 60, kStarts = 8;
    static constexpr double kLargestStep = 8.0;  // of x

    std::size_t n_, top_ = 0;
    double size_ = 1.0;  // of D M D⁻¹: the decomposition is that of 1/size of it
    Hermitian gram_;
    Balancing balancing_;
    Dense scaled_, product_, right_;
    std::vector<double> up_, down_, trial_, anchor_, best_, slope_, step_, weight_, share_, lambda_, log_, pair_, curvature_, filled_;
    std::vector<Complex> values_, a_, b_, w_, turned_;
    Eigenvalues eigenvalues_;

    // Eigenvalues σ² and, where asked for, vectors of the Gram matrix of D M D⁻¹.
    bool decompose(const Dense& m, const double* x, bool with_vectors) {
        const std::size_t n = n_;
        for (std::size_t i = 0; i < n; i++) {
            up_[i] = std::exp(x[i]);
            down_[i] = 1 / up_[i];
        }
        double most = 0.0;
        for (std::size_t i = 0; i < n; i++)
            for (std::size_t j = 0; j < n; j++) {
                const double ratio = up_[i] * down_[j];
                scaled_.re[i * n + j] = m.re[i * n + j] * ratio;
                scaled_.im[i * n + j] = m.im[i * n + j] * ratio;
                most = std::max({most, std::fabs(scaled_.re[i * n + j]), std::fabs(scaled_.im[i * n + j])});
            }
        size_ = most > kSmallest ? most : 1.0;
        const double inverse = 1 / size_;
        for (std::size_t k = 0; k < n * n; k++) {
            scaled_.re[k] *= inverse;
            scaled_.im[k] *= inverse;
        }
        gram(scaled_, product_);
        return gram_.find(product_, with_vectors);
    }

    // log(Σ (σ/σ_max)^q)/q.
    double excess(double power) const {
        double sum = 0.0;
        for (const double value : gram_.values) sum += value > 0 ? std::pow(value / gram_.values[0], 0.5 * power) : 0.0;
        return std::log(std::max(sum, 1.0)) / power;
    }

    void newton_step(double damping) {
        const std::size_t n = n_;
        double mean = 0.0;
        for (std::size_t i = 0; i < n; i++) mean += curvature_[i * n + i];
        mean = mean / n + 1e-12;
        for (std::size_t i = 0; i < n; i++) {
            for (std::size_t j = i; j < n; j++) filled_[i * n + j] = curvature_[i * n + j] + mean / n;
            filled_[i * n + i] += mean * damping;
            step_[i] = -slope_[i];
        }
        solve_positive(filled_, step_);
        shorten(step_, kLargestStep);
    }

    // Gradient and upper half of the Hessian of log‖D M D⁻¹‖_q in x.
    //
    // With dx = ξ, V the eigenvectors of the Gram matrix H, λ its eigenvalues, W = D M D⁻¹ V, B = Vᴴ diag(ξ) V, Y = Wᴴ diag(ξ) W and
    // p = q/2: dH_kl = 2 Y_kl − (λ_k + λ_l) B_kl, and
    //
    //     d² tr H^p = p tr(H^(p−1) d²H) + p Σ |dH_kl|² (λ_k^(p−1) − λ_l^(p−1))/(λ_k − λ_l).
    //
    // Of each pair k, l that is a form a|B|² + 2b Re(B Ȳ) + c|Y|² = c|Y + (b/c) B|² + (a − b²/c)|B|². Pairs without one of the eigenvalues
    // that carry the norm are left out.
    void derivatives(double power) {
        const std::size_t n = n_;
        const double p = 0.5 * power, most = gram_.values[0] > 0 ? gram_.values[0] : 1.0;
        double total = 0.0;
        for (std::size_t k = 0; k < n; k++) {
            lambda_[k] = std::max(gram_.values[k] / most, 1e-24);
            log_[k] = std::log(lambda_[k]);
            weight_[k] = std::exp(p * log_[k]);
            total += weight_[k];
        }
        top_ = 0;
        for (std::size_t k = 0; k < n; k++) {
            weight_[k] /= total;
            share_[k] = weight_[k] / lambda_[k];
            if (weight_[k] > 1e-14) top_ = k + 1;
        }
        images(1 / std::sqrt(most));
        std::fill(slope_.begin(), slope_.end(), 0.0);
        std::fill(curvature_.begin(), curvature_.end(), 0.0);
        for (std::size_t k = 0; k < top_; k++) {
            const double *vr = &gram_.vectors.re[k * n], *vi = &gram_.vectors.im[k * n], *wr = &right_.re[k * n], *wi = &right_.im[k * n];
            for (std::size_t i = 0; i < n; i++) {
                const double v = vr[i] * vr[i] + vi[i] * vi[i], w = wr[i] * wr[i] + wi[i] * wi[i];
                slope_[i] += share_[k] * w - weight_[k] * v;
                curvature_[i * n + i] += 2 * share_[k] * w + weight_[k] * v;
            }
            for (std::size_t l = k; l < n; l++) add_pair(k, l, p, total);
        }
        for (std::size_t i = 0; i < n; i++) rank_one(i, slope_.data(), -power);
    }

    // W, in rows, of D M D⁻¹ times `factor`.
    void images(double factor) {
        const std::size_t n = n_;
        std::fill(right_.re.begin(), right_.re.end(), 0.0);
        std::fill(right_.im.begin(), right_.im.end(), 0.0);
        for (std::size_t k = 0; k < n; k++)
            for (std::size_t i = 0; i < n; i++) {
                double re = 0.0, im = 0.0;
                const double *ar = &scaled_.re[i * n], *ai = &scaled_.im[i * n];
                const double *vr = &gram_.vectors.re[k * n], *vi = &gram_.vectors.im[k * n];
                for (std::size_t j = 0; j < n; j++) {
                    re += ar[j] * vr[j] - ai[j] * vi[j];
                    im += ar[j] * vi[j] + ai[j] * vr[j];
                }
                right_.re[k * n + i] = factor * re;
                right_.im[k * n + i] = factor * im;
            }
    }

    void add_pair(std::size_t k, std::size_t l, double p, double total) {
        const std::size_t n = n_;
        const double fall = log_[l] - log_[k], sum = lambda_[k] + lambda_[l];
        const double between = fall > -1e-12 ? p - 1 : std::expm1((p - 1) * fall) / std::expm1(fall);
        const double phi = std::exp((p - 2) * log_[k]) * between / total, half = k == l ? 0.5 : 1.0;
        const double a = half * (share_[k] * lambda_[l] + share_[l] * lambda_[k] + phi * sum * sum);
        const double b = half * (-2 * (share_[k] + share_[l]) - 2 * phi * sum), c = half * 4 * phi;
        const double *kr = &gram_.vectors.re[k * n], *ki = &gram_.vectors.im[k * n];
        const double *lr = &gram_.vectors.re[l * n], *li = &gram_.vectors.im[l * n];
        const double *pr = &right_.re[k * n], *pi = &right_.im[k * n], *qr = &right_.re[l * n], *qi = &right_.im[l * n];
        double *br = pair_.data(), *bi = br + n, *yr = bi + n, *yi = yr + n;
        const double lean = b / c;
        for (std::size_t i = 0; i < n; i++) {
            br[i] = kr[i] * lr[i] + ki[i] * li[i];
            bi[i] = kr[i] * li[i] - ki[i] * lr[i];
            yr[i] = pr[i] * qr[i] + pi[i] * qi[i] + lean * br[i];
            yi[i] = pr[i] * qi[i] - pi[i] * qr[i] + lean * bi[i];
        }
        const double rest = a - b * lean;
        for (std::size_t i = 0; i < n; i++) {
            double* row = &curvature_[i * n];
            const double f = rest * br[i], g = rest * bi[i], u = c * yr[i], v = c * yi[i];
            for (std::size_t j = i; j < n; j++) row[j] += f * br[j] + g * bi[j] + u * yr[j] + v * yi[j];
        }
    }

    void rank_one(std::size_t i, const double* vector, double factor) {
        for (std::size_t j = i; j < n_; j++) curvature_[i * n_ + j] += factor * vector[i] * vector[j];
    }

    static double length(Complex value) { return std::sqrt(std::norm(value)); }
    static Complex sign(Complex value) {
        const double size = length(value);
        return size > 0 ? value / size : Complex(1.0);
    }

    // b and w: the first singular vectors, or mixtures of all, of which each start takes fewer.
    void begin(int start) {
        const std::size_t n = n_;
        const double most = std::max(gram_.values[0], kSmallest), fade = 40.0 + (1.0 - 40.0) * start / (kStarts - 1);
        images(1.0);
        std::fill(b_.begin(), b_.end(), Complex(0.0));
        std::fill(w_.begin(), w_.end(), Complex(0.0));
        std::fill(a_.begin(), a_.end(), Complex(0.0));
        for (std::size_t k = 0; k < (start == 0 ? 1 : n); k++) {
            const double value = std::sqrt(std::max(gram_.values[k] / most, 0.0));
            if (!(value > 1e-12)) break;
            // phases that do not repeat: multiples of the golden section
            const Complex mix = start == 0 ? 1.0 : std::polar(std::pow(value, fade), 2 * kPi * 0.6180339887498949 * (start * n + k));
            for (std::size_t i = 0; i < n; i++) {
                b_[i] += times(mix, gram_.vectors.at(k, i));
                w_[i] += times(mix, right_.at(k, i)) / value;
            }
        }
    }

    // a ← M b, w ← Mᴴ (|w| sign a), b ← |a| sign w; false where a no longer moves.
    bool power_step(const Dense& m) {
        const std::size_t n = n_;
        double moved = 0.0;
        for (std::size_t i = 0; i < n; i++) {
            Complex sum = 0.0;
            for (std::size_t j = 0; j < n; j++) sum += times(m.at(i, j), b_[j]);
            values_[i] = sum;
        }
        unit(values_);
        for (std::size_t i = 0; i < n; i++) {
            moved = std::max(moved, length(values_[i] - a_[i]));
            a_[i] = values_[i];
            w_[i] = length(w_[i]) * sign(a_[i]);
        }
        std::fill(values_.begin(), values_.end(), Complex(0.0));
        for (std::size_t i = 0; i < n; i++)
            for (std::size_t j = 0; j < n; j++) values_[j] += times(std::conj(m.at(i, j)), w_[i]);
        unit(values_);
        for (std::size_t i = 0; i < n; i++) {
            w_[i] = values_[i];
            b_[i] = length(a_[i]) * sign(w_[i]);
        }
        return moved >= 1e-9;
    }

    static void unit(std::vector<Complex>& column) {
        double sum = 0.0;
        for (const Complex value : column) sum += std::norm(value);
        const double inverse = 1 / std::max(std::sqrt(sum), kSmallest);
        for (Complex& value : column) value *= inverse;
    }
};

}  // namespace gainroom
