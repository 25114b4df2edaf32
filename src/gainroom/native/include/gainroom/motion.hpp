// One joint with its current loop over a substep in which the demanded torque does not change.
//
// Plant and current loop are linear and are propagated by their matrix exponential; friction and gravity are torques that are constant
// over the substep and obey their laws on its average (see friction.hpp): gravity does exactly the work by which the potential falls.
// With both off nothing is approximated.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "friction.hpp"

namespace gainroom {

enum Side { kMotor, kLink, kSides };

constexpr std::size_t kTorques = 3;  // inputs of a body: the demand, then torques from outside on motor and link

// Plant and current loop in continuous time, of m states. Matrices are row by row.
struct Body {
    std::vector<double> system;                          // (m + 3, m + 3) d/dt of states and of the inputs, which stay
    std::array<std::vector<double>, kSides> positions;   // (m) of motor and link
    std::array<std::vector<double>, kSides> rates;       // (m)
    std::array<std::vector<double>, kSides> entries;     // (m) how a torque on motor or link accelerates
    std::vector<double> current;                         // (m) the actual torque; not used behind an ideal current loop
    bool ideal;                                          // the current loop is ideal
    std::size_t coordinates;                             // c: the last 2c states are the plant's coordinates, then their rates

    std::size_t states() const { return current.size(); }
    std::size_t width() const { return states() + kTorques; }  // of `system`
};

struct Gravity {
    double moment;      // m g l [N m]
    double hanging_at;  // link position where it hangs [rad]

    // m g l (cos a − cos(a + d))/d: the torque that does the work of the potential over a turn of d from the angle a.
    double mean(double angle, double turn) const {
        const double half = 0.5 * turn, share = std::fabs(half) < 1e-4 ? 1 - half * half / 6 : std::sin(half) / half;
        return moment * std::sin(angle + half) * share;
    }
};

using Laws = std::array<FrictionLaw, kSides>;

inline double dot(const double* row, const double* column, std::size_t size) {
    double total = 0.0;
    for (std::size_t k = 0; k < size; k++) total += row[k] * column[k];
    return total;
}

// Fills `result` (n, n) with factor · left right.
inline void product(const double* left, const double* right, double factor, std::size_t size, double* result) {
    for (std::size_t i = 0; i < size; i++) {
        double* row = result + i * size;
        std::fill(row, row + size, 0.0);
        for (std::size_t k = 0; k < size; k++) {
            const double value = factor * left[i * size + k];
            for (std::size_t j = 0; j < size; j++) row[j] += value * right[k * size + j];
        }
    }
}

// Fills `transition` (n, n) with e^{system · width} by its Taylor series, scaled and squared. `work` holds 2n² numbers.
inline void propagator(const double* system, std::size_t size, double width, double* transition, double* work) {
    constexpr int kTerms = 22;         // at norm ≤ 1/2: 0.5^22/22! is 1e-28
    constexpr int kMostHalves = 2200;  // from the largest number to the smallest; one that is infinite stays so
    const std::size_t entries = size * size;
    double norm = 0.0, scale = width;
    for (std::size_t i = 0; i < size; i++) {
        double row = 0.0;
        for (std::size_t j = 0; j < size; j++) row += std::fabs(system[i * size + j]);
        norm = std::max(norm, row * width);
    }
    int halves = 0;
    for (; norm > 0.5 && halves < kMostHalves; halves++) {
        norm *= 0.5;
        scale *= 0.5;
    }
    double *term = work, *other = work + entries;
    for (std::size_t i = 0; i < size; i++)
        for (std::size_t j = 0; j < size; j++) term[i * size + j] = transition[i * size + j] = i == j ? 1.0 : 0.0;
    for (int k = 1; k < kTerms; k++) {
        product(term, system, scale / k, size, other);
        std::swap(term, other);
        for (std::size_t entry = 0; entry < entries; entry++) transition[entry] += term[entry];
    }
    for (; halves > 0; halves--) {
        product(transition, transition, 1.0, size, other);
        std::copy(other, other + entries, transition);
    }
}

// Fills `result` (n, n) with e^matrix. Units that differ by orders of magnitude would cost as many squarings, and digits: rows and columns
// are brought to one size first, by powers of two (Osborne 1960; Parlett and Reinsch 1969). `work` holds 3n² + n numbers.
inline void exponential(const double* matrix, std::size_t size, double* result, double* work) {
    double *balanced = work + 2 * size * size, *units = balanced + size * size;
    std::copy(matrix, matrix + size * size, balanced);
    std::fill(units, units + size, 1.0);
    bool moved = true;
    for (int sweep = 0; moved && sweep < 50; sweep++) {
        moved = false;
        for (std::size_t i = 0; i < size; i++) {
            double row = 0.0, column = 0.0;
            for (std::size_t j = 0; j < size; j++) {
                if (j == i) continue;
                row += std::fabs(balanced[i * size + j]);
                column += std::fabs(balanced[j * size + i]);
            }
            if (!(row > 0) || !(column > 0) || !std::isfinite(row + column)) continue;
            const double factor = std::ldexp(1.0, std::ilogb(std::sqrt(row / column)));
            if (!(column * factor + row / factor < 0.95 * (row + column))) continue;
            moved = true;
            units[i] *= factor;
            for (std::size_t j = 0; j < size; j++) {
                balanced[i * size + j] /= factor;
                balanced[j * size + i] *= factor;
            }
        }
    }
    propagator(balanced, size, 1.0, result, work);
    for (std::size_t i = 0; i < size; i++)
        for (std::size_t j = 0; j < size; j++) result[i * size + j] *= units[i] / units[j];
}

// What friction and gravity do during a substep.
struct Reaction {
    std::array<double, kSides> torque{};          // of friction [N m]
    double weight = 0.0;                          // of gravity, on the link [N m]
    std::array<double, kSides> velocity, bent;    // means; the bristles' deflections at the end
    std::array<bool, kSides> stuck{};
};

// `from` the state at the begin of a substep to the one at its end without friction and gravity, `drifted`.
inline Reaction reaction(const double* from, const double* drifted, const double* bent, const double* transition, double width,
                         const Body& body, const Laws& laws, const Gravity& gravity) {
    constexpr int kSweeps = 60;  // over motor, gravity and link, which couple weakly within a substep
    const std::size_t size = body.states();
    const double angle = dot(body.positions[kLink].data(), from, size) - gravity.hanging_at;
    double moved[kSides], answer[kSides][kSides];  // displacement; the same per torque
    Reaction found;
    for (int side = 0; side < kSides; side++) {
        const double* position = body.positions[side].data();
        moved[side] = dot(position, drifted, size) - dot(position, from, size);
        for (int other = 0; other < kSides; other++) {
            answer[side][other] = 0.0;
            for (std::size_t i = 0; i < size; i++)
                answer[side][other] += position[i] * transition[i * body.width() + size + 1 + other];
        }
        found.velocity[side] = dot(body.rates[side].data(), from, size);
        found.bent[side] = bent[side];
    }
    for (int sweep = 0; sweep < kSweeps; sweep++) {
        double change = 0.0;
        for (int side = 0; side < kSides; side++) {
            if (side == kLink && gravity.moment != 0 && answer[1][1] > 0) {
                const double turn = moved[1] - answer[1][0] * found.torque[0] - answer[1][1] * (found.torque[1] + found.weight);
                const double weight = gravity.mean(angle, turn);
                change = std::max(change, std::fabs(weight - found.weight));
                found.weight = weight;
            }
            if (!laws[side].rubs() || answer[side][side] <= 0) continue;  // a locked link does not move
            const double others = answer[side][1] * found.weight + answer[side][1 - side] * found.torque[1 - side];
            const double free = (moved[side] - others) / width, gain = answer[side][side] / width, before = found.torque[side];
            if (std::isinf(laws[side].bristle_stiffness)) {
                const DryContact contact = dry(laws[side], free, gain);
                found.torque[side] = contact.torque;
                found.velocity[side] = contact.velocity;
                found.stuck[side] = contact.stuck;
            } else {
                const BristledContact contact = lugre(laws[side], bent[side], free, gain, width, found.velocity[side]);
                found.torque[side] = contact.torque;
                found.velocity[side] = contact.velocity;
                found.bent[side] = contact.bent;
            }
            change = std::max(change, std::fabs(found.torque[side] - before));
        }
        if (change <= 1e-13 * (std::fabs(found.torque[0]) + std::fabs(found.torque[1]) + std::fabs(found.weight))) break;
    }
    return found;
}

// A side whose mean velocity over a substep was 0: removes from `state` its remaining velocity, and the rounding of its position.
inline void hold(const double* from, double* state, const Body& body, int side) {
    const std::size_t size = body.states(), count = body.coordinates;
    const double *position = body.positions[side].data(), *rate = body.rates[side].data(), *entry = body.entries[side].data();
    const double unit = dot(rate, entry, size), push = dot(rate, state, size) / unit;
    const double slip = (dot(position, state, size) - dot(position, from, size)) / unit;
    for (std::size_t i = size - count; i < size; i++) {
        state[i] -= entry[i] * push;
        state[i - count] -= entry[i] * slip;
    }
}

// Moves `state` (m) and the bristles' deflections `bent` (2) by one substep of `width` [s], over which the body's `transition`
// (m + 3, m + 3) is. torques (3): as `kTorques` says. `work` holds m numbers.
inline void substep(double* state, double* bent, const double* transition, double width, const double* torques, const Body& body,
                    const Laws& laws, const Gravity& gravity, double* work) {
    const std::size_t size = body.states();
    for (std::size_t i = 0; i < size; i++) {
        const double* row = transition + i * body.width();
        double total = 0.0;
        for (std::size_t j = 0; j < size; j++) total += row[j] * state[j];
        for (std::size_t j = 0; j < kTorques; j++) total += row[size + j] * torques[j];
        work[i] = total;
    }
    if (laws[kMotor].rubs() || laws[kLink].rubs() || gravity.moment != 0) {
        const Reaction found = reaction(state, work, bent, transition, width, body, laws, gravity);
        for (std::size_t i = 0; i < size; i++) {
            const double* pushed = transition + i * body.width() + size + 1;
            work[i] -= pushed[kMotor] * found.torque[0] + pushed[kLink] * (found.torque[1] + found.weight);
        }
        for (int side = 0; side < kSides; side++) {
            bent[side] = found.bent[side];
            if (found.stuck[side]) hold(state, work, body, side);
        }
    }
    std::copy(work, work + size, state);
}

}  // namespace gainroom
