// Joint by joint, what closes the loop around W: at s = jω a gain factor g puts a root of the closed loop there where
//
//     det(W + diag(β)) = 0,    β = (1 + a e) / (a + (1 + a e) d),    a = J + D_m/s + g c/s²,  e = s²/(K + sB),  d = D_l/s
//
// with c = C(s) e^{−sT} (kp + s kd). All of W's neighbours are diagonal, so a robot's posture enters through W alone.
//
// Sampled (torque held for T_s, backward difference) L is a sum over aliases s_k = s + 2πjk/T_s. With the link of an elastic joint held
// the motor's mobility is p = 1/(J s² + s (D_m + B) + K); the rest, which carries W, falls by four more powers of s and its aliases are
// left out (see alias_left). Aliases of p are a diagonal ε that posture does not change, tabulated once, and
//
//     g c = g D h / (1 + g ε D),    D = kp + kd (1 − 1/z)/T_s,    h = C(s) e^{−sT} (1 − e^{−sT_s})/(s T_s).
//
// Where all joints are rigid, P_M s² is one real matrix and the aliases of h/s² add up exactly: h becomes h + s² ε.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "block.hpp"
#include "complex.hpp"

namespace gainroom {

// Of one joint: inertia J, friction D_m and D_l, stiffness K (infinite: rigid) and damping B of the gearbox, current loop (bandwidth
// infinite: ideal), delay T [s], gains. SI, on the joint's side.
struct JointData {
    double motor_inertia, motor_viscous, link_viscous, stiffness, damping;
    double bandwidth, damping_ratio, delay;
    double kp, kd;
};

// β and a + q d with their derivatives; `factor` is 1 + g ε D, 1 in continuous time.
struct JointValue {
    Complex beta, beta_omega, beta_gain, outer, outer_omega, inner, factor;
};

// Of a joint without control: β, `outer` = a + q d and `through` = (1 + e d)/outer, with which the motors' mobility is
//
//     s² P_M = diag(through) − diag(1/outer) (W + diag β)⁻¹ diag(1/outer);
//
// `drive` takes a command to s²-fold torque, C e^{−sT}/s² with the hold, and `alias` is ε, which adds to P_M diag(drive); with derivatives.
struct OpenValue {
    Complex beta, beta_omega, outer, outer_omega, through, through_omega, drive, drive_omega, alias, alias_omega;
};

class JointLaws {
public:
    // sample_time 0: continuous.
    JointLaws(const JointData* joints, std::size_t count, double sample_time) : joints_(joints, joints + count), step_(sample_time) {
        all_rigid_ = true;
        for (const auto& joint : joints_) all_rigid_ = all_rigid_ && !std::isfinite(joint.stiffness);
        if (step_ > 0.0) tabulate();
        for (std::size_t i = 0; i < count; i++) {
            std::size_t k = 0;
            while (k < i && !equal(joints_[i], joints_[k])) k++;
            first_.push_back(k);
        }
    }

    std::size_t size() const { return joints_.size(); }
    double sample_time() const { return step_; }
    const JointData& joint(std::size_t i) const { return joints_[i]; }

    // All joints at jω under the factor g.
    void at(double omega, double gain, JointValue* values) const {
        Actuation last{};
        Spring spring{};
        std::size_t before = 0;  // the joint that these two are of
        for (std::size_t i = 0; i < joints_.size(); i++) {
            if (first_[i] < i) {
                values[i] = values[first_[i]];
                continue;
            }
            if (i == 0 || !same_drive(joints_[i], joints_[before])) last = actuation(joints_[i], omega);
            if (i == 0 || !same_spring(joints_[i], joints_[before])) spring = spring_of(joints_[i], omega);
            before = i;
            values[i] = value(i, omega, gain, last, spring);
        }
    }

    // All joints at jω without control.
    void open(double omega, OpenValue* values) const {
        for (std::size_t i = 0; i < joints_.size(); i++) {
            if (first_[i] < i) {
                values[i] = values[first_[i]];
                continue;
            }
            const Actuation drive = actuation(joints_[i], omega);
            const Spring spring = spring_of(joints_[i], omega);
            const JointValue one = value(i, omega, 0.0, drive, spring);
            const double square = 1.0 / (omega * omega);
            const Complex d(0.0, -joints_[i].link_viscous / omega), d_omega(0.0, joints_[i].link_viscous * square);
            const Complex through = over(1.0 + times(spring.value, d), one.outer);
            const Complex turned = times(spring.slope, d) + times(spring.value, d_omega) - times(through, one.outer_omega);
            Complex e = 0.0, e_omega = 0.0;
            if (step_ > 0.0) aliases(i, omega, e, e_omega);
            values[i] = {one.beta, one.beta_omega, one.outer, one.outer_omega, through, over(turned, one.outer),
                         -square * drive.value, (2.0 * square / omega) * drive.value - square * drive.slope, e, e_omega};
            if (!all_rigid_) continue;
            values[i].drive += e;  // aliases go through the same mobility
            values[i].drive_omega += e_omega;
            values[i].alias = values[i].alias_omega = 0.0;
        }
    }

    // Whether all drives, and what aliases add to them, are the same.
    bool alike_drives() const {
        for (const JointData& joint : joints_)
            if (!same_drive(joint, joints_[0]) || (all_rigid_ && step_ > 0.0 && !alike(joint, joints_[0]))) return false;
        return true;
    }

    // Up to where every joint's controller only takes energy out [rad/s]; 0: nowhere.
    double passive_end() const {
        double last = 0.0;
        for (double omega = 1e-2; omega < 1e7; omega *= 1.01) {
            if (step_ > 0.0 && omega * step_ > kPi) return 0.0;
            for (std::size_t i = 0; i < joints_.size(); i++)
                if (control(i, omega, 1.0).imag() < 0.0) return 0.95 * last;
            last = omega;
        }
        return 0.0;
    }

    // Above every resonance of the plant [rad/s], with `inverse` W (n, n).
    double highest_resonance(const double* inverse) const {
        const std::size_t n = joints_.size();
        double highest = 0.0;
        for (std::size_t i = 0; i < n; i++) {
            if (!std::isfinite(joints_[i].stiffness)) continue;
            double row = 1.0 / joints_[i].motor_inertia;
            for (std::size_t j = 0; j < n; j++) row += std::fabs(inverse[i * n + j]);
            highest = std::max(highest, std::sqrt(joints_[i].stiffness * row));
        }
        return highest;
    }

    // Of the factor g, the strongest control relative to the motor's inertia.
    double strongest_control(double omega, double gain) const {
        double most = 0.0;
        for (std::size_t i = 0; i < joints_.size(); i++)
            if (first_[i] == i) most = std::max(most, std::abs(control(i, omega, gain)) / (joints_[i].motor_inertia * omega * omega));
        return most;
    }

    // The strongest joint's acceleration per unit of command, far above its resonance.
    double strongest(double omega) const {
        double most = 0.0;
        for (const JointData& joint : joints_) most = std::max(most, std::abs(driven(joint, omega)) / (joint.motor_inertia * omega * omega));
        return most;
    }

    // Share of ω, at most `share`, beyond which a resonance could hide: its half width is about ζω with ζ = ωB/2K.
    double resolution(double omega, double share) const {
        for (const JointData& joint : joints_)
            if (std::isfinite(joint.stiffness)) share = std::min(share, std::max(0.35 * omega * joint.damping / joint.stiffness, 2e-3));
        return share;
    }

    // Largest share that the aliases of what carries W have in the response of motors, relative: with `inverse` W (n, n).
    double alias_left(const double* inverse, double omega) const {
        if (step_ == 0.0 || all_rigid_) return 0.0;
        const std::size_t n = joints_.size();
        double worst = 0.0;
        for (std::size_t i = 0; i < n; i++) {
            double row = 0.0;
            for (std::size_t j = 0; j < n; j++) row += std::fabs(inverse[i * n + j]);
            const JointData& joint = joints_[i];
            double sum = 0.0;
            for (int k = -3; k <= 3; k++) {
                if (k == 0) continue;
                const double at = omega + 2 * kPi * k / step_;
                const double passed = std::isfinite(joint.stiffness) ? std::abs(held(joint, at) * gearbox(joint, at)) : 1.0;
                sum += std::abs(driven(joint, at)) * passed * passed * row / (at * at);
            }
            worst = std::fmax(worst, sum * joint.motor_inertia * omega * omega / std::abs(driven(joint, omega)));
        }
        return worst;
    }

private:
    struct Actuation {  // C e^{−sT}, in sampled time with the hold, and its derivative
        Complex value, slope;
    };
    struct Spring {
        Complex value, slope;
    };
    struct Applied {
        Complex value, omega, gain, factor;
    };

    static bool same_drive(const JointData& a, const JointData& b) {
        return a.bandwidth == b.bandwidth && a.damping_ratio == b.damping_ratio && a.delay == b.delay;
    }
    static bool same_spring(const JointData& a, const JointData& b) { return a.stiffness == b.stiffness && a.damping == b.damping; }

    Actuation actuation(const JointData& joint, double omega) const {
        const double lag = std::isfinite(joint.bandwidth) ? 1.0 / joint.bandwidth : 0.0;
        const double r = omega * lag;
        const Complex den(1.0 - r * r, 2.0 * joint.damping_ratio * r), slope(-2.0 * r * lag, 2.0 * joint.damping_ratio * lag);
        Complex value = over(Complex(std::cos(omega * joint.delay), -std::sin(omega * joint.delay)), den);
        Complex relative = Complex(0.0, -joint.delay) - over(slope, den);
        if (step_ > 0.0) {
            const double angle = omega * step_;
            const Complex late(std::cos(angle), -std::sin(angle));
            const Complex hold = over(1.0 - late, Complex(0.0, angle));
            relative += over((late - hold) / omega, hold);
            value = times(value, hold);
        }
        return {value, times(value, relative)};
    }

    static Spring spring_of(const JointData& joint, double omega) {
        if (!std::isfinite(joint.stiffness)) return {};
        const Complex k(joint.stiffness, omega * joint.damping);
        const Complex e = over(Complex(-omega * omega, 0.0), k);
        return {e, over(Complex(-2.0 * omega, 0.0) - times(e, Complex(0.0, joint.damping)), k)};
    }

    // g c with its derivatives.
    Applied applied(std::size_t i, double omega, double gain, const Actuation& drive) const {
        const JointData& joint = joints_[i];
        if (step_ == 0.0) {
            const Complex law(joint.kp, omega * joint.kd);
            const Complex c = times(drive.value, law);
            const Complex slope = times(drive.slope, law) + times(drive.value, Complex(0.0, joint.kd));
            return {gain * c, gain * slope, c, 1.0};
        }
        const double angle = omega * step_;
        const Complex late(std::cos(angle), -std::sin(angle));
        const Complex law = joint.kp + joint.kd / step_ * (1.0 - late), law_slope = joint.kd * times(Complex(0.0, 1.0), late);
        Complex e, e_slope;
        aliases(i, omega, e, e_slope);
        if (all_rigid_) {  // h + s² ε in place of h
            const Complex whole = drive.value - omega * omega * e;
            const Complex slope = drive.slope - omega * omega * e_slope - 2.0 * omega * e;
            const Complex c = times(whole, law);
            return {gain * c, gain * (times(slope, law) + times(whole, law_slope)), c, 1.0};
        }
        const Complex c = times(drive.value, law), slope = times(drive.slope, law) + times(drive.value, law_slope);
        const Complex factor = 1.0 + gain * times(e, law);
        const Complex value = over(gain * c, factor);
        const Complex omega_slope = over(gain * slope - times(value, gain * (times(e_slope, law) + times(e, law_slope))), factor);
        return {value, omega_slope, over(over(c, factor), factor), factor};
    }

    // c of the factor g that acts: Im c >= 0 where the joint's controller takes energy out.
    Complex control(std::size_t i, double omega, double gain) const {
        const Actuation drive = actuation(joints_[i], omega);
        return applied(i, omega, gain, drive).value;
    }

    JointValue value(std::size_t i, double omega, double gain, const Actuation& drive, const Spring& spring) const {
        const JointData& joint = joints_[i];
        const Applied c = applied(i, omega, gain, drive);
        const double square = 1.0 / (omega * omega);
        const Complex a = Complex(joint.motor_inertia, -joint.motor_viscous / omega) - square * c.value;
        const Complex a_omega = Complex(0.0, joint.motor_viscous * square) - square * c.omega + (2.0 * square / omega) * c.value;
        const Complex a_gain = -square * c.gain;
        const Complex d(0.0, -joint.link_viscous / omega), d_omega(0.0, joint.link_viscous * square);
        const Complex q = 1.0 + times(a, spring.value), q_omega = times(a_omega, spring.value) + times(a, spring.slope);
        const Complex q_gain = times(a_gain, spring.value);
        const Complex outer = a + times(q, d), outer_omega = a_omega + times(q_omega, d) + times(q, d_omega);
        const Complex outer_gain = a_gain + times(q_gain, d);
        const Complex inverse = over(1.0, outer), beta = times(q, inverse);
        return {beta, times(q_omega - times(beta, outer_omega), inverse), times(q_gain - times(beta, outer_gain), inverse),
                outer, outer_omega, a, c.factor};
    }

    Complex driven(const JointData& joint, double omega) const { return actuation(joint, omega).value; }
    static Complex gearbox(const JointData& joint, double omega) { return {joint.stiffness, omega * joint.damping}; }
    static Complex held(const JointData& joint, double omega) {
        return over(1.0, Complex(joint.stiffness - joint.motor_inertia * omega * omega, omega * (joint.motor_viscous + joint.damping)));
    }

    // ε at jω and its derivative, from neighbouring entries of the table by a cubic.
    void aliases(std::size_t i, double omega, Complex& value, Complex& slope) const {
        const double position = omega / spacing_;
        const std::size_t k = position < double(kEntries - 2) ? std::size_t(position) : kEntries - 2;
        const double t = position - double(k);
        const Complex* entry = &table_[(row_[i] * kEntries + k) * 2];
        const Complex p0 = entry[0], m0 = spacing_ * entry[1], p1 = entry[2], m1 = spacing_ * entry[3];
        const Complex rise = p1 - p0, second = 3.0 * rise - 2.0 * m0 - m1, third = m0 + m1 - 2.0 * rise;
        value = p0 + t * (m0 + t * (second + t * third));
        slope = (m0 + t * (2.0 * second + 3.0 * t * third)) / spacing_;
    }

    // ε = Σ_{k≠0} (h p)(jω_k), rigid: Σ h/s_k²; one row for joints alike. Slopes by the chain rule, term by term.
    void tabulate() {
        spacing_ = kPi / step_ / double(kEntries - 1);
        for (std::size_t i = 0; i < joints_.size(); i++) {
            std::size_t same = 0;
            while (same < i && !alike(joints_[i], joints_[same])) same++;
            row_.push_back(same < i ? row_[same] : table_.size() / (2 * kEntries));
            if (same < i) continue;
            for (std::size_t k = 0; k < kEntries; k++) {
                Complex value = 0.0, slope = 0.0;
                sum_aliases(joints_[i], std::fmax(spacing_ * double(k), 1e-9 * spacing_), value, slope);
                table_.push_back(value);
                table_.push_back(slope);
            }
        }
    }

    static bool equal(const JointData& a, const JointData& b) {
        return alike(a, b) && a.link_viscous == b.link_viscous && a.kp == b.kp && a.kd == b.kd;
    }

    static bool alike(const JointData& a, const JointData& b) {
        return a.motor_inertia == b.motor_inertia && a.motor_viscous == b.motor_viscous && a.stiffness == b.stiffness &&
               a.damping == b.damping && a.bandwidth == b.bandwidth && a.damping_ratio == b.damping_ratio && a.delay == b.delay;
    }

    void sum_aliases(const JointData& joint, double omega, Complex& value, Complex& slope) const {
        if (!std::isfinite(joint.stiffness) && !all_rigid_) return;
        for (int k = 1; k <= kTerms; k++) {
            Complex both = 0.0;
            for (const int side : {-1, 1}) {
                const double at = omega + side * 2 * kPi * k / step_;
                const Actuation drive = actuation(joint, at);
                Complex p = 1.0 / Complex(-at * at, 0.0), relative = Complex(-2.0 / at, 0.0);
                if (!all_rigid_) {
                    p = held(joint, at);
                    relative = -times(p, Complex(-2.0 * joint.motor_inertia * at, joint.motor_viscous + joint.damping));
                }
                const Complex term = times(drive.value, p);
                both += term;
                slope += times(drive.slope, p) + times(term, relative);
            }
            value += both;
            if (!(std::abs(both) * double(k) > 1e-10 * std::abs(value))) break;  // or not a number
        }
    }

    static constexpr std::size_t kEntries = 385;
    static constexpr int kTerms = 3000;
    Vector<JointData> joints_;
    double step_, spacing_ = 0.0;
    bool all_rigid_ = false;
    Vector<std::size_t> row_, first_;  // of each joint: its row of the table, and the first joint equal to it
    Vector<Complex> table_;
};

}  // namespace gainroom
