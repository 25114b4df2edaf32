// The joint gain matrices of tasks at a posture, as TaskLoop takes them: W, then Q, R_p and R_v with Kpq = Q R_p Qᵀ, Kvq = Q R_v Qᵀ.
//
// Kpq = X diag(K'p) Eᵀ, and the columns of X are combinations of those of E (robot/tasks.py). Q are these made orthonormal in the tasks' order,
// so that it moves smoothly as the robot does; a direction that adds nothing has a column of zeros.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "block.hpp"
#include "joint_law.hpp"
#include "task_motion.hpp"

namespace gainroom {

// Tasks by falling priority: `sizes` directions each, of which each has K'p [1/s²] and K'v [1/s]; whether the controller's model of the
// robot counts the motors' inertia; MOVABLE of robot/tasks.py.
struct TaskStack {
    std::vector<std::size_t> sizes;
    std::vector<double> kp, kd;
    bool rotors = false;
    double movable = 1e-6;
};

class TaskGains {
public:
    TaskGains(const JointLaws& laws, std::size_t velocities, std::size_t rows, const TaskStack& tasks)
        : laws_(laws), kp_(tasks.kp.begin(), tasks.kp.end()), kd_(tasks.kd.begin(), tasks.kd.end()), rotors_(tasks.rotors),
          motion_(velocities, laws.size(), tasks.sizes, tasks.movable),
          own_(tasks.rotors ? velocities : 0, tasks.rotors ? laws.size() : 0, tasks.rotors ? rows : 0), mass_(tasks.rotors ? velocities * velocities : 0),
          unused_(tasks.rotors ? laws.size() * laws.size() : 0), jacobians_(motion_.directions() * velocities), rank_(rank(laws.size(), tasks)),
          shares_(2 * rank_ * motion_.directions()), column_(laws.size()) {
        for (std::size_t i = 0; i < laws.size(); i++) inverse_root_.push_back(1.0 / std::sqrt(laws.joint(i).motor_inertia));
    }

    // r of the TaskLoop.
    static std::size_t rank(std::size_t joints, const TaskStack& tasks) {
        std::size_t directions = 0;
        for (const std::size_t size : tasks.sizes) directions += size;
        return std::min(joints, directions);
    }
    std::size_t directions() const { return motion_.directions(); }
    // Up to where every direction's controller takes energy out through every drive [rad/s]; 0: nowhere.
    static double leading(const JointData* joints, std::size_t count, double sample_time, const TaskStack& tasks) {
        double last = std::numeric_limits<double>::infinity();
        std::vector<JointData> same(joints, joints + count);
        for (std::size_t k = 0; k < tasks.kp.size(); k++) {
            std::size_t before = 0;
            while (before < k && (tasks.kp[before] != tasks.kp[k] || tasks.kd[before] != tasks.kd[k])) before++;
            if (before < k || (tasks.kp[k] == 0.0 && tasks.kd[k] == 0.0)) continue;
            for (JointData& joint : same) joint.kp = tasks.kp[k], joint.kd = tasks.kd[k];
            last = std::min(last, JointLaws(same.data(), count, sample_time).passive_end());
        }
        return std::isfinite(last) ? last : 0.0;
    }

    // Fills `gains` (what TaskLoop has after W) where `links` are: `mass` (N, N), `rows` (count, N) as there, `tasks` Jacobians (m, N) one below the other.
    bool compute(const LinkInertia& links, const double* mass, const double* rows, std::size_t count, const double* tasks, double* gains) {
        std::copy_n(tasks, jacobians_.size(), jacobians_.begin());
        if (!rotors_) return fill(links, gains);
        const std::size_t size = own_.velocities(), base = size - laws_.size();
        std::copy_n(mass, size * size, mass_.begin());
        for (std::size_t i = 0; i < laws_.size(); i++) mass_[(base + i) * (size + 1)] += laws_.joint(i).motor_inertia;
        return own_.compute(mass_.data(), rows, count, unused_.data()) && fill(own_, gains);
    }

    // The same for other `rows`, at mass matrix and Jacobians of before.
    bool hold(const LinkInertia& links, const double* rows, std::size_t count, double* gains) {
        if (!rotors_) return fill(links, gains);
        return own_.hold(rows, count, unused_.data()) && fill(own_, gains);
    }

private:
    static constexpr double kAdds = 1e-8;  // of a direction's size, what it has to add to those before it

    // J^(−½) Q R_v Qᵀ J^(−½).
    GAINROOM_INLINE void spread_damping(const double* q, const double* damped, double* found) {
        const std::size_t n = laws_.size(), r = rank_;
        double* row = shares_.data();
        for (std::size_t i = 0; i < n; i++) {
            std::fill(row, row + r, 0.0);
            for (std::size_t k = 0; k < r; k++) subtract(row, -q[i * r + k], damped + k * r, r);
            for (std::size_t j = 0; j < n; j++) found[i * n + j] = inverse_root_[i] * inverse_root_[j] * scalar_product(row, q + j * r, r);
        }
    }

    GAINROOM_WIDE bool fill(const LinkInertia& links, double* gains) {
        if (!motion_.compute(links, jacobians_.data())) return false;
        const std::size_t n = laws_.size(), r = rank_, m = motion_.directions();
        const Real &e = motion_.jacobian(), &x = motion_.torque();
        double *q = gains, *seen = shares_.data(), *given = seen + r * m;
        orthonormal(e, q);
        std::fill(shares_.begin(), shares_.end(), 0.0);
        for (std::size_t i = 0; i < n; i++)
            for (std::size_t k = 0; k < r; k++) {
                subtract(seen + k * m, -q[i * r + k], e.row(i), m);
                subtract(given + k * m, -q[i * r + k], x.row(i), m);
            }
        double sum = 0.0;
        for (std::size_t k = 0; k < r; k++)
            for (std::size_t l = 0; l < r; l++) {
                double stiff = 0.0, damped = 0.0;
                for (std::size_t d = 0; d < m; d++) {
                    const double both = given[k * m + d] * seen[l * m + d];
                    stiff += kp_[d] * both;
                    damped += kd_[d] * both;
                }
                gains[n * r + k * r + l] = stiff;
                gains[n * r + (r + k) * r + l] = damped;
                sum += stiff + damped;
            }
        spread_damping(q, gains + n * r + r * r, gains + n * r + 2 * r * r);
        return std::isfinite(sum);
    }

    // The columns of E (n, m), one after the other, without those before. Where there are more than joints, those that add something.
    GAINROOM_INLINE void orthonormal(const Real& e, double* q) {
        const std::size_t n = e.rows, m = e.columns, r = rank_;
        std::fill(q, q + n * r, 0.0);
        double largest = 0.0;
        for (std::size_t d = 0; d < m; d++) largest = std::max(largest, size(e.entries.data() + d, m));
        for (std::size_t d = 0, k = 0; d < m && k < r; d++) {
            for (std::size_t i = 0; i < n; i++) column_[i] = e.row(i)[d];
            const double whole = size(column_.data(), 1);
            for (int pass = 0; pass < 2; pass++)
                for (std::size_t l = 0; l < k; l++) {
                    double share = 0.0;
                    for (std::size_t i = 0; i < n; i++) share += q[i * r + l] * column_[i];
                    for (std::size_t i = 0; i < n; i++) column_[i] -= share * q[i * r + l];
                }
            const double left = size(column_.data(), 1);
            const bool adds = left > kAdds * whole && whole > kAdds * largest;
            for (std::size_t i = 0; adds && i < n; i++) q[i * r + k] = column_[i] / left;
            if (adds || m == r) k++;
        }
    }

    // Of n entries, `stride` apart.
    GAINROOM_INLINE double size(const double* values, std::size_t stride) const {
        double sum = 0.0;
        for (std::size_t i = 0; i < laws_.size(); i++) sum += values[i * stride] * values[i * stride];
        return std::sqrt(sum);
    }

    const JointLaws& laws_;
    Vector<double> kp_, kd_;
    bool rotors_;
    TaskMotion motion_;
    LinkInertia own_;  // of the controller's model, where that is another
    Vector<double> mass_, unused_, jacobians_;
    std::size_t rank_;
    Vector<double> shares_, inverse_root_, column_;
};

}  // namespace gainroom
