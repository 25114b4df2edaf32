// The distance between two postures, measured by the change of the inverse inertia.
#pragma once

#include <cmath>
#include <cstddef>

#include "block.hpp"
#include "complex.hpp"
#include "four.hpp"
#include "joint_law.hpp"

namespace gainroom {

class PostureChange {
public:
    explicit PostureChange(std::size_t size) : stride_(fours(size)), inverse_root_(size), change_(size * stride_) {}

    // From W `before` to `now` (n, n): at least the largest |λ| of E = S^(−½)(now − before) S^(−½) with S = diag(before + 1/J), and little
    // more: (Σ λ⁴)^¼ = ‖E²‖^½.
    GAINROOM_WIDE double operator()(const JointLaws& laws, const double* before, const double* now) {
        const std::size_t n = laws.size();
        for (std::size_t i = 0; i < n; i++) inverse_root_[i] = 1.0 / std::sqrt(before[i * n + i] + 1.0 / laws.joint(i).motor_inertia);
        for (std::size_t i = 0; i < n; i++)
            for (std::size_t j = 0; j < n; j++) change_[i * stride_ + j] = inverse_root_[i] * inverse_root_[j] * (now[i * n + j] - before[i * n + j]);
        const double nothing[4] = {};
        Four sums = four(nothing), beside = sums;
        for (std::size_t i = 0; i < n; i += 4)  // E² in squares of four by four on and beside its diagonal: it is symmetric
            for (std::size_t j = i; j < n; j += 4) {
                Four rows[4] = {four(nothing), four(nothing), four(nothing), four(nothing)};
                for (std::size_t k = 0; k < n; k++) {
                    const Four row = four(&change_[k * stride_ + j]);
                    for (std::size_t m = 0; m < 4; m++) rows[m] += change_[k * stride_ + i + m] * row;
                }
                for (const Four& row : rows) (i == j ? sums : beside) += row * row;
            }
        return std::sqrt(std::sqrt(sum_of(sums) + 2.0 * sum_of(beside)));
    }

private:
    std::size_t stride_;
    Vector<double> inverse_root_, change_;  // change_: E, in rows of whole fours
};

}  // namespace gainroom
