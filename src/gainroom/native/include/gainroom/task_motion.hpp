// Tasks by strict priority on the motion that contacts leave: robot/tasks.py has the theory.
//
// With A = R_AᵀR_A and Q_c the held directions as in link_inertia.hpp, the joints reach Ŷ = (I − Q_c Q_cᵀ) R_A⁻ᵀ Sᵀ = U Lᵀ with U orthonormal, and a
// task J feels F = J R_A⁻¹ U of it. W = L Lᵀ and E = W⁺ S P Jᵀ = L⁺ᵀ Fᵀ; priorities are taken among the rows of F, and torques are X = L⁺ᵀ f.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "block.hpp"
#include "link_inertia.hpp"
#include "row_space.hpp"

namespace gainroom {

// For one machine and its tasks, of `sizes` directions by falling priority; all space is taken at construction. For one thread at a time.
class TaskMotion {
public:
    // movable: as MOVABLE in robot/tasks.py
    TaskMotion(std::size_t velocities, std::size_t joints, const std::vector<std::size_t>& sizes, double movable)
        : velocities_(velocities), joints_(joints), sizes_(sizes.begin(), sizes.end()), movable_(movable), ranks_(sizes_.size()), axis_(velocities) {
        std::size_t most = 0;
        for (const std::size_t size : sizes_) {
            directions_ += size;
            most = std::max(most, size);
        }
        reached_.entries.reserve(joints * velocities);
        space_.reserve(joints, velocities);
        left_.entries.reserve(most * joints);
        reach_.reserve(most, joints);
        for (Real* one : {&inner_, &taken_}) one->entries.reserve(joints * joints);
        for (Real* one : {&felt_, &force_}) one->entries.reserve(joints * directions_);
        for (Real* one : {&asked_, &back_}) one->entries.reserve(most * std::max(directions_, joints));
        for (Real* one : {&jacobian_, &torque_}) one->clear(joints, directions_);
    }

    std::size_t directions() const { return directions_; }
    // E (n, m), X (n, m), and how many directions of each task the joints can move.
    const Real& jacobian() const { return jacobian_; }
    const Real& torque() const { return torque_; }
    const Vector<std::size_t>& ranks() const { return ranks_; }

    // With `links` at a mass matrix and held directions, `tasks` their Jacobians (m, N), one below the other. False where a result is not finite.
    GAINROOM_WIDE bool compute(const LinkInertia& links, const double* tasks) {
        reached_.clear(joints_, velocities_);
        links.reach(reached_.entries.data());
        space_.find(reached_, movable_);
        space_.inverse_within(inner_);
        const std::size_t r = space_.rank();
        felt_.clear(directions_, r);
        force_.clear(r, directions_);
        taken_.clear(r, r);
        taken_.rows = 0;
        std::size_t start = 0;
        for (std::size_t k = 0; k < sizes_.size(); k++) {
            double scale = 0.0;
            for (std::size_t i = start; i < start + sizes_[k]; i++) {
                scale = std::max(scale, links.carry(tasks + i * velocities_, axis_.data()));
                space_.turn(axis_.data());
                std::copy_n(axis_.data(), r, felt_.row(i));
            }
            add(start, sizes_[k], movable_ * scale, ranks_[k]);
            start += sizes_[k];
        }
        return spread(felt_, true, jacobian_) && spread(force_, false, torque_);
    }

    // Y (N, n), how everything moves with the joints; after `compute`.
    void follow(const LinkInertia& links, Real& found) {
        found.clear(velocities_, joints_);
        for (std::size_t j = 0; j < joints_; j++) {
            std::fill(axis_.begin(), axis_.end(), 0.0);
            std::copy_n(inner_.row(j), space_.rank(), axis_.begin());
            space_.turn_back(axis_.data());
            links.release(axis_.data());
            for (std::size_t i = 0; i < velocities_; i++) found.row(i)[j] = axis_[i];
        }
    }

private:
    // The next task, of `count` rows of felt_ from `start` on: force_ grows by what it asks for beside those before it.
    GAINROOM_INLINE void add(std::size_t start, std::size_t count, double least, std::size_t& rank) {
        const std::size_t r = force_.rows, m = directions_;
        left_.clear(count, r);
        for (std::size_t i = 0; i < count; i++) {
            double* row = left_.row(i);
            std::copy_n(felt_.row(start + i), r, row);
            for (std::size_t t = 0; t < taken_.rows; t++)
                subtract(row, scalar_product(felt_.row(start + i), taken_.row(t), r), taken_.row(t), r);
        }
        reach_.find(left_, 0.0, least);
        rank = reach_.rank();
        asked_.clear(count, m);
        for (std::size_t i = 0; i < count; i++) {
            asked_.row(i)[start + i] = 1.0;
            for (std::size_t k = 0; k < r; k++)
                if (felt_.row(start + i)[k] != 0.0) subtract(asked_.row(i), felt_.row(start + i)[k], force_.row(k), m);
        }
        reach_.inverse_within(back_);
        for (std::size_t i = 0; i < count; i++) {
            std::fill(axis_.begin(), axis_.end(), 0.0);
            std::copy_n(back_.row(i), rank, axis_.begin());
            reach_.turn_back(axis_.data());
            for (std::size_t k = 0; k < r; k++)
                if (axis_[k] != 0.0) subtract(force_.row(k), -axis_[k], asked_.row(i), m);
        }
        for (std::size_t k = 0; k < rank && taken_.rows < r; k++) reach_.direction(k, taken_.row(taken_.rows++));
    }

    // inner_ times `what`, (r, m) or `turned` (m, r); whether it is finite.
    GAINROOM_INLINE bool spread(const Real& what, bool turned, Real& found) const {
        const std::size_t r = inner_.columns, m = directions_;
        found.clear(joints_, m);
        double sum = 0.0;
        for (std::size_t j = 0; j < joints_; j++) {
            double* row = found.row(j);
            if (turned)
                for (std::size_t i = 0; i < m; i++) row[i] = scalar_product(inner_.row(j), what.row(i), r);
            else
                for (std::size_t k = 0; k < r; k++) subtract(row, -inner_.row(j)[k], what.row(k), m);
            for (std::size_t i = 0; i < m; i++) sum += row[i];
        }
        return std::isfinite(sum);
    }

    std::size_t velocities_, joints_, directions_ = 0;
    Vector<std::size_t> sizes_;
    double movable_;
    Vector<std::size_t> ranks_;
    Vector<double> axis_;
    RowSpace space_, reach_;
    Real reached_, inner_, felt_, force_, taken_, left_, asked_, back_, jacobian_, torque_;
};

}  // namespace gainroom
