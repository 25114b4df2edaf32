// Four numbers, added, multiplied and divided at once. Short loops over sums that should stay in registers compilers turn inside out.
#pragma once

#include <cstddef>
#include <cstring>

// Always inline: a call would not know which registers the caller's processor returns four numbers in.
#if defined(__GNUC__)
#define GAINROOM_INLINE inline __attribute__((always_inline))
#else
#define GAINROOM_INLINE inline
#endif

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

// So many numbers are `count`, and those beside them up to whole fours.
constexpr std::size_t fours(std::size_t count) { return (count + 3) / 4 * 4; }

}  // namespace gainroom
