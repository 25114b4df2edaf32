// W + diag(β) = L D Lᵀ of one real symmetric W and four β at once, as at four frequencies: symmetric_factor.hpp, a matrix in each place of Four.
//
// Every entry has its four matrices beside each other, so that short rows cost no more than long ones. Rows are subtracted two at a time: what they
// are subtracted from is loaded and stored once for both.
#pragma once

#include <cstddef>

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

// from −= a · row + b · other, of `count` entries. Nearly all of a count's time goes here.
using Subtract = void (*)(double* from, const double* a, const double* row, const double* b, const double* other, std::size_t count);

GAINROOM_WIDE inline void subtract_apart(double* from, const double* a, const double* row, const double* b, const double* other, std::size_t count) {
    const FourComplex by = entry(a), also = entry(b);
    for (std::size_t k = 0; k < kEntry * count; k += kEntry) put(from + k, entry(from + k) - by * entry(row + k) - also * entry(other + k));
}

#ifdef GAINROOM_FUSED
GAINROOM_FUSED inline void subtract_fused(double* from, const double* a, const double* row, const double* b, const double* other, std::size_t count) {
    const __m256d a_re = _mm256_loadu_pd(a), a_im = _mm256_loadu_pd(a + kLanes), b_re = _mm256_loadu_pd(b), b_im = _mm256_loadu_pd(b + kLanes);
    for (std::size_t k = 0; k < kEntry * count; k += kEntry) {
        __m256d re = _mm256_loadu_pd(from + k), im = _mm256_loadu_pd(from + k + kLanes);
        const __m256d r = _mm256_loadu_pd(row + k), s = _mm256_loadu_pd(row + k + kLanes);
        re = _mm256_fmadd_pd(a_im, s, _mm256_fnmadd_pd(a_re, r, re));
        im = _mm256_fnmadd_pd(a_im, r, _mm256_fnmadd_pd(a_re, s, im));
        const __m256d t = _mm256_loadu_pd(other + k), u = _mm256_loadu_pd(other + k + kLanes);
        _mm256_storeu_pd(from + k, _mm256_fmadd_pd(b_im, u, _mm256_fnmadd_pd(b_re, t, re)));
        _mm256_storeu_pd(from + k + kLanes, _mm256_fnmadd_pd(b_im, t, _mm256_fnmadd_pd(b_re, u, im)));
    }
}
inline Subtract subtract_of_processor() { return processor_fuses() ? subtract_fused : subtract_apart; }
#else
inline Subtract subtract_of_processor() { return subtract_apart; }
#endif

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
        for (std::size_t k = 0; k < size_; k += 2) {  // rows of Lᵀ behind their pivots
            const std::size_t length = size_ - k;
            double *next = row + kEntry * length, *below = next + kEntry * (length - 1);
            set_pivot(k, row);
            if (length == 1) return;
            alignas(kLine) double a[kEntry], b[kEntry];
            const FourComplex by = entry(row + kEntry) * entry(&inverse_[kEntry * k]);
            for (std::size_t j = 1; j < length; j++) put(next + kEntry * (j - 1), entry(next + kEntry * (j - 1)) - by * entry(row + kEntry * j));
            put(row + kEntry, by);
            set_pivot(k + 1, next);
            for (std::size_t i = 2; i < length; i++) {
                put(a, entry(row + kEntry * i) * entry(&inverse_[kEntry * k]));
                put(b, entry(next + kEntry * (i - 1)) * entry(&inverse_[kEntry * (k + 1)]));
                subtract_(below, a, row + kEntry * i, b, next + kEntry * (i - 1), length - i);
                put(row + kEntry * i, entry(a));
                put(next + kEntry * (i - 1), entry(b));
                below += kEntry * (length - i);
            }
            row = next + kEntry * (length - 1);
        }
    }

    // tr((W + diag β)⁻¹ diag(β_ω)), with β_ω (n) four times each: column by column of L⁻¹.
    GAINROOM_WIDE FourComplex trace(const double* beta_omega) {
        const double nothing[kLanes] = {};
        const FourComplex zero{four(nothing), four(nothing)};
        FourComplex sum = zero;
        double* x = column_.data();
        const double* first = upper_.data();
        for (std::size_t j = 0; j < size_; j++) {
            for (std::size_t k = j + 1; k < size_; k++) put(x + kEntry * k, zero - entry(first + kEntry * (k - j)));
            FourComplex own = entry(&inverse_[kEntry * j]);
            const double* row = first += kEntry * (size_ - j);
            for (std::size_t m = j + 1; m < size_; m += 2) {
                const std::size_t length = size_ - m;
                const double* next = row + kEntry * length;
                double *a = x + kEntry * m, *b = a + kEntry;
                own = own + square(entry(a)) * entry(&inverse_[kEntry * m]);
                if (length == 1) break;
                put(b, entry(b) - entry(a) * entry(row + kEntry));
                own = own + square(entry(b)) * entry(&inverse_[kEntry * (m + 1)]);
                subtract_(b + kEntry, a, row + 2 * kEntry, b, next + kEntry, length - 2);
                row = next + kEntry * (length - 1);
            }
            sum = sum + own * entry(beta_omega + kEntry * j);
        }
        return sum;
    }

private:
    GAINROOM_INLINE void set_pivot(std::size_t k, const double* row) {
        put(&pivots_[kEntry * k], entry(row));
        put(&inverse_[kEntry * k], inverse_of(entry(row)));
    }

    Subtract subtract_ = subtract_of_processor();
    std::size_t size_;
    Numbers upper_, pivots_, inverse_, column_;  // upper_: row by row from the diagonal on
};

}  // namespace gainroom
