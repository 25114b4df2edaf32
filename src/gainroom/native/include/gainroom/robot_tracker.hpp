// The gain limit from a mass matrix and contact Jacobians: what a robot's own controller calls at every tick (examples/control_loop.cpp).
#pragma once

#include "block.hpp"
#include "joint_search.hpp"
#include "link_inertia.hpp"
#include "task_gains.hpp"
#include "task_search.hpp"
#include "tracker.hpp"

namespace gainroom {

// A floating or fixed base with `velocities` N, of which the joints are the last n, held in at most `rows` directions, in contact states 0 to
// contacts − 1. All space is taken here, in one block.
class RobotTracker {
public:
    // One kp and kd per joint.
    RobotTracker(const JointData* joints, std::size_t count, double sample_time, std::size_t velocities, std::size_t rows,
                 std::size_t contacts, const TrackerSettings& settings = {}) {
        const Block::Filling filling(block_);
        auto& loop = begin(in_block<JointLoop>(block_, joints, count, sample_time), settings, velocities, count, rows);
        search_ = in_block<JointSearch>(block_, loop, *known_, contacts);
        tracker_ = in_block<Tracker>(block_, *known_, *search_, contacts, settings);
    }

    // Gains of tasks; those of `joints` do not count.
    RobotTracker(const JointData* joints, std::size_t count, double sample_time, std::size_t velocities, std::size_t rows,
                 std::size_t contacts, const TaskStack& tasks, const TrackerSettings& settings = {}) {
        const Block::Filling filling(block_);
        const double leading = TaskGains::leading(joints, count, sample_time, tasks);
        auto& loop = begin(in_block<TaskLoop>(block_, joints, count, sample_time, TaskGains::rank(count, tasks), leading), settings, velocities,
                           count, rows);
        gains_ = in_block<TaskGains>(block_, loop.laws(), velocities, rows, tasks);
        search_ = in_block<TaskSearch>(block_, loop, *known_, contacts);
        tracker_ = in_block<Tracker>(block_, *known_, *search_, contacts, settings);
    }

    // One tick: A (N, N), of which the upper triangle is read, of the links without rotors; J (count, N), the directions that are held
    // now, of any rank; with tasks, their Jacobians (m, N), one below the other in the world's axes; all row by row. No exceptions, no
    // allocation.
    Limit update(const double* mass, const double* rows, std::size_t count, std::size_t contact, const double* tasks = nullptr) {
        if (contact >= tracker_->contacts()) return tracker_->lost(Flag::bad_contact);
        if (laws_->size() == 0 || !links_->compute(mass, rows, count, posture_.data())) return tracker_->lost(Flag::bad_posture, contact);
        if (gains_ && (!tasks || !gains_->compute(*links_, mass, rows, count, tasks, posture_.data() + square())))
            return tracker_->lost(Flag::bad_posture, contact);
        return tracker_->update(posture_.data(), contact);
    }

    // After `update`, where there is time: what another contact state would be now, so that a switch to it finds its limit certified, or nearly.
    // Each of them every tenth tick is enough. Nothing is done after a tick that has taken long already.
    void prepare(const double* rows, std::size_t count, std::size_t contact) {
        if (tracker_->load() > Tracker::kBusy || !links_->hold(rows, count, other_.data())) return;
        if (gains_ && !gains_->hold(*links_, rows, count, other_.data() + square())) return;
        tracker_->prepare(other_.data(), contact);
    }

    Tracker& tracker() { return *tracker_; }
    const Tracker& tracker() const { return *tracker_; }
    const JointLaws& laws() const { return *laws_; }
    const LinkInertia& links() const { return *links_; }
    std::size_t directions() const { return gains_ ? gains_->directions() : 0; }
    // The posture of the last tick, as the loop takes it: W (n, n) first.
    const double* posture() const { return posture_.data(); }
    Block& block() { return block_; }

private:
    template <class Loop>
    Loop& begin(Owned<Loop> own, const TrackerSettings& settings, std::size_t velocities, std::size_t count, std::size_t rows) {
        Loop& loop = *own;
        loop_ = std::move(own);
        laws_ = &loop.laws();
        known_ = in_block<CrossingSet>(block_, loop, settings.stride);
        links_ = in_block<LinkInertia>(block_, velocities, count, rows);
        posture_ = Vector<double>(loop.posture_size());
        other_ = Vector<double>(loop.posture_size());
        return loop;
    }
    std::size_t square() const { return links_->joints() * links_->joints(); }

    Block block_;  // first: the others lie in it
    Owned<TrackedLoop> loop_;
    const JointLaws* laws_ = nullptr;
    Owned<CrossingSet> known_;
    Owned<LinkInertia> links_;
    Owned<TaskGains> gains_;
    Owned<CrossingSearch> search_;
    Owned<Tracker> tracker_;
    Vector<double> posture_, other_;
};

}  // namespace gainroom
