// Mass matrix and Jacobians of a tree of rigid links at a posture, by composite rigid bodies (Featherstone 2008, chapter 6).
//
// All is seen from a floating base, or from the first joint on a fixed one, wherever that is: neither the mass matrix nor what contacts hold
// depends on it. Velocities are the twist of a floating base in its own axes, linear before angular, then those of the joints.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>

#include "block.hpp"
#include "rigid_tree.hpp"

namespace gainroom {

// For one thread at a time.
class TreeDynamics {
public:
    explicit TreeDynamics(const RigidTree& tree)
        : tree_(tree), carried_(tree.joints() + 1), motions_(tree.joints()), momenta_(tree.joints()) {}

    const RigidTree& tree() const { return tree_; }

    // Places the links of posture q (nq); what follows is about it.
    void place(const double* q) {
        base_axes_ = tree_.base(q).axes;
        const bool moves = tree_.base_velocities() || !tree_.joints();
        tree_.place(q, {{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}, moves ? Triple{} : -1.0 * tree_.joint(0).place.origin});
        for (std::size_t k = 0; k < carried_.size(); k++) carried_[k] = body(k);
        for (std::size_t k = tree_.joints(); k-- > 0;) carried_[tree_.joint(k).parent].add(carried_[k + 1]);
        for (std::size_t k = 0; k < tree_.joints(); k++) {
            const Pose& link = tree_.link(k + 1);
            const Triple axis = turned(link.axes, tree_.joint(k).axis);
            motions_[k] = tree_.joint(k).prismatic ? Twist{axis, {}} : Twist{cross(link.origin, axis), axis};
            momenta_[k] = carried_[k + 1].momentum(motions_[k]);
        }
    }

    // Fills A (N, N), of which the lower triangle is 0.
    void mass_matrix(double* a) const {
        const std::size_t size = tree_.velocities(), base = tree_.base_velocities();
        std::fill(a, a + size * size, 0.0);
        for (std::size_t i = 0; i < base; i++) {
            const Six momentum = row(carried_[0].momentum(unit(i)));
            for (std::size_t j = i; j < base; j++) a[i * size + j] = momentum[j];
        }
        for (std::size_t k = 0; k < tree_.joints(); k++) {
            const Six momentum = row(momenta_[k]);
            for (std::size_t i = 0; i < base; i++) a[i * size + base + k] = momentum[i];
            for (std::size_t link = k + 1; link > 0; link = tree_.joint(link - 1).parent)
                a[(base + link - 1) * size + base + k] = product(motions_[link - 1], momenta_[k]);
        }
    }

    // Writes the held rows of a frame's Jacobian (6, N), in the frame's own axes; where the next ones go.
    double* write(const HeldFrame& held, double* rows) const { return write(held, transposed(tree_.at(held.frame).axes), rows); }

    // The same of a task's, in the world's axes.
    double* write(const TaskReading& task, double* rows) const {
        if (task.kind == Reading::posture) return write_joints(rows);
        if (task.kind == Reading::center) return write_center(rows);
        const bool linear = task.kind == Reading::position;
        return write({task.frame, {linear, linear, linear, !linear, !linear, !linear}}, base_axes_, rows);
    }

private:
    // Or momentum, about the base's origin.
    struct Twist {
        Triple linear, angular;
    };

    // A link with all that it carries, seen from the base's origin.
    struct Carried {
        double mass;
        Triple moment;     // mass times centre
        Rotation inertia;  // about the base's origin

        void add(const Carried& other) {
            mass += other.mass;
            moment = moment + other.moment;
            for (std::size_t k = 0; k < 3; k++) inertia[k] = inertia[k] + other.inertia[k];
        }
        Twist momentum(const Twist& motion) const {
            return {mass * motion.linear + cross(motion.angular, moment), cross(moment, motion.linear) + turned(inertia, motion.angular)};
        }
    };

    Carried body(std::size_t link) const {
        const Mass& own = tree_.mass(link);
        const Pose& at = tree_.link(link);
        const Triple center = moved(at, own.center);
        Rotation inertia = turned(turned(at.axes, own.inertia), transposed(at.axes));
        const double square = own.mass * dot(center, center);
        for (std::size_t k = 0; k < 3; k++) {
            inertia[k] = inertia[k] - (own.mass * center[k]) * center;
            inertia[k][k] += square;
        }
        return {own.mass, own.mass * center, inertia};
    }

    static Twist unit(std::size_t k) {
        Six one{};
        one[k] = 1.0;
        return {{one[0], one[1], one[2]}, {one[3], one[4], one[5]}};
    }
    static Six row(const Twist& twist) { return six(twist.linear, twist.angular); }
    static double product(const Twist& a, const Twist& b) { return dot(a.linear, b.linear) + dot(a.angular, b.angular); }

    // The same along `axes`.
    double* write(const HeldFrame& held, const Rotation& axes, double* rows) const {
        const std::size_t size = tree_.velocities(), base = tree_.base_velocities();
        const Triple point = tree_.at(held.frame).origin;
        double* end = rows + size * held.rows();
        std::fill(rows, end, 0.0);
        const auto column = [&](std::size_t number, const Twist& motion) {
            const Six seen = six(turned(axes, motion.linear + cross(motion.angular, point)), turned(axes, motion.angular));
            double* entry = rows + number;
            for (std::size_t k = 0; k < kTwist; k++)
                if (held.held[k]) *entry = seen[k], entry += size;
        };
        for (std::size_t i = 0; i < base; i++) column(i, unit(i));
        for (std::size_t link = held.frame.link; link > 0; link = tree_.joint(link - 1).parent) column(base + link - 1, motions_[link - 1]);
        return end;
    }

    double* write_joints(double* rows) const {
        const std::size_t size = tree_.velocities(), base = tree_.base_velocities();
        std::fill(rows, rows + tree_.joints() * size, 0.0);
        for (std::size_t k = 0; k < tree_.joints(); k++) rows[k * size + base + k] = 1.0;
        return rows + tree_.joints() * size;
    }

    // The centre of all that moves has its momentum.
    double* write_center(double* rows) const {
        const std::size_t size = tree_.velocities(), base = tree_.base_velocities();
        for (std::size_t i = 0; i < size; i++) {
            const Twist momentum = i < base ? carried_[0].momentum(unit(i)) : momenta_[i - base];
            const Triple seen = (1 / carried_[0].mass) * turned(base_axes_, momentum.linear);
            for (std::size_t k = 0; k < 3; k++) rows[k * size + i] = seen[k];
        }
        return rows + 3 * size;
    }

    RigidTree tree_;
    Rotation base_axes_{};
    Vector<Carried> carried_;         // of each link
    Vector<Twist> motions_, momenta_;  // of each joint at unit rate
};

}  // namespace gainroom
