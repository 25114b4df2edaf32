// Eigenvalues of small dense complex matrices.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "complex.hpp"

namespace gainroom {

// Hessenberg form by elimination, then LR with shifts and exchanges, which takes a third of QR's products (Martin and Wilkinson 1968). It
// may lose digits where QR does not: sums of eigenvalues and of their squares tell, and then QR follows (Golub and Van Loan, section 7.5).
class Eigenvalues {
public:
    // Of a (n, n), which is destroyed. False where they do not settle, or an entry is not finite.
    bool find(std::vector<Complex>& a, std::size_t n, Complex* values) {
        a_ = a.data();
        n_ = n;
        double most = 0.0;
        for (std::size_t k = 0; k < n * n; k++) {
            if (!std::isfinite(size(a_[k]))) return false;
            most = std::max(most, size(a_[k]));
        }
        if (most == 0) {
            std::fill(values, values + n, Complex(0.0));
            return true;
        }
        Complex sum = 0.0, squares = 0.0;
        for (std::size_t k = 0; k < n * n; k++) a_[k] /= most;  // so that no square leaves the range
        for (std::size_t r = 0; r < n; r++) {
            sum += entry(r, r);
            for (std::size_t c = 0; c < n; c++) squares += times(entry(r, c), entry(c, r));
        }
        reduce();
        form_.assign(a_, a_ + n * n);
        bool found = settled(values, false);
        for (std::size_t k = 0; found && k < n; k++) {
            sum -= values[k];
            squares -= times(values[k], values[k]);
        }
        if (!found || !(size(sum) + size(squares) < kAgree)) {
            std::copy(form_.begin(), form_.end(), a_);
            found = settled(values, true);
        }
        for (std::size_t k = 0; k < n; k++) {
            values[k] *= most;
            found = found && std::isfinite(size(values[k]));
        }
        return found;
    }

private:
    static constexpr double kAgree = 1e-11;  // of the largest entry

    bool settled(Complex* values, bool unitary) {
        std::size_t high = n_;
        for (int round = 0; high > 0;) {
            const std::size_t low = start_of_block(high);
            if (low + 1 == high) {
                values[--high] = entry(low, low);
                round = 0;
                continue;
            }
            if (++round > 90) return false;
            const Complex own = shift(high, round);
            if (unitary) step(low, high, own);
            else eliminate(low, high, own);
        }
        return true;
    }

    // H − shift = L R with exchanges of rows, then R L + shift.
    GAINROOM_WIDE void eliminate(std::size_t low, std::size_t high, Complex shift) {
        factor_.resize(n_);
        exchanged_.assign(n_, 0);
        for (std::size_t k = low; k < high; k++) entry(k, k) -= shift;
        for (std::size_t k = low; k + 1 < high; k++) {
            Complex *upper = a_ + k * n_, *lower = upper + n_;
            if (size(lower[k]) > size(upper[k])) {
                exchanged_[k] = 1;
                std::swap_ranges(upper + k, upper + high, lower + k);
            }
            factor_[k] = upper[k] == 0.0 ? Complex(0.0) : over(lower[k], upper[k]);
            lower[k] = 0.0;
            for (std::size_t c = k + 1; c < high; c++) lower[c] -= times(factor_[k], upper[c]);
        }
        for (std::size_t r = low; r < high; r++) {  // R L, row by row
            Complex* row = a_ + r * n_;
            for (std::size_t k = r > low ? r - 1 : low; k + 1 < high; k++) {
                if (exchanged_[k]) std::swap(row[k], row[k + 1]);
                row[k] += times(factor_[k], row[k + 1]);
            }
        }
        for (std::size_t k = low; k < high; k++) entry(k, k) += shift;
    }

    Complex& entry(std::size_t r, std::size_t c) { return a_[r * n_ + c]; }
    static double size(Complex a) { return std::fabs(a.real()) + std::fabs(a.imag()); }

    GAINROOM_WIDE void reduce() {
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
    std::vector<Complex> cosine_, sine_, factor_, form_;
    std::vector<char> exchanged_;
};

}  // namespace gainroom
