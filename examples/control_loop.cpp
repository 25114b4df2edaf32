// A controller of a planar robot on two legs whose gains follow what its delay and elasticity allow: gainroom's headers in a control loop.
//
// The class has the shape of a ros2_control controller, `on_configure` and `update(time, period)`, and needs no ROS to build:
//
//     headers=$(python -c 'import gainroom.native; print(gainroom.native.include_dir())')
//     mkdir -p build && c++ -std=c++17 -O2 -I"$headers" examples/control_loop.cpp -o build/control_loop && build/control_loop
//
// On a robot, Dynamics is what computes M and J already (Pinocchio, RBDL, KDL), contact comes from its estimator, and positions and efforts
// are the hardware interfaces'. With the argument `trace` every tick's inputs and limits are printed in hexadecimal.
#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <memory>

#include "gainroom/robot_tracker.hpp"

constexpr std::size_t kJoints = 4, kVelocities = 7, kMostRows = 4;  // base x, y, angle; left hip, left knee, right hip, right knee
using Joints = std::array<double, kJoints>;
using Row = std::array<double, kVelocities>;

// Stands for the robot's dynamics library: mass matrix of the links, rotors apart, and Jacobians of the feet.
class Dynamics {
public:
    std::array<double, kVelocities * kVelocities> mass{};
    std::array<double, kMostRows * kVelocities> rows{};
    std::size_t count = 0;

    enum Contact : std::size_t { both, left, right, flight };

    void compute(double trunk, const Joints& q) {
        mass.fill(0.0);
        add_mass(30.0, {1, 0, -0.3 * std::cos(trunk)}, {0, 1, -0.3 * std::sin(trunk)});
        mass[2 * kVelocities + 2] += 1.2;
        for (std::size_t leg = 0; leg < 2; leg++) {
            const double thigh = trunk + q[2 * leg], shank = thigh + q[2 * leg + 1];
            const std::size_t hip = 3 + 2 * leg;
            Row x{1, 0, 0}, y{0, 1, 0};
            turn(x, y, 0.2, thigh, hip, false);
            add_mass(7.0, x, y);
            add_inertia(0.1, hip, false);
            turn(x, y, 0.2, thigh, hip, false);
            turn(x, y, 0.2, shank, hip, true);
            add_mass(4.0, x, y);
            add_inertia(0.06, hip, true);
            turn(x, y, 0.2, shank, hip, true);
            feet_[2 * leg] = x;
            feet_[2 * leg + 1] = y;
        }
    }

    // The rows of a contact state.
    void hold(Contact contact) {
        count = 0;
        for (std::size_t row = 0; row < kMostRows; row++)
            if (contact == both || contact == (row < 2 ? left : right)) put_row(feet_[row]);
    }

private:
    // `length` further down a link at `angle` that turns with trunk and hip, and with the knee.
    static void turn(Row& x, Row& y, double length, double angle, std::size_t hip, bool knee) {
        const double dx = length * std::cos(angle), dy = length * std::sin(angle);
        for (std::size_t k : {std::size_t(2), hip, hip + 1}) {
            if (k == hip + 1 && !knee) continue;
            x[k] += dx;
            y[k] += dy;
        }
    }

    void add_mass(double kilograms, const Row& x, const Row& y) {
        for (std::size_t i = 0; i < kVelocities; i++)
            for (std::size_t j = 0; j < kVelocities; j++) mass[i * kVelocities + j] += kilograms * (x[i] * x[j] + y[i] * y[j]);
    }
    void add_inertia(double inertia, std::size_t hip, bool knee) {
        Row turning{};
        turning[2] = turning[hip] = 1.0;
        if (knee) turning[hip + 1] = 1.0;
        for (std::size_t i = 0; i < kVelocities; i++)
            for (std::size_t j = 0; j < kVelocities; j++) mass[i * kVelocities + j] += inertia * turning[i] * turning[j];
    }
    void put_row(const Row& row) {
        for (std::size_t j = 0; j < kVelocities; j++) rows[count * kVelocities + j] = row[j];
        count++;
    }

    std::array<Row, kMostRows> feet_{};
};

// Joint-space PD; its gains are the nominal ones times a factor that keeps twofold gain margin wherever the robot stands.
class FollowingController {
public:
    static constexpr double kMargin = 2.0;   // 6 dB
    static constexpr double kRise = 6.9;     // of the factor, per second: 60 dB/s; it falls at once
    static constexpr double kLeast = 1e-3;   // from which it rises where nothing was known
    static constexpr int kSettling = 20000;  // ticks within which the first limit of a contact state is certified
    static constexpr Joints kp{1800.0, 1800.0, 1800.0, 1800.0}, kd{90.0, 80.0, 90.0, 80.0};

    // All memory is taken here, and the first limit of every contact state is found, as many ticks as that takes, so that none of the first ticks is
    // without one. False where there is none: kd/kp of a joint is less than the lag, so that it takes energy out at no frequency, or nothing is certified.
    bool on_configure(double period) {
        for (std::size_t i = 0; i < kJoints; i++)
            data_[i] = {i % 2 ? 0.3 : 0.5, 0.2, 0.0, 8e3, 2.0, 4000.0, 0.9, 2e-3, kp[i], kd[i]};
        tracker_ = std::make_unique<gainroom::RobotTracker>(data_.data(), kJoints, period, kVelocities, kMostRows, 4);
        if (!(tracker_->tracker().passive_frequency() > 0.0)) return false;
        dynamics.compute(trunk, position);
        for (const auto state : {Dynamics::both, Dynamics::left, Dynamics::right, Dynamics::flight}) {
            dynamics.hold(state);
            limit = {};
            for (int tick = 0; tick < kSettling && !limit.certified; tick++) ask(state);
            if (!limit.certified) return false;
        }
        return true;
    }

    // One tick: reads positions, velocities and contact, writes efforts.
    bool update(double /*time*/, double period) {
        dynamics.compute(trunk, position);
        dynamics.hold(contact);
        ask(contact);
        const double allowed = limit.safe_gain / kMargin;
        factor = std::fmin(std::fmin(1.0, allowed), std::fmax(factor, kLeast) * (1.0 + kRise * period));
        for (std::size_t i = 0; i < kJoints; i++) effort[i] = factor * (kp[i] * (target[i] - position[i]) - kd[i] * velocity[i]);
        return true;
    }

    // With what is left of a tick: another contact state is made ready, so that a switch finds its limit certified, or nearly.
    void prepare(Dynamics::Contact other) {
        dynamics.hold(other);
        tracker_->prepare(dynamics.rows.data(), dynamics.count, other);
    }

    // State interfaces, and what the robot's own dynamics and contact estimation say.
    Dynamics dynamics;
    Dynamics::Contact contact = Dynamics::both;
    double trunk = 0.0;
    Joints position{}, velocity{}, target{};
    // Command interface.
    Joints effort{};

    gainroom::Limit limit;
    double factor = 0.1;

private:
    void ask(Dynamics::Contact state) { limit = tracker_->update(dynamics.mass.data(), dynamics.rows.data(), dynamics.count, state); }

    std::array<gainroom::JointData, kJoints> data_{};
    std::unique_ptr<gainroom::RobotTracker> tracker_;
};

static void print(const double* values, std::size_t count) {
    for (std::size_t k = 0; k < count; k++) std::printf(" %a", values[k]);
}

int main(int argc, char** argv) {
    const bool trace = argc > 1 && std::strcmp(argv[1], "trace") == 0;
    constexpr double period = 5e-4;
    constexpr Dynamics::Contact walk[] = {Dynamics::both, Dynamics::left, Dynamics::both, Dynamics::right};
    constexpr const char* names[] = {"both", "left", "right", "flight"};
    FollowingController controller;
    const auto move = [&controller](double time) {
        for (std::size_t i = 0; i < kJoints; i++) {
            const double bend = i % 2 ? 0.7 : -0.35, phase = 4.0 * time + double(i / 2) * gainroom::kPi;
            controller.position[i] = bend + 0.25 * std::sin(phase);
            controller.velocity[i] = 0.25 * 4.0 * std::cos(phase);
            controller.target[i] = controller.position[i] + 0.01;
        }
    };
    move(0.0);
    if (!controller.on_configure(period)) return 1;
    std::size_t certified = 0;
    double lowest = 1e300;
    constexpr std::size_t ticks = 4000;
    for (std::size_t tick = 0; tick < ticks; tick++) {
        const double time = period * double(tick);
        controller.contact = walk[tick / 1000 % 4];
        move(time);
        controller.update(time, period);
        certified += controller.limit.certified;
        if (controller.limit.certified) lowest = std::fmin(lowest, controller.limit.gain);
        if (trace) {
            std::printf("%zu %zu", std::size_t(controller.contact), controller.dynamics.count);
            print(controller.dynamics.mass.data(), controller.dynamics.mass.size());
            print(controller.dynamics.rows.data(), controller.dynamics.count * kVelocities);
            const gainroom::Limit& limit = controller.limit;
            std::printf(" %a %a %d %ld %a", limit.gain, limit.frequency, int(limit.certified), limit.age, limit.safe_gain);
        }
        const auto other = Dynamics::Contact(tick / 4 % 3);
        const bool prepares = tick % 4 == 0 && other != controller.contact;
        if (prepares) controller.prepare(other);
        if (trace) {
            std::printf(" %zu", prepares ? controller.dynamics.count : 0);
            if (prepares) print(controller.dynamics.rows.data(), controller.dynamics.count * kVelocities);
            std::printf("\n");
        } else if (tick % 500 == 499) {
            std::printf("%6.3f s  %-5s  limit %6.3f at %5.1f Hz  %-13s  factor on the gains %.3f\n", time, names[controller.contact],
                        controller.limit.gain, controller.limit.frequency / (2 * gainroom::kPi),
                        controller.limit.certified ? "certified" : "not certified", controller.factor);
        }
    }
    if (!trace) std::printf("%.1f %% of %zu ticks certified; lowest limit %.3f\n", 100.0 * double(certified) / double(ticks), ticks, lowest);
}
