// Small dense complex matrices, by rows: inverse with determinant, factors, linear equations.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>

#include "block.hpp"
#include "complex.hpp"
#include "four.hpp"

namespace gainroom {

// A matrix with its real and imaginary parts apart, so that rows are added several entries at a time.
struct Dense {
    std::size_t rows = 0, columns = 0;
    Vector<double> re, im;

    void resize(std::size_t r, std::size_t c) {
        rows = r;
        columns = c;
        re.assign(r * c, 0.0);
        im.assign(r * c, 0.0);
    }
    // The same, for what sets every entry.
    void shape(std::size_t r, std::size_t c) {
        rows = r;
        columns = c;
        re.resize(r * c);
        im.resize(r * c);
    }
    // All entries, by rows.
    void copy(const Complex* from) {
        for (std::size_t k = 0; k < rows * columns; k++) {
            re[k] = from[k].real();
            im[k] = from[k].imag();
        }
    }
    GAINROOM_INLINE Complex at(std::size_t r, std::size_t c) const { return {re[r * columns + c], im[r * columns + c]}; }
    GAINROOM_INLINE void set(std::size_t r, std::size_t c, Complex value) {
        re[r * columns + c] = value.real();
        im[r * columns + c] = value.imag();
    }
    // Row `to` −= factor × row `from`, from column `first` on.
    GAINROOM_INLINE void subtract(std::size_t to, std::size_t from, Complex factor, std::size_t first) {
        double *tr = &re[to * columns], *ti = &im[to * columns];
        const double *fr = &re[from * columns], *fi = &im[from * columns], a = factor.real(), b = factor.imag();
        std::size_t c = first;
        for (; c + 4 <= columns; c += 4) subtract_complex(tr + c, ti + c, a, b, fr + c, fi + c);
        for (; c < columns; c++) {
            tr[c] -= a * fr[c] - b * fi[c];
            ti[c] -= a * fi[c] + b * fr[c];
        }
    }
    GAINROOM_INLINE void scale(std::size_t row, Complex factor, std::size_t first) {
        double *r = &re[row * columns], *i = &im[row * columns];
        for (std::size_t c = first; c < columns; c++) {
            const double value = r[c];
            r[c] = value * factor.real() - i[c] * factor.imag();
            i[c] = value * factor.imag() + i[c] * factor.real();
        }
    }
    // The row, from `k` on, whose entry in column k is largest; false where all are 0 or one is not finite.
    GAINROOM_INLINE bool pivot(std::size_t k, std::size_t& found) const {
        double most = 0.0;
        for (std::size_t r = k; r < rows; r++) {
            const double size = std::fabs(re[r * columns + k]) + std::fabs(im[r * columns + k]);
            if (!std::isfinite(size)) return false;
            if (size > most) {
                most = size;
                found = r;
            }
        }
        return most > 0;
    }
    GAINROOM_INLINE void exchange(std::size_t a, std::size_t b) {
        for (std::size_t c = 0; a != b && c < columns; c++) {
            std::swap(re[a * columns + c], re[b * columns + c]);
            std::swap(im[a * columns + c], im[b * columns + c]);
        }
    }
};

// ln det of a matrix, its imaginary part in (−π, π]: pivots are multiplied, so that few logarithms are taken.
class LogDeterminant {
public:
    GAINROOM_INLINE void multiply(Complex pivot) {
        product_ = times(product_, pivot);
        const double size = std::norm(product_);
        if (!(size > 1e-100 && size < 1e100)) {
            size_ += 0.5 * std::log(size);
            product_ /= std::sqrt(size);
        }
    }
    Complex value() const { return {size_ + 0.5 * std::log(std::norm(product_)), std::atan2(product_.imag(), product_.real())}; }

private:
    Complex product_ = 1.0;
    double size_ = 0.0;
};

// A (n, n) → A⁻¹ in its place, by Gauss and Jordan with exchanges of rows; false where it is singular.
GAINROOM_WIDE inline bool invert(Dense& a, Vector<std::size_t>& exchanged, LogDeterminant& determinant) {
    const std::size_t n = a.rows;
    exchanged.resize(n);
    for (std::size_t k = 0; k < n; k++) {
        std::size_t row = k;
        if (!a.pivot(k, row)) return false;
        exchanged[k] = row;
        a.exchange(k, row);
        const Complex pivot = a.at(k, k);
        determinant.multiply(row == k ? pivot : -pivot);
        a.set(k, k, 1.0);
        a.scale(k, over(1.0, pivot), 0);
        for (std::size_t r = 0; r < n; r++) {
            if (r == k) continue;
            const Complex factor = a.at(r, k);
            a.set(r, k, 0.0);
            a.subtract(r, k, factor, 0);
        }
    }
    for (std::size_t k = n; k-- > 0;)
        for (std::size_t r = 0; exchanged[k] != k && r < n; r++) {
            const Complex value = a.at(r, k);
            a.set(r, k, a.at(r, exchanged[k]));
            a.set(r, exchanged[k], value);
        }
    return true;
}

// A (n, n) → L below the diagonal, where it is 1, and U of its exchanged rows; false where it is singular.
GAINROOM_WIDE inline bool factorise(Dense& a, Vector<std::size_t>& exchanged) {
    exchanged.resize(a.rows);
    for (std::size_t k = 0; k < a.rows; k++) {
        std::size_t row = k;
        if (!a.pivot(k, row)) return false;
        exchanged[k] = row;
        a.exchange(k, row);
        const Complex inverse = over(1.0, a.at(k, k));
        for (std::size_t r = k + 1; r < a.rows; r++) {
            const Complex factor = times(a.at(r, k), inverse);
            a.set(r, k, factor);
            a.subtract(r, k, factor, k + 1);
        }
    }
    return true;
}

// b (n) → A⁻¹ b, of a matrix that is factorised.
inline void solve_factorised(const Dense& a, const Vector<std::size_t>& exchanged, Complex* b) {
    const std::size_t n = a.rows;
    for (std::size_t k = 0; k < n; k++) std::swap(b[k], b[exchanged[k]]);
    for (std::size_t r = 0; r < n; r++)
        for (std::size_t c = 0; c < r; c++) b[r] -= times(a.at(r, c), b[c]);
    for (std::size_t r = n; r-- > 0;) {
        for (std::size_t c = r + 1; c < n; c++) b[r] -= times(a.at(r, c), b[c]);
        b[r] = over(b[r], a.at(r, r));
    }
}

// Solution with the transpose: a row b → b A⁻¹.
inline void solve_transposed(const Dense& a, const Vector<std::size_t>& exchanged, Complex* b) {
    const std::size_t n = a.rows;
    for (std::size_t k = 0; k < n; k++) {
        b[k] = over(b[k], a.at(k, k));
        for (std::size_t c = k + 1; c < n; c++) b[c] -= times(b[k], a.at(k, c));
    }
    for (std::size_t k = n; k-- > 0;)
        for (std::size_t c = 0; c < k; c++) b[c] -= times(b[k], a.at(k, c));
    for (std::size_t k = n; k-- > 0;) std::swap(b[k], b[exchanged[k]]);
}

// [A | B] (n, n + c) → B becomes A⁻¹B, by elimination with exchanges of rows; false where A is singular. `hessenberg`: A has that form.
GAINROOM_WIDE inline bool solve(Dense& system, bool hessenberg = false) {
    const std::size_t n = system.rows;
    for (std::size_t k = 0; k < n; k++) {
        const std::size_t end = hessenberg ? std::min(n, k + 2) : n;
        std::size_t row = k;
        if (hessenberg) {
            const auto size = [&](std::size_t r) { return std::abs(system.at(r, k)); };
            if (end > k + 1 && size(k + 1) > size(k)) row = k + 1;
            if (!(size(row) > 0) || !std::isfinite(size(row))) return false;
        } else if (!system.pivot(k, row)) {
            return false;
        }
        system.exchange(k, row);
        const Complex inverse = over(1.0, system.at(k, k));
        for (std::size_t r = k + 1; r < end; r++) {
            const Complex entry = system.at(r, k);
            if (entry != 0.0) system.subtract(r, k, times(entry, inverse), k);
        }
    }
    for (std::size_t k = n; k-- > 0;) {
        system.scale(k, over(1.0, system.at(k, k)), n);
        for (std::size_t r = 0; r < k; r++) {
            const Complex entry = system.at(r, k);
            if (entry != 0.0) system.subtract(r, k, entry, n);
        }
    }
    return true;
}

}  // namespace gainroom
