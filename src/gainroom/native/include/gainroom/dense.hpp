// Small dense complex matrices, by rows: inverse with determinant, linear equations, eigenvalues and one pair of eigenvectors.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "complex.hpp"

namespace gainroom {

// A matrix with its real and imaginary parts apart, so that rows are added several entries at a time.
struct Dense {
    std::size_t rows = 0, columns = 0;
    std::vector<double> re, im;

    void resize(std::size_t r, std::size_t c) {
        rows = r;
        columns = c;
        re.assign(r * c, 0.0);
        im.assign(r * c, 0.0);
    }
    Complex at(std::size_t r, std::size_t c) const { return {re[r * columns + c], im[r * columns + c]}; }
    void set(std::size_t r, std::size_t c, Complex value) {
        re[r * columns + c] = value.real();
        im[r * columns + c] = value.imag();
    }
    // Row `to` −= factor × row `from`, from column `first` on.
    void subtract(std::size_t to, std::size_t from, Complex factor, std::size_t first) {
        double *tr = &re[to * columns], *ti = &im[to * columns];
        const double *fr = &re[from * columns], *fi = &im[from * columns], a = factor.real(), b = factor.imag();
        for (std::size_t c = first; c < columns; c++) {
            tr[c] -= a * fr[c] - b * fi[c];
            ti[c] -= a * fi[c] + b * fr[c];
        }
    }
    void scale(std::size_t row, Complex factor, std::size_t first) {
        double *r = &re[row * columns], *i = &im[row * columns];
        for (std::size_t c = first; c < columns; c++) {
            const double value = r[c];
            r[c] = value * factor.real() - i[c] * factor.imag();
            i[c] = value * factor.imag() + i[c] * factor.real();
        }
    }
    // The row, from `k` on, whose entry in column k is largest; false where all are 0 or one is not finite.
    bool pivot(std::size_t k, std::size_t& found) const {
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
    void exchange(std::size_t a, std::size_t b) {
        for (std::size_t c = 0; a != b && c < columns; c++) {
            std::swap(re[a * columns + c], re[b * columns + c]);
            std::swap(im[a * columns + c], im[b * columns + c]);
        }
    }
};

// ln det of a matrix, its imaginary part in (−π, π]: pivots are multiplied, so that few logarithms are taken.
class LogDeterminant {
public:
    void multiply(Complex pivot) {
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
inline bool invert(Dense& a, std::vector<std::size_t>& exchanged, LogDeterminant& determinant) {
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

// [A | B] (n, n + c) → B becomes A⁻¹B, by elimination with exchanges of rows; false where A is singular. `hessenberg`: A has that form.
inline bool solve(Dense& system, bool hessenberg = false) {
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

// |A⁸|_F^(1/8) ≥ every |eigenvalue| of A (n, n), which is destroyed.
inline double radius_bound(Dense& a, Dense& square) {
    for (int power = 0; power < 3; power++) {
        square.resize(a.rows, a.rows);
        for (std::size_t i = 0; i < a.rows; i++)
            for (std::size_t k = 0; k < a.rows; k++) {
                const double re = a.re[i * a.columns + k], im = a.im[i * a.columns + k];
                double *to_re = &square.re[i * a.columns], *to_im = &square.im[i * a.columns];
                const double *from_re = &a.re[k * a.columns], *from_im = &a.im[k * a.columns];
                for (std::size_t j = 0; j < a.columns; j++) {
                    to_re[j] += re * from_re[j] - im * from_im[j];
                    to_im[j] += re * from_im[j] + im * from_re[j];
                }
            }
        std::swap(a, square);
    }
    double size = 0.0;
    for (std::size_t k = 0; k < a.re.size(); k++) size += a.re[k] * a.re[k] + a.im[k] * a.im[k];
    return std::pow(size, 0.0625);
}

// Eigenvalues of a (n, n), which is destroyed: Hessenberg form by elimination, then QR with shifts (Golub and Van Loan, sections 7.4, 7.5).
// False where they do not settle, or an entry is not finite.
class Eigenvalues {
public:
    bool find(std::vector<Complex>& a, std::size_t n, Complex* values) {
        a_ = a.data();
        n_ = n;
        double most = 0.0;
        for (std::size_t k = 0; k < n * n; k++) {
            if (!std::isfinite(size(a_[k]))) return false;
            most = std::max(most, size(a_[k]));
        }
        for (std::size_t k = 0; most > 0 && k < n * n; k++) a_[k] /= most;  // so that no square leaves the range
        reduce();
        std::size_t high = n;
        for (int round = 0; high > 0;) {
            const std::size_t low = start_of_block(high);
            if (low + 1 == high) {
                values[--high] = entry(low, low) * most;
                round = 0;
                continue;
            }
            if (++round > 90) return false;
            step(low, high, shift(high, round));
        }
        return true;
    }

private:
    Complex& entry(std::size_t r, std::size_t c) { return a_[r * n_ + c]; }
    static double size(Complex a) { return std::fabs(a.real()) + std::fabs(a.imag()); }

    void reduce() {
        for (std::size_t m = 1; m + 1 < n_; m++) {
            std::size_t row = m;
            for (std::size_t r = m + 1; r < n_; r++)
                if (size(entry(r, m - 1)) > size(entry(row, m - 1))) row = r;
            if (size(entry(row, m - 1)) == 0) continue;
            if (row != m) {
                for (std::size_t c = m - 1; c < n_; c++) std::swap(entry(row, c), entry(m, c));
                for (std::size_t r = 0; r < n_; r++) std::swap(entry(r, row), entry(r, m));
            }
            const Complex inverse = over(1.0, entry(m, m - 1));
            for (std::size_t r = m + 1; r < n_; r++) {
                if (size(entry(r, m - 1)) == 0) continue;
                const Complex factor = times(entry(r, m - 1), inverse);
                entry(r, m - 1) = 0.0;
                for (std::size_t c = m; c < n_; c++) entry(r, c) -= times(factor, entry(m, c));
                for (std::size_t k = 0; k < n_; k++) entry(k, m) += times(factor, entry(k, r));
            }
        }
    }

    std::size_t start_of_block(std::size_t high) {
        for (std::size_t low = high - 1; low > 0; low--) {
            double beside = size(entry(low - 1, low - 1)) + size(entry(low, low));
            if (beside == 0) beside = 1e-300;
            if (size(entry(low, low - 1)) <= 2.3e-16 * beside) {
                entry(low, low - 1) = 0.0;
                return low;
            }
        }
        return 0;
    }

    // The eigenvalue of the last two rows that is nearer to the last entry; now and then something else, as a cycle is possible.
    Complex shift(std::size_t high, int round) {
        const Complex a = entry(high - 2, high - 2), b = entry(high - 2, high - 1), c = entry(high - 1, high - 2), d = entry(high - 1, high - 1);
        if (round % 15 == 0) return d + size(c);
        const Complex half = 0.5 * (a - d), root = std::sqrt(times(half, half) + times(b, c));
        const Complex larger = std::norm(half + root) > std::norm(half - root) ? half + root : half - root;
        return larger == 0.0 ? d : d - over(times(b, c), larger);
    }

    void step(std::size_t low, std::size_t high, Complex shift) {
        cosine_.resize(n_);
        sine_.resize(n_);
        for (std::size_t k = low; k < high; k++) entry(k, k) -= shift;
        for (std::size_t k = low; k + 1 < high; k++) {
            const Complex a = entry(k, k), b = entry(k + 1, k);
            const double length = std::sqrt(std::norm(a) + std::norm(b));
            const Complex c = length > 0 ? a / length : Complex(1.0), s = length > 0 ? b / length : Complex(0.0);
            cosine_[k] = c;
            sine_[k] = s;
            for (std::size_t j = k; j < high; j++) {
                const Complex upper = entry(k, j), lower = entry(k + 1, j);
                entry(k, j) = times(std::conj(c), upper) + times(std::conj(s), lower);
                entry(k + 1, j) = times(c, lower) - times(s, upper);
            }
        }
        for (std::size_t k = low; k + 1 < high; k++) {
            const Complex c = cosine_[k], s = sine_[k];
            for (std::size_t r = low; r < std::min(k + 2, high); r++) {
                const Complex left = entry(r, k), right = entry(r, k + 1);
                entry(r, k) = times(left, c) + times(right, s);
                entry(r, k + 1) = times(right, std::conj(c)) - times(left, std::conj(s));
            }
        }
        for (std::size_t k = low; k < high; k++) entry(k, k) += shift;
    }

    Complex* a_ = nullptr;
    std::size_t n_ = 0;
    std::vector<Complex> cosine_, sine_;
};

}  // namespace gainroom
