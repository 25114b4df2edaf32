// Floating-point numbers of 320 bits (96 digits) for the few sums that lose tens of digits; cut off, not rounded, in the last bits.
//
// A number is ± 0.m × 2^exponent with the first bit of m set, or zero. There is neither infinity nor NaN: what comes in has to be finite,
// and a division by zero gives zero.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

#include "complex.hpp"

namespace gainroom {

class Extended {
   public:
    static constexpr int kLimbs = 5, kBits = 64 * kLimbs;

    Extended(double value = 0.0) : negative_(std::signbit(value)) {
        int exponent = 0;
        const double size = std::frexp(std::fabs(value), &exponent);
        limbs_[kLimbs - 1] = static_cast<std::uint64_t>(std::ldexp(size, 64));
        exponent_ = exponent;
        if (is_zero()) *this = Extended(Nothing{});
    }

    bool is_zero() const { return limbs_[kLimbs - 1] == 0; }
    // Of the first bit: |value| < 2^exponent.
    std::int64_t exponent() const { return is_zero() ? std::numeric_limits<std::int64_t>::min() / 4 : exponent_; }

    // The nearest double.
    double to_double() const {
        bool more = false;
        for (int k = 0; k + 1 < kLimbs; k++) more = more || limbs_[k] != 0;
        const std::uint64_t top = limbs_[kLimbs - 1];
        const auto exponent = static_cast<int>(std::clamp<std::int64_t>(exponent_, -5000, 5000));
        const double size = std::ldexp(static_cast<double>(more ? top | 1 : top), exponent - 64);
        return negative_ ? -size : size;
    }

    Extended operator-() const {
        Extended result = *this;
        result.negative_ = !negative_;
        return result;
    }

    // Times 2^power.
    Extended shifted(std::int64_t power) const {
        Extended result = *this;
        if (!is_zero()) result.exponent_ += power;
        return result;
    }

    friend Extended operator+(const Extended& a, const Extended& b) {
        if (a.is_zero()) return b;
        if (b.is_zero()) return a;
        const bool first = larger(a, b);
        const Extended &big = first ? a : b, &small = first ? b : a;
        const std::int64_t apart = big.exponent_ - small.exponent_;
        if (apart >= kBits) return big;
        const Limbs other = moved_right(small.limbs_, static_cast<int>(apart));
        Extended sum = big;
        return big.negative_ == small.negative_ ? sum.add(other) : sum.subtract(other);
    }
    friend Extended operator-(const Extended& a, const Extended& b) { return a + -b; }

    friend Extended operator*(const Extended& a, const Extended& b) {
        if (a.is_zero() || b.is_zero()) return Extended(Nothing{});
        std::array<std::uint64_t, 2 * kLimbs> product{};
        GAINROOM_UNROLLED
        for (int i = 0; i < kLimbs; i++) {
            std::uint64_t carry = 0;
            GAINROOM_UNROLLED
            for (int j = std::max(0, kLimbs - 3 - i); j < kLimbs; j++)  // lower columns come after the last bit
                product[i + j] = low_of_product(a.limbs_[i], b.limbs_[j], product[i + j], carry);
            product[i + kLimbs] = carry;
        }
        Extended result;
        const int part = product[2 * kLimbs - 1] >> 63 ? 0 : 1;
        GAINROOM_UNROLLED
        for (int k = 0; k < kLimbs; k++) result.limbs_[k] = moved_left(product[k + kLimbs], product[k + kLimbs - 1], part);
        result.exponent_ = a.exponent_ + b.exponent_ - part;
        result.negative_ = a.negative_ != b.negative_;
        return result;
    }

    // 1/a by Newton, from the 53 bits of a double.
    Extended inverse() const {
        if (is_zero()) return *this;
        Extended mantissa = *this;
        mantissa.exponent_ = 0;
        Extended result(1 / mantissa.to_double());
        for (int bits = 50; bits < kBits; bits *= 2) result = result + result * (Extended(1.0) - mantissa * result);
        return result.shifted(-exponent_);
    }
    friend Extended operator/(const Extended& a, const Extended& b) { return a * b.inverse(); }

   private:
    using Limbs = std::array<std::uint64_t, kLimbs>;  // lowest first
    struct Nothing {};

    Limbs limbs_{};
    std::int64_t exponent_ = 0;
    bool negative_ = false;

    explicit Extended(Nothing) {}

    static bool larger(const Extended& a, const Extended& b) {
        if (a.exponent_ != b.exponent_) return a.exponent_ > b.exponent_;
        for (int k = kLimbs - 1; k >= 0; k--)
            if (a.limbs_[k] != b.limbs_[k]) return a.limbs_[k] > b.limbs_[k];
        return true;
    }

    // The lower half of a b + c + carry, whose upper half becomes the carry.
    GAINROOM_INLINE static std::uint64_t low_of_product(std::uint64_t a, std::uint64_t b, std::uint64_t c, std::uint64_t& carry) {
#if defined(__SIZEOF_INT128__) && !defined(GAINROOM_PLAIN)
        __extension__ typedef unsigned __int128 Wide;
        const Wide whole = static_cast<Wide>(a) * b + c + carry;
        carry = static_cast<std::uint64_t>(whole >> 64);
        return static_cast<std::uint64_t>(whole);
#else
        // Digits of 32 bits (Knuth, The Art of Computer Programming 2, 4.3.1, Algorithm M).
        constexpr std::uint64_t kDigit = 0xffffffff;
        const std::uint64_t a_low = a & kDigit, a_high = a >> 32, b_low = b & kDigit, b_high = b >> 32;
        const std::uint64_t first = a_low * b_low, second = a_high * b_low + (first >> 32), third = a_low * b_high + (second & kDigit);
        std::uint64_t low = third << 32 | (first & kDigit), high = a_high * b_high + (second >> 32) + (third >> 32);
        for (const std::uint64_t more : {c, carry}) {
            low += more;
            high += low < more;
        }
        carry = high;
        return low;
#endif
    }

    // The upper 64 of 128 bits that are moved left by 0 to 63; a branch less, as numbers are not moved by 64.
    static std::uint64_t moved_left(std::uint64_t high, std::uint64_t low, int bits) { return high << bits | low >> 1 >> (63 - bits); }

    static Limbs moved_right(const Limbs& limbs, int bits) {
        const int whole = bits / 64, part = bits % 64;
        Limbs result{};
        for (int k = 0; k + whole + 1 < kLimbs; k++) result[k] = limbs[k + whole] >> part | limbs[k + whole + 1] << 1 << (63 - part);
        result[kLimbs - 1 - whole] = limbs[kLimbs - 1] >> part;
        return result;
    }

    Extended& add(const Limbs& other) {
        std::uint64_t carry = 0;
        GAINROOM_UNROLLED
        for (int k = 0; k < kLimbs; k++) {
            const std::uint64_t sum = limbs_[k] + other[k], whole = sum + carry;
            carry = (sum < other[k]) | (whole < sum);
            limbs_[k] = whole;
        }
        if (carry) {
            limbs_ = moved_right(limbs_, 1);
            limbs_[kLimbs - 1] |= std::uint64_t{1} << 63;
            exponent_++;
        }
        return *this;
    }

    // Of a number that is no larger.
    Extended& subtract(const Limbs& other) {
        std::uint64_t borrow = 0;
        GAINROOM_UNROLLED
        for (int k = 0; k < kLimbs; k++) {
            const std::uint64_t difference = limbs_[k] - other[k], whole = difference - borrow;
            borrow = (limbs_[k] < other[k]) | (difference < borrow);
            limbs_[k] = whole;
        }
        int top = kLimbs - 1;
        while (top >= 0 && limbs_[top] == 0) top--;
        if (top < 0) return *this = Extended(Nothing{});
        int part = 0;
        while (!(limbs_[top] << part >> 63)) part++;
        const int whole = kLimbs - 1 - top;
        for (int k = kLimbs - 1; k >= 0; k--) {
            const int from = k - whole;
            limbs_[k] = from < 0 ? 0 : moved_left(limbs_[from], from > 0 ? limbs_[from - 1] : 0, part);
        }
        exponent_ -= 64 * whole + part;
        return *this;
    }
};

struct ExtendedComplex {
    Extended real, imag;

    ExtendedComplex() = default;
    ExtendedComplex(Extended real, Extended imag) : real(real), imag(imag) {}
    ExtendedComplex(Extended real) : real(real) {}
    ExtendedComplex(Complex value) : real(value.real()), imag(value.imag()) {}

    ExtendedComplex conjugate() const { return {real, -imag}; }
    Complex to_double() const { return {real.to_double(), imag.to_double()}; }
    std::int64_t exponent() const { return std::max(real.exponent(), imag.exponent()); }

    friend ExtendedComplex operator+(const ExtendedComplex& a, const ExtendedComplex& b) { return {a.real + b.real, a.imag + b.imag}; }
    friend ExtendedComplex operator-(const ExtendedComplex& a, const ExtendedComplex& b) { return {a.real - b.real, a.imag - b.imag}; }
    friend ExtendedComplex operator*(const ExtendedComplex& a, const ExtendedComplex& b) {
        return {a.real * b.real - a.imag * b.imag, a.real * b.imag + a.imag * b.real};
    }
    friend ExtendedComplex operator*(const ExtendedComplex& a, const Extended& b) { return {a.real * b, a.imag * b}; }
    ExtendedComplex squared() const { return {(real + imag) * (real - imag), (real * imag).shifted(1)}; }
    friend ExtendedComplex operator/(const ExtendedComplex& a, const ExtendedComplex& b) {
        const Extended scale = (b.real * b.real + b.imag * b.imag).inverse();
        return a * b.conjugate() * scale;
    }
};

// e^z by its series at z/2^k, squared k times; 0 where it is less than any double.
inline ExtendedComplex exponential(const ExtendedComplex& z) {
    constexpr double kLeast = -2000.0;
    if (z.real.to_double() < kLeast) return {};
    const std::int64_t halvings = std::max<std::int64_t>(0, z.exponent() + 16);
    const ExtendedComplex part(z.real.shifted(-halvings), z.imag.shifted(-halvings));
    constexpr int kTerms = 20;  // 2^(−16·20)/20! is below the last bit
    static const auto factors = [] {
        std::array<Extended, kTerms> all{Extended(1.0)};
        for (int k = 1; k < kTerms; k++) all[k] = all[k - 1] * Extended(static_cast<double>(k)).inverse();
        return all;
    }();
    // Four powers at a time, so that most products are with a real number.
    const ExtendedComplex second = part.squared(), third = second * part, fourth = second.squared();
    ExtendedComplex sum;
    for (int k = kTerms - 4; k >= 0; k -= 4)
        sum = sum * fourth + (third * factors[k + 3] + second * factors[k + 2] + part * factors[k + 1] + ExtendedComplex(factors[k]));
    for (std::int64_t k = 0; k < halvings; k++) sum = sum.squared();
    return sum;
}

}  // namespace gainroom
