// Coupled loops whose gains act along directions (joints, or those of tasks): L = P C e^{−sT} X Δ E, Δ = diag(d_j(s)) made of the gains.
#pragma once

#include <cmath>
#include <cstddef>
#include <limits>
#include <memory>
#include <unordered_map>
#include <vector>

#include "actuated.hpp"
#include "complex.hpp"
#include "factors.hpp"

namespace gainroom {

// Numerator over denominator, coefficients of v, the highest power first.
struct Polynomials {
    std::vector<double> numerator, denominator;

    Complex at(Complex v) const { return over(horner(numerator, v), horner(denominator, v)); }

private:
    static Complex horner(const std::vector<double>& coefficients, Complex v) {
        Complex value = 0.0;
        for (double coefficient : coefficients) value = times(value, v) + coefficient;
        return value;
    }
};

// Gains of m directions: kp, kd, ki, of a PD (ki 0) or PID one; of a P/PI one kp, kv, ki.
struct DirectedGains {
    std::vector<double> kp, kd, ki;
};

// What changes of a joint's gains: all by a factor, or one of a PD or PID.
enum class Gain { all, kp, kd };

// What does not depend on the gains at one frequency.
struct LoopPoint {
    double omega = 0.0;
    Complex velocity, integral, shaping;
    std::vector<Complex> reached, seen;  // P C e^{−sT} X (n, m), empty where it is `seen`; E P C e^{−sT} X (m, m)
};

class DirectedLoop {
public:
    Actuated actuated;
    std::size_t directions = 0;          // m
    std::vector<double> torque, jacobian;  // X (n, m), E (m, n); both empty where directions are joints
    std::vector<char> cascade;           // (m) 1 where a direction is P/PI
    Polynomials velocity, integrator;
    Factors shaping;
    double tilt = 0.0, last = std::numeric_limits<double>::infinity();  // s = ω (tilt + j); half the sample rate
    int unstable_poles = 0;
    std::vector<double> grid;  // the first samples
    double settles = 0.0;      // gravity: where its loops are at rest, as a part of the lowest ω; 0: there is none

    std::size_t size() const { return actuated.size; }
    bool joints() const { return torque.empty(); }

    // False where the response has no finite value.
    bool point(double omega, LoopPoint& found) {
        const Complex s(tilt * omega, omega), v = variable(s, actuated.step);
        const std::size_t n = size(), m = directions;
        found.omega = omega;
        found.velocity = velocity.at(v);
        found.integral = integrator.at(v);
        found.shaping = value_at(shaping, 0.0, actuated.step, s);
        found.seen.resize(m * m);
        if (joints()) {
            if (!actuated.at(s, work_, found.seen.data())) return false;
        } else {
            response_.resize(n * n);
            if (!actuated.at(s, work_, response_.data())) return false;
            found.reached.assign(n * m, 0.0);
            for (std::size_t i = 0; i < n; i++)
                for (std::size_t k = 0; k < n; k++)
                    for (std::size_t j = 0; j < m; j++) found.reached[i * m + j] += response_[i * n + k] * torque[k * m + j];
            found.seen.assign(m * m, 0.0);
            for (std::size_t i = 0; i < m; i++)
                for (std::size_t k = 0; k < n; k++)
                    for (std::size_t j = 0; j < m; j++) found.seen[i * m + j] += jacobian[i * n + k] * found.reached[k * m + j];
        }
        for (const Complex& value : found.seen)
            if (!std::isfinite(value.real()) || !std::isfinite(value.imag())) return false;
        return std::isfinite(std::abs(found.velocity)) && std::isfinite(std::abs(found.integral)) && std::isfinite(std::abs(found.shaping));
    }

    // The same, computed once for frequencies that every look asks for; null where there is none.
    std::shared_ptr<const LoopPoint> known(double omega) {
        auto& place = points_[omega];
        if (place == nullptr) {
            auto fresh = std::make_shared<LoopPoint>();
            if (!point(omega, *fresh)) {
                points_.erase(omega);
                return nullptr;
            }
            place = std::move(fresh);
        }
        return place;
    }

    // Before a look: what is known is bounded.
    void forget() {
        if (points_.size() * directions * (directions + (joints() ? 0 : size())) > kEntries) points_.clear();
    }

    // d (m), and its changes by ln of stiffness and of damping (2, m) where asked for.
    void law(const LoopPoint& point, const DirectedGains& gains, Complex* d, Complex* change = nullptr) const {
        for (std::size_t j = 0; j < directions; j++) {
            const double kp = gains.kp[j], kd = gains.kd[j], ki = gains.ki[j];
            Complex value, stiffness, damping;
            if (cascade[j]) {
                const Complex inner = kd + ki * point.integral, outer = kp + point.velocity;
                value = times(inner, outer);
                stiffness = inner * kp + ki * times(point.integral, outer);
                damping = kd * outer - inner * kp;
            } else {
                stiffness = kp + ki * point.integral;
                damping = kd * point.velocity;
                value = stiffness + damping;
            }
            d[j] = times(point.shaping, value);
            if (change == nullptr) continue;
            change[j] = times(point.shaping, stiffness);
            change[directions + j] = times(point.shaping, damping);
        }
    }

    // What one gain of a joint multiplies, over its law d.
    static Complex share(const LoopPoint& point, Gain gain, Complex d) {
        return gain == Gain::all ? Complex(1.0) : over(gain == Gain::kd ? times(point.shaping, point.velocity) : point.shaping, d);
    }

    // A tenth of the lowest frequency at which one gain takes over from another; infinite where there is but one.
    double slowest(const DirectedGains& gains) const {
        double least = std::numeric_limits<double>::infinity();
        for (std::size_t j = 0; j < directions; j++) {
            const double kp = gains.kp[j], kd = gains.kd[j], ki = gains.ki[j];
            const double by_order[3] = {cascade[j] ? ki * kp : ki, cascade[j] ? kd * kp + ki : kp, kd};
            for (int low = 0; low < 3; low++)
                for (int high = low + 1; high < 3; high++)
                    if (by_order[low] > 0 && by_order[high] > 0)
                        least = std::min(least, std::pow(by_order[low] / by_order[high], 1.0 / (high - low)));
        }
        return 0.1 * least;
    }

private:
    static constexpr std::size_t kEntries = 1500000;  // complex numbers that are held: of a humanoid's joints two looks
    Actuated::Workspace work_;
    std::vector<Complex> response_;
    std::unordered_map<double, std::shared_ptr<const LoopPoint>> points_;
};

}  // namespace gainroom
