// A small convex quadratic programme with a diagonal, brought to a least distance, which non-negative least squares finds (Lawson and Hanson
// 1974, chapter 23).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "four.hpp"

namespace gainroom {

// The u ≥ 0 with the least |E u − f|: columns enter one by one, and those leave whose share would be negative.
class NonNegativeSquares {
public:
    // E by columns of `rows` numbers each. What it has when `kTurns` a column are over is not far off.
    NonNegativeSquares(const std::vector<double>& columns, const std::vector<double>& wanted)
        : columns_(columns), wanted_(wanted), rows_(wanted.size()), count_(columns.size() / std::max<std::size_t>(rows_, 1)), share_(count_), used_(count_),
          left_(wanted) {
        for (std::size_t turn = 0; turn < kTurns * count_ && enter(); turn++) {}
        if (order_.empty()) return;
        rebuild();  // without the round-off of all that has come and gone
        settle(solved());
    }

    // E u − f.
    std::vector<double> residual() const {
        std::vector<double> found(rows_);
        for (std::size_t i = 0; i < rows_; i++) found[i] = -left_[i];
        return found;
    }

private:
    static constexpr std::size_t kTurns = 3;
    static constexpr double kDependent = 1e-13;  // of a column: what is left of one that others make up
    static constexpr double kNone = 1e-15;       // of a slope: round-off of columns of about 1, and of the residual

    const double* column(std::size_t k) const { return &columns_[k * rows_]; }

    // One more column, the steepest that shortens the residual; false where none does.
    bool enter() {
        std::vector<bool> refused(used_);
        while (true) {
            std::size_t best = count_;
            double steepest = kNone * std::sqrt(scalar_product(left_.data(), left_.data(), rows_));
            for (std::size_t k = 0; k < count_; k++) {
                if (refused[k]) continue;
                const double slope = scalar_product(column(k), left_.data(), rows_);
                if (!(slope > steepest)) continue;
                steepest = slope;
                best = k;
            }
            if (best == count_) return false;
            if (!append(best)) {
                refused[best] = true;
                continue;
            }
            const std::vector<double> target = solved();
            if (!(target.back() > 0.0)) {  // round-off alone had it shorten anything
                order_.pop_back();
                basis_.resize(basis_.size() - rows_);
                upper_.pop_back();
                refused[best] = true;
                continue;
            }
            used_[best] = true;
            settle(target);
            return true;
        }
    }

    // From the shares as they are towards `target`, and on, dropping what comes to 0 on the way.
    void settle(std::vector<double> target) {
        while (true) {
            double part = 1.0;
            std::size_t first = order_.size();
            for (std::size_t k = 0; k < order_.size(); k++) {
                if (target[k] > 0.0) continue;
                const double now = share_[order_[k]], to = now / (now - target[k]);
                if (first < order_.size() && !(to < part)) continue;
                part = std::isfinite(to) ? std::min(std::max(to, 0.0), 1.0) : 0.0;
                first = k;
            }
            for (std::size_t k = 0; k < order_.size(); k++) share_[order_[k]] += part * (target[k] - share_[order_[k]]);
            if (first == order_.size()) break;
            drop(first);
            target = solved();
        }
        left_ = wanted_;
        for (const std::size_t k : order_) subtract(left_.data(), share_[k], column(k), rows_);
    }

    // Column `first` of those in use; rotations make what stands behind it triangular again.
    void drop(std::size_t first) {
        share_[order_[first]] = 0.0;
        used_[order_[first]] = false;
        order_.erase(order_.begin() + long(first));
        upper_.erase(upper_.begin() + long(first));
        for (std::size_t m = first; m < order_.size(); m++) {
            double &diagonal = upper_[m][m], below = upper_[m][m + 1];
            const double size = std::hypot(diagonal, below), cosine = diagonal / size, sine = below / size;
            upper_[m].pop_back();
            diagonal = size;
            for (std::size_t k = m + 1; k < order_.size(); k++) {
                const double x = upper_[k][m], y = upper_[k][m + 1];
                upper_[k][m] = cosine * x + sine * y;
                upper_[k][m + 1] = cosine * y - sine * x;
            }
            double *one = &basis_[m * rows_], *next = one + rows_;
            for (std::size_t i = 0; i < rows_; i++) {
                const double x = one[i], y = next[i];
                one[i] = cosine * x + sine * y;
                next[i] = cosine * y - sine * x;
            }
        }
        basis_.resize(order_.size() * rows_);
    }

    // Factors of all columns in use, in the order in which they came.
    void rebuild() {
        std::vector<std::size_t> before;
        before.swap(order_);
        basis_.clear();
        upper_.clear();
        for (const std::size_t k : before)
            if (!append(k)) {
                share_[k] = 0.0;
                used_[k] = false;
            }
    }

    // Column k behind the others: E = Q R by Gram and Schmidt, twice. False where it is a combination of them.
    bool append(std::size_t k) {
        if (order_.size() >= rows_) return false;
        std::vector<double> rest(column(k), column(k) + rows_), shares(order_.size() + 1);
        const double before = std::sqrt(scalar_product(rest.data(), rest.data(), rows_));
        for (int pass = 0; pass < 2; pass++)
            for (std::size_t m = 0; m < order_.size(); m++) {
                const double share = scalar_product(rest.data(), &basis_[m * rows_], rows_);
                subtract(rest.data(), share, &basis_[m * rows_], rows_);
                shares[m] += share;
            }
        const double size = std::sqrt(scalar_product(rest.data(), rest.data(), rows_));
        if (!(size > kDependent * before)) return false;
        shares.back() = size;
        for (const double one : rest) basis_.push_back(one / size);
        upper_.push_back(shares);
        order_.push_back(k);
        return true;
    }

    // Shares of the columns with which they come nearest to `wanted`, of any sign.
    std::vector<double> solved() const {
        std::vector<double> found(order_.size());
        for (std::size_t k = order_.size(); k-- > 0;) {
            double sum = scalar_product(&basis_[k * rows_], wanted_.data(), rows_);
            for (std::size_t m = k + 1; m < order_.size(); m++) sum -= upper_[m][k] * found[m];
            found[k] = sum / upper_[k][k];
        }
        return found;
    }

    const std::vector<double>&columns_, &wanted_;
    std::size_t rows_, count_;
    std::vector<double> share_;
    std::vector<bool> used_;
    std::vector<double> left_, basis_;           // f − E u; columns of Q
    std::vector<std::vector<double>> upper_;     // columns of R
    std::vector<std::size_t> order_;             // the columns that are used
};

// The x (n) with low ≤ x ≤ high, and the t ≥ 0 behind it, that make ½ Σ bend x² + pull·x + penalty t + ½ t² smallest with value + slope x ≤ t;
// slope (m, n) by rows, bend > 0. Digits are lost where pull/√bend or the penalty are large: about 16 less twice those of their size are left.
inline std::vector<double> quadratic_programme(const std::vector<double>& bend, const std::vector<double>& pull, const double* slope,
                                               const std::vector<double>& value, double penalty, const std::vector<double>& low,
                                               const std::vector<double>& high) {
    // With y = root (x − centre) least where nothing limits it, rows a·x ≤ limit become y·(−a/root) ≥ a·centre − limit.
    const std::size_t n = bend.size(), rows = n + 2;
    std::vector<double> root(n + 1), centre(n + 1), columns, wanted(rows);
    for (std::size_t i = 0; i <= n; i++) {
        root[i] = i < n ? std::sqrt(bend[i]) : 1.0;
        centre[i] = i < n ? -pull[i] / bend[i] : -penalty;
    }
    const auto add = [&](const std::vector<double>& row, double limit) {
        double away = -limit, most = 0.0;
        for (std::size_t i = 0; i <= n; i++) {
            columns.push_back(-row[i] / root[i]);
            away += row[i] * centre[i];
            most = std::max(most, std::fabs(columns.back()));
        }
        columns.push_back(away);
        most = std::max(std::max(most, std::fabs(away)), 1e-300);
        for (std::size_t i = columns.size() - rows; i < columns.size(); i++) columns[i] /= most;
    };
    columns.reserve((value.size() + 1 + 2 * n) * rows);
    std::vector<double> row(n + 1);
    row[n] = -1.0;
    for (std::size_t k = 0; k < value.size(); k++) {
        std::copy(slope + k * n, slope + (k + 1) * n, row.begin());
        add(row, -value[k]);
    }
    std::fill(row.begin(), row.end() - 1, 0.0);
    add(row, 0.0);
    row[n] = 0.0;
    for (std::size_t i = 0; i < n; i++) {
        row[i] = 1.0;
        add(row, high[i]);
        row[i] = -1.0;
        add(row, -low[i]);
        row[i] = 0.0;
    }
    wanted.back() = 1.0;
    const std::vector<double> residual = NonNegativeSquares(columns, wanted).residual();
    std::vector<double> found(n + 1);
    for (std::size_t i = 0; i <= n; i++) {
        const double exact = centre[i] - residual[i] / residual[n + 1] / root[i];
        found[i] = i < n ? std::min(std::max(exact, low[i]), high[i]) : std::max(exact, 0.0);
    }
    return found;
}

}  // namespace gainroom
