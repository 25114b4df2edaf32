// Complex products and quotients without the tests for infinities that the language asks of std::complex.
#pragma once

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__) || defined(_M_FP_FAST)
#error "gainroom tells what is no number, and answers safely: compile it without -ffast-math, -ffinite-math-only, /fp:fast"
#endif

#include <cmath>
#include <complex>

#include "processor.hpp"

namespace gainroom {

using Complex = std::complex<double>;

constexpr double kPi = 3.14159265358979323846;

GAINROOM_INLINE Complex times(Complex a, Complex b) {
    return {a.real() * b.real() - a.imag() * b.imag(), a.real() * b.imag() + a.imag() * b.real()};
}

// a/b of any numbers, by Smith's method, which does not overflow where the quotient does not.
inline Complex over_any(Complex a, Complex b) {
    if (std::fabs(b.real()) >= std::fabs(b.imag())) {
        const double ratio = b.imag() / b.real(), size = b.real() + b.imag() * ratio;
        return {(a.real() + a.imag() * ratio) / size, (a.imag() - a.real() * ratio) / size};
    }
    const double ratio = b.real() / b.imag(), size = b.real() * ratio + b.imag();
    return {(a.real() * ratio + a.imag()) / size, (a.imag() * ratio - a.real()) / size};
}

// 1/a, and a/b: one division where |a|², |b|² are far from the ends of the range.
GAINROOM_INLINE Complex inverse_of(Complex a) {
    const double size = std::norm(a);
    if (!(size > 1e-280 && size < 1e280)) return over_any(1.0, a);
    const double scale = 1 / size;
    return {a.real() * scale, -a.imag() * scale};
}
GAINROOM_INLINE Complex over(Complex a, Complex b) {
    const double size = std::norm(b);
    if (!(size > 1e-280 && size < 1e280)) return over_any(a, b);
    const double scale = 1 / size;
    return times(a, {b.real() * scale, -b.imag() * scale});
}

// |a|, of numbers whose squares are within range, and of any.
GAINROOM_INLINE double size_of(Complex a) { return std::sqrt(std::norm(a)); }
GAINROOM_INLINE double size_of_any(Complex a) {
    const double square = std::norm(a);
    return square > 1e-280 && square < 1e280 ? std::sqrt(square) : std::abs(a);
}

// log|a|, finite: of 0 less than of any other number.
constexpr double kLogZero = -800.0;
inline double log_size(Complex a) {
    const double size = size_of_any(a);
    return size > 0 ? std::log(size) : kLogZero;
}

// `angle` in (−π, π].
inline double wrapped(double angle) { return angle - 2 * kPi * std::ceil((angle - kPi) / (2 * kPi)); }

// arg(b/a) in (−π, π].
inline double turn_between(Complex a, Complex b) {
    const Complex rotated = times(b, std::conj(a));
    return std::atan2(rotated.imag(), rotated.real());
}

}  // namespace gainroom
