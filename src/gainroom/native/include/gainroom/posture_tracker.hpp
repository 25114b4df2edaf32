// The gain limit at every tick from a posture alone: mass matrix, contact Jacobians and those of tasks are the tree's own.
#pragma once

#include <cmath>
#include <cstddef>
#include <optional>
#include <utility>
#include <vector>

#include "block.hpp"
#include "robot_tracker.hpp"
#include "tree_dynamics.hpp"

namespace gainroom {

// For one thread at a time. All space is taken here, in one block. `robot` has to outlive it.
class PostureTracker {
public:
    // contacts   the frames that each contact state of `robot` holds
    // switches   contact states that are kept ready for a switch
    // tasks      in the order of the robot's task gains; none in joint space
    PostureTracker(RobotTracker& robot, const RigidTree& tree, const std::vector<std::vector<HeldFrame>>& contacts,
                   const std::vector<std::size_t>& switches, const std::vector<TaskReading>& tasks)
        : filling_(std::in_place, block_), robot_(robot), dynamics_(tree), switches_(switches.begin(), switches.end()),
          tasks_(tasks.begin(), tasks.end()), mass_(tree.velocities() * tree.velocities()), rows_(robot.links().most_rows() * tree.velocities()),
          task_rows_(robot.directions() * tree.velocities()), q_(tree.positions()), every_(tasks_.empty() ? kPrepared : kPreparedTasks) {
        for (const auto& one : contacts) contacts_.emplace_back(one.begin(), one.end());
        filling_.reset();
    }

    const RigidTree& tree() const { return dynamics_.tree(); }

    // One tick at posture q (nq) in contact state `contact`. No exceptions, no allocation.
    Limit update(const double* q, std::size_t contact) {
        if (contact >= contacts_.size()) return robot_.tracker().lost(Flag::bad_contact);
        if (!take(q)) return robot_.tracker().lost(Flag::bad_posture, contact);
        dynamics_.place(q_.data());
        dynamics_.mass_matrix(mass_.data());
        double* end = task_rows_.data();
        for (const TaskReading& task : tasks_) end = dynamics_.write(task, end);
        const std::size_t count = hold(contact);
        const Limit found = robot_.update(mass_.data(), rows_.data(), count, contact, tasks_.empty() ? nullptr : task_rows_.data());
        if (++waited_ >= every_ && robot_.tracker().load() < (waited_ < kLate * every_ ? kQuiet : Tracker::kBusy)) prepare_next(contact);
        return found;
    }

private:
    // Ticks after which another contact state is made ready, in a quiet one; kLate times as many, in any. From farther away crossings of tasks take
    // longer to follow than a tick has.
    static constexpr std::size_t kPrepared = 8, kPreparedTasks = 3, kLate = 3;
    static constexpr double kQuiet = 0.4;
    static constexpr double kUnit = 1e-3;  // so far squares of quaternions, cosines and sines may be from 1

    // Into q_, with quaternions, cosines and sines brought to unit size; false where they are not nearly so, or one is no number.
    bool take(const double* q) {
        for (std::size_t k = 0; k < q_.size(); k++) {
            if (!std::isfinite(q[k])) return false;
            q_[k] = q[k];
        }
        double* next = q_.data();
        if (tree().base_velocities()) {
            if (!normalize(next + 3, 4)) return false;
            next += 7;
        }
        for (std::size_t k = 0; k < tree().joints(); k++) {
            const bool continuous = tree().joint(k).continuous;
            if (continuous && !normalize(next, 2)) return false;
            next += continuous ? 2 : 1;
        }
        return true;
    }

    static bool normalize(double* values, std::size_t count) {
        double square = 0.0;
        for (std::size_t k = 0; k < count; k++) square += values[k] * values[k];
        if (!(std::fabs(square - 1.0) < kUnit)) return false;
        const double size = std::sqrt(square);
        for (std::size_t k = 0; k < count; k++) values[k] /= size;
        return true;
    }

    // The rows that a contact state holds, into rows_; how many.
    std::size_t hold(std::size_t contact) {
        double* end = rows_.data();
        for (const HeldFrame& one : contacts_[contact]) end = dynamics_.write(one, end);
        return std::size_t(end - rows_.data()) / tree().velocities();
    }

    // Another one each time.
    void prepare_next(std::size_t now) {
        waited_ = 0;
        for (std::size_t k = 0; k < switches_.size(); k++) {
            turn_ = (turn_ + 1) % switches_.size();
            if (switches_[turn_] == now) continue;
            const std::size_t count = hold(switches_[turn_]);
            return robot_.prepare(rows_.data(), count, switches_[turn_]);
        }
    }

    Block block_;
    std::optional<Block::Filling> filling_;  // until all that follows is made
    RobotTracker& robot_;
    TreeDynamics dynamics_;
    Vector<Vector<HeldFrame>> contacts_;
    Vector<std::size_t> switches_;
    Vector<TaskReading> tasks_;
    Vector<double> mass_, rows_, task_rows_, q_;
    std::size_t every_, waited_ = 0, turn_ = 0;  // see kPrepared; ticks since the last one was made ready; its place in switches_
};

}  // namespace gainroom
