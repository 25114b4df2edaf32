// How far a robot has moved, as far as its inverse inertia tells.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

#include "joint_law.hpp"
#include "link_inertia.hpp"

namespace gainroom {

class PostureChange {
public:
    explicit PostureChange(std::size_t size) : inverse_root_(size), change_(size * size), square_(size) {}

    // From W `before` to `now` (n, n): at least the largest |λ| of E = S^(−½)(now − before) S^(−½) with S = diag(before + 1/J), and little
    // more: (Σ λ⁴)^¼ = ‖E²‖^½.
    double operator()(const JointLaws& laws, const double* before, const double* now) {
        const std::size_t n = laws.size();
        for (std::size_t i = 0; i < n; i++) inverse_root_[i] = 1.0 / std::sqrt(before[i * n + i] + 1.0 / laws.joint(i).motor_inertia);
        for (std::size_t i = 0; i < n; i++)
            for (std::size_t j = 0; j < n; j++) change_[i * n + j] = inverse_root_[i] * inverse_root_[j] * (now[i * n + j] - before[i * n + j]);
        double sum = 0.0;
        for (std::size_t i = 0; i < n; i++) {
            for (std::size_t j = 0; j <= i; j++) square_[j] = 0.0;
            for (std::size_t k = 0; k < n; k++) subtract(square_.data(), change_[i * n + k], &change_[k * n], i + 1);
            sum += 2.0 * scalar_product(square_.data(), square_.data(), i) + square_[i] * square_[i];
        }
        return std::sqrt(std::sqrt(sum));
    }

private:
    std::vector<double> inverse_root_, change_, square_;
};

}  // namespace gainroom
