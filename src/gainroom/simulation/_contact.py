"""Compiled: friction during one substep, from the motion without it.

All is in terms of the mean velocity v̄ of the substep: it is `free` without the contact, and every N m of friction takes `gain` off. The
friction torque τ is the same all through the substep and obeys the law at v̄, so the work that it takes out, τ v̄ h, is never negative:
friction can create no energy, however long the substep is (a discrete gradient; the error of sliding falls with h²).

A law is (F_C, F_S, v_s, σ_0, σ_1) as in friction.py.
"""

import math

from ..analysis.compiled import cached_njit

jit = cached_njit(error_model="numpy")


@jit
def sliding(law, speed):
    """F(v) at speed |v|."""
    if law[1] == law[0]:
        return law[0]
    ratio = speed / law[2]
    return law[0] + (law[1] - law[0]) * math.exp(-ratio * ratio)


@jit
def dry(law, free, gain):
    """Without bristles: (τ, v̄, stuck). It sticks where no more than F_S is needed for v̄ = 0; else w + gain F(w) = |free|, w = |v̄|."""
    needed = free / gain
    if abs(needed) <= law[1]:
        return needed, 0.0, True
    wanted = abs(free)
    side = math.copysign(1.0, free)
    low, high = 0.0, wanted
    speed = max(wanted - gain * law[0], 0.5 * wanted)
    for _ in range(80):
        torque = sliding(law, speed)
        rest = speed + gain * torque - wanted
        if rest > 0:
            high = speed
        else:
            low = speed
        slope = 1.0 - gain * (torque - law[0]) * 2 * speed / (law[2] * law[2])
        trial = speed - rest / slope if slope > 0 else 0.5 * (low + high)
        if not low <= trial <= high:
            trial = 0.5 * (low + high)
        done = abs(trial - speed) <= 1e-15 * wanted
        speed = trial
        if done:
            break
    return side * sliding(law, speed), side * speed, False


@jit
def bristles(law, bent, rate, width):
    """With bristles: (mean torque, deflection at the end) of a substep of `width` [s] at constant velocity `rate`, from z = `bent`.

    ż = v − a z with a = σ_0 |v| / F(v) is then linear: z approaches v/a as e^{−a t}.
    """
    fade = law[3] * abs(rate) / sliding(law, abs(rate)) * width  # a h
    if fade < 1e-6:  # v/a (1 − e^{−ah}) and its mean, by their series
        end = bent * (1 - fade + 0.5 * fade * fade) + rate * width * (1 - 0.5 * fade)
        mean = bent * (1 - 0.5 * fade) + 0.5 * rate * width * (1 - fade / 3)
    else:
        goal = math.copysign(sliding(law, abs(rate)), rate) / law[3]
        gone = -math.expm1(-fade)
        end = bent + (goal - bent) * gone
        mean = goal + (bent - goal) * gone / fade
    return law[3] * mean + law[4] * (end - bent) / width, end


@jit
def lugre(law, bent, free, gain, width, guess):
    """With bristles: (τ, v̄, deflection at the end), v̄ + gain τ(v̄) = free by a bracketed secant from `guess`."""
    most = max(law[3] * abs(bent), law[1])
    most *= 1 + 2 * law[4] / (law[3] * width)  # no torque is larger, whatever v̄ is
    low, high = free - gain * most, free + gain * most
    here = min(max(guess, low), high)
    torque, end = bristles(law, bent, here, width)
    rest = here + gain * torque - free
    there = free - gain * torque
    for _ in range(100):
        if rest > 0:
            high = here
        else:
            low = here
        if not low <= there <= high:
            there = 0.5 * (low + high)
        if abs(there - here) <= 1e-16 * (abs(free) + gain * most) or there == here:
            break
        before, rest_before = here, rest
        here = there
        torque, end = bristles(law, bent, here, width)
        rest = here + gain * torque - free
        if rest == 0.0:
            break
        there = here - rest * (here - before) / (rest - rest_before) if rest != rest_before else 0.5 * (low + high)
    return torque, here, end
