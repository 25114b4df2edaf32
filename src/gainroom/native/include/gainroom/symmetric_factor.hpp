// W + diag(β) = L D Lᵀ for a real symmetric W and complex β: what the tracker asks of that matrix.
//
// No rows are exchanged. A pivot may come out small where a part of the joints alone is near a resonance; digits are lost then, which the
// phase of the determinant does not need and a crossing makes good by its residual. Where Im β > 0 no pivot is small.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

#include "complex.hpp"
#include "joint_law.hpp"

namespace gainroom {

class SymmetricFactor {
public:
    explicit SymmetricFactor(std::size_t size) : size_(size), re_(size * size), im_(size * size), pivots_(size), inverse_(size) {}

    std::size_t size() const { return size_; }
    Complex pivot(std::size_t k) const { return pivots_[k]; }

    // `values` have β: JointValue, OpenValue.
    template <class Value>
    void factor(const double* w, const Value* values) {
        const std::size_t n = size_;
        for (std::size_t i = 0; i < n; i++) {
            for (std::size_t j = i; j < n; j++) {
                re_[i * n + j] = w[i * n + j];
                im_[i * n + j] = 0.0;
            }
            re_[i * n + i] += values[i].beta.real();
            im_[i * n + i] = values[i].beta.imag();
        }
        for (std::size_t k = 0; k < n; k++) {
            double *re = &re_[k * n], *im = &im_[k * n];
            Complex pivot(re[k], im[k]);
            if (std::fabs(pivot.real()) + std::fabs(pivot.imag()) < 1e-290) pivot = 1e-290;
            pivots_[k] = pivot;
            const Complex inverse = over(1.0, pivot);
            inverse_[k] = inverse;
            for (std::size_t i = k + 1; i < n; i++) {
                const Complex f = times(Complex(re[i], im[i]), inverse);
                double *to_re = &re_[i * n], *to_im = &im_[i * n];
                const double fr = f.real(), fi = f.imag();
                for (std::size_t j = i; j < n; j++) {
                    to_re[j] -= fr * re[j] - fi * im[j];
                    to_im[j] -= fr * im[j] + fi * re[j];
                }
            }
            for (std::size_t j = k + 1; j < n; j++) {  // from here on a row of Lᵀ
                const Complex l = times(Complex(re[j], im[j]), inverse);
                re[j] = l.real();
                im[j] = l.imag();
            }
        }
    }

    // In place.
    void solve(Complex* b) const {
        const std::size_t n = size_;
        for (std::size_t k = 0; k < n; k++)
            for (std::size_t j = k + 1; j < n; j++) b[j] -= times(Complex(re_[k * n + j], im_[k * n + j]), b[k]);
        for (std::size_t k = n; k-- > 0;) {
            Complex sum = times(b[k], inverse_[k]);
            for (std::size_t j = k + 1; j < n; j++) sum -= times(Complex(re_[k * n + j], im_[k * n + j]), b[j]);
            b[k] = sum;
        }
    }

    // The same for `columns`, which the compiler knows where Columns is not 0: n rows of real and of imaginary parts.
    template <std::size_t Columns = 0>
    void solve(double* re, double* im, std::size_t columns) const {
        const std::size_t n = size_, count = Columns ? Columns : columns;
        for (std::size_t k = 0; k < n; k++)
            for (std::size_t j = k + 1; j < n; j++) subtract_row(re, im, j, k, re_[k * n + j], im_[k * n + j], count);
        for (std::size_t k = n; k-- > 0;) {
            const double a = inverse_[k].real(), b = inverse_[k].imag();
            for (std::size_t c = k * count; c < (k + 1) * count; c++) {
                const double x = re[c];
                re[c] = a * x - b * im[c];
                im[c] = a * im[c] + b * x;
            }
            for (std::size_t j = k + 1; j < n; j++) subtract_row(re, im, k, j, re_[k * n + j], im_[k * n + j], count);
        }
    }

    // tr((W + diag β)⁻¹ diag(β_ω)); `work` 2 n² numbers: L⁻¹ by rows.
    Complex trace(const JointValue* values, double* work) const {
        const std::size_t n = size_;
        double *re = work, *im = work + n * n;
        Complex sum = 0.0;
        for (std::size_t k = 0; k < n; k++) {
            double *row_re = re + k * n, *row_im = im + k * n;
            for (std::size_t j = 0; j < k; j++) row_re[j] = row_im[j] = 0.0;
            row_re[k] = 1.0;
            row_im[k] = 0.0;
            for (std::size_t m = 0; m < k; m++) {
                const double lr = re_[m * n + k], li = im_[m * n + k];
                const double *from_re = re + m * n, *from_im = im + m * n;
                for (std::size_t j = 0; j <= m; j++) {
                    row_re[j] -= lr * from_re[j] - li * from_im[j];
                    row_im[j] -= lr * from_im[j] + li * from_re[j];
                }
            }
            Complex own = 0.0;
            for (std::size_t j = 0; j <= k; j++) {
                const Complex entry(row_re[j], row_im[j]);
                own += times(times(entry, entry), values[j].beta_omega);
            }
            sum += times(own, inverse_[k]);
        }
        return sum;
    }

private:
    static void subtract_row(double* re, double* im, std::size_t to, std::size_t from, double a, double b, std::size_t count) {
        double *tr = re + to * count, *ti = im + to * count;
        const double *fr = re + from * count, *fi = im + from * count;
        for (std::size_t c = 0; c < count; c++) {
            tr[c] -= a * fr[c] - b * fi[c];
            ti[c] -= a * fi[c] + b * fr[c];
        }
    }

    std::size_t size_;
    std::vector<double> re_, im_;
    std::vector<Complex> pivots_, inverse_;
};

}  // namespace gainroom
