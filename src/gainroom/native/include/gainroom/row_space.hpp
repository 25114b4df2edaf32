// The row space of a small real matrix, and its pseudo-inverse: Householder's factors with pivots (Golub and Van Loan, section 5.5).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <memory>
#include <utility>

#include "block.hpp"
#include "four.hpp"

namespace gainroom {

// Matrix stored by rows.
struct Real {
    std::size_t rows, columns;
    Vector<double> entries;

    Real() : Real(0, 0) {}
    Real(std::size_t r, std::size_t c) : rows(r), columns(c), entries(r * c) {}
    Real(std::size_t r, std::size_t c, const double* from) : rows(r), columns(c), entries(from, from + r * c) {}
    // Zeros, of another shape; takes no memory where there has been room for as many.
    void clear(std::size_t r, std::size_t c) {
        rows = r;
        columns = c;
        entries.assign(r * c, 0.0);
    }
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
    RowSpace() = default;
    RowSpace(const Real& a, double share, double least = 0.0) { find(a, share, least); }

    // Rows count as independent while what they add to those before, the largest first, is above `least` and above `share` of the largest.
    // Takes no memory where a matrix as large has been there before.
    GAINROOM_WIDE void find(const Real& a, double share, double least = 0.0) {
        l_ = a;
        mirrors_.clear(std::min(a.rows, a.columns), a.columns);
        order_.resize(a.rows);
        largest_ = 0.0;
        for (std::size_t i = 0; i < l_.rows; i++) order_[i] = i;
        for (rank_ = 0; rank_ < mirrors_.rows; rank_++) {
            const double size = bring_largest(rank_);
            if (rank_ == 0) largest_ = size;
            if (!(size > share * largest_) || !(size > least)) break;
            mirror(rank_, size);
        }
    }

    std::size_t rank() const { return rank_; }
    double largest() const { return largest_; }  // row's size

    // Column k of Q (n): up to the rank they span the rows of A, from there on what is at right angles to them.
    GAINROOM_INLINE void direction(std::size_t k, double* axis) const {
        std::fill(axis, axis + l_.columns, 0.0);
        axis[k] = 1.0;
        reflect_back(axis);
    }

    // `row` (n) in the columns of Q.
    GAINROOM_INLINE void turn(double* row) const {
        for (std::size_t k = 0; k < rank_; k++) reflect(row, k);
    }
    GAINROOM_INLINE void turn_back(double* row) const { reflect_back(row); }

    // A⁺ transposed, (m, n).
    Real inverse_turned() {
        Real found(l_.rows, l_.columns), inner;
        inverse_within(inner);
        for (std::size_t i = 0; i < l_.rows; i++) {
            std::copy_n(inner.row(i), rank_, found.row(i));
            reflect_back(found.row(i));
        }
        return found;
    }

    // The same in the first columns of Q, (m, rank).
    void inverse_within(Real& inner);

    // All memory for matrices up to (m, n).
    void reserve(std::size_t m, std::size_t n);

private:
    // Brings the row with the most left from column k on to place k; how much that is.
    GAINROOM_INLINE double bring_largest(std::size_t k) {
        std::size_t found = k;
        double most = -1.0;
        for (std::size_t i = k; i < l_.rows; i++) {
            const double square = scalar_product(l_.row(i) + k, l_.row(i) + k, l_.columns - k);
            if (square > most) most = square, found = i;
        }
        if (found != k) {
            std::swap_ranges(l_.row(k), l_.row(k) + l_.columns, l_.row(found));
            std::swap(order_[k], order_[found]);
        }
        return std::sqrt(most);
    }

    // Turns row k, of `size` from column k on, into the k-th axis, and the rows after it alike.
    GAINROOM_INLINE void mirror(std::size_t k, double size) {
        const std::size_t n = l_.columns;
        double* row = l_.row(k);
        const double head = row[k] > 0 ? -size : size, scale = 1 / std::sqrt(size * (size + std::fabs(row[k])));
        double* axis = mirrors_.row(k);  // of size √2
        axis[k] = (row[k] - head) * scale;
        for (std::size_t j = k + 1; j < n; j++) axis[j] = row[j] * scale;
        row[k] = head;
        std::fill(row + k + 1, row + n, 0.0);
        for (std::size_t i = k + 1; i < l_.rows; i++) reflect(l_.row(i), k);
    }

    GAINROOM_INLINE void reflect(double* row, std::size_t k) const {
        const double* axis = mirrors_.row(k);
        subtract(row + k, scalar_product(axis + k, row + k, l_.columns - k), axis + k, l_.columns - k);
    }

    GAINROOM_INLINE void reflect_back(double* row) const {
        for (std::size_t k = rank_; k-- > 0;) reflect(row, k);
    }

    // The transposed inverse of L where it is square, its rows in A's order: row i is L⁻¹ e_i.
    void triangle(Real& found) const {
        for (std::size_t i = 0; i < rank_; i++) {
            double* x = found.row(order_[i]);
            x[i] = 1 / l_.row(i)[i];
            for (std::size_t k = i + 1; k < rank_; k++) {
                double sum = 0.0;
                for (std::size_t j = i; j < k; j++) sum += l_.row(k)[j] * x[j];
                x[k] = -sum / l_.row(k)[k];
            }
        }
    }

    struct Tall;  // for a pseudo-inverse of more rows than rank

    Real l_, mirrors_;
    Vector<std::size_t> order_;
    std::size_t rank_ = 0;
    double largest_ = 0.0;
    std::unique_ptr<Tall> tall_;
};

struct RowSpace::Tall {
    RowSpace space;
    Real turned, inner;
    Vector<double> row;
};

GAINROOM_WIDE inline void RowSpace::inverse_within(Real& inner) {
    inner.clear(l_.rows, rank_);
    if (l_.rows == rank_) {
        triangle(inner);
        return;
    }
    if (!tall_) tall_ = std::make_unique<Tall>();
    tall_->turned.clear(rank_, l_.rows);
    for (std::size_t i = 0; i < l_.rows; i++)
        for (std::size_t k = 0; k < rank_; k++) tall_->turned.row(k)[order_[i]] = l_.row(i)[k];
    tall_->space.find(tall_->turned, 0.0);
    tall_->inner.clear(rank_, rank_);
    if (tall_->space.rank() == rank_) tall_->space.triangle(tall_->inner);
    else std::fill(tall_->inner.entries.begin(), tall_->inner.entries.end(), std::numeric_limits<double>::quiet_NaN());
    tall_->row.resize(l_.rows);
    for (std::size_t k = 0; k < rank_; k++) {
        std::fill(tall_->row.begin(), tall_->row.end(), 0.0);
        std::copy_n(tall_->inner.row(k), rank_, tall_->row.begin());
        tall_->space.reflect_back(tall_->row.data());
        for (std::size_t i = 0; i < l_.rows; i++) inner.row(i)[k] = tall_->row[i];
    }
}

inline void RowSpace::reserve(std::size_t m, std::size_t n) {
    l_.entries.reserve(m * n);
    mirrors_.entries.reserve(std::min(m, n) * n);
    order_.reserve(m);
    tall_ = std::make_unique<Tall>();
    const std::size_t rank = std::min(m, n);
    tall_->turned.entries.reserve(rank * m);
    tall_->inner.entries.reserve(rank * rank);
    tall_->row.reserve(m);
    tall_->space.l_.entries.reserve(rank * m);
    tall_->space.mirrors_.entries.reserve(rank * m);
    tall_->space.order_.reserve(rank);
}

}  // namespace gainroom
