// W + diag(β) = L D Lᵀ for a real symmetric W and complex β: what the tracker asks of that matrix.
//
// No rows are exchanged. A pivot may come out small where a part of the joints alone is near a resonance; digits are lost then, which the
// phase of the determinant does not need and a crossing makes good by its residual. Where Im β > 0 no pivot is small.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "block.hpp"
#include "complex.hpp"
#include "four.hpp"
#include "joint_law.hpp"

namespace gainroom {

// W x of a symmetric W (n, n).
GAINROOM_WIDE inline void product(const double* w, const Complex* x, std::size_t n, Complex* out) {
    std::size_t i = 0;
    for (; i + 4 <= n; i += 4) {
        double re[4] = {}, im[4] = {};
        Four a = four(re), b = a;
        for (std::size_t j = 0; j < n; j++) {
            const Four row = four(w + j * n + i);
            a += x[j].real() * row;
            b += x[j].imag() * row;
        }
        put(re, a);
        put(im, b);
        for (std::size_t k = 0; k < 4; k++) out[i + k] = {re[k], im[k]};
    }
    for (; i < n; i++) {
        out[i] = 0.0;
        for (std::size_t j = 0; j < n; j++) out[i] += w[j * n + i] * x[j];
    }
}

class SymmetricFactor {
public:
    explicit SymmetricFactor(std::size_t size)
        : size_(size), stride_(fours(size)), re_(size * stride_), im_(size * stride_), side_(2 * stride_), pivots_(size), inverse_(size) {}

    // Numbers that `trace` needs room for.
    static std::size_t room(std::size_t size) { return 2 * (size + 1) * fours(size); }

    std::size_t size() const { return size_; }
    Complex pivot(std::size_t k) const { return pivots_[k]; }

    // `values` have β: JointValue, OpenValue.
    template <class Value>
    void factor(const double* w, const Value* values) {
        for (std::size_t i = 0; i < size_; i++) {
            double *re = &re_[i * stride_], *im = &im_[i * stride_];
            for (std::size_t j = 0; j < stride_; j++) {
                re[j] = j < size_ ? w[i * size_ + j] : 0.0;
                im[j] = 0.0;
            }
            re[i] += values[i].beta.real();
            im[i] = values[i].beta.imag();
        }
        eliminate();
    }

    // Any symmetric matrix: `entry(i, j)`, j ≥ i.
    template <class Entry>
    void factor(Entry entry) {
        for (std::size_t i = 0; i < size_; i++)
            for (std::size_t j = i; j < stride_; j++) {
                const Complex value = j < size_ ? entry(i, j) : Complex(0.0);
                re_[i * stride_ + j] = value.real();
                im_[i * stride_ + j] = value.imag();
            }
        eliminate();
    }

    // Of L, apart from its diagonal of 1: large where digits are lost.
    double largest() const {
        double most = 0.0;
        for (std::size_t k = 0; k < size_; k++)
            for (std::size_t j = k + 1; j < size_; j++) most = std::max(most, std::norm(lower(k, j)));
        return std::sqrt(most);
    }

    // In place.
    GAINROOM_WIDE void solve(Complex* b) const {
        double *re = side_.data(), *im = re + stride_;
        for (std::size_t k = 0; k < size_; k++) {
            re[k] = b[k].real();
            im[k] = b[k].imag();
        }
        for (std::size_t k = 0; k < size_; k++) {
            const Complex own(re[k], im[k]);
            b[k] = times(own, inverse_[k]);
            subtract(re, im, &re_[k * stride_], &im_[k * stride_], own, k + 1, stride_);
        }
        for (std::size_t end = stride_; end > 0; end -= 4) {  // four at a time: they are read back as a whole
            const std::size_t last = std::min(end, size_);
            for (std::size_t k = last; k-- > end - 4;) {
                b[k] -= product_of_rows(&re_[k * stride_], &im_[k * stride_], re, im, end, stride_);
                for (std::size_t j = k + 1; j < last; j++) b[k] -= times(lower(k, j), b[j]);
            }
            for (std::size_t k = end - 4; k < end; k++) {
                re[k] = k < last ? b[k].real() : 0.0;
                im[k] = k < last ? b[k].imag() : 0.0;
            }
        }
    }

    // The same for `columns`, whole fours: n rows of real and of imaginary parts.
    GAINROOM_WIDE void solve(double* re, double* im, std::size_t columns) const {
        const std::size_t n = size_;
        const auto take = [&](std::size_t to, std::size_t from, Complex factor) {
            subtract(re + to * columns, im + to * columns, re + from * columns, im + from * columns, factor, 0, columns);
        };
        for (std::size_t k = 0; k < n; k++)
            for (std::size_t j = k + 1; j < n; j++) take(j, k, lower(k, j));
        for (std::size_t k = n; k-- > 0;) {
            scale(re + k * columns, im + k * columns, inverse_[k], 0, columns);
            for (std::size_t j = k + 1; j < n; j++) take(k, j, lower(k, j));
        }
    }

    // tr((W + diag β)⁻¹ diag(β_ω)); `work`, with `room`.
    Complex trace(const JointValue* values, double* work) const {
        double *slope_re = work + 2 * size_ * stride_, *slope_im = slope_re + stride_;
        for (std::size_t j = 0; j < stride_; j++) {
            const Complex slope = j < size_ ? values[j].beta_omega : Complex(0.0);
            slope_re[j] = slope.real();
            slope_im[j] = slope.imag();
        }
        Complex sum = 0.0;
        inverted(work, [&](std::size_t k, const double* re, const double* im) {
            sum += times(sum_of_squares(re, im, slope_re, slope_im, k + 1), inverse_[k]);
        });
        return sum;
    }

    // Diagonal of the inverse (n).
    void inverse_diagonal(double* work, Complex* found) const {
        std::fill(found, found + size_, Complex(0.0));
        inverted(work, [&](std::size_t k, const double* re, const double* im) {
            for (std::size_t j = 0; j <= k; j++) found[j] += times(square(re[j], im[j]), inverse_[k]);
        });
    }

private:
    // Entry (j, k) of L, j > k.
    GAINROOM_INLINE Complex lower(std::size_t k, std::size_t j) const { return {re_[k * stride_ + j], im_[k * stride_ + j]}; }

    static Complex square(double re, double im) { return {re * re - im * im, 2 * re * im}; }

    // Σ (re + j im)² times what they count, up to whole fours.
    GAINROOM_WIDE static Complex sum_of_squares(const double* re, const double* im, const double* count_re, const double* count_im, std::size_t end) {
        const double nothing[4] = {};
        Four whole_re = four(nothing), whole_im = whole_re;
        for (std::size_t j = 0; j < end; j += 4) {
            const Four a = four(re + j), b = four(im + j), u = four(count_re + j), v = four(count_im + j);
            const Four real = a * a - b * b, half = a * b, imaginary = half + half;
            whole_re += real * u - imaginary * v;
            whole_im += real * v + imaginary * u;
        }
        return {sum_of(whole_re), sum_of(whole_im)};
    }

    // Σ (a_re + j a_im) (b_re + j b_im) from `first` to before `end`, both whole fours.
    GAINROOM_INLINE static Complex product_of_rows(const double* a_re, const double* a_im, const double* b_re, const double* b_im, std::size_t first,
                                                   std::size_t end) {
        const double nothing[4] = {};
        Four re_re = four(nothing), im_im = re_re, re_im = re_re, im_re = re_re;  // one alone would wait for its own sum
        for (std::size_t j = first; j < end; j += 4) {
            const Four p = four(a_re + j), q = four(a_im + j), u = four(b_re + j), v = four(b_im + j);
            re_re += p * u;
            im_im += q * v;
            re_im += p * v;
            im_re += q * u;
        }
        return {sum_of(re_re - im_im), sum_of(re_im + im_re)};
    }

    // L⁻¹ row by row, into `work` and to `use(k, re, im)`: of row k the first k + 1.
    template <class Use>
    void inverted(double* work, Use use) const {
        double *re = work, *im = work + size_ * stride_;
        for (std::size_t k = 0; k < size_; k++) {
            next_row(re, im, k);
            use(k, re + k * stride_, im + k * stride_);
        }
    }

    GAINROOM_WIDE void next_row(double* re, double* im, std::size_t k) const {
        double *row_re = re + k * stride_, *row_im = im + k * stride_;
        for (std::size_t j = 0; j < stride_; j++) row_re[j] = row_im[j] = 0.0;
        row_re[k] = 1.0;
        for (std::size_t m = 0; m < k; m++) subtract(row_re, row_im, re + m * stride_, im + m * stride_, lower(m, k), 0, m + 1);
    }

    // Upper triangle → pivots, and a row of Lᵀ behind each.
    GAINROOM_WIDE void eliminate() {
        for (std::size_t k = 0; k < size_; k++) {
            double *re = &re_[k * stride_], *im = &im_[k * stride_];
            Complex pivot(re[k], im[k]);
            if (std::fabs(pivot.real()) + std::fabs(pivot.imag()) < 1e-290) pivot = 1e-290;
            pivots_[k] = pivot;
            const Complex inverse = inverse_of(pivot);
            inverse_[k] = inverse;
            for (std::size_t i = k + 1; i < size_; i++)
                subtract(&re_[i * stride_], &im_[i * stride_], re, im, times(Complex(re[i], im[i]), inverse), i, stride_);
            scale(re, im, inverse, k + 1, stride_);
        }
    }

    // Entries from `first` to before `end` of a row, and others with them up to whole fours: take `factor` times another row.
    GAINROOM_INLINE static void subtract(double* to_re, double* to_im, const double* re, const double* im, Complex factor, std::size_t first,
                                std::size_t end) {
        for (std::size_t j = first / 4 * 4; j < end; j += 4)
            subtract_complex(to_re + j, to_im + j, factor.real(), factor.imag(), re + j, im + j);
    }

    GAINROOM_INLINE static void scale(double* re, double* im, Complex factor, std::size_t first, std::size_t end) {
        const double a = factor.real(), b = factor.imag();
        for (std::size_t j = first / 4 * 4; j < end; j += 4) {
            const Four x = four(re + j), y = four(im + j);
            put(re + j, a * x - b * y);
            put(im + j, a * y + b * x);
        }
    }

    std::size_t size_, stride_;  // whole fours
    Numbers re_, im_;  // what is below the diagonal is not read; beyond the end of a row are zeros
    mutable Numbers side_;  // the one that is solved for
    Vector<Complex> pivots_, inverse_;
};

}  // namespace gainroom
