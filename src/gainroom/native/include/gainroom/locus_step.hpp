// Loci from one sample to the next: which belongs to which, and how they pass −1.
#pragma once

#include <algorithm>
#include <array>
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

    double largest() const {
        double found = 0.0;
        for (const Complex& value : values) found = std::max(found, std::norm(value));
        return std::sqrt(found);
    }

    void describe() {
        for (auto* one : {&sizes, &angles, &returned}) one->reserve(values.size());
        for (const Complex& value : values) {
            sizes.push_back(std::log(std::max(size_of_any(value), 1e-150)));
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

// Whether two loci of equal limbs are nearer to each other's next places than is clear: each may take the other's way, and cross the unit circle
// with a phase, or the negative real axis with a |ln g|, below these, more often than their ends show.
inline bool may_exchange(const Loci& before, const Loci& after, const std::vector<std::size_t>& pairs, double factor, double phase) {
    // Of their moves, that tell two loci apart; of their size: nearer ones cross within that of where one would.
    constexpr double kTold = 3.0, kEqual = 3e-4, kBeyond = 0.25;
    const auto left = [](double angle) { return angle > 0 ? kPi - angle : -kPi - angle; };  // from the negative real axis
    // 0 lies between the four or near them, as they are apart; so does what they cross at with what is below `limit`.
    const auto may_cross = [](const std::array<double, 4>& off, const std::array<double, 4>& at, double limit) {
        const auto [least, most] = std::minmax_element(off.begin(), off.end());
        const auto [first, last] = std::minmax_element(at.begin(), at.end());
        return *least < kBeyond * (*most - *least) && -*most < kBeyond * (*most - *least) && *first - kBeyond * (*last - *first) < limit;
    };
    std::vector<double> moves(pairs.size());
    for (std::size_t i = 0; i < pairs.size(); i++) {
        moves[i] = size_of_any(after.values[pairs[i]] - before.values[i]);
        for (std::size_t k = 0; k < i; k++) {
            const std::size_t j = pairs[i], l = pairs[k];
            const Complex from = before.values[i], to = after.values[j], other = before.values[k], next = after.values[l];
            const double straight = moves[i] + moves[k], farthest = 0.5 * (kTold + 1) * straight;
            if (std::norm(from - other) > farthest * farthest) continue;  // `swapped` is at least 2 |from − other| − straight
            if (std::max(std::norm(from - other), std::norm(to - next)) < kEqual * kEqual * std::norm(from)) continue;
            const std::array<double, 4> sizes = {before.sizes[i], after.sizes[j], before.sizes[k], after.sizes[l]};
            const std::array<double, 4> angles = {left(before.angles[i]), left(after.angles[j]), left(before.angles[k]), left(after.angles[l])};
            std::array<double, 4> size = sizes, angle = angles;
            for (double& one : size) one = std::fabs(one);
            for (double& one : angle) one = std::fabs(one);
            if (!may_cross(sizes, angle, phase) && !may_cross(angles, size, factor)) continue;
            if (size_of_any(next - from) + size_of_any(to - other) < kTold * straight) return true;
        }
    }
    return false;
}

}  // namespace gainroom
