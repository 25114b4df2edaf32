// The virtual testbed: one joint, its drive, its encoders and its controller, tick by tick.
//
// A command is computed from the readings of its tick and arrives its delay later; the newest that has arrived counts. A controller may run
// in two parts, each with its own rate and delay, such as stiffness on a host and damping in the drive: ticks are then those of a clock that
// both share, each part samples every so many of them, and the drive adds what has arrived of both. All memory is taken when a testbed is
// made: a tick neither allocates nor throws.
#pragma once

#include <cstdint>
#include <optional>
#include <utility>

#include "motion.hpp"

namespace gainroom {

// The controller, one step a tick, times the loop's gain: x⁺ = a x + b e, u = c x + d e, e = (position error, motion error, −torque).
struct Control {
    std::vector<double> a, b, c, d;  // (r, r), (r, e), (r), (e); e = 2, or 3 with the torque of the spring
    int side, velocity;              // what position gains measure, and what velocity is made from
    std::vector<double> torque;      // (m) the spring's torque in the body's states; empty where it is not measured

    std::size_t signals() const { return d.size(); }
};

// Nonlinear parts of the testbed.
struct Hardware {
    double tick;                            // T_s [s]
    std::int64_t cells;                     // substeps per tick
    Laws laws;                              // friction of motor and link
    Gravity gravity;
    double torque_limit;                    // [N m]
    std::array<double, kSides> resolution;  // of the encoders [rad]; 0: exact
    double position_limit;                  // [rad] where a run has diverged
};

// Inputs and outputs of one tick.
struct TickInputs {
    double reference, motion, feedforward;       // what position gains act on [rad], what velocity is made from [rad], torque [N m]
    double torque[kSides], noise[kSides];        // on motor and link [N m]; of their readings [rad]
};
struct TickRow {
    double position[kSides], reading[kSides];    // of motor and link [rad]
    double target, demand, actual;               // torque: sent, arrived and limited, behind the current loop [N m]
};

// A command's way to the drive takes whole ticks and a fraction of one.
struct Delay {
    std::int64_t whole;
    double fraction;
};

// A part of the controller that measures every so many ticks; none of its commands takes more than `longest` whole ticks.
struct Path {
    Control control;
    std::int64_t every, longest;
};

class Testbed {
   public:
    // From `state` (m) at tick 0, with no command under way. A second path damps: no reference and no feedforward goes to it.
    Testbed(Body body, Path first, std::optional<std::pair<Path, Delay>> second, Hardware hardware, std::vector<double> state)
        : body_(std::move(body)), hardware_(hardware), state_(std::move(state)) {
        paths_.emplace_back(std::move(first));
        if (second) {
            paths_.emplace_back(std::move(second->first));
            second_delay_ = second->second;
        }
        const std::size_t entries = body_.width() * body_.width();
        work_.assign(std::max(2 * entries, body_.states()), 0.0);
        whole_cell_.transition.assign(entries, 0.0);
        for (Stretch& part : parts_) part.transition.assign(entries, 0.0);
        propagate(hardware_.tick / static_cast<double>(hardware_.cells), whole_cell_);
    }

    std::size_t states() const { return body_.states(); }
    std::int64_t longest() const { return paths_[0].path.longest; }

    // One sample of the first path, with all ticks up to its next one. Fills a row; false, with no more than its positions, where one of
    // these is out of bounds. `torque_noise` [N m]: of the readings of the spring's torque.
    bool step(const TickInputs& given, double torque_noise, const Delay& delay, TickRow& row) noexcept {
        for (std::int64_t tick = 0; tick < paths_[0].path.every; tick++, now_++) {
            TickRow later;
            TickRow& here = tick == 0 ? row : later;
            if (!read(given, here)) return false;
            if (tick == 0) paths_[0].send(now_, command(paths_[0], here, torque_noise, given), delay);
            if (paths_.size() > 1 && now_ % paths_[1].path.every == 0) {
                const TickInputs nothing{};
                paths_[1].send(now_, command(paths_[1], here, torque_noise, nothing), second_delay_);
            }
            if (tick == 0) {
                row.target = paths_[0].target + (paths_.size() > 1 ? paths_[1].target : 0.0);
                take_newest(0.0);
                row.demand = demand_;
                row.actual = body_.ideal ? demand_ : dot(body_.current.data(), state_.data(), states());
            } else {
                take_newest(0.0);
            }
            move(given);
        }
        return true;
    }

   private:
    static constexpr double kSameInstant = 1e-9;  // of a tick: two instants closer than this are one

    struct Command {
        double torque, fraction;
        std::int64_t arrival;  // tick in which it arrives, at `fraction` of it
    };
    struct Stretch {
        double width = 0.0;  // [s]
        std::vector<double> transition;
    };

    // A path with its memory and the commands under way.
    struct Running {
        Path path;
        std::vector<double> memory, moved;     // the controller's states
        std::vector<Command> sent;             // those of the last samples, round and round; as many as a power of two
        std::int64_t count = 0, newest = -1;   // samples; `newest` the one whose command the drive has, −1: none
        double target = 0.0, demand = 0.0, first_reading = 0.0;

        explicit Running(Path given) : path(std::move(given)) {
            std::size_t places = 1;
            while (places < static_cast<std::size_t>(reach()) + 1) places *= 2;
            sent.assign(places, Command{0.0, 0.0, -1});
            memory.assign(path.control.c.size(), 0.0);
            moved = memory;
        }

        std::int64_t reach() const { return path.longest / path.every + 1; }  // samples before the last one that may be under way
        const Command& at(std::int64_t sample) const { return sent[static_cast<std::size_t>(sample) & (sent.size() - 1)]; }
        std::int64_t first_known() const { return std::max(newest + 1, count - 1 - reach()); }

        void send(std::int64_t now, double torque, const Delay& delay) {
            target = torque;
            sent[static_cast<std::size_t>(count) & (sent.size() - 1)] = {torque, delay.fraction, now + delay.whole};
            count++;
        }
    };

    Body body_;
    Hardware hardware_;
    std::vector<Running> paths_;
    Delay second_delay_{0, 0.0};
    std::vector<double> state_, work_;
    std::int64_t now_ = 0;  // ticks
    double demand_ = 0.0, bent_[kSides] = {0.0, 0.0};
    Stretch whole_cell_, parts_[2];
    int oldest_part_ = 0;

    // The reading of an encoder with steps of `resolution`; 0: exact.
    static double quantised(double value, double resolution) {
        return resolution > 0 ? resolution * std::floor(value / resolution + 0.5) : value;
    }

    // Positions and readings of this tick; false where a position is out of bounds.
    bool read(const TickInputs& given, TickRow& row) const {
        for (int side = 0; side < kSides; side++) {
            row.position[side] = dot(body_.positions[side].data(), state_.data(), states());
            if (!(std::fabs(row.position[side]) <= hardware_.position_limit)) return false;
            row.reading[side] = quantised(row.position[side] + given.noise[side], hardware_.resolution[side]);
        }
        return true;
    }

    // The target torque of a path at this tick; moves its controller on.
    double command(Running& own, const TickRow& row, double torque_noise, const TickInputs& given) const {
        const Control& control = own.path.control;
        const double reading = row.reading[control.side], moving = row.reading[control.velocity];
        if (own.count == 0) own.first_reading = moving;  // the difference's past: it has always read this
        const double torque = control.torque.empty() ? 0.0 : dot(control.torque.data(), state_.data(), states()) + torque_noise;
        const double signals[3] = {given.reference - reading, given.motion + own.first_reading - moving, -torque};
        const std::size_t size = own.memory.size(), count = control.signals();
        double target = given.feedforward + dot(control.c.data(), own.memory.data(), size);
        for (std::size_t k = 0; k < count; k++) target += control.d[k] * signals[k];
        for (std::size_t i = 0; i < size; i++) {
            own.moved[i] = dot(&control.a[i * size], own.memory.data(), size);
            for (std::size_t k = 0; k < count; k++) own.moved[i] += control.b[count * i + k] * signals[k];
        }
        std::swap(own.memory, own.moved);
        return target;
    }

    // The drive takes up the newest command of each path that arrives at `fraction` of this tick, unless it has a newer one.
    void take_newest(double fraction) {
        double total = 0.0;
        for (Running& own : paths_) {
            for (std::int64_t sample = own.count - 1; sample >= own.first_known(); sample--) {
                const Command& one = own.at(sample);
                if (one.arrival != now_ || !(std::fabs(one.fraction - fraction) <= kSameInstant)) continue;
                own.newest = sample;
                own.demand = one.torque;
                break;
            }
            total += own.demand;
        }
        demand_ = std::min(std::max(total, -hardware_.torque_limit), hardware_.torque_limit);
    }

    // The first fraction of this tick after `after` at which a command arrives that is newer than the drive's; 2 where none does.
    double next_arrival(double after) {
        double first = 2.0;
        for (const Running& own : paths_) {
            for (std::int64_t sample = own.count - 1; sample >= own.first_known(); sample--) {
                const Command& one = own.at(sample);
                if (one.arrival == now_ && after + kSameInstant < one.fraction && one.fraction < first) first = one.fraction;
            }
        }
        return first;
    }

    // The joint through this tick, from arrival to arrival, in no longer steps than a cell.
    void move(const TickInputs& given) {
        double now = 0.0;
        const auto cells = static_cast<double>(hardware_.cells);
        for (std::int64_t cell = 1; cell <= hardware_.cells;) {
            const double end = static_cast<double>(cell) / cells, arrival = next_arrival(now), until = std::min(arrival, end);
            if (until - now > kSameInstant) {
                const double torques[kTorques] = {demand_, given.torque[kMotor], given.torque[kLink]};
                const bool whole = std::fabs((until - now) * cells - 1) <= kSameInstant;
                const Stretch& over = whole ? whole_cell_ : part(hardware_.tick * (until - now));
                const double width = whole ? whole_cell_.width : hardware_.tick * (until - now);
                substep(state_.data(), bent_, over.transition.data(), width, torques, body_, hardware_.laws, hardware_.gravity,
                        work_.data());
            }
            now = until;
            if (arrival <= end) take_newest(arrival);
            if (end - now <= kSameInstant) cell++;
        }
    }

    // The transition over `width` [s]: one of the last two, which with a constant delay are all there are, or a new one.
    const Stretch& part(double width) {
        for (int place = 0; place < 2; place++) {
            if (!(std::fabs(parts_[place].width - width) <= 1e-12 * width)) continue;
            oldest_part_ = 1 - place;
            return parts_[place];
        }
        Stretch& one = parts_[oldest_part_];
        oldest_part_ = 1 - oldest_part_;
        propagate(width, one);
        return one;
    }

    void propagate(double width, Stretch& over) {
        over.width = width;
        propagator(body_.system.data(), body_.width(), width, over.transition.data(), work_.data());
    }
};

}  // namespace gainroom
