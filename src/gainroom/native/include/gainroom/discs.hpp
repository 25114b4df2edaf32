// Discs of numbers that contain a quantity, and its slopes, everywhere in a box of parameters.
//
// Sums, products and inverses of discs contain every sum, product and inverse of their members (Gargantini and Henrici 1972). Where a disc
// that is inverted contains 0, or its numbers leave the range of doubles, the result is NaN, which the caller looks for. The same functions
// of plain numbers are beside them, so that a formula has one text for what is in a box and for what is at its middle.
#pragma once

#include <algorithm>
#include <limits>
#include <type_traits>

#include "complex.hpp"

namespace gainroom {

constexpr int kBoxParameters = 6;

// |a|, by one square root where |a|² is far from the ends of the range.
inline double magnitude(Complex a) {
    const double square = a.real() * a.real() + a.imag() * a.imag();
    return square > 1e-280 && square < 1e280 ? std::sqrt(square) : std::hypot(a.real(), a.imag());
}

// 1/x for x > 0 that is finite, else NaN.
inline double positive_inverse(double x) {
    return x > 0 && x < std::numeric_limits<double>::infinity() ? 1 / x : std::numeric_limits<double>::quiet_NaN();
}

// All real numbers within `rad` of `mid`.
struct Disc {
    double mid = 0.0, rad = 0.0;
};

inline Disc operator+(const Disc& a, const Disc& b) { return {a.mid + b.mid, a.rad + b.rad}; }
inline Disc operator+(double a, const Disc& b) { return {a + b.mid, b.rad}; }
inline Disc operator*(double a, const Disc& b) { return {a * b.mid, std::fabs(a) * b.rad}; }
inline Disc operator*(const Disc& a, const Disc& b) {
    return {a.mid * b.mid, std::fabs(a.mid) * b.rad + a.rad * (std::fabs(b.mid) + b.rad)};
}

inline double inverse(double a) { return 1 / a; }
inline Disc inverse(const Disc& a) {
    const double scale = positive_inverse(a.mid * a.mid - a.rad * a.rad);
    return {a.mid * scale, a.rad * scale};
}

// √x of x > 0.
inline double root(double x) { return std::sqrt(x); }
inline Disc root(const Disc& x) {
    const double least = x.mid - x.rad, low = std::sqrt(least < 0 ? 0.0 : least), high = std::sqrt(x.mid + x.rad);
    return {0.5 * (low + high), 0.5 * (high - low)};
}

// All complex numbers within `rad` of `mid`, and |mid|.
struct ComplexDisc {
    Complex mid;
    double rad = 0.0, size = 0.0;

    static ComplexDisc around(Complex mid, double rad) { return {mid, rad, magnitude(mid)}; }
    double least() const { return size - rad < 0 ? 0.0 : size - rad; }
    double most() const { return size + rad; }
};

inline ComplexDisc times(const ComplexDisc& a, const ComplexDisc& b) {
    return {times(a.mid, b.mid), a.size * b.rad + a.rad * (b.size + b.rad), a.size * b.size};
}
inline Complex times(double a, Complex b) { return {a * b.real(), a * b.imag()}; }
inline ComplexDisc times(const Disc& a, const ComplexDisc& b) {
    const double size = std::fabs(a.mid);
    return {times(a.mid, b.mid), size * b.rad + a.rad * (b.size + b.rad), size * b.size};
}

inline Complex inverse(Complex a) { return over(1.0, a); }
inline ComplexDisc inverse(const ComplexDisc& a) {
    const double scale = positive_inverse(a.mid.real() * a.mid.real() + a.mid.imag() * a.mid.imag() - a.rad * a.rad);
    return {{a.mid.real() * scale, -a.mid.imag() * scale}, a.rad * scale, a.size * scale};
}

inline Complex as_complex(double x) { return x; }
inline ComplexDisc as_complex(const Disc& x) { return {x.mid, x.rad, std::fabs(x.mid)}; }

// x + jy.
inline Complex joined(double x, double y) { return {x, y}; }
inline ComplexDisc joined(double x, const Disc& y) { return ComplexDisc::around({x, y.mid}, y.rad); }
inline ComplexDisc joined(const Disc& x, const Disc& y) { return ComplexDisc::around({x.mid, y.mid}, x.rad + y.rad); }

// e^{jx}, of which the middle is known; a chord is not longer than its arc.
inline Complex turned(Complex middle, double) { return middle; }
inline ComplexDisc turned(Complex middle, const Disc& x) {
    return {middle, x.rad < 0.1 ? x.rad : 2 * std::sin(x.rad < kPi ? x.rad / 2 : kPi / 2), 1.0};
}

// One quantity in a box: its disc, and that of its slope by each parameter, times half the box's width.
struct Ball {
    Disc disc;
    double mid[kBoxParameters], rad[kBoxParameters];

    static Ball known(double value) { return {{value}, {}, {}}; }

    // Parameter number `index`, between `low` and `high`.
    static Ball parameter(int index, double low, double high) {
        Ball one = known(0.5 * (low + high));
        one.disc.rad = 0.5 * (high - low);
        one.mid[index] = one.disc.rad;
        return one;
    }

    Disc slope(int index) const { return {mid[index], rad[index]}; }
    void set_slope(int index, const Disc& slope) { mid[index] = slope.mid, rad[index] = slope.rad; }

    // f(x) of this x: its disc, and that of its slope by x.
    Ball chained(const Disc& value, const Disc& change) const {
        Ball found;
        found.disc = value;
        for (int i = 0; i < kBoxParameters; i++) found.set_slope(i, change * slope(i));
        return found;
    }
};

inline Ball operator+(const Ball& a, const Ball& b) {
    Ball sum;
    sum.disc = a.disc + b.disc;
    for (int i = 0; i < kBoxParameters; i++) sum.set_slope(i, a.slope(i) + b.slope(i));
    return sum;
}

inline Ball operator+(double a, const Ball& b) {
    Ball sum = b;
    sum.disc.mid += a;
    return sum;
}

inline Ball operator*(const Ball& a, const Ball& b) {
    Ball product;
    product.disc = a.disc * b.disc;
    for (int i = 0; i < kBoxParameters; i++) product.set_slope(i, a.slope(i) * b.disc + a.disc * b.slope(i));
    return product;
}

inline Ball operator*(double a, const Ball& b) { return b.chained(a * b.disc, {a}); }

inline Ball inverse(const Ball& a) {
    const Disc value = inverse(a.disc);
    return a.chained(value, -1.0 * (value * value));
}

inline Ball root(const Ball& a) {
    const Disc value = root(a.disc);
    return a.chained(value, 0.5 * inverse(value));
}

template <class T>
T known(double value) {
    if constexpr (std::is_same_v<T, Ball>) return Ball::known(value);
    else return {value};
}

inline double disc_of(double a) { return a; }
inline const Disc& disc_of(const Disc& a) { return a; }
inline const Disc& disc_of(const Ball& a) { return a.disc; }

}  // namespace gainroom
