// A tree of rigid links at a posture: where its links are, their centre of mass, and what holds them against gravity.
//
// A posture q holds the position and quaternion (x, y, z, w) of a floating base, then of each joint its position, or cosine and sine.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <vector>

#include "block.hpp"
#include "pose.hpp"

namespace gainroom {

struct TreeJoint {
    std::size_t parent;  // link that it is on: 0 the base, k + 1 what joint k moves
    Pose place;          // on that link
    Triple axis;         // of unit size, in its own axes
    bool prismatic;
    bool continuous;     // its posture is cosine and sine
};

struct Mass {
    double mass;         // [kg]
    Triple center;       // in the link's own axes [m]
    Rotation inertia{};  // about the centre, in the same axes [kg m²]
};

// A frame on a link.
struct Frame {
    std::size_t link;
    Pose place;
};

// For one thread at a time.
class RigidTree {
public:
    // joints   parents before their children
    // masses   of the base, 0 where it is fixed, then of what each joint moves
    // root     where a fixed base is, or a floating one's origin counts from
    RigidTree(bool floating, const Pose& root, const std::vector<TreeJoint>& joints, const std::vector<Mass>& masses,
              const Triple& gravity)
        : floating_(floating), root_(root), joints_(joints.begin(), joints.end()), masses_(masses.begin(), masses.end()), gravity_(gravity),
          links_(joints_.size() + 1), sums_(joints_.size() + 1) {
        positions_ = base_positions();
        for (const TreeJoint& joint : joints_) positions_ += joint.continuous ? 2 : 1;
    }

    std::size_t joints() const { return joints_.size(); }
    std::size_t positions() const { return positions_; }                            // nq
    std::size_t base_velocities() const { return floating_ ? 6 : 0; }
    std::size_t velocities() const { return base_velocities() + joints_.size(); }  // N
    // Whether parents come before their children, and every link has its mass.
    bool sound() const {
        for (std::size_t k = 0; k < joints_.size(); k++)
            if (joints_[k].parent > k) return false;
        return masses_.size() == joints_.size() + 1;
    }

    const TreeJoint& joint(std::size_t k) const { return joints_[k]; }
    const Mass& mass(std::size_t link) const { return masses_[link]; }
    // The pose of a link as it was last computed.
    const Pose& link(std::size_t k) const { return links_[k]; }
    // The base of posture q (nq).
    Pose base(const double* q) const {
        return floating_ ? moved(root_, Pose{rotation({q[3], q[4], q[5], q[6]}), {q[0], q[1], q[2]}}) : root_;
    }

    // Places the links of posture q (nq); what follows is about it.
    void place(const double* q) { place(q, base(q)); }

    // Places the links of the joints in q (nq) with the base at the pose `base`.
    void place(const double* q, const Pose& base) {
        links_[0] = base;
        q += base_positions();
        for (std::size_t k = 0; k < joints_.size(); k++) {
            const TreeJoint& joint = joints_[k];
            Pose at = moved(links_[joint.parent], joint.place);
            if (joint.prismatic)
                at.origin = moved(at, *q * joint.axis);
            else
                at.axes = turned(at.axes, joint.continuous ? about(joint.axis, q[0], q[1]) : about(joint.axis, std::cos(*q), std::sin(*q)));
            q += joint.continuous ? 2 : 1;
            links_[k + 1] = at;
        }
    }

    Pose at(const Frame& frame) const { return moved(links_[frame.link], frame.place); }

    // Centre of mass of everything that moves [m].
    Triple center() {
        collect();
        return (1 / sums_[0].mass) * sums_[0].center;
    }

    // Fills g (N), the generalised forces that balance gravity.
    void weight(double* g) {
        collect();
        if (floating_) {
            const Triple force = lift(0), turn = turned_back(links_[0].axes, moment(0, force)), own = turned_back(links_[0].axes, force);
            for (std::size_t k = 0; k < 3; k++) g[k] = own[k], g[3 + k] = turn[k];
        }
        g += base_velocities();
        for (std::size_t k = 0; k < joints_.size(); k++) {
            const Triple force = lift(k + 1), axis = turned(links_[k + 1].axes, joints_[k].axis);
            g[k] = dot(axis, joints_[k].prismatic ? force : moment(k + 1, force));
        }
    }

    // Moves q by v (N), as after unit time at that velocity.
    void integrate(double* q, const double* v) const {
        if (floating_) move_base(q, v);
        q += base_positions();
        v += base_velocities();
        for (std::size_t k = 0; k < joints_.size(); k++, q++) {
            if (!joints_[k].continuous) {
                *q += v[k];
                continue;
            }
            const double c = q[0], s = q[1], cosine = std::cos(v[k]), sine = std::sin(v[k]);
            const double size = std::hypot(c, s);  // rounding would grow from tick to tick
            q[0] = (c * cosine - s * sine) / size;
            q[1] = (s * cosine + c * sine) / size;
            q++;
        }
    }

    // Moves the base alone, by a twist (6) in its own axes.
    static void move_base(double* q, const double* v) {
        const Turned step = exponential({v[0], v[1], v[2]}, {v[3], v[4], v[5]});
        const Quaternion before{q[3], q[4], q[5], q[6]}, after = product(before, step.rotation);
        const Triple way = turned(rotation(before), step.origin);
        for (std::size_t k = 0; k < 3; k++) q[k] += way[k];
        for (std::size_t k = 0; k < 4; k++) q[3 + k] = after[k];
    }

    // Writes the joints' positions (n) into q.
    void put(const double* joints, double* q) const {
        q += base_positions();
        for (std::size_t k = 0; k < joints_.size(); k++, q++) {
            if (!joints_[k].continuous)
                *q = joints[k];
            else
                *q = std::cos(joints[k]), *++q = std::sin(joints[k]);
        }
    }

    // The joints' positions (n) in q; of a continuous one within ±π.
    void get(const double* q, double* joints) const {
        q += base_positions();
        for (std::size_t k = 0; k < joints_.size(); k++, q++) {
            joints[k] = joints_[k].continuous ? std::atan2(q[1], q[0]) : *q;
            if (joints_[k].continuous) q++;
        }
    }

private:
    std::size_t base_positions() const { return floating_ ? 7 : 0; }

    // Masses, and masses times centres in world axes, of each link and all that it carries.
    void collect() {
        for (std::size_t k = 0; k < links_.size(); k++) {
            sums_[k].mass = masses_[k].mass;
            sums_[k].center = masses_[k].mass * moved(links_[k], masses_[k].center);
        }
        for (std::size_t k = joints_.size(); k-- > 0;) {
            Mass& below = sums_[joints_[k].parent];
            below.mass += sums_[k + 1].mass;
            below.center = below.center + sums_[k + 1].center;
        }
    }

    Triple lift(std::size_t link) const { return -sums_[link].mass * gravity_; }

    // Of a force that acts at the centre of all that a link carries, about the link's origin.
    Triple moment(std::size_t link, const Triple& force) const {
        return -1.0 * cross(sums_[link].center, gravity_) - cross(links_[link].origin, force);
    }

    bool floating_;
    Pose root_;
    Vector<TreeJoint> joints_;
    Vector<Mass> masses_;
    Triple gravity_;
    std::size_t positions_;
    Vector<Pose> links_;
    Vector<Mass> sums_;
};

constexpr std::size_t kTwist = 6;  // linear x y z, angular x y z

// A frame on the ground, and which directions of its twist are held.
struct HeldFrame {
    Frame frame;
    std::array<bool, kTwist> held;

    std::size_t rows() const { return std::size_t(std::count(held.begin(), held.end(), true)); }
};

enum class Reading { center, posture, position, orientation };
constexpr std::size_t kReadings = 4;

// The quantity that a task controls.
struct TaskReading {
    Reading kind;
    Frame frame;  // of position and orientation

    std::size_t directions(const RigidTree& tree) const { return kind == Reading::posture ? tree.joints() : 3; }
};

}  // namespace gainroom
