// The return ratio of one joint in a box of frequency and uncertain parameters: a sector that contains L everywhere in the box.
//
// The plant is written with ν, the frequency over the resonance √(K (1/J_m + 1/J_l)), so that a resonance stands still while the
// parameters move, with y = 1 + jωB/K and the friction of motor and link, D_m and D_l:
//
//     P_M = (y − ν² c (1 − j D_l/(J_l ω))) / −ω (J_m + J_l) R,   c = (J_m + J_l)/J_m;   link side: y in place of the numerator
//     R   = ω (y − ν²) − j y (D_m + D_l)/(J_m + J_l) + jν² (D_m/J_m + D_l/J_l) + (ν²/ω) (D_m/J_m) (D_l/J_l)
//
// Sampled behind a hold, L(e^{jωT_s}) = D (1 − e^{−jωT_s})/T_s · Σ_k G(jω_k)/(jω_k) with ω_k = ω + 2πk/T_s and G = P C e^{−sT}: a few
// terms beside k = 0 are added up, all further ones bounded. log|L| and arg L in a box: their values at its middle, and the largest slopes
// anywhere in it (mean value theorem).
#pragma once

#include "box_factors.hpp"
#include "factors.hpp"

namespace gainroom {

constexpr double kSectorRounding = 1e-11;  // of log|L| and arg L: far above that of some fifty operations in doubles
constexpr int kMostAliases = 24;
constexpr int kQuantities = 5;
enum Quantity { kDelay, kStiffness, kLinkInertia, kMotorInertia, kDamping };

// Bounds of L over a box: log|L| and arg L between two values, the latter up to full turns. center: L in the middle of the box; score: how
// much each parameter's width moves L.
struct Sector {
    double log_low, log_high, phase_low, phase_high;
    Complex center;
    double score[kBoxParameters];
};

// One joint's loop over ranges.
class BoxLoop {
  public:
    double values[kQuantities];  // in the order of Quantity, of those that are known exactly
    int columns[kQuantities];    // of the others in a box, from 1 on; 0: known. Column 0 is the frequency
    double motor_viscous, link_viscous;
    bool motor_side;
    double sample_time;         // [s]; 0: continuous
    Factors currents, control;  // current loop, in s, without zeros; controller
    double control_delay;       // [s]
    int aliases;                // terms of the sum to either side that are added up
    double rest;                // what the others come to, at most, over ω

    int width() const { return 1 + *std::max_element(columns, columns + kQuantities); }

    // The box from low to high (width(),); column 0: ω [rad/s], or ν where `scaled`.
    Sector at(const double* low, const double* high, bool scaled) const {
        Ball given[kQuantities];
        Disc wide[kQuantities];
        double middle[kQuantities];
        for (int k = 0; k < kQuantities; k++) {
            const int column = columns[k];
            given[k] = column ? Ball::parameter(column, low[column], high[column]) : Ball::known(values[k]);
            wide[k] = given[k].disc;
            middle[k] = wide[k].mid;
        }
        const Ball frequency = Ball::parameter(0, low[0], high[0]);
        const Place<Ball> box(Masses<Ball>(*this, given), frequency, scaled);
        const Masses<double> masses(*this, middle);
        const Place<double> center(masses, frequency.disc.mid, scaled);
        const Moved moved = moved_by(box.omega.disc);
        Sizes body = body_of(box.plant, moved.currents);
        Complex value = times(center.plant.value(), value_at(currents, 0.0, 0.0, {0.0, center.omega}));
        double hidden = 0.0;
        if (sample_time > 0) {
            const Complex own = others(masses, center.omega);
            const ComplexDisc sum = all_others(Masses<Disc>(*this, wide), box.omega.disc);
            const ComplexDisc share = times(times(sum, box.plant.inverse_value()), inverse_currents(box.omega.disc));
            hidden = hidden_reach(share, over(own, value));
            body = {std::max(body.least - sum.most(), 0.0), body.most + sum.most()};
            value += own;
        }
        Sector found = enclosed(times(value, after(center.omega, masses.delay)), hidden, slopes(box, given[kDelay], moved.steep));
        // NaN bounds exclude nothing
        const double least = std::log(body.least * moved.control.least) - kSectorRounding;
        const double most = std::log(body.most * moved.control.most) + kSectorRounding;
        if (least > found.log_low) found.log_low = least;
        if (most < found.log_high) found.log_high = most;
        if (sample_time > 0 && columns[kDelay])
            found.score[columns[kDelay]] += std::min(std::isfinite(hidden) ? hidden : 1.0, 2 * kPi / sample_time * wide[kDelay].rad);
        return found;
    }

  private:
    bool rigid() const { return !columns[kStiffness] && std::isinf(values[kStiffness]); }
    bool locked() const { return !rigid() && !columns[kLinkInertia] && std::isinf(values[kLinkInertia]); }

    // Terms that do not depend on the frequency: share is c, lag B/K, square that of the resonance.
    template <class T>
    struct Masses {
        const BoxLoop& loop;
        const T &stiffness, &delay;
        T total, inverse_motor, inverse_link, share, lag, square, inverse_square;

        Masses(const BoxLoop& of, const T (&values)[kQuantities]) : loop(of), stiffness(values[kStiffness]), delay(values[kDelay]) {
            const bool locked = loop.locked();
            total = values[kMotorInertia];
            if (!locked) total = total + values[kLinkInertia];
            if (loop.rigid()) return;
            inverse_motor = inverse(values[kMotorInertia]);
            square = inverse_motor;
            if (!locked) {
                inverse_link = inverse(values[kLinkInertia]);
                square = square + inverse_link;
            }
            square = stiffness * square;
            inverse_square = inverse(square);
            share = total * inverse_motor;
            lag = values[kDamping] * inverse(stiffness);
        }
    };

    // ω, and the plant there.
    template <class T>
    struct Place {
        T omega;
        PlantFactors<T> plant;

        Place(const Masses<T>& masses, const T& frequency, bool scaled) {
            if (masses.loop.rigid() || !scaled) {
                omega = frequency;
                masses.loop.set_plant(masses, omega, plant);
            } else {
                const T resonance = root(masses.square);
                omega = frequency * resonance;
                masses.loop.set_plant(masses, omega, frequency * frequency, frequency * inverse(resonance), plant);
            }
        }
    };

    template <class T>
    void set_plant(const Masses<T>& masses, const T& omega, PlantFactors<T>& plant) const {
        if (rigid()) return set_plant(masses, omega, omega, omega, plant);
        const T over = omega * masses.inverse_square;
        set_plant(masses, omega, omega * over, over, plant);
    }

    // `swing` is ν², `over` ν²/ω.
    template <class T>
    void set_plant(const Masses<T>& masses, const T& omega, const T& swing, const T& over, PlantFactors<T>& plant) const {
        const double friction = motor_viscous + link_viscous;
        if (locked()) {
            plant.divide(masses.stiffness);
            const T lagging = omega * masses.lag, resisted = 1.0 + -1.0 * swing;
            if (motor_viscous == 0) return plant.divide(resisted, lagging);
            return plant.divide(resisted, lagging + motor_viscous * (over * masses.inverse_motor));
        }
        plant.divide(omega);
        if (rigid() && friction != 0) return plant.divide(-1.0 * (omega * masses.total), known<T>(friction));
        plant.sign = -1.0;
        plant.divide(masses.total);
        if (rigid()) return plant.divide(omega);
        const T lagging = omega * masses.lag, resisted = 1.0 + -1.0 * swing;
        if (friction == 0) {
            plant.divide(omega);
            plant.divide(resisted, lagging);
        } else {
            const T on_motor = motor_viscous * masses.inverse_motor, on_link = link_viscous * masses.inverse_link;
            const T drag = friction * inverse(masses.total);
            plant.divide(omega * resisted + lagging * drag + over * on_motor * on_link,
                         omega * lagging + swing * (on_motor + on_link) + -1.0 * drag);
        }
        if (!motor_side) return plant.multiply(known<T>(1.0), lagging);
        const T held = 1.0 + -1.0 * (swing * masses.share);
        if (link_viscous == 0) return plant.multiply(held, lagging);
        plant.multiply(held, lagging + link_viscous * (over * masses.share * masses.inverse_link));
    }

    // Σ_{k≠0} P C(jω_k) (ω/ω_k) e^{−j(ω_k − ω)T} over the terms that are added up.
    template <class T>
    auto others(const Masses<T>& masses, const T& omega) const -> decltype(joined(omega, omega)) {
        const double rate = 2 * kPi / sample_time, angle = rate * middle_of(masses.delay);
        const Complex further(std::cos(angle), -std::sin(angle));
        Complex turn = 1.0;
        decltype(joined(omega, omega)) total{};
        for (int step = 1; step <= aliases; step++) {
            turn = times(turn, further);
            for (const double sign : {1.0, -1.0}) {
                const T at = sign * step * rate + omega;
                PlantFactors<T> plant;
                set_plant(masses, at, plant);
                auto value = times(plant.value(), turned(sign > 0 ? turn : std::conj(turn), step * rate * masses.delay));
                for (const Complex& pole : currents.poles) value = times(value, inverse(joined(-pole.real(), -pole.imag() + at)));
                add(total, times(currents.gain * (omega * inverse(at)), value));
            }
        }
        return total;
    }

    static double middle_of(double a) { return a; }
    static double middle_of(const Disc& a) { return a.mid; }
    static void add(Complex& total, Complex value) { total += value; }
    static void add(ComplexDisc& total, const ComplexDisc& value) { total.mid += value.mid, total.rad += value.rad; }

    ComplexDisc all_others(const Masses<Disc>& masses, const Disc& omega) const {
        const ComplexDisc sum = others(masses, omega);
        return ComplexDisc::around(sum.mid, sum.rad + rest * (std::fabs(omega.mid) + omega.rad));
    }

    static Sizes body_of(const PlantFactors<Ball>& plant, Sizes body) {
        for (int k = 0; k < plant.reals; k++) body.divide(as_complex(plant.real[k].disc));
        if (plant.has_above) body.multiply(PlantFactors<Ball>::whole(plant.above));
        if (plant.has_below) body.divide(PlantFactors<Ball>::whole(plant.below));
        return body;
    }

    // What the parameters do not touch: sizes, and the slope of the log of all by ω.
    struct Moved {
        Sizes currents, control;  // with the hold
        ComplexDisc steep;
    };

    Moved moved_by(const Disc& omega) const {
        Moved found;
        const ComplexDisc along{{0.0, 1.0}, 0.0, 1.0};
        found.currents.multiply(std::fabs(currents.gain), std::fabs(currents.gain));
        for (const Complex& pole : currents.poles) {
            const ComplexDisc distance = joined(-pole.real(), -pole.imag() + omega);
            found.currents.divide(distance);
            add(found.steep, times(Disc{-1.0}, times(along, inverse(distance))));
        }
        const bool sampled = sample_time > 0;
        ComplexDisc v{variable({0.0, omega.mid}, sample_time), omega.rad}, change = along;
        if (sampled) {
            const ComplexDisc turn = turned(1.0 + sample_time * v.mid, sample_time * omega);
            v.rad = turn.rad / sample_time;
            change = times(along, turn);
            add_hold(omega, found);
        }
        found.control.multiply(std::fabs(control.gain), std::fabs(control.gain));
        for (const Complex& zero : control.zeros) {
            const ComplexDisc distance = ComplexDisc::around(v.mid - zero, v.rad);
            found.control.multiply(distance);
            add(found.steep, times(change, inverse(distance)));
        }
        for (const Complex& pole : control.poles) {
            const ComplexDisc distance = ComplexDisc::around(v.mid - pole, v.rad);
            found.control.divide(distance);
            add(found.steep, times(Disc{-1.0}, times(change, inverse(distance))));
        }
        found.steep = ComplexDisc::around(found.steep.mid - Complex(0.0, control_delay), found.steep.rad);
        return found;
    }

    // sin x/x and a turn by x = ωT_s/2 ≥ 0; the former, and the slope of its log, fall.
    void add_hold(const Disc& omega, Moved& found) const {
        const double half = sample_time / 2, low = omega.mid - omega.rad;
        const double first = half * (low < 0 ? 0.0 : low), last = half * (omega.mid + omega.rad);
        found.control.multiply(last < kPi ? sinc(last) : 0.0, sinc(first));
        const double start = half * sinc_slope(first), end = half * sinc_slope(last);
        add(found.steep, {{0.5 * (start + end), -half}, 0.5 * std::fabs(start - end)});
    }

    static double sinc(double x) { return std::fabs(x) < 1e-4 ? 1 - x * x / 6 : std::sin(x) / x; }

    // d log(sin x/x)/dx in [0, π); NaN beyond.
    static double sinc_slope(double x) {
        if (x <= 1e-4) return -x / 3;
        return x < kPi ? 1 / std::tan(x) - 1 / x : std::numeric_limits<double>::quiet_NaN();
    }

    LogSlopes slopes(const Place<Ball>& box, const Ball& delay, const ComplexDisc& steep) const {
        LogSlopes found;
        const Ball turn = box.omega * delay;
        for (int i = 0; i < kBoxParameters; i++) {
            found.add(i, {0.0, -turn.mid[i]}, turn.rad[i]);
            const Disc omega = box.omega.slope(i);
            if (omega.mid == 0 && omega.rad == 0) continue;
            const ComplexDisc part = times(omega, steep);
            found.add(i, part.mid, part.rad);
        }
        for (int k = 0; k < box.plant.reals; k++) found.divide(box.plant.real[k]);
        if (box.plant.has_above) found.multiply(box.plant.above, 1.0);
        if (box.plant.has_below) found.multiply(box.plant.below, -1.0);
        return found;
    }

    // How far log(1 + x) may be from its value at `own`, for x in `share`; NaN where 1 + x may be 0.
    static double hidden_reach(const ComplexDisc& share, Complex own) {
        const double reach = (magnitude(share.mid - own) + share.rad) / magnitude(1.0 + own);
        return reach < 1 ? -std::log1p(-reach) : std::numeric_limits<double>::quiet_NaN();
    }

    ComplexDisc inverse_currents(const Disc& omega) const {
        ComplexDisc value = as_complex(Disc{1 / currents.gain});
        for (const Complex& pole : currents.poles) value = times(value, joined(-pole.real(), -pole.imag() + omega));
        return value;
    }

    // Delay, hold and controller at ω.
    Complex after(double omega, double delay) const {
        const double half = 0.5 * omega * sample_time, angle = half + omega * (delay + control_delay);
        const Complex turn(std::cos(angle), -std::sin(angle));
        return times(times(sinc(half), turn), value_at(control, 0.0, sample_time, {0.0, omega}));
    }

    // By the mean value theorem; where nothing is known, the whole plane.
    static Sector enclosed(Complex center, double hidden, const LogSlopes& slopes) {
        constexpr double infinite = std::numeric_limits<double>::infinity();
        Sector found{-infinite, infinite, 0.0, 2 * kPi, center, {}};
        double log_reach = hidden + kSectorRounding, phase_reach = hidden + kSectorRounding;
        for (int i = 0; i < kBoxParameters; i++) {
            log_reach += std::fabs(slopes.mid[i].real()) + slopes.rad[i];
            phase_reach += std::fabs(slopes.mid[i].imag()) + slopes.rad[i];
        }
        const double log_center = std::log(magnitude(center)), phase = std::atan2(center.imag(), center.real());
        const bool known = std::isfinite(log_center + log_reach + phase_reach);
        for (int i = 0; i < kBoxParameters; i++) found.score[i] = known ? slopes.size(i) : slopes.rough[i];
        if (known) {
            found.log_low = log_center - log_reach, found.log_high = log_center + log_reach;
            found.phase_low = phase - phase_reach, found.phase_high = phase + phase_reach;
        }
        return found;
    }
};

}  // namespace gainroom
