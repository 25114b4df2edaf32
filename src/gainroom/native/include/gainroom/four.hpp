// Four numbers, added, multiplied and divided at once. Short loops over sums that should stay in registers compilers turn inside out.
#pragma once

#include <cstddef>
#include <cstring>

#include "block.hpp"
#include "processor.hpp"

namespace gainroom {

#if defined(__GNUC__) && !defined(GAINROOM_PLAIN)
#pragma GCC diagnostic ignored "-Wpsabi"  // nothing here is called across libraries
typedef double Four __attribute__((vector_size(32)));
#else
struct Four {
    double of[4];
};
inline Four operator*(double a, const Four& b) { return {{a * b.of[0], a * b.of[1], a * b.of[2], a * b.of[3]}}; }
inline Four operator*(const Four& a, const Four& b) {
    return {{a.of[0] * b.of[0], a.of[1] * b.of[1], a.of[2] * b.of[2], a.of[3] * b.of[3]}};
}
inline Four operator+(const Four& a, const Four& b) {
    return {{a.of[0] + b.of[0], a.of[1] + b.of[1], a.of[2] + b.of[2], a.of[3] + b.of[3]}};
}
inline Four operator-(const Four& a, const Four& b) {
    return {{a.of[0] - b.of[0], a.of[1] - b.of[1], a.of[2] - b.of[2], a.of[3] - b.of[3]}};
}
inline Four operator+(const Four& a, double b) { return {{a.of[0] + b, a.of[1] + b, a.of[2] + b, a.of[3] + b}}; }
inline Four operator/(double a, const Four& b) { return {{a / b.of[0], a / b.of[1], a / b.of[2], a / b.of[3]}}; }
inline Four& operator+=(Four& a, const Four& b) { return a = a + b; }
#endif

GAINROOM_INLINE Four four(const double* from) {
    Four found;
    std::memcpy(&found, from, sizeof found);
    return found;
}

GAINROOM_INLINE void put(double* to, const Four& from) { std::memcpy(to, &from, sizeof from); }

GAINROOM_INLINE double sum_of(const Four& a) {
    double parts[4];
    put(parts, a);
    return (parts[0] + parts[1]) + (parts[2] + parts[3]);
}

// Numbers, 0 at first, of which a Four lies in one line of the cache: one that lies in two takes twice as long.
class Numbers {
public:
    explicit Numbers(std::size_t count) : lines_((count + 7) / 8) {}
    double* data() { return lines_.empty() ? nullptr : lines_.front().of; }
    const double* data() const { return lines_.empty() ? nullptr : lines_.front().of; }
    double& operator[](std::size_t k) { return data()[k]; }
    const double& operator[](std::size_t k) const { return data()[k]; }

private:
    struct alignas(kLine) Line {
        double of[8] = {};
    };
    Vector<Line> lines_;
};

// So many numbers are `count`, and those beside them up to whole fours.
constexpr std::size_t fours(std::size_t count) { return (count + 3) / 4 * 4; }

GAINROOM_INLINE double scalar_product(const double* a, const double* b, std::size_t count) {
    const double nothing[4] = {};
    Four chains = four(nothing);  // one alone would wait for its own result
    std::size_t k = 0;
    for (; k + 4 <= count; k += 4) chains += four(a + k) * four(b + k);
    double rest = 0.0;
    for (; k < count; k++) rest += a[k] * b[k];
    return sum_of(chains) + rest;
}

GAINROOM_INLINE void subtract(double* from, double factor, const double* what, std::size_t count) {
    std::size_t k = 0;
    for (; k + 4 <= count; k += 4) put(from + k, four(from + k) - factor * four(what + k));
    for (; k < count; k++) from[k] -= factor * what[k];
}

// The same with what stands beside them, up to whole fours.
GAINROOM_INLINE void subtract_fours(double* from, double factor, const double* what, std::size_t count) {
    for (std::size_t k = 0; k < count; k += 4) put(from + k, four(from + k) - factor * four(what + k));
}

// Four complex numbers take a + jb times others.
GAINROOM_INLINE void subtract_complex(double* to_re, double* to_im, double a, double b, const double* re, const double* im) {
    const Four x = four(re), y = four(im);
    put(to_re, four(to_re) - (a * x - b * y));
    put(to_im, four(to_im) - (a * y + b * x));
}

}  // namespace gainroom
