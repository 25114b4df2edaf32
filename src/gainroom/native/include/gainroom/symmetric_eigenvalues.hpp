// Eigenvalues of small complex matrices that are symmetric in some units of their rows, as loops of joints with encoders on the motors are.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "complex.hpp"
#include "four.hpp"

namespace gainroom {

// Three diagonals by reflections H = I − u uᵀ/h, h = uᵀu/2, then QL with shifts, as of a real matrix: transposes do not conjugate (Cullum and
// Willoughby 1985, chapter 6). That takes a third of the time of eigenvalues.hpp, and knows nothing of eigenvalues much smaller than others.
// Such reflections and rotations are orthogonal, not unitary, and lose digits where xᵀx is much smaller than |x|². There, where no units make
// the matrix symmetric, and where the sums of the eigenvalues λ and of their squares, and the product of 1 + λ, do not agree with it, nothing
// is found.
class SymmetricEigenvalues {
public:
    // Of a (n, n) by rows, its real and imaginary parts apart; false also where they may be off by more than `error`, or where pairs of entries
    // differ, in those units, by more than `symmetric` of the largest.
    bool find(const double* re, const double* im, std::size_t n, double error, Complex* values, double symmetric = kSymmetric) {
        if (n == 0) return true;
        n_ = n;
        stride_ = (n + 3) / 4 * 4;
        const auto entry = [re, im, n](std::size_t r, std::size_t c) { return Complex(re[r * n + c], im[r * n + c]); };
        find_units(entry);
        for (auto* one : {&re_, &im_}) one->assign(n * stride_, 0.0);
        for (auto* one : {&u_re_, &u_im_, &p_re_, &p_im_}) one->assign(stride_, 0.0);
        for (auto* one : {&diagonal_, &beside_}) one->assign(n, 0.0);
        double most = 0.0, off = 0.0;
        Complex sum = 0.0, squares = 0.0;
        for (std::size_t r = 0; r < n; r++) {
            for (std::size_t c = 0; c < r; c++) {
                const Complex below = times(times(entry(r, c), units_[r]), inverse_units_[c]);
                const Complex above = times(times(entry(c, r), units_[c]), inverse_units_[r]);
                re_[r * stride_ + c] = below.real();
                im_[r * stride_ + c] = below.imag();
                squares += times(below, above);
                most = std::max(most, std::norm(below));
                off = std::max(off, std::norm(below - above));
            }
            diagonal_[r] = entry(r, r);
            most = std::max(most, std::norm(diagonal_[r]));
        }
        if (!(kDigits * kDigits * most <= error * error && most > 1 / kLargest)) return false;
        if (!(off <= std::min(error * error, symmetric * symmetric * most))) return false;
        squares *= 2.0;
        for (const Complex& one : diagonal_) {
            sum += one;
            squares += times(one, one);
        }
        if (!reduce()) return false;
        const Complex determinant = determinant_beside_one();
        if (!settled()) return false;
        Complex product = 1.0;  // small ones do not show in sums beside large ones
        for (const Complex& one : diagonal_) product = times(product, 1.0 + one);
        if (!(size_of_any(product - determinant) <= kSure * size_of_any(determinant))) return false;
        for (std::size_t k = 0; k < n; k++) {
            sum -= diagonal_[k];
            squares -= times(diagonal_[k], diagonal_[k]);
            values[k] = diagonal_[k];
        }
        error = std::min(error, symmetric * std::sqrt(most));  // sums differ from what they should be by as much as pairs of entries
        return std::norm(sum) <= error * error && std::norm(squares) <= error * error * most;
    }

    // Entry (i, j) times this is that of the symmetric matrix, of the one that was found last.
    Complex unit(std::size_t i, std::size_t j) const { return times(units_[i], inverse_units_[j]); }

private:
    static constexpr double kDigits = 1e-13, kSymmetric = 1e-12;  // of the largest entry
    static constexpr double kSure = 1e-8;  // of det(I + A), that tells whether eigenvalues near −1 and small ones are right
    static constexpr double kLargest = 1e100;  // its square
    static constexpr double kShortest = 0.01;  // |xᵀx| of |x|²: below, what is orthogonal loses too many digits
    static constexpr double kJoined = -2.0;  // no strength of a tie
    static constexpr double kEqual = 2.3e-16;  // of its neighbours on the diagonal: what stands beside them is 0
    static constexpr int kRounds = 60;

    static double size(Complex a) { return std::fabs(a.real()) + std::fabs(a.imag()); }

    // The root with a positive real part.
    static Complex root(Complex a) {
        const double length = std::sqrt(a.real() * a.real() + a.imag() * a.imag());
        if (length == 0) return 0.0;
        const double part = std::sqrt(0.5 * (length + std::fabs(a.real()))), other = 0.5 * a.imag() / part;
        if (a.real() >= 0) return {part, other};
        return {std::fabs(other), a.imag() < 0 ? -part : part};
    }

    // Units r in which entry_ij r_i/r_j are those of a symmetric matrix, where there are such: from one row to the next, by the strongest tie.
    template <typename Entry>
    void find_units(Entry entry) {
        units_.assign(n_, 1.0);
        inverse_units_.assign(n_, 1.0);
        from_.assign(n_, 0);
        ties_.assign(n_, -1.0);
        share_.resize(n_);
        for (std::size_t i = 0; i < n_; i++) share_[i] = 1 / std::max(std::norm(entry(i, i)), 1e-300);
        std::size_t last = 0;
        for (std::size_t known = 1; known < n_; known++) {
            ties_[last] = kJoined;
            std::size_t next = last;
            for (std::size_t j = 0; j < n_; j++) {
                if (ties_[j] == kJoined) continue;
                const double tie = std::norm(entry(last, j)) * share_[last] * (std::norm(entry(j, last)) * share_[j]);
                if (tie > ties_[j]) {
                    ties_[j] = tie;
                    from_[j] = last;
                }
                if (next == last || ties_[j] > ties_[next]) next = j;
            }
            if (ties_[next] > 0) {
                const std::size_t i = from_[next];
                units_[next] = times(units_[i], root(over(entry(i, next), entry(next, i))));
                inverse_units_[next] = inverse_of(units_[next]);
            }
            last = next;
        }
    }

    // To diagonal_ and beside_, of which beside_[k] stands between k and k + 1.
    GAINROOM_WIDE bool reduce() {
        for (std::size_t i = n_; i-- > 1;) {
            double *row_re = &re_[i * stride_], *row_im = &im_[i * stride_];
            Complex square = 0.0;
            double length = 0.0, rest = 0.0;
            for (std::size_t k = 0; k < i; k++) {
                square += Complex(row_re[k] * row_re[k] - row_im[k] * row_im[k], 2 * row_re[k] * row_im[k]);
                length += row_re[k] * row_re[k] + row_im[k] * row_im[k];
                if (k + 1 < i) rest = length;
            }
            const Complex last(row_re[i - 1], row_im[i - 1]);
            if (rest == 0) {
                beside_[i - 1] = last;
                continue;
            }
            if (!(std::norm(square) > kShortest * kShortest * length * length)) return false;
            Complex reflected = root(square);
            if (last.real() * reflected.real() + last.imag() * reflected.imag() < 0) reflected = -reflected;
            beside_[i - 1] = -reflected;
            const Complex pivot = last + reflected, half = square + times(reflected, last);  // uᵀu/2
            std::copy(row_re, row_re + i, u_re_.begin());
            std::copy(row_im, row_im + i, u_im_.begin());
            u_re_[i - 1] = pivot.real();
            u_im_[i - 1] = pivot.imag();
            const std::size_t end = (i + 3) / 4 * 4;
            std::fill(u_re_.begin() + i, u_re_.begin() + end, 0.0);
            std::fill(u_im_.begin() + i, u_im_.begin() + end, 0.0);
            multiply(i);
            const Complex inverse = over(1.0, half);
            Complex both = 0.0;  // uᵀ A u/h
            for (std::size_t k = 0; k < i; k++) {
                const Complex p = times({p_re_[k], p_im_[k]}, inverse);
                p_re_[k] = p.real();
                p_im_[k] = p.imag();
                both += times(p, {u_re_[k], u_im_[k]});
            }
            const Complex along = times(0.5 * both, inverse);
            for (std::size_t k = 0; k < i; k++) {
                const Complex less = times(along, {u_re_[k], u_im_[k]});
                p_re_[k] -= less.real();
                p_im_[k] -= less.imag();
            }
            subtract(i);
        }
        return true;
    }

    // p = A u of the first `count` rows and columns.
    GAINROOM_WIDE void multiply(std::size_t count) {
        std::fill(p_re_.begin(), p_re_.end(), 0.0);
        std::fill(p_im_.begin(), p_im_.end(), 0.0);
        for (std::size_t j = 0; j < count; j++) {
            const double *re = &re_[j * stride_], *im = &im_[j * stride_], x = u_re_[j], y = u_im_[j];
            const double nothing[4] = {};
            Four own_re = four(nothing), own_im = own_re;
            for (std::size_t k = 0; k < j; k += 4) {  // what is beyond the diagonal is 0
                const Four a = four(re + k), b = four(im + k), u = four(&u_re_[k]), v = four(&u_im_[k]);
                own_re += a * u - b * v;
                own_im += a * v + b * u;
                put(&p_re_[k], four(&p_re_[k]) + (x * a - y * b));
                put(&p_im_[k], four(&p_im_[k]) + (x * b + y * a));
            }
            double sums[8];
            put(sums, own_re);
            put(sums + 4, own_im);
            const Complex on = times(diagonal_[j], {x, y});
            p_re_[j] += (sums[0] + sums[1]) + (sums[2] + sums[3]) + on.real();
            p_im_[j] += (sums[4] + sums[5]) + (sums[6] + sums[7]) + on.imag();
        }
    }

    // A −= u pᵀ + p uᵀ in the first `count` rows.
    GAINROOM_WIDE void subtract(std::size_t count) {
        for (std::size_t j = 0; j < count; j++) {
            double *re = &re_[j * stride_], *im = &im_[j * stride_];
            const double x = u_re_[j], y = u_im_[j], v = p_re_[j], w = p_im_[j];
            for (std::size_t k = 0; k < j; k += 4) {
                const Four a = four(&u_re_[k]), b = four(&u_im_[k]), c = four(&p_re_[k]), d = four(&p_im_[k]);
                put(re + k, four(re + k) - (x * c - y * d + v * a - w * b));
                put(im + k, four(im + k) - (x * d + y * c + v * b + w * a));
            }
            diagonal_[j] -= 2.0 * times(Complex(x, y), Complex(v, w));
            for (std::size_t k = j; k < (j + 3) / 4 * 4; k++) re[k] = im[k] = 0.0;
        }
    }

    // Eigenvalues into diagonal_, from squares of what stands beside it.
    bool settled() {
        for (Complex& one : beside_) one = times(one, one);
        for (std::size_t low = 0; low < n_; low++) {
            for (int round = 0;; round++) {
                std::size_t high = low;
                while (high + 1 < n_ && !negligible(high)) high++;
                if (high == low) break;
                if (round == kRounds || !turn(low, high)) return false;
            }
        }
        return true;
    }

    // det(I + T) of the three diagonals.
    Complex determinant_beside_one() const {
        Complex before = 1.0, own = 1.0 + diagonal_[0];
        for (std::size_t k = 1; k < n_; k++) {
            const Complex next = times(1.0 + diagonal_[k], own) - times(times(beside_[k - 1], beside_[k - 1]), before);
            before = own;
            own = next;
        }
        return own;
    }

    bool negligible(std::size_t k) const {
        const double around = kEqual * (size(diagonal_[k]) + size(diagonal_[k + 1]));
        return size(beside_[k]) <= around * around;
    }

    // One sweep over a block, from its end to its begin, without roots (Reinsch 1973).
    bool turn(std::size_t low, std::size_t high) {
        const Complex beside = root(beside_[low]);
        Complex half = over(diagonal_[low + 1] - diagonal_[low], 2.0 * beside);
        const Complex corner = root(times(half, half) + 1.0);
        half += half.real() * corner.real() + half.imag() * corner.imag() < 0 ? -corner : corner;
        const Complex shift = diagonal_[low] - over(beside, half);
        Complex g = diagonal_[high] - shift, h = g, s = 0.0;
        for (std::size_t i = high; i-- > low;) {
            if (g == 0.0) g = h = kEqual * kEqual;
            const Complex p = times(g, h), r = p + beside_[i];
            if (!(std::norm(r) > kShortest * kShortest * (std::norm(p) + std::norm(beside_[i])))) return false;
            if (i + 1 < high) beside_[i + 1] = times(s, r);
            const Complex inverse = inverse_of(r), own = diagonal_[i] - shift;
            s = times(beside_[i], inverse);
            diagonal_[i + 1] = h + times(s, h + own) + shift;
            g = own - times(beside_[i], inverse_of(g));
            h = times(g, times(p, inverse));
        }
        beside_[low] = times(s, times(g, h));
        diagonal_[low] = h + shift;
        return true;
    }

    std::size_t n_ = 0, stride_ = 0;
    std::vector<double> re_, im_, u_re_, u_im_, p_re_, p_im_, ties_, share_;
    std::vector<Complex> units_, inverse_units_, diagonal_, beside_;
    std::vector<std::size_t> from_;
};

}  // namespace gainroom
