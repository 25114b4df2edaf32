// The gain limits of a robot at every tick from its posture alone: what GainTracker.to_header writes in Python, and what tracks it here
// (examples/posture_loop.cpp).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <optional>
#include <vector>

#include "posture_tracker.hpp"
#include "settling.hpp"

namespace gainroom {

// Of the headers that to_header writes: what TrackedRobot holds, and in which order.
constexpr int kTrackedRobotFormat = 1;

// A robot, its control and its contact states.
struct TrackedRobot {
    struct Contact {
        const char* name;
        std::vector<HeldFrame> held;
        bool tracked;  // false: it holds a floating base, but in too few directions to stand
        double limit;  // at `posture`, by gain_limit
    };

    const char* model;
    const char* version;  // of gainroom
    const char* date;
    double sample_time;  // [s]: of the ticks of the control that limits hold for; 0: continuous control
    double gain_margin;  // that the limits ask for: safe_gain over it is the factor on the gains that is allowed
    std::vector<const char*> joint_names;
    std::vector<JointData> joints;
    RigidTree tree;                  // its joints in the same order; tree.put(angles, q) writes their angles into a posture
    TaskStack stack;                 // without directions: each joint's own gains
    std::vector<TaskReading> tasks;  // as many as the stack has sizes
    std::vector<Contact> contacts;
    std::vector<double> posture;  // q (nq) of the first posture: position and quaternion (x, y, z, w) of a floating base, then the joints

    // The number of a contact state; as many as there are: none of this name.
    std::size_t contact(const char* name) const {
        const auto same = [name](const Contact& one) { return std::strcmp(one.name, name) == 0; };
        return std::size_t(std::find_if(contacts.begin(), contacts.end(), same) - contacts.begin());
    }

    // Whether sizes agree, frames are on links that there are, and limits are numbers: a header that was edited may have others.
    bool sound() const {
        const auto on_link = [this](const Frame& frame) { return frame.link <= tree.joints(); };
        std::size_t directions = 0, tracked = 0;
        if (!tree.sound() || stack.sizes.size() != tasks.size()) return false;
        for (std::size_t k = 0; k < tasks.size(); k++) {
            if (!on_link(tasks[k].frame) || stack.sizes[k] != tasks[k].directions(tree)) return false;
            directions += stack.sizes[k];
        }
        for (const Contact& one : contacts) {
            for (const HeldFrame& frame : one.held)
                if (!on_link(frame.frame)) return false;
            if (!(one.limit >= 0.0 && std::isfinite(one.limit)) || (one.tracked && one.limit == 0.0)) return false;
            tracked += one.tracked;
        }
        return tracked && stack.kp.size() == directions && stack.kd.size() == directions && sample_time >= 0.0 && std::isfinite(sample_time) &&
               gain_margin >= 1.0 && std::isfinite(gain_margin) && tree.joints() > 0 && joints.size() == tree.joints() &&
               joint_names.size() == joints.size() && posture.size() == tree.positions();
    }
};

// For one thread at a time. All space is taken here; cannot be copied or moved.
class GainTracker {
public:
    explicit GainTracker(const TrackedRobot& robot) : start_(robot.posture), contacts_(robot.contacts) {
        if (!robot.sound()) return;
        std::vector<std::vector<HeldFrame>> held;
        std::vector<std::size_t> tracked;
        std::size_t rows = 0;
        for (const auto& one : contacts_) {
            if (one.tracked) tracked.push_back(held.size());
            held.push_back(one.held);
            std::size_t count = 0;
            for (const HeldFrame& frame : one.held) count += frame.rows();
            rows = std::max(rows, count);
        }
        const std::size_t size = robot.joints.size(), velocities = robot.tree.velocities();
        if (robot.stack.sizes.empty())
            robot_.emplace(robot.joints.data(), size, robot.sample_time, velocities, rows, held.size());
        else
            robot_.emplace(robot.joints.data(), size, robot.sample_time, velocities, rows, held.size(), robot.stack);
        posture_.emplace(*robot_, robot.tree, held, tracked, robot.tasks);
    }
    GainTracker(const GainTracker&) = delete;
    GainTracker& operator=(const GainTracker&) = delete;

    // Before the control loop begins: finds the first limit of every contact state that is tracked, and whether it is the one that gain_limit found. True:
    // all are. False: `unsettled` says which is not, and ticks tell nothing. Takes some ten milliseconds, seconds for many tasks.
    bool settle() {
        settled_ = false;
        if (!posture_) return false;
        for (unsettled_ = 0; unsettled_ < contacts_.size(); unsettled_++) {
            const auto& contact = contacts_[unsettled_];
            if (!contact.tracked) continue;
            Limit found;
            if (!settles([&] { return posture_->update(start_.data(), unsettled_); }, contact.limit, found)) return false;
        }
        return settled_ = true;
    }
    // After settle(): the name of the contact state at which it ended; nullptr: all are settled, or the robot is not sound().
    const char* unsettled() const { return posture_ && unsettled_ < contacts_.size() ? contacts_[unsettled_].name : nullptr; }

    // One tick at posture q (nq) in a contact state by its number. Without tasks it does not matter where the base is and how it is turned; its quaternion
    // has unit size. In a contact state that is not tracked safe_gain is less than its limit at the first posture. No exceptions, no allocation.
    Limit update(const double* q, std::size_t contact) {
        if (!settled_) {
            Limit nothing;
            nothing.flag = Flag::not_settled;
            return nothing;
        }
        if (contact < contacts_.size() && !contacts_[contact].tracked)
            return robot_->tracker().lost(Flag::too_few_constraints, contacts_.size(), contacts_[contact].limit);
        return posture_->update(q, contact);
    }

private:
    std::vector<double> start_;
    std::vector<TrackedRobot::Contact> contacts_;
    std::optional<RobotTracker> robot_;
    std::optional<PostureTracker> posture_;
    std::size_t unsettled_ = 0;
    bool settled_ = false;
};

}  // namespace gainroom
