// Loci from one sample to the next: which belongs to which, and how they pass −1.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "complex.hpp"

namespace gainroom {

// Eigenvalues λ of L at one frequency, ln|λ|, arg λ and arg(1 + λ).
struct Loci {
    std::vector<Complex> values;
    std::vector<double> sizes, angles, returned;

    bool known() const { return !values.empty(); }
    void describe() {
        for (const Complex& value : values) {
            sizes.push_back(0.5 * std::log(std::max(std::norm(value), 1e-300)));
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

// Which locus of `high` continues each of `low`: the nearest in ln of size and direction, the nearest as a whole.
inline std::vector<int> paired(const Loci& low, const Loci& high) {
    const std::size_t m = low.values.size();
    struct Distance {
        double square;
        int from, to;
    };
    std::vector<int> pairs(m, -1), taken(m, 0);
    const auto distance = [&](std::size_t i, std::size_t j) {
        const double grown = high.sizes[j] - low.sizes[i], turned = kPi - std::fabs(std::fabs(high.angles[j] - low.angles[i]) - kPi);
        return grown * grown + turned * turned;
    };
    bool clash = false;
    for (std::size_t i = 0; i < m; i++) {
        int nearest = 0;
        double least = distance(i, 0);
        for (std::size_t j = 1; j < m; j++) {
            const double square = distance(i, j);
            if (square < least) {
                least = square;
                nearest = static_cast<int>(j);
            }
        }
        pairs[i] = nearest;
        clash |= taken[static_cast<std::size_t>(nearest)]++ > 0;
    }
    if (!clash) return pairs;
    std::vector<Distance> all;
    for (std::size_t i = 0; i < m; i++)
        for (std::size_t j = 0; j < m; j++) all.push_back({distance(i, j), static_cast<int>(i), static_cast<int>(j)});
    std::stable_sort(all.begin(), all.end(), [](const Distance& a, const Distance& b) { return a.square < b.square; });
    std::fill(pairs.begin(), pairs.end(), -1);
    std::fill(taken.begin(), taken.end(), 0);
    for (const Distance& one : all)
        if (pairs[static_cast<std::size_t>(one.from)] < 0 && !taken[static_cast<std::size_t>(one.to)]) {
            pairs[static_cast<std::size_t>(one.from)] = one.to;
            taken[static_cast<std::size_t>(one.to)] = 1;
        }
    for (bool better = true; better;) {  // two that are nearer as a whole when they change places
        better = false;
        for (std::size_t i = 0; i < m; i++)
            for (std::size_t j = i + 1; j < m; j++) {
                const auto a = static_cast<std::size_t>(pairs[i]), b = static_cast<std::size_t>(pairs[j]);
                if (distance(i, b) + distance(j, a) < (distance(i, a) + distance(j, b)) * (1 - 1e-9)) {
                    std::swap(pairs[i], pairs[j]);
                    better = true;
                }
            }
    }
    return pairs;
}

}  // namespace gainroom
