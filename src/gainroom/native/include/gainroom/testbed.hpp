// The virtual testbed: one joint, its drive, its encoders and its controller, tick by tick.
//
// A command is computed from the readings of its tick and arrives its delay later; the newest that has arrived counts. All memory is taken
// when a testbed is made: a tick neither allocates nor throws.
#pragma once

#include <cstdint>

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

class Testbed {
   public:
    // From `state` (m) at tick 0, with no command under way; none will take more than `longest` whole ticks.
    Testbed(Body body, Control control, Hardware hardware, std::vector<double> state, std::int64_t longest)
        : body_(std::move(body)), control_(std::move(control)), hardware_(hardware), state_(std::move(state)), longest_(longest) {
        std::size_t places = 1;
        while (places < static_cast<std::size_t>(longest) + 1) places *= 2;
        sent_.assign(places, Command{0.0, 0.0, -1});
        const std::size_t entries = body_.width() * body_.width();
        memory_.assign(control_.c.size(), 0.0);
        moved_ = memory_;
        work_.assign(std::max(2 * entries, body_.states()), 0.0);
        whole_cell_.transition.assign(entries, 0.0);
        for (Stretch& part : parts_) part.transition.assign(entries, 0.0);
        propagate(hardware_.tick / static_cast<double>(hardware_.cells), whole_cell_);
    }

    std::size_t states() const { return body_.states(); }
    std::int64_t longest() const { return longest_; }

    bool measures_torque() const { return !control_.torque.empty(); }

    // Fills a row; false, with no more than its positions, where one of these is out of bounds. `torque_noise` [N m]: of the reading.
    bool step(const TickInputs& given, double torque_noise, const Delay& delay, TickRow& row) noexcept {
        for (int side = 0; side < kSides; side++) {
            row.position[side] = dot(body_.positions[side].data(), state_.data(), states());
            if (!(std::fabs(row.position[side]) <= hardware_.position_limit)) return false;
            row.reading[side] = quantised(row.position[side] + given.noise[side], hardware_.resolution[side]);
        }
        const double torque = measures_torque() ? dot(control_.torque.data(), state_.data(), states()) + torque_noise : 0.0;
        row.target = command(row.reading[control_.side], row.reading[control_.velocity], torque, given);
        at(now_) = {row.target, delay.fraction, now_ + delay.whole};
        take_newest(0.0);
        row.demand = demand_;
        row.actual = body_.ideal ? demand_ : dot(body_.current.data(), state_.data(), states());
        move(given);
        now_++;
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

    Body body_;
    Control control_;
    Hardware hardware_;
    std::vector<double> state_, memory_, moved_, work_;  // memory: the controller's states
    std::int64_t longest_, now_ = 0, newest_ = -1;       // ticks; `newest_` the one whose command the drive has, −1: none
    double demand_ = 0.0, first_reading_ = 0.0, bent_[kSides] = {0.0, 0.0};
    std::vector<Command> sent_;  // those of the last ticks, round and round; as many as a power of two
    Stretch whole_cell_, parts_[2];
    int oldest_part_ = 0;

    Command& at(std::int64_t tick) { return sent_[static_cast<std::size_t>(tick) & (sent_.size() - 1)]; }
    std::int64_t first_known() const { return std::max(newest_ + 1, now_ - longest_); }

    // The reading of an encoder with steps of `resolution`; 0: exact.
    static double quantised(double value, double resolution) {
        return resolution > 0 ? resolution * std::floor(value / resolution + 0.5) : value;
    }

    // The target torque of this tick; moves the controller on.
    double command(double reading, double moving, double torque, const TickInputs& given) {
        if (now_ == 0) first_reading_ = moving;  // the difference's past: it has always read this
        const double signals[3] = {given.reference - reading, given.motion + first_reading_ - moving, -torque};
        const std::size_t size = memory_.size(), count = control_.signals();
        const double own = dot(control_.c.data(), memory_.data(), size);
        double target = given.feedforward + own;
        for (std::size_t k = 0; k < count; k++) target += control_.d[k] * signals[k];
        for (std::size_t i = 0; i < size; i++) {
            moved_[i] = dot(&control_.a[i * size], memory_.data(), size);
            for (std::size_t k = 0; k < count; k++) moved_[i] += control_.b[count * i + k] * signals[k];
        }
        std::swap(memory_, moved_);
        return target;
    }

    // The drive takes up the newest command that arrives at `fraction` of this tick, unless it has a newer one.
    void take_newest(double fraction) {
        for (std::int64_t tick = now_; tick >= first_known(); tick--) {
            const Command& one = at(tick);
            if (one.arrival != now_ || !(std::fabs(one.fraction - fraction) <= kSameInstant)) continue;
            newest_ = tick;
            demand_ = std::min(std::max(one.torque, -hardware_.torque_limit), hardware_.torque_limit);
            return;
        }
    }

    // The first fraction of this tick after `after` at which a command arrives that is newer than the drive's; 2 where none does.
    double next_arrival(double after) {
        double first = 2.0;
        for (std::int64_t tick = now_; tick >= first_known(); tick--) {
            const Command& one = at(tick);
            if (one.arrival == now_ && after + kSameInstant < one.fraction && one.fraction < first) first = one.fraction;
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
