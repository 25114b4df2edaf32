// The posture estimate of a robot's computer: joints from encoders, the base from contacts that stay where they are, and the values of
// tasks there. See simulation/whole_body.py.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <vector>

#include "rigid_tree.hpp"

namespace gainroom {

// For one thread at a time.
class PostureEstimate {
public:
    // Contacts stay where the posture `start` (nq) has them.
    PostureEstimate(const RigidTree& tree, std::vector<HeldFrame> contacts, const double* start)
        : tree_(tree), contacts_(std::move(contacts)), q_(start, start + tree.positions()), last_(tree.joints()),
          counted_(tree.base_velocities() * tree.joints()), twist_(tree.velocities()) {
        tree_.get(start, last_.data());
        tree_.place(start);
        for (const HeldFrame& contact : contacts_) {
            goals_.push_back(tree_.at(contact.frame));
            rows_ += contact.rows();
        }
        away_.resize(rows_);
        back_.resize(tree.velocities() * rows_);
    }

    const RigidTree& tree() const { return tree_; }
    std::size_t rows() const { return rows_; }
    const std::vector<double>& posture() const { return q_; }

    // From now on `back` (N, rows) brings held frames back, and the base is counted on by `counted` (6, n) times the joints' motion where
    // encoders and contacts do not show all of its motion; else nullptr.
    void renew(const double* back, const double* counted) {
        std::copy_n(back, back_.size(), back_.begin());
        counts_ = counted != nullptr;
        if (counts_) std::copy_n(counted, counted_.size(), counted_.begin());
    }

    // One Newton step on the encoders' `joints` (n).
    void update(const double* joints) {
        const std::size_t n = tree_.joints();
        if (counts_ && tree_.base_velocities()) {
            for (std::size_t i = 0; i < kTwist; i++) {
                double sum = 0.0;
                for (std::size_t k = 0; k < n; k++) sum += counted_[i * n + k] * (joints[k] - last_[k]);
                twist_[i] = sum;
            }
            RigidTree::move_base(q_.data(), twist_.data());
        }
        std::copy_n(joints, n, last_.begin());
        tree_.put(joints, q_.data());
        if (!rows_) return;
        look();
        for (std::size_t i = 0; i < twist_.size(); i++) {
            const double* row = &back_[i * rows_];
            double sum = 0.0;
            for (std::size_t k = 0; k < rows_; k++) sum += row[k] * away_[k];
            twist_[i] = sum;
        }
        tree_.integrate(q_.data(), twist_.data());
    }

private:
    // How far each contact frame is from its place, along the directions it is held in, in its own axes.
    void look() {
        tree_.place(q_.data());
        double* out = away_.data();
        for (std::size_t c = 0; c < contacts_.size(); c++) {
            const std::array<bool, kTwist>& held = contacts_[c].held;
            const Pose left = seen_from(tree_.at(contacts_[c].frame), goals_[c]);
            const Triple angular = logarithm(left.axes);
            // with all six, to second order; free directions may have turned far
            const bool all = std::find(held.begin(), held.end(), false) == held.end();
            const Triple linear = all ? linear_logarithm(angular, left.origin) : left.origin;
            const Six away = six(linear, angular);
            for (std::size_t k = 0; k < kTwist; k++)
                if (held[k]) *out++ = away[k];
        }
    }

    RigidTree tree_;
    std::vector<HeldFrame> contacts_;
    std::vector<Pose> goals_;
    std::vector<double> q_, last_, back_, counted_, twist_, away_;
    std::size_t rows_ = 0;
    bool counts_ = false;
};

// Values of tasks at a posture, world axes; orientations as rotation vectors from the posture `start`. For one thread at a time.
class TaskValues {
public:
    TaskValues(const RigidTree& tree, std::vector<TaskReading> tasks, const double* start) : tree_(tree), tasks_(std::move(tasks)) {
        tree_.place(start);
        for (const TaskReading& task : tasks_) {
            first_.push_back(transposed(tree_.at(task.frame).axes));
            size_ += task.directions(tree_);
        }
    }

    const RigidTree& tree() const { return tree_; }
    std::size_t size() const { return size_; }

    void read(const double* q, double* values) {
        tree_.place(q);
        for (std::size_t k = 0; k < tasks_.size(); k++) {
            if (tasks_[k].kind == Reading::posture) {
                tree_.get(q, values);
                values += tree_.joints();
                continue;
            }
            const Triple found = read(tasks_[k], first_[k]);
            values = std::copy(found.begin(), found.end(), values);
        }
    }

private:
    Triple read(const TaskReading& task, const Rotation& first) {
        if (task.kind == Reading::center) return tree_.center();
        const Pose at = tree_.at(task.frame);
        return task.kind == Reading::position ? at.origin : logarithm(turned(at.axes, first));
    }

    RigidTree tree_;
    std::vector<TaskReading> tasks_;
    std::vector<Rotation> first_;
    std::size_t size_ = 0;
};

}  // namespace gainroom
