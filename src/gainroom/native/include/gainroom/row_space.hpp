// The row space of a small real matrix, and its pseudo-inverse: Householder's factors with pivots (Golub and Van Loan, section 5.5).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

namespace gainroom {

// By rows.
struct Real {
    std::size_t rows, columns;
    std::vector<double> entries;

    Real(std::size_t r, std::size_t c) : rows(r), columns(c), entries(r * c) {}
    Real(std::size_t r, std::size_t c, const double* from) : rows(r), columns(c), entries(from, from + r * c) {}
    double* row(std::size_t r) { return entries.data() + r * columns; }
    const double* row(std::size_t r) const { return entries.data() + r * columns; }
};

inline Real transposed(const Real& a) {
    Real turned(a.columns, a.rows);
    for (std::size_t i = 0; i < a.rows; i++)
        for (std::size_t j = 0; j < a.columns; j++) turned.row(j)[i] = a.row(i)[j];
    return turned;
}

inline Real product(const Real& a, const Real& b) {
    Real found(a.rows, b.columns);
    for (std::size_t i = 0; i < a.rows; i++)
        for (std::size_t k = 0; k < a.columns; k++)
            if (const double factor = a.row(i)[k]; factor != 0.0)
                for (std::size_t j = 0; j < b.columns; j++) found.row(i)[j] += factor * b.row(k)[j];
    return found;
}

// a bᵀ.
inline Real product_turned(const Real& a, const Real& b) {
    Real found(a.rows, b.rows);
    for (std::size_t i = 0; i < a.rows; i++)
        for (std::size_t j = 0; j < b.rows; j++) {
            double sum = 0.0;
            for (std::size_t k = 0; k < a.columns; k++) sum += a.row(i)[k] * b.row(j)[k];
            found.row(i)[j] = sum;
        }
    return found;
}

// A = Πᵀ L Qᵀ with Q (n, n) orthogonal: a product of reflections, as many as A (m, n) has independent rows.
class RowSpace {
public:
    // Rows count as independent while what they add to those before, the largest first, is above `least` and above `share` of the largest.
    RowSpace(Real a, double share, double least = 0.0) : l_(std::move(a)), mirrors_(0, l_.columns), order_(l_.rows) {
        for (std::size_t i = 0; i < l_.rows; i++) order_[i] = i;
        const std::size_t most = std::min(l_.rows, l_.columns);
        for (rank_ = 0; rank_ < most; rank_++) {
            const double size = bring_largest(rank_);
            if (rank_ == 0) largest_ = size;
            if (!(size > share * largest_) || !(size > least)) break;
            mirror(rank_, size);
        }
    }

    std::size_t rank() const { return rank_; }
    double largest() const { return largest_; }  // row's size

    // Columns `first` to n of Q, as rows: up to the rank they span the rows of A, from there on what is at right angles to them.
    Real directions(std::size_t first, std::size_t last) const {
        Real found(last - first, l_.columns);
        for (std::size_t k = first; k < last; k++) {
            found.row(k - first)[k] = 1.0;
            reflect_back(found.row(k - first));
        }
        return found;
    }

    // A⁺ transposed, (m, n).
    Real inverse_turned() const {
        Real found(l_.rows, l_.columns);
        const Real inner = l_.rows == rank_ ? triangle() : RowSpace(lower_turned(), 0.0).inverse_of_columns();
        for (std::size_t i = 0; i < l_.rows; i++) {
            double* row = found.row(order_[i]);
            std::copy_n(inner.row(i), rank_, row);
            reflect_back(row);
        }
        return found;
    }

private:
    // Brings the row with the most left from column k on to place k; how much that is.
    double bring_largest(std::size_t k) {
        std::size_t found = k;
        double most = -1.0;
        for (std::size_t i = k; i < l_.rows; i++) {
            double square = 0.0;
            for (std::size_t j = k; j < l_.columns; j++) square += l_.row(i)[j] * l_.row(i)[j];
            if (square > most) most = square, found = i;
        }
        if (found != k) {
            std::swap_ranges(l_.row(k), l_.row(k) + l_.columns, l_.row(found));
            std::swap(order_[k], order_[found]);
        }
        return std::sqrt(most);
    }

    // Turns row k, of `size` from column k on, into the k-th axis, and the rows after it alike.
    void mirror(std::size_t k, double size) {
        const std::size_t n = l_.columns;
        double* row = l_.row(k);
        const double head = row[k] > 0 ? -size : size, scale = 1 / std::sqrt(size * (size + std::fabs(row[k])));
        mirrors_.entries.resize((k + 1) * n);
        mirrors_.rows = k + 1;
        double* axis = mirrors_.row(k);  // of size √2
        axis[k] = (row[k] - head) * scale;
        for (std::size_t j = k + 1; j < n; j++) axis[j] = row[j] * scale;
        row[k] = head;
        std::fill(row + k + 1, row + n, 0.0);
        for (std::size_t i = k + 1; i < l_.rows; i++) reflect(l_.row(i), k);
    }

    void reflect(double* row, std::size_t k) const {
        const double* axis = mirrors_.row(k);
        double sum = 0.0;
        for (std::size_t j = k; j < l_.columns; j++) sum += axis[j] * row[j];
        for (std::size_t j = k; j < l_.columns; j++) row[j] -= sum * axis[j];
    }

    void reflect_back(double* row) const {
        for (std::size_t k = rank_; k-- > 0;) reflect(row, k);
    }

    // (m, r) the transposed inverse of L where it is square: row i is L⁻¹ e_i.
    Real triangle() const {
        Real found(rank_, rank_);
        for (std::size_t i = 0; i < rank_; i++) {
            double* x = found.row(i);
            x[i] = 1 / l_.row(i)[i];
            for (std::size_t k = i + 1; k < rank_; k++) {
                double sum = 0.0;
                for (std::size_t j = i; j < k; j++) sum += l_.row(k)[j] * x[j];
                x[k] = -sum / l_.row(k)[k];
            }
        }
        return found;
    }

    // (r, m) Lᵀ without its columns of zeros.
    Real lower_turned() const {
        Real found(rank_, l_.rows);
        for (std::size_t i = 0; i < l_.rows; i++)
            for (std::size_t k = 0; k < rank_; k++) found.row(k)[i] = l_.row(i)[k];
        return found;
    }

    Real inverse_of_columns() const { return transposed(inverse_turned()); }

    Real l_, mirrors_;
    std::vector<std::size_t> order_;
    std::size_t rank_ = 0;
    double largest_ = 0.0;
};

}  // namespace gainroom
