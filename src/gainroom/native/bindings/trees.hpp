// Trees of links, frames on them, contacts and tasks, from rows of numbers.
#pragma once

#include <cmath>
#include <vector>

#include "arrays.hpp"
#include "gainroom/rigid_tree.hpp"

constexpr std::size_t kPlace = 12;  // a rotation row by row, then the origin

inline gainroom::Triple triple(const double* from) { return {from[0], from[1], from[2]}; }
inline gainroom::Pose pose(const double* from) { return {{triple(from), triple(from + 3), triple(from + 6)}, triple(from + 9)}; }

inline std::size_t index(double number, std::size_t below, const char* message) {
    require(number >= 0 && number < double(below) && number == std::floor(number), message);
    return std::size_t(number);
}

inline const double* posture(const gainroom::RigidTree& tree, const Vector& q) {
    require(q.shape(0) == tree.positions(), "a posture has the shape (nq,)");
    return q.data();
}

inline gainroom::Frame frame(const gainroom::RigidTree& tree, const double* row) {
    return {index(row[0], tree.joints() + 1, "a frame's link is one of the tree"), pose(row + 1)};
}

// frames (c, 13), held (c, 6).
inline std::vector<gainroom::HeldFrame> held_frames(const gainroom::RigidTree& tree, const Matrix& frames, const Matrix& held) {
    const std::size_t count = frames.shape(0);
    require(frames.shape(1) == kPlace + 1 && has_shape(held, count, gainroom::kTwist), "frames and held have the shapes (c, 13), (c, 6)");
    std::vector<gainroom::HeldFrame> found;
    for (std::size_t k = 0; k < count; k++) {
        found.push_back({frame(tree, frames.data() + k * (kPlace + 1)), {}});
        for (std::size_t i = 0; i < gainroom::kTwist; i++) found.back().held[i] = held(k, i) != 0.0;
    }
    return found;
}

// tasks (k, 14).
inline std::vector<gainroom::TaskReading> task_readings(const gainroom::RigidTree& tree, const Matrix& tasks) {
    require(tasks.shape(1) == kPlace + 2, "tasks have the shape (k, 14)");
    std::vector<gainroom::TaskReading> found;
    for (std::size_t k = 0; k < tasks.shape(0); k++) {
        const double* row = tasks.data() + k * (kPlace + 2);
        found.push_back({gainroom::Reading(index(row[0], gainroom::kReadings, "a task's kind is 0 to 3")), frame(tree, row + 1)});
    }
    return found;
}
