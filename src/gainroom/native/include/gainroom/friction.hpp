// Friction during one substep, from the motion without it.
//
// All is in terms of the mean velocity v̄ of the substep: it is `free` without the contact, and every N m of friction takes `gain` off.
// The friction torque τ is the same all through the substep and obeys the law at v̄, so the work that it takes out, τ v̄ h, is never
// negative: friction can create no energy, however long the substep is (a discrete gradient; the error of sliding falls with h²).
#pragma once

#include <algorithm>
#include <cmath>

namespace gainroom {

// One contact: Coulomb and Stribeck friction, or LuGre (Canudas de Wit, Olsson, Åström and Lischinsky 1995) with its bristles.
struct FrictionLaw {
    double coulomb, breakaway;  // F_C, sliding fast, and F_S ≥ F_C, what breaks it loose [N m]
    double stribeck_velocity;   // v_s, over which F_S falls to F_C [rad/s]
    double bristle_stiffness;   // σ_0 [N m/rad]; infinite: no bristles, it sticks
    double bristle_damping;     // σ_1 [N m s/rad]

    bool rubs() const { return breakaway > 0; }

    // F(v) at speed |v|.
    double sliding(double speed) const {
        if (breakaway == coulomb) return coulomb;
        const double ratio = speed / stribeck_velocity;
        return coulomb + (breakaway - coulomb) * std::exp(-ratio * ratio);
    }
};

struct DryContact {
    double torque, velocity;  // τ, v̄
    bool stuck;
};

// Without bristles. It sticks where no more than F_S is needed for v̄ = 0; else w + gain F(w) = |free|, w = |v̄|.
inline DryContact dry(const FrictionLaw& law, double free, double gain) {
    const double needed = free / gain;
    if (std::fabs(needed) <= law.breakaway) return {needed, 0.0, true};
    const double wanted = std::fabs(free), side = std::copysign(1.0, free);
    double low = 0.0, high = wanted, speed = std::max(wanted - gain * law.coulomb, 0.5 * wanted);
    for (int round = 0; round < 80; round++) {
        const double torque = law.sliding(speed), rest = speed + gain * torque - wanted;
        (rest > 0 ? high : low) = speed;
        const double slope = 1.0 - gain * (torque - law.coulomb) * 2 * speed / (law.stribeck_velocity * law.stribeck_velocity);
        double trial = slope > 0 ? speed - rest / slope : 0.5 * (low + high);
        if (!(low <= trial && trial <= high)) trial = 0.5 * (low + high);
        const bool done = std::fabs(trial - speed) <= 1e-15 * wanted;
        speed = trial;
        if (done) break;
    }
    return {side * law.sliding(speed), side * speed, false};
}

struct Bristles {
    double torque, bent;  // mean over a substep; deflection z at its end
};

// Of a substep of `width` [s] at constant velocity `rate`, from z = `bent`: ż = v − a z with a = σ_0 |v| / F(v) is then linear, and z
// approaches v/a as e^{−a t}.
inline Bristles bristles(const FrictionLaw& law, double bent, double rate, double width) {
    const double stiffness = law.bristle_stiffness, most = law.sliding(std::fabs(rate));
    const double fade = stiffness * std::fabs(rate) / most * width;  // a h
    double end, mean;
    if (fade < 1e-6) {  // v/a (1 − e^{−ah}) and its mean, by their series
        end = bent * (1 - fade + 0.5 * fade * fade) + rate * width * (1 - 0.5 * fade);
        mean = bent * (1 - 0.5 * fade) + 0.5 * rate * width * (1 - fade / 3);
    } else {
        const double goal = std::copysign(most, rate) / stiffness, gone = -std::expm1(-fade);
        end = bent + (goal - bent) * gone;
        mean = goal + (bent - goal) * gone / fade;
    }
    return {stiffness * mean + law.bristle_damping * (end - bent) / width, end};
}

struct BristledContact {
    double torque, velocity, bent;  // τ, v̄, z at the end
};

// With bristles: v̄ + gain τ(v̄) = free by a bracketed secant from `guess`.
inline BristledContact lugre(const FrictionLaw& law, double bent, double free, double gain, double width, double guess) {
    double most = std::max(law.bristle_stiffness * std::fabs(bent), law.breakaway);
    most *= 1 + 2 * law.bristle_damping / (law.bristle_stiffness * width);  // no torque is larger, whatever v̄ is
    double low = free - gain * most, high = free + gain * most;
    double here = std::min(std::max(guess, low), high);
    Bristles found = bristles(law, bent, here, width);
    double rest = here + gain * found.torque - free, there = free - gain * found.torque;
    for (int round = 0; round < 100; round++) {
        (rest > 0 ? high : low) = here;
        if (!(low <= there && there <= high)) there = 0.5 * (low + high);
        if (std::fabs(there - here) <= 1e-16 * (std::fabs(free) + gain * most) || there == here) break;
        const double before = here, rest_before = rest;
        here = there;
        found = bristles(law, bent, here, width);
        rest = here + gain * found.torque - free;
        if (rest == 0.0) break;
        there = rest != rest_before ? here - rest * (here - before) / (rest - rest_before) : 0.5 * (low + high);
    }
    return {found.torque, here, found.bent};
}

}  // namespace gainroom
