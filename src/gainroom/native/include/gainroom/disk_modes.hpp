// Bounds of S − T between frequencies: the modes of n loops closed without delay, and expansions whose remainders they bound.
//
// Let G be the loop without its pure delays E = diag(e^{−jωT_i}) (in sampled time: without whole ticks), L = G E, and
// N = G (I + R G)⁻¹ = Σ c_i b_iᵀ/(v − p_i): the modes of the loops closed without delay through a diagonal R > 0. Then
//
//     S − T = E⁻¹ X Y⁻¹ E,    X = I − (R + E) N,    Y = I − (R − E) N,
//
// where nothing is infinite at ω = 0: integrators only make N = R⁻¹ there. R is near I; that it differs from joint to joint parts the modes
// of equal joints, whose eigenvectors would otherwise come out as any mixture.
//
// About the middle of an interval X Y⁻¹ is expanded to second order in ω; what is left out is bounded mode by mode, with the distance of
// p_i from the interval for |v − p_i|. A quadratic in ω stays inside the hull of its Bernstein coefficients, so its norm stays below the
// largest of theirs. With D held this bounds σ_max(D (S − T) D⁻¹) on the whole interval. Beyond the last interval N is bounded by its
// expansion in 1/s.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "block.hpp"
#include "structured_value.hpp"

namespace gainroom {

struct DiskModes {
    std::size_t size = 0;        // n
    std::vector<Complex> poles;  // p (m)
    std::vector<Complex> into;   // b (m, n)
    std::vector<Complex> out;    // c (m, n)
    std::vector<double> delays;  // of E (n) [s]
    std::vector<double> share;   // of R (n)
    double step = 0.0;           // [s]; 0: continuous

    // v at ω.
    Complex variable(double omega) const {
        if (step == 0) return {0.0, omega};
        const double half = 0.5 * omega * step;
        return times(std::polar(1.0, half), Complex(0.0, 2 / step * std::sin(half)));
    }
    double fastest() const {
        double most = 0.0;
        for (const Complex pole : poles) most = std::max(most, size_of_any(pole));
        return most > 0 ? most : 1.0;
    }
    double last() const { return step == 0 ? std::numeric_limits<double>::infinity() : kPi / step; }
};

// A cheap upper bound of σ_max of D M D⁻¹, D = diag(up): the Frobenius norm, or the mean of the row and column sum norms.
class CheapNorm {
public:
    explicit CheapNorm(std::size_t n) : columns_(n) {}
    double of(const Dense& m, const double* up, const double* down) {
        const std::size_t n = m.rows;
        double squares = 0.0, row_most = 0.0, column_most = 0.0;
        std::fill(columns_.begin(), columns_.end(), 0.0);
        for (std::size_t i = 0; i < n; i++) {
            double row = 0.0;
            const double *re = &m.re[i * n], *im = &m.im[i * n];
            for (std::size_t j = 0; j < n; j++) {
                const double ratio = up[i] * down[j], square = (re[j] * re[j] + im[j] * im[j]) * ratio * ratio, size = std::sqrt(square);
                squares += square;
                row += size;
                columns_[j] += size;
            }
            row_most = std::max(row_most, row);
        }
        for (std::size_t j = 0; j < n; j++) column_most = std::max(column_most, columns_[j]);  // NaN is in the sum of squares
        return std::sqrt(std::min(squares, row_most * column_most));
    }

private:
    std::vector<double> columns_;
};

class DiskExpansion {
public:
    explicit DiskExpansion(const DiskModes& modes)
        : modes_(modes), n_(modes.size), m_(modes.poles.size()), term_(3 * m_), lag_(n_), center_(m_), across_(m_), out_(m_ * n_),
          rest_(m_), rows_(m_ * n_), up_(n_), down_(n_), right_(4 * n_), cheap_(n_), value_(n_) {
        for (std::size_t k = 0; k < m_; k++) {
            const Complex pole = modes.poles[k], z = 1.0 + modes.step * pole;
            center_[k] = modes.step == 0 ? pole.imag() : std::arg(z) / modes.step;
            across_[k] = modes.step == 0 ? std::fabs(pole.real()) : std::fabs(1 - size_of_any(z)) / modes.step;
            for (std::size_t i = 0; i < n_; i++) out_[k * n_ + i] = std::norm(modes.out[k * n_ + i]);
            for (std::size_t i = 0; i < n_; i++) into_.push_back(modes.into[k * n_ + i].real());
            for (std::size_t i = 0; i < n_; i++) into_.push_back(modes.into[k * n_ + i].imag());
            for (std::size_t i = 0; i < n_; i++) columns_.push_back(modes.out[k * n_ + i].real());
            for (std::size_t i = 0; i < n_; i++) columns_.push_back(modes.out[k * n_ + i].imag());
        }
        delay_ = modes.delays.empty() ? 0.0 : *std::max_element(modes.delays.begin(), modes.delays.end());
        share_ = modes.share.empty() ? 0.0 : *std::max_element(modes.share.begin(), modes.share.end());
        pair_modes();
    }

    double middle = 0.0, half = 0.0;
    Dense quadratic[3];  // X Y⁻¹ = M0 + M1 δ + M2 δ² + … about `middle`

    // X Y⁻¹ at ω: S − T up to the phases of E, which no bound of μ feels. NaN and false where Y is singular.
    bool at(double omega, Dense& found) {
        const Complex v = modes_.variable(omega);
        for (std::size_t k = 0; k < m_; k++) term_[k] = over(1.0, v - modes_.poles[k]);
        sum_modes(term_.data(), n0_);
        system_.resize(n_, 2 * n_);  // Yᵀ Mᵀ = Xᵀ
        for (std::size_t i = 0; i < n_; i++) {
            const Complex lag = std::polar(1.0, -omega * modes_.delays[i]);
            for (std::size_t j = 0; j < n_; j++) {
                const Complex entry = n0_.at(i, j), delayed = times(lag, entry), rest = (i == j ? 1.0 : 0.0) - modes_.share[i] * entry;
                system_.set(j, i, rest + delayed);
                system_.set(j, n_ + i, rest - delayed);
            }
        }
        const bool solved = solve(system_);
        const Complex none(std::numeric_limits<double>::quiet_NaN());
        found.resize(n_, n_);
        for (std::size_t i = 0; i < n_; i++)
            for (std::size_t j = 0; j < n_; j++) found.set(i, j, solved ? system_.at(j, n_ + i) : none);
        return solved;
    }

    // Least |v − p_k| for ω in [low, high], where v is `start` and `end`.
    double distance(std::size_t k, double low, double high, Complex start, Complex end) const {
        if (center_[k] > low && center_[k] < high) return std::max(across_[k], kNearest);
        return std::max(std::sqrt(std::min(std::norm(start - modes_.poles[k]), std::norm(end - modes_.poles[k]))), kNearest);
    }

    // The expansion about the middle of [low, high]; false where it is not finite.
    bool expand(double low, double high) {
        middle = 0.5 * (low + high);
        half = 0.5 * (high - low);
        const double step = modes_.step;
        const Complex start = modes_.variable(low), end = modes_.variable(high), v = modes_.variable(middle);
        const Complex rate = Complex(0.0, 1.0) + times(Complex(0.0, step), v);  // dv/dω; d²v/dω² = j T_s dv/dω
        const Complex square = times(rate, rate), bend = times(Complex(0.0, 0.5 * step), rate);
        for (std::size_t k = 0; k < m_; k++) {
            const Complex pole = modes_.poles[k], f = over(1.0, v - pole), ff = times(f, f);
            term_[k] = f;
            term_[m_ + k] = -times(rate, ff);
            term_[2 * m_ + k] = times(times(square, f) - bend, ff);
            // 1/(v − p) is a geometric series in (v − v0)/(v0 − p); in sampled time v − v0 is not quite proportional to δ
            const double square_size = std::norm(f), near = distance(k, low, high, start, end);
            rest_[k] = square_size * std::sqrt(square_size) * (1 / near + step) + step * step / 6 * square_size;
        }
        sum_modes(term_.data(), n0_);
        sum_modes(term_.data() + m_, n1_);
        sum_modes(term_.data() + 2 * m_, n2_);
        inverse_.resize(n_, n_);
        for (std::size_t i = 0; i < n_; i++) {
            lag_[i] = std::polar(1.0, -middle * modes_.delays[i]);
            const Complex apart = modes_.share[i] - lag_[i];
            for (std::size_t j = 0; j < n_; j++) inverse_.set(i, j, (i == j ? 1.0 : 0.0) - times(apart, n0_.at(i, j)));
        }
        LogDeterminant unused;
        if (!invert(inverse_, exchanged_, unused)) return false;
        multiply(n0_, inverse_, u_[0]);
        multiply(n1_, inverse_, u_[1]);
        multiply(n2_, inverse_, u_[2]);
        combine();
        project_rows();
        return true;
    }

    // What σ_max(D X Y⁻¹ D⁻¹), D = e^x, stays below on the interval, and the part of it that is left over from the expansion. Where a rough
    // bound is below `enough` it is left at that.
    double bound(const double* x, double enough, double& rest) {
        const double h = half, turn = h * delay_;
        for (std::size_t i = 0; i < n_; i++) {
            up_[i] = std::exp(x[i]);
            down_[i] = 1 / up_[i];
        }
        const double u0 = cheap(u_[0]), u1 = cheap(u_[1]) * h, u2 = cheap(u_[2]) * h * h;
        const double y1 = cheap(y_[0]) * h, y2 = cheap(y_[1]) * h * h;
        const double m1 = cheap(quadratic[1]) * h, m2 = cheap(quadratic[2]) * h * h, modes = h * h * h * left_out();
        double m0 = cheap(quadratic[0]);
        // E = E0 (1 − jδT − δ²T²/2 + r), |r| ≤ (hT)³/6; products of third order and beyond
        const double r = (1 + share_) * modes + turn * turn * turn / 6 * (u0 + u1 + u2) + turn * u2 + turn * turn / 2 * (u1 + u2);
        const double smallest_gain = 1 - y1 - y2 - r;  // ‖(Y(δ) Y⁻¹)⁻¹‖ ≤ 1/smallest_gain
        const auto left = [&] { return (r + m1 * y2 + m2 * y1 + m2 * y2 + (m0 + m1 + m2) * r) / smallest_gain; };
        rest = std::numeric_limits<double>::infinity();
        if (!(smallest_gain > 0) || !std::isfinite(left())) return rest;
        rest = left();
        if (m0 + m1 + m2 + rest <= enough) return m0 + m1 + m2 + rest;
        m0 = value_.largest(quadratic[0], x);
        rest = left();
        if (m0 + m1 + m2 + rest <= enough) return m0 + m1 + m2 + rest;
        double height = 0.0;
        for (const double way : {-1.0, 1.0, 0.0}) {  // Bernstein's coefficients
            mixed_.resize(n_, n_);
            const double first = way * h, second = way == 0 ? -h * h : h * h;
            for (std::size_t k = 0; k < n_ * n_; k++) {
                mixed_.re[k] = quadratic[0].re[k] + first * quadratic[1].re[k] + second * quadratic[2].re[k];
                mixed_.im[k] = quadratic[0].im[k] + first * quadratic[1].im[k] + second * quadratic[2].im[k];
            }
            height = std::max(height, value_.largest(mixed_, x));
        }
        return height + rest;
    }

    // ω beyond which σ_max(D (S − T) D⁻¹) < `height`, for some D, whatever the phases of E; in continuous time. Infinite: none is known.
    //
    // With t ≥ ‖D N D⁻¹‖ and r = t/(1 − ‖R‖ t) ≥ ‖D L D⁻¹‖, σ_max ≤ (1 + r)/(1 − r). N = Σ_k m_k/s^(k+1) with m_k = Σ c_i p_i^k b_iᵀ,
    // and a remainder after kOrder terms.
    double end(double height) {
        const double r = (height - 1) / (height + 1), allowed = r / (1 + share_ * r), fastest = modes_.fastest();
        std::vector<double> x(n_, 0.0), sizes(m_, 0.0);
        if (!at(fastest, mixed_)) return std::numeric_limits<double>::infinity();
        value_.balance(mixed_, x.data());
        for (std::size_t i = 0; i < n_; i++) {
            up_[i] = std::exp(x[i]);
            down_[i] = 1 / up_[i];
        }
        double terms[kOrder];
        for (int order = 0; order < kOrder; order++) {
            for (std::size_t k = 0; k < m_; k++) term_[k] = order == 0 ? Complex(1.0) : times(term_[k], modes_.poles[k]);
            sum_modes(term_.data(), n0_);
            terms[order] = cheap(n0_);
        }
        for (std::size_t k = 0; k < m_; k++) {
            double out = 0.0, into = 0.0;
            for (std::size_t i = 0; i < n_; i++) {
                out += out_[k * n_ + i] * up_[i] * up_[i];
                into += std::norm(modes_.into[k * n_ + i]) * down_[i] * down_[i];
            }
            sizes[k] = std::sqrt(out * into);
        }
        for (double power = -6; power < 40; power += 0.25) {
            const double omega = fastest * std::exp2(power);
            double sum = 0.0, weight = 1 / omega;
            for (const double term : terms) {
                sum += term * weight;
                weight /= omega;
            }
            for (std::size_t k = 0; k < m_; k++) {
                const Complex pole = modes_.poles[k];
                const double ratio = std::norm(pole) / (omega * omega);
                const double near = pole.imag() > omega ? std::fabs(pole.real()) : std::sqrt(std::norm(Complex(0.0, omega) - pole));
                sum += ratio * ratio * sizes[k] / std::max(near, kNearest);
            }
            if (sum < allowed) return omega;
        }
        return std::numeric_limits<double>::infinity();
    }

private:
    static constexpr double kNearest = 1e-100;  // distance of a pole on the boundary [1/s]
    static constexpr int kOrder = 4;  // of the expansion of N in 1/s: current loops make N fall with the third power of s
    static_assert(kOrder == 4, "the remainder is of this order");

    const DiskModes& modes_;
    std::size_t n_, m_;
    std::vector<Complex> term_, lag_;
    std::vector<double> center_, across_, out_, rest_, rows_, up_, down_, right_;
    std::vector<double> into_, columns_;  // Re b and Im b, Re c and Im c of each mode (m, 2, n)
    double delay_ = 0.0, share_ = 0.0;            // the largest
    Vector<std::size_t> first_, exchanged_;  // modes with which groups begin, and the end of the last
    Dense n0_, n1_, n2_, inverse_, u_[3], y_[2], system_, mixed_;
    CheapNorm cheap_;
    StructuredValue value_;

    double cheap(const Dense& m) { return cheap_.of(m, up_.data(), down_.data()); }

    // Groups of one mode, or of two that are each other's conjugates to the last digit: their sum is cheaper than its parts.
    void pair_modes() {
        for (std::size_t k = 0; k < m_; k++) {
            first_.push_back(k);
            bool pair = k + 1 < m_ && modes_.poles[k].imag() != 0 && modes_.poles[k + 1] == std::conj(modes_.poles[k]);
            const Complex *out = &modes_.out[k * n_], *into = &modes_.into[k * n_];
            for (std::size_t i = 0; pair && i < n_; i++) pair = out[n_ + i] == std::conj(out[i]) && into[n_ + i] == std::conj(into[i]);
            if (pair) k++;
        }
        first_.push_back(m_);
    }

    // Σ c_k b_kᵀ f_k; of two conjugates with f and g: Re(c bᵀ)(f + g) + j Im(c bᵀ)(f − g), real columns times complex rows.
    void sum_modes(const Complex* f, Dense& sum) {
        sum.resize(n_, n_);
        double *dr = &right_[0], *di = dr + n_, *ar = di + n_, *ai = ar + n_;
        for (std::size_t q = 0; q + 1 < first_.size(); q++) {
            const std::size_t k = first_[q];
            const bool pair = first_[q + 1] - k == 2;
            const Complex even = pair ? f[k] + f[k + 1] : f[k], odd = times(Complex(0.0, 1.0), pair ? f[k] - f[k + 1] : f[k]);
            const double er = even.real(), ei = even.imag(), pr = odd.real(), pi = odd.imag();
            const double *b = &into_[2 * k * n_], *s = b + n_, *c = &columns_[2 * k * n_];
            for (std::size_t j = 0; j < n_; j++) {
                const double own_r = pair ? pr : -ei, own_i = pair ? pi : er, cross_r = pair ? -er : -pi, cross_i = pair ? -ei : pr;
                dr[j] = b[j] * er + s[j] * own_r;
                di[j] = b[j] * ei + s[j] * own_i;
                ar[j] = b[j] * pr + s[j] * cross_r;
                ai[j] = b[j] * pi + s[j] * cross_i;
            }
            for (std::size_t i = 0; i < n_; i++) {
                double *re = &sum.re[i * n_], *im = &sum.im[i * n_];
                const double p = c[i], t = c[n_ + i];
                for (std::size_t j = 0; j < n_; j++) {
                    re[j] += p * dr[j] + t * ar[j];
                    im[j] += p * di[j] + t * ai[j];
                }
            }
        }
    }

    // Y(δ) Y⁻¹ − I and X Y⁻¹ from N Y⁻¹, with E N Y⁻¹ = e0 + e1 δ + e2 δ².
    void combine() {
        for (Dense& part : y_) part.resize(n_, n_);
        for (Dense& part : quadratic) part.resize(n_, n_);
        for (std::size_t i = 0; i < n_; i++) {
            const double delay = modes_.delays[i], share = modes_.share[i];
            const Complex turn(0.0, -delay);
            for (std::size_t j = 0; j < n_; j++) {
                const Complex n0 = u_[0].at(i, j), n1 = u_[1].at(i, j), n2 = u_[2].at(i, j);
                const Complex e0 = times(lag_[i], n0), e1 = times(lag_[i], n1 + times(turn, n0));
                const Complex e2 = times(lag_[i], n2 + times(turn, n1) - 0.5 * delay * delay * n0);
                y_[0].set(i, j, e1 - share * n1);
                y_[1].set(i, j, e2 - share * n2);
                quadratic[0].set(i, j, inverse_.at(i, j) - share * n0 - e0);
                quadratic[1].set(i, j, -share * n1 - e1);
                quadratic[2].set(i, j, -share * n2 - e2);
            }
        }
        subtract_product(quadratic[0], y_[0], quadratic[1]);
        subtract_product(quadratic[1], y_[0], quadratic[2]);
        subtract_product(quadratic[0], y_[1], quadratic[2]);
    }

    void subtract_product(const Dense& a, const Dense& b, Dense& from) {
        multiply(a, b, mixed_);
        for (std::size_t k = 0; k < n_ * n_; k++) {
            from.re[k] -= mixed_.re[k];
            from.im[k] -= mixed_.im[k];
        }
    }

    // |b_kᵀ Y⁻¹|² (m, n).
    void project_rows() {
        double *dr = &right_[0], *di = dr + n_, *ar = di + n_, *ai = ar + n_;
        for (std::size_t q = 0; q + 1 < first_.size(); q++) {
            const std::size_t k = first_[q];
            const bool pair = first_[q + 1] - k == 2;
            const double* b = &into_[2 * k * n_];
            std::fill(right_.begin(), right_.end(), 0.0);
            for (std::size_t i = 0; i < n_; i++) {  // with Re b, and with Im b
                const double *re = &inverse_.re[i * n_], *im = &inverse_.im[i * n_], p = b[i], s = b[n_ + i];
                for (std::size_t j = 0; j < n_; j++) {
                    dr[j] += p * re[j];
                    di[j] += p * im[j];
                    ar[j] += s * re[j];
                    ai[j] += s * im[j];
                }
            }
            for (std::size_t j = 0; j < n_; j++) {
                const double plus = dr[j] - ai[j], also = di[j] + ar[j], minus = dr[j] + ai[j], other = di[j] - ar[j];
                rows_[k * n_ + j] = plus * plus + also * also;
                if (pair) rows_[(k + 1) * n_ + j] = minus * minus + other * other;
            }
        }
    }

    // Σ |D c_k| |b_kᵀ Y⁻¹ D⁻¹| times what 1/(v − p_k) may be from its expansion, over h³.
    double left_out() {
        double sum = 0.0;
        for (std::size_t k = 0; k < m_; k++) {
            double out = 0.0, rows = 0.0;
            for (std::size_t i = 0; i < n_; i++) {
                out += out_[k * n_ + i] * up_[i] * up_[i];
                rows += rows_[k * n_ + i] * down_[i] * down_[i];
            }
            sum += std::sqrt(out * rows) * rest_[k];
        }
        return sum;
    }
};

}  // namespace gainroom
