// Loci from one sample to the next: which belongs to which, and how they pass −1.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "assignment.hpp"
#include "complex.hpp"

namespace gainroom {

// Eigenvalues λ of L at one frequency, ln|λ|, arg λ and arg(1 + λ).
struct Loci {
    std::vector<Complex> values;
    std::vector<double> sizes, angles, returned;

    void describe() {
        for (auto* one : {&sizes, &angles, &returned}) one->reserve(values.size());
        for (const Complex& value : values) {
            sizes.push_back(std::log(std::max(std::abs(value), 1e-150)));
            angles.push_back(std::arg(value));
            returned.push_back(std::arg(1.0 + value));
        }
    }
};

// How often, with its sign, the argument of a value on the way from `a` to `b` passes from π to −π.
inline int wraps(Complex a, Complex b) {
    if ((a.imag() >= 0) == (b.imag() >= 0) || (a.real() > 0 && b.real() > 0)) return 0;
    const double side = a.real() * b.imag() - b.real() * a.imag();  // of the origin
    return a.imag() >= 0 ? (side > 0 ? 1 : 0) : (side < 0 ? -1 : 0);
}

// |μ| > size, 2μ = (1 − λ)/(1 + λ).
inline bool nearer(Complex locus, double size) { return std::norm(1.0 - locus) > 4 * size * size * std::norm(1.0 + locus); }

inline Complex nearest_to_minus_one(Complex start, Complex end) {
    const Complex move = end - start;
    const double square = std::max(std::norm(move), 1e-300);
    return start + std::clamp(times(-1.0 - start, std::conj(move)).real() / square, 0.0, 1.0) * move;
}

// Whether a step passes −1 at less than a third of its own length, and turns about it: on which side is not to be seen from its ends.
inline bool passes(Complex start, Complex end) {
    return std::norm(1.0 + nearest_to_minus_one(start, end)) < 0.1 * std::norm(end - start) &&
           std::fabs(turn_between(1.0 + start, 1.0 + end)) > 0.8;
}

// Whether factor λ is so small that no step from it to another such one comes near −1, or turns 1 + factor λ past the negative real axis.
inline bool stays_small(Complex factor, Complex locus) { return std::norm(factor) * std::norm(locus) < 0.25; }

// Which locus of `high` continues each of `low`: the nearest in ln of size and direction, or where two claim the same the nearest as a whole.
inline std::vector<std::size_t> paired(const Loci& low, const Loci& high) {
    const std::size_t m = low.values.size();
    std::vector<double> distances(m * m);
    std::vector<std::size_t> pairs(m);
    std::vector<char> taken(m, 0);
    bool clash = false;
    for (std::size_t i = 0; i < m; i++) {
        for (std::size_t j = 0; j < m; j++) {
            const double grown = high.sizes[j] - low.sizes[i], turned = kPi - std::fabs(std::fabs(high.angles[j] - low.angles[i]) - kPi);
            distances[i * m + j] = grown * grown + turned * turned;
        }
        const double* row = &distances[i * m];
        pairs[i] = static_cast<std::size_t>(std::min_element(row, row + m) - row);
        clash |= taken[pairs[i]]++ > 0;
    }
    return clash ? assigned(distances.data(), m) : pairs;
}

}  // namespace gainroom
