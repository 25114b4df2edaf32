// Scales that balance a complex matrix, and the small positive systems that Newton's methods about them solve.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "dense.hpp"

namespace gainroom {

// b ← a⁻¹ b, of a positive a (n, n) whose upper half is read and which is destroyed. Pivots that rounding takes away count as small ones.
inline void solve_positive(std::vector<double>& a, std::vector<double>& b) {
    const std::size_t n = b.size();
    double most = 0.0;
    for (std::size_t i = 0; i < n; i++) most = std::max(most, a[i * n + i]);
    for (std::size_t k = 0; k < n; k++) {
        double* row = &a[k * n];
        row[k] = std::max(row[k], 1e-15 * most + 1e-300);
        for (std::size_t i = k + 1; i < n; i++) {
            const double factor = row[i] / row[k];
            for (std::size_t j = i; j < n; j++) a[i * n + j] -= factor * row[j];
            b[i] -= factor * b[k];
        }
    }
    for (std::size_t k = n; k-- > 0;) {
        for (std::size_t j = k + 1; j < n; j++) b[k] -= a[k * n + j] * b[j];
        b[k] /= a[k * n + k];
    }
}

// `step`, shortened where an entry exceeds `most`; 0 where it is not a number.
inline void shorten(std::vector<double>& step, double most) {
    double largest = 0.0;
    for (const double value : step) largest = std::max(largest, std::fabs(value));
    const double factor = largest > most ? most / largest : 1.0;
    for (double& value : step) value = std::isfinite(factor * value) ? factor * value : 0.0;
}

inline void centre(double* x, std::size_t n) {
    double sum = 0.0;
    for (std::size_t i = 0; i < n; i++) sum += x[i];
    for (std::size_t i = 0; i < n; i++) x[i] -= sum / double(n);
}

class Balancing {
public:
    explicit Balancing(std::size_t n)
        : n_(n), up_(n), down_(n), rows_(n), columns_(n), step_(n), squares_(n * n), changed_(n * n), filled_(n * n) {}

    // x, from where it is, to where the Frobenius norm of D M D⁻¹ is nearly least, by Newton's method on its convex logarithm.
    void run(const Dense& m, double* x) {
        const std::size_t n = n_;
        double most = 0.0;
        for (std::size_t k = 0; k < n * n; k++) {
            squares_[k] = m.re[k] * m.re[k] + m.im[k] * m.im[k];
            most = std::max(most, squares_[k]);
        }
        if (n < 2 || !std::isfinite(most)) return;
        for (std::size_t k = 0; k < n * n; k++) squares_[k] += kSmallestEntry * kSmallestEntry * most + 1e-300;
        for (std::size_t i = 0; i < n; i++) squares_[i * n + i] = 0.0;
        for (int round = 0; round < kRounds && step(x); round++) {}
        centre(x, n);
    }

private:
    static constexpr int kRounds = 8;
    // Entries below this part of the largest count as this part: a triangular M would send D to infinity.
    static constexpr double kSmallestEntry = 1e-9;

    std::size_t n_;
    std::vector<double> up_, down_, rows_, columns_, step_, squares_, changed_, filled_;

    bool step(double* x) {
        const std::size_t n = n_;
        for (std::size_t i = 0; i < n; i++) {
            up_[i] = std::exp(2 * x[i]);
            down_[i] = 1 / up_[i];
        }
        std::fill(rows_.begin(), rows_.end(), 0.0);
        std::fill(columns_.begin(), columns_.end(), 0.0);
        for (std::size_t i = 0; i < n; i++)
            for (std::size_t j = 0; j < n; j++) {
                const double now = squares_[i * n + j] * up_[i] * down_[j];
                changed_[i * n + j] = now;
                rows_[i] += now;
                columns_[j] += now;
            }
        bool even = true;
        double total = 0.0;
        for (std::size_t i = 0; i < n; i++) {
            even = even && std::fabs(rows_[i] - columns_[i]) <= 0.05 * (rows_[i] + columns_[i]);
            total += rows_[i];
        }
        if (even || !std::isfinite(total)) return false;
        // Constant x changes nothing, nor does a common factor on loops that are not coupled: filled up, so that there is a solution.
        const double fill = total * 2 / double(n);
        for (std::size_t i = 0; i < n; i++) {
            for (std::size_t j = 0; j < n; j++) filled_[i * n + j] = fill / double(n) - changed_[i * n + j] - changed_[j * n + i];
            filled_[i * n + i] += rows_[i] + columns_[i] + 1e-6 * fill;
            step_[i] = 0.5 * (columns_[i] - rows_[i]);
        }
        solve_positive(filled_, step_);
        shorten(step_, 1.5);
        for (std::size_t i = 0; i < n; i++) x[i] += step_[i];
        return true;
    }
};

}  // namespace gainroom
