// W + diag(β) = L D Lᵀ of one real symmetric W and four β at once, as at four frequencies: symmetric_factor.hpp, a matrix in each place of Four.
//
// Every entry has its four matrices beside each other, so that short rows cost no more than long ones.
#pragma once

#include <cstddef>
#include <vector>

#include "complex.hpp"
#include "four.hpp"

namespace gainroom {

struct FourComplex {
    Four re, im;
};

GAINROOM_INLINE FourComplex operator+(const FourComplex& a, const FourComplex& b) { return {a.re + b.re, a.im + b.im}; }
GAINROOM_INLINE FourComplex operator-(const FourComplex& a, const FourComplex& b) { return {a.re - b.re, a.im - b.im}; }
GAINROOM_INLINE FourComplex operator*(const FourComplex& a, const FourComplex& b) {
    return {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
}
GAINROOM_INLINE FourComplex square(const FourComplex& a) {
    const Four both = a.re * a.im;
    return {a.re * a.re - a.im * a.im, both + both};
}
// Not a number where the square of a size is none.
GAINROOM_INLINE FourComplex inverse_of(const FourComplex& a) {
    const Four scale = 1.0 / (a.re * a.re + a.im * a.im);
    return {a.re * scale, -1.0 * (a.im * scale)};
}

// Rows of FourComplex in a vector of numbers.
constexpr std::size_t kLanes = 4, kEntry = 2 * kLanes;
GAINROOM_INLINE FourComplex entry(const double* from) { return {four(from), four(from + kLanes)}; }
GAINROOM_INLINE void put(double* to, const FourComplex& from) {
    put(to, from.re);
    put(to + kLanes, from.im);
}
inline void put(double* to, std::size_t lane, Complex from) {
    to[lane] = from.real();
    to[kLanes + lane] = from.imag();
}

class FourFactors {
public:
    explicit FourFactors(std::size_t size)
        : size_(size), upper_(kEntry * (size * (size + 1) / 2)), pivots_(kEntry * size), inverse_(kEntry * size), column_(kEntry * size) {}

    GAINROOM_INLINE FourComplex pivot(std::size_t k) const { return entry(&pivots_[kEntry * k]); }

    // W (n, n); β (n) four times each.
    GAINROOM_WIDE void factor(const double* w, const double* beta) {
        double* to = upper_.data();
        const double nothing[kLanes] = {};
        const Four zero = four(nothing);
        for (std::size_t i = 0; i < size_; i++)
            for (std::size_t j = i; j < size_; j++, to += kEntry) {
                const FourComplex real{zero + w[i * size_ + j], zero};
                put(to, j == i ? real + entry(beta + kEntry * i) : real);
            }
        double* row = upper_.data();
        for (std::size_t k = 0; k < size_; k++) {  // a row of Lᵀ behind its pivot
            const std::size_t length = size_ - k;
            const FourComplex pivot = entry(row), inverse = inverse_of(pivot);
            put(&pivots_[kEntry * k], pivot);
            put(&inverse_[kEntry * k], inverse);
            double* below = row + kEntry * length;
            for (std::size_t i = 1; i < length; i++) {
                const FourComplex factor = entry(row + kEntry * i) * inverse;
                for (std::size_t j = i; j < length; j++, below += kEntry) put(below, entry(below) - factor * entry(row + kEntry * j));
                put(row + kEntry * i, factor);
            }
            row += kEntry * length;
        }
    }

    // tr((W + diag β)⁻¹ diag(β_ω)), with β_ω (n) four times each: column by column of L⁻¹.
    GAINROOM_WIDE FourComplex trace(const double* beta_omega) {
        const double nothing[kLanes] = {};
        FourComplex sum{four(nothing), four(nothing)};
        double* x = column_.data();
        const double* first = upper_.data();
        for (std::size_t j = 0; j < size_; j++) {
            for (std::size_t k = j + 1; k < size_; k++) put(x + kEntry * k, FourComplex{four(nothing), four(nothing)} - entry(first + kEntry * (k - j)));
            FourComplex own = entry(&inverse_[kEntry * j]);
            const double* row = first += kEntry * (size_ - j);
            for (std::size_t m = j + 1; m < size_; m++) {
                const FourComplex factor = entry(x + kEntry * m);
                own = own + square(factor) * entry(&inverse_[kEntry * m]);
                for (std::size_t k = m + 1; k < size_; k++) put(x + kEntry * k, entry(x + kEntry * k) - factor * entry(row + kEntry * (k - m)));
                row += kEntry * (size_ - m);
            }
            sum = sum + own * entry(beta_omega + kEntry * j);
        }
        return sum;
    }

private:
    std::size_t size_;
    std::vector<double> upper_, pivots_, inverse_, column_;  // upper_: row by row from the diagonal on
};

}  // namespace gainroom
