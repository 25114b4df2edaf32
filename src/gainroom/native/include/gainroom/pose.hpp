// The pose of a rigid body: rotations, poses, their exponentials and logarithms (Lynch and Park, Modern Robotics, sections 3.2 and 3.3).
#pragma once

#include <array>
#include <cmath>
#include <cstddef>

namespace gainroom {

using Triple = std::array<double, 3>;

inline Triple operator+(const Triple& a, const Triple& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
inline Triple operator-(const Triple& a, const Triple& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
inline Triple operator*(double factor, const Triple& a) { return {factor * a[0], factor * a[1], factor * a[2]}; }
inline double dot(const Triple& a, const Triple& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
inline Triple cross(const Triple& a, const Triple& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

// Linear before angular. Not a choice by index between two triples: in a loop that writes them one after the other gcc 12 with AVX leaves some out (-O3,
// or -O2 with -ftree-vectorize; tests/test_tracked_header.py).
using Six = std::array<double, 6>;
inline Six six(const Triple& linear, const Triple& angular) { return {linear[0], linear[1], linear[2], angular[0], angular[1], angular[2]}; }

// Its rows.
using Rotation = std::array<Triple, 3>;

inline Triple turned(const Rotation& r, const Triple& a) { return {dot(r[0], a), dot(r[1], a), dot(r[2], a)}; }
inline Triple turned_back(const Rotation& r, const Triple& a) { return a[0] * r[0] + a[1] * r[1] + a[2] * r[2]; }
inline Rotation turned(const Rotation& a, const Rotation& b) {
    return {turned_back(b, a[0]), turned_back(b, a[1]), turned_back(b, a[2])};
}
inline Rotation transposed(const Rotation& r) {
    return {{{r[0][0], r[1][0], r[2][0]}, {r[0][1], r[1][1], r[2][1]}, {r[0][2], r[1][2], r[2][2]}}};
}

// About a unit axis (Rodrigues), by an angle of which the cosine and sine are given.
inline Rotation about(const Triple& axis, double cosine, double sine) {
    const Triple part = (1.0 - cosine) * axis, turn = sine * axis;
    return {{{part[0] * axis[0] + cosine, part[0] * axis[1] - turn[2], part[0] * axis[2] + turn[1]},
             {part[1] * axis[0] + turn[2], part[1] * axis[1] + cosine, part[1] * axis[2] - turn[0]},
             {part[2] * axis[0] - turn[1], part[2] * axis[1] + turn[0], part[2] * axis[2] + cosine}}};
}

// x, y, z, w, of unit size.
using Quaternion = std::array<double, 4>;

inline Rotation rotation(const Quaternion& q) {
    const double x = q[0], y = q[1], z = q[2], w = q[3];
    return {{{1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)},
             {2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)},
             {2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)}}};
}

// a b, brought back to unit size.
inline Quaternion product(const Quaternion& a, const Quaternion& b) {
    const Triple left{a[0], a[1], a[2]}, right{b[0], b[1], b[2]}, part = a[3] * right + b[3] * left + cross(left, right);
    const double whole = a[3] * b[3] - dot(left, right), size = std::sqrt(dot(part, part) + whole * whole);
    return {part[0] / size, part[1] / size, part[2] / size, whole / size};
}

// The rotation vector, of at most π. By the largest of the four squares (Shepperd 1978): no digits are lost near 0 or π.
inline Triple logarithm(const Rotation& r) {
    const double squares[4] = {1 + r[0][0] - r[1][1] - r[2][2], 1 - r[0][0] + r[1][1] - r[2][2], 1 - r[0][0] - r[1][1] + r[2][2],
                               1 + r[0][0] + r[1][1] + r[2][2]};
    const Triple odd{r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]};
    std::size_t most = 3;
    for (std::size_t k = 0; k < 3; k++)
        if (squares[k] > squares[most]) most = k;
    Triple part = odd;  // of the quaternion, times a positive number, as `whole`
    double whole = squares[3];
    if (most != 3) {
        for (std::size_t k = 0; k < 3; k++) part[k] = k == most ? squares[k] : r[most][k] + r[k][most];
        whole = odd[most];
        if (whole < 0) part = -1.0 * part, whole = -whole;
    }
    const double size = std::sqrt(dot(part, part));
    return (size > 0 ? 2 * std::atan2(size, whole) / size : 2 / whole) * part;
}

struct Pose {
    Rotation axes;
    Triple origin;
};

inline Triple moved(const Pose& a, const Triple& point) { return a.origin + turned(a.axes, point); }
inline Pose moved(const Pose& a, const Pose& b) { return {turned(a.axes, b.axes), moved(a, b.origin)}; }
// b as seen from a.
inline Pose seen_from(const Pose& a, const Pose& b) {
    return {turned(transposed(a.axes), b.axes), turned_back(a.axes, b.origin - a.origin)};
}

// Where a body that moves for unit time with a twist, in its own axes, comes to: with the angle t of `angular` w,
// p = v sin t/t + (w × v) (1 − cos t)/t² + w (w·v) (t − sin t)/t³. Below a small angle by series, exact to t⁴.
struct Turned {
    Quaternion rotation;
    Triple origin;
};

inline Turned exponential(const Triple& linear, const Triple& angular) {
    const double square = dot(angular, angular), angle = std::sqrt(square), half = 0.5 * angle;
    const bool small = square < 1e-6;
    const double sine = small ? 1 - square / 6 : std::sin(angle) / angle, rest = small ? 1.0 / 6 - square / 120 : (1 - sine) / square;
    const double halved = small ? 0.5 - square / 48 : std::sin(half) / angle;
    const double lift = small ? 0.5 - square / 24 : 2 * halved * halved;
    const Triple part = halved * angular;
    return {{part[0], part[1], part[2], std::cos(half)},
            sine * linear + lift * cross(angular, linear) + (rest * dot(angular, linear)) * angular};
}

// The linear part of the twist that leads to a pose at `origin` in unit time while the body turns by `angular`: the inverse of the above,
// p − w × p/2 + w × (w × p) β, β = 1/t² − (1 + cos t)/(2 t sin t), with β = 1/12 + t²/720 at small angles.
inline Triple linear_logarithm(const Triple& angular, const Triple& origin) {
    const double square = dot(angular, angular), angle = std::sqrt(square), half = 0.5 * angle;
    const double share = square < 1e-4 ? 1.0 / 12 + square / 720 : (1 - half * std::cos(half) / std::sin(half)) / square;
    const Triple turn = cross(angular, origin);
    return origin - 0.5 * turn + share * cross(angular, turn);
}

}  // namespace gainroom
