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

// What changes of the command add, by q kinds of arrival within a tick: mean (q, 3) and covariance (q, 3, 3) of what a unit change adds to
// the state at the tick's end (2) and to the torque where it is read.
struct Arrivals {
    std::size_t kinds;
    const double *parts, *noises;
};

// What a log says, in m rows.
struct TorqueRows {
    std::size_t count;
    const double *command, *changes, *torque;  // (m), (m, q) of the command in each row by kind of arrival, (m)
    const bool* fresh;                         // (m) behind a gap; the first row always is
};

// Kalman filter of the current loop whose command changes within a tick at uncertain moments, and whose torque is read within it. tick
// (3, 3): what a state (2) and the command held before come to, at the tick's end (2) and where the torque is read. Fills error and
// variance (m). `unknown`: variance of the state behind a gap [(N m)²].
inline void predict_torque(const TorqueRows& rows, const double* tick, const Arrivals& arrivals, const TorqueSensor& sensor,
                           double unknown, double* error, double* variance) {
    double x0 = 0.0, x1 = 0.0, p00 = 0.0, p01 = 0.0, p11 = 0.0;
    const double gain = sensor.gain, quiet = sensor.noise * sensor.noise;
    for (std::size_t k = 0; k < rows.count; k++) {
        double n[3], c00, c01, c02, c11, c12, c22;
        if (k == 0 || rows.fresh[k]) {
            n[0] = n[2] = rows.command[k];
            n[1] = 0.0;
            c00 = c02 = c11 = c22 = unknown;
            c01 = c12 = 0.0;
        } else {
            double a[3][2];
            for (int i = 0; i < 3; i++) {
                const double* t = tick + 3 * i;
                n[i] = t[0] * x0 + t[1] * x1 + t[2] * rows.command[k - 1];
                a[i][0] = t[0] * p00 + t[1] * p01;
                a[i][1] = t[0] * p01 + t[1] * p11;
            }
            const auto with = [&](int i, int j) { return a[i][0] * tick[3 * j] + a[i][1] * tick[3 * j + 1]; };
            c00 = with(0, 0), c01 = with(0, 1), c11 = with(1, 1), c02 = with(2, 0), c12 = with(2, 1), c22 = with(2, 2);
            for (std::size_t q = 0; q < arrivals.kinds; q++) {
                const double change = rows.changes[k * arrivals.kinds + q], square = change * change;
                const double *part = arrivals.parts + 3 * q, *noise = arrivals.noises + 9 * q;
                for (int i = 0; i < 3; i++) n[i] += part[i] * change;
                c00 += noise[0] * square, c01 += noise[1] * square, c02 += noise[2] * square;
                c11 += noise[4] * square, c12 += noise[5] * square, c22 += noise[8] * square;
            }
        }
        const double e = rows.torque[k] - gain * n[2] - sensor.offset, s = gain * gain * c22 + quiet;
        error[k] = e;
        variance[k] = s;
        const double k0 = gain * c02 / s, k1 = gain * c12 / s;
        x0 = n[0] + k0 * e;
        x1 = n[1] + k1 * e;
        p00 = c00 - k0 * gain * c02, p01 = c01 - k0 * gain * c12, p11 = c11 - k1 * gain * c12;
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
