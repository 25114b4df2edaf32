// How far a robot has moved, as far as its inverse inertia tells.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

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
        Four sums = four(nothing);
        for (std::size_t i = 0; i < n; i++)  // rows of E² one after the other, four columns at a time
            for (std::size_t j = 0; j < n; j += 4) {
                Four square = four(nothing);
                for (std::size_t k = 0; k < n; k++) square += change_[i * stride_ + k] * four(&change_[k * stride_ + j]);
                sums += square * square;
            }
        return std::sqrt(std::sqrt(sum_of(sums)));
    }

private:
    std::size_t stride_;
    std::vector<double> inverse_root_, change_;  // change_: E, in rows of whole fours
};

}  // namespace gainroom
