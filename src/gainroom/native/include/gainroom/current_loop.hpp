// The current loop's torque predicted row by row, and the commands decoded that must have acted.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

namespace gainroom {

// A state (τ, τ̇/ω_c), or what a command adds to it.
struct LoopState {
    double torque = 0.0, rate = 0.0;
};

// The current loop over one tick: x⁺ = transition x + full u, u held all the tick.
struct LoopTick {
    double transition[2][2];
    LoopState full;

    LoopState after(const LoopState& x, double command) const {
        return {transition[0][0] * x.torque + transition[0][1] * x.rate + full.torque * command,
                transition[1][0] * x.torque + transition[1][1] * x.rate + full.rate * command};
    }
};

// The measured torque is gain · τ + offset, with this standard deviation.
struct TorqueSensor {
    double gain, offset, noise;
};

// Commands change within a tick at moments that are uncertain, by q kinds of arrival.
struct Arrivals {
    std::size_t kinds;
    const LoopState* parts;  // (3, q) what a change of a row adds one row before it, in it, and one row after it
    const LoopState* slope;  // (q) derivative of their sum by the moment of arrival
    const double* spread;    // (q) that moment's standard deviation [ticks]
};

// What a log says, in m rows.
struct TorqueRows {
    std::size_t count;
    const double *command, *changes, *torque;  // (m), (m, q) of the command in each row by kind of arrival, (m)
    const bool* fresh;                         // (m) behind a gap; the first row always is
};

// Kalman filter of the current loop. Fills error and variance (m) of the torque's prediction. `unknown`: variance of the state behind a
// gap [(N m)²].
inline void predict_torque(const TorqueRows& rows, const LoopTick& tick, const Arrivals& arrivals, const TorqueSensor& sensor,
                           double unknown, double* error, double* variance) {
    const auto& t = tick.transition;
    const std::size_t kinds = arrivals.kinds;
    const LoopState *earlier = arrivals.parts, *within = earlier + kinds, *later = within + kinds;
    const auto fresh = [&rows](std::size_t k) { return k == 0 || rows.fresh[k]; };
    LoopState x;
    double p00 = 0.0, p01 = 0.0, p11 = 0.0;  // covariance of x
    for (std::size_t k = 0; k < rows.count; k++) {
        if (fresh(k)) {
            x = {rows.command[k], 0.0};
            p00 = p11 = unknown;
            p01 = 0.0;
        } else {
            x = tick.after(x, rows.command[k - 1]);
            const double a00 = t[0][0] * p00 + t[0][1] * p01, a01 = t[0][0] * p01 + t[0][1] * p11;
            const double a10 = t[1][0] * p00 + t[1][1] * p01, a11 = t[1][0] * p01 + t[1][1] * p11;
            p00 = a00 * t[0][0] + a01 * t[0][1];
            p01 = a00 * t[1][0] + a01 * t[1][1];
            p11 = a10 * t[1][0] + a11 * t[1][1];
            const bool before = !fresh(k - 1), behind = k + 1 < rows.count && !fresh(k + 1);
            const double* changes = rows.changes + k * kinds;
            const auto add = [&x](const LoopState& part, double change) {
                x.torque += part.torque * change;
                x.rate += part.rate * change;
            };
            for (std::size_t q = 0; q < kinds; q++) {
                add(within[q], changes[q]);
                const double moment = arrivals.spread[q] * changes[q];
                const double r0 = moment * arrivals.slope[q].torque, r1 = moment * arrivals.slope[q].rate;
                p00 += r0 * r0;
                p01 += r0 * r1;
                p11 += r1 * r1;
                if (before) add(later[q], rows.changes[(k - 1) * kinds + q]);
                if (behind) add(earlier[q], rows.changes[(k + 1) * kinds + q]);
            }
        }
        const double gain = sensor.gain, quiet = sensor.noise * sensor.noise;
        const double e = rows.torque[k] - gain * x.torque - sensor.offset, s = gain * gain * p00 + quiet;
        error[k] = e;
        variance[k] = s;
        const double k0 = gain * p00 / s, k1 = gain * p01 / s;
        x.torque += k0 * e;
        x.rate += k1 * e;
        p11 -= k1 * gain * p01;
        p01 -= k0 * gain * p01;
        p00 *= quiet / s;
    }
}

// Which ages of commands [ticks] are possible, and what is likely.
struct Ages {
    std::int64_t first, last;
    LoopState part;      // of a full tick's effect: a newer command acts by so much in its first row
    double change_cost;  // what one tick of difference from the usual age, the middle, costs, in units of squared errors
};

// The likeliest ages (m) [ticks] of the commands that acted at each row: Viterbi's algorithm. The age grows by one where no newer command
// has arrived. target and torque (m). There are at most 256 ages.
inline void decode(const double* target, const double* torque, std::size_t count, const LoopTick& tick, const Ages& ages,
                   const TorqueSensor& sensor, std::int64_t* age) {
    if (count == 0) return;
    const std::int64_t first = ages.first, last = ages.last, rows = static_cast<std::int64_t>(count), kinds = last - first + 1;
    struct Path {
        double cost = 0.0;
        LoopState state;
    };
    std::vector<Path> paths(kinds), fresh(kinds);
    std::vector<std::uint8_t> back(count * kinds);
    const double middle = 0.5 * static_cast<double>(first + last);
    for (std::int64_t i = 0; i < kinds; i++) paths[i].state.torque = target[std::min(kinds - 1 - i, rows - 1)];
    for (std::int64_t k = last + 1; k < rows; k++) {
        double least = std::numeric_limits<double>::infinity();
        for (std::int64_t i = 0; i < kinds; i++) {
            const double now = target[k - first - i];
            Path best{std::numeric_limits<double>::infinity(), {}};
            std::int64_t choice = 0;
            // the age before: at most one tick less, or more where newer commands have arrived
            for (std::int64_t j = std::max<std::int64_t>(i - 1, 0); j < kinds; j++) {
                const double before = target[k - 1 - first - j], change = now - before;
                LoopState x = tick.after(paths[j].state, before);
                x.torque += ages.part.torque * change;
                x.rate += ages.part.rate * change;
                const double e = (torque[k] - sensor.gain * x.torque - sensor.offset) / sensor.noise;
                const double total = paths[j].cost + e * e + ages.change_cost * std::fabs(static_cast<double>(first + i) - middle);
                if (total < best.cost) {
                    best = {total, x};
                    choice = j;
                }
            }
            fresh[i] = best;
            least = std::min(least, best.cost);
            back[k * kinds + i] = static_cast<std::uint8_t>(choice);
        }
        for (Path& path : fresh) path.cost -= least;
        std::swap(paths, fresh);
    }
    const auto cheaper = [](const Path& a, const Path& b) { return a.cost < b.cost; };
    std::int64_t place = std::min_element(paths.begin(), paths.end(), cheaper) - paths.begin();
    std::int64_t k = rows - 1;
    for (; k > last; k--) {
        age[k] = first + place;
        place = back[k * kinds + place];
    }
    for (; k >= 0; k--) age[k] = first + place;
}

}  // namespace gainroom
