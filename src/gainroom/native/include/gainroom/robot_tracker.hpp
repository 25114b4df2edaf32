// The gain limit from a mass matrix and contact Jacobians: what a robot's own controller calls at every tick (examples/control_loop.cpp).
#pragma once

#include "joint_search.hpp"
#include "link_inertia.hpp"
#include "tracker.hpp"

namespace gainroom {

// A floating or fixed base with `velocities` N, of which the joints are the last n, held in at most `rows` directions, in contact states 0 to
// contacts − 1. All space is taken here.
class RobotTracker {
public:
    RobotTracker(const JointData* joints, std::size_t count, double sample_time, std::size_t velocities, std::size_t rows,
                 std::size_t contacts, const TrackerSettings& settings = {})
        : loop_(joints, count, sample_time), known_(loop_, settings.stride), search_(loop_, known_, contacts),
          tracker_(known_, search_, contacts, settings), links_(velocities, count, rows), inverse_(count * count), other_(count * count) {}

    // One tick: A (N, N), of which the upper triangle is read, of the links without rotors; J (count, N), the directions that are held
    // now, of any rank; both row by row. No exceptions, no allocation.
    Limit update(const double* mass, const double* rows, std::size_t count, std::size_t contact) {
        if (contact >= tracker_.contacts()) return tracker_.without_evidence(Flag::bad_contact);
        if (!links_.compute(mass, rows, count, inverse_.data())) return tracker_.without_evidence(Flag::bad_posture);
        return tracker_.update(inverse_.data(), contact);
    }

    // After `update`, where there is time: what another contact state would be now, so that a switch to it finds its limit certified, or nearly.
    // Each of them every tenth tick is enough. Nothing is done after a tick that has taken long already.
    void prepare(const double* rows, std::size_t count, std::size_t contact) {
        if (tracker_.has_time() && links_.hold(rows, count, other_.data())) tracker_.prepare(other_.data(), contact);
    }

    Tracker& tracker() { return tracker_; }
    const Tracker& tracker() const { return tracker_; }
    const JointLaws& laws() const { return loop_.laws(); }
    const LinkInertia& links() const { return links_; }
    // W (n, n) of the last tick.
    const double* inverse() const { return inverse_.data(); }

private:
    JointLoop loop_;
    CrossingSet known_;
    JointSearch search_;
    Tracker tracker_;
    LinkInertia links_;
    std::vector<double> inverse_, other_;
};

}  // namespace gainroom
