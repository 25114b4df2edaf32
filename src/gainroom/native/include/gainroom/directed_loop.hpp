// Coupled loops whose gains act along directions (joints, or those of tasks): L = P C e^{−sT} X Δ E, Δ = diag(d_j(s)) made of the gains. Gain
// matrices that share no directions are part of X(s) = Σ V^a I^b K_ab Eᵀ; the gains of the directions, which are all 1, then only scale them.
#pragma once

#include <algorithm>
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

// Of X: K (n, m) times the velocity, or the integrator, or both.
struct GainTerm {
    bool velocity, integral;
    std::vector<double> gain;
};

// The gain of a joint that is varied: all by a factor, or one of a PD or PID.
enum class Gain { all, kp, kd };

// Sample at one frequency of all that does not depend on the gains.
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
    bool by_direction = false;             // one loop at a time is a direction's, not a joint's
    std::vector<GainTerm> matrices;        // of X beside `torque`, with all that their law has: gains kp, 1 or 0, are numbers then
    double slow = std::numeric_limits<double>::infinity();  // with `matrices`: a tenth of where one gain takes over from another
    std::vector<char> cascade;           // (m) 1 where a direction is P/PI
    Polynomials velocity, integrator;
    Factors shaping;
    double last = std::numeric_limits<double>::infinity();  // half the sample rate
    std::vector<double> leaning;  // ω beside which s = ω (j + tilt · share) leans to the right, as analysis/stability_boundary.py
    double tilt = 0.0, lean = 0.0;
    int unstable_poles = 0;
    std::vector<double> grid;  // the first samples
    double settles = 0.0;      // gravity: where its loops are at rest, as a part of the lowest ω; 0: there is none

    std::size_t size() const { return actuated.size; }
    bool joints() const { return torque.empty(); }
    // S is that of E P X Δ itself: (I + E P X Δ)⁻¹ (m, m), else that of P X Δ E (n, n).
    bool own() const { return by_direction || joints(); }
    std::size_t loops() const { return own() ? directions : size(); }

    // False where the response has no finite value.
    bool point(double omega, LoopPoint& found) {
        const Complex s(leans(omega) * omega, omega), v = variable(s, actuated.step);
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
            if (!matrices.empty()) act(found);
            for (std::size_t i = 0; i < n; i++)
                for (std::size_t k = 0; k < n; k++)
                    for (std::size_t j = 0; j < m; j++)
                        found.reached[i * m + j] += matrices.empty() ? response_[i * n + k] * torque[k * m + j] : times(response_[i * n + k], acting_[k * m + j]);
            found.seen.assign(m * m, 0.0);
            for (std::size_t i = 0; i < m; i++)
                for (std::size_t k = 0; k < n; k++)
                    for (std::size_t j = 0; j < m; j++) found.seen[i * m + j] += jacobian[i * n + k] * found.reached[k * m + j];
        }
        for (const Complex& value : found.seen)
            if (!std::isfinite(value.real()) || !std::isfinite(value.imag())) return false;
        return std::isfinite(std::abs(found.velocity)) && std::isfinite(std::abs(found.integral)) && std::isfinite(std::abs(found.shaping));
    }

    // The sample computed once for frequencies of every look; null where there is none.
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
            if (!matrices.empty()) {
                d[j] = kp;
                if (change != nullptr) change[j] = change[directions + j] = 0.0;
                continue;
            }
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

    // Transfer function that one gain of a joint multiplies.
    static Complex unit(const LoopPoint& point, Gain gain) { return gain == Gain::kd ? times(point.shaping, point.velocity) : point.shaping; }

    // A tenth of the lowest frequency at which one gain takes over from another; infinite where there is but one.
    double slowest(const DirectedGains& gains) const {
        if (!matrices.empty()) return slow;
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
    double leans(double omega) const {
        double share = 0.0;
        for (const double center : leaning) share = std::max(share, 1 - std::fabs(omega / center - 1) / lean);
        return tilt * share;
    }

    // X at a point.
    void act(const LoopPoint& point) {
        acting_.assign(torque.begin(), torque.end());
        for (const GainTerm& term : matrices) {
            const Complex law = times(point.shaping, times(term.velocity ? point.velocity : 1.0, term.integral ? point.integral : 1.0));
            for (std::size_t k = 0; k < acting_.size(); k++) acting_[k] += law * term.gain[k];
        }
    }

    static constexpr std::size_t kEntries = 1500000;  // complex numbers that are held: of a humanoid's joints two looks
    Actuated::Workspace work_;
    std::vector<Complex> response_, acting_;
    std::unordered_map<double, std::shared_ptr<const LoopPoint>> points_;
};

}  // namespace gainroom
