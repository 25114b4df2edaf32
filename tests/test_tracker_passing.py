"""A crossing that a sharp resonance of another joint passes: it falls within that resonance's width, which no speed of before tells.

Joint 0 crosses just above joint 2, which feels neither of the others. Joint 1 has next to no gains and never crosses: the resonance of its
link, damped by as little as 3e-5, comes to joint 0's crossing as W moves, and takes that below joint 2's, or has a pair of crossings born
beside it, of which the lower one is.
"""

import numpy as np
import pytest

import gainroom as gr
from gainroom.native import _core

NAMES = ("motor_inertia", "motor_viscous", "link_viscous", "stiffness", "damping", "bandwidth", "damping_ratio", "delay", "kp", "kd")
ABOVE = 1e-6
AT_REST, LOOKED_AT = 60, 90  # ticks
BORN = (17, 325, 88, 352, 494, 1034)  # it takes longer to certify what is found there
SHARP = (115, 553)  # that is not done, as long as the crossing is not known at which the pair's root is stable again


class Passing:
    """One such machine, `at` how far the resonance has come."""

    def __init__(self, seed: int):
        rng = np.random.default_rng(seed)

        def between(low: float, high: float, size: int | None = None) -> np.ndarray:
            return np.exp(rng.uniform(np.log(low), np.log(high), size))

        inertia = between(0.1, 10, 3)
        motor, sharp, self.damping, self.share = between(15, 250), between(1e-4, 0.05), between(3e-5, 1e-2), rng.uniform(0.1, 0.99)
        self.own = [between(0.03, 30) / inertia[0], between(0.03, 30) / inertia[1], between(0.1, 10) / inertia[2]]
        self.sample_time = float(rng.choice([0, 0, 5e-4, 1e-3, 2e-3]))
        delay, bandwidth = between(3e-4, 3e-3), between(1000, 6000)
        delays, corner = (delay, delay, delay * between(0.3, 3)), between(5, 100)
        gearbox, gains = (motor**2, 2 * sharp * motor), (corner**2 / 4, corner)  # over the motor's inertia
        rows = [(j, 0, 0, j * gearbox[0], j * gearbox[1], bandwidth, 0.9, 0, j * gains[0], j * gains[1]) for j in inertia]
        self.table = np.array(rows)
        self.table[:, 7] = delays
        self.table[1, 8:] = 1e-4 * inertia[1], 1e-3 * inertia[1]
        omega = gr.gain_limit(self.loop([0], 1.0)).frequency
        stiffness = omega**2 / (1 / inertia[1] + self.own[1])
        self.table[1, 3:5] = stiffness, 2 * self.damping * stiffness / omega

    def w(self, at: float) -> np.ndarray:
        found = np.diag([self.own[0], self.own[1] * at, self.own[2]])
        found[0, 1] = found[1, 0] = self.share * np.sqrt(found[0, 0] * found[1, 1])
        return found

    def loop(self, joints: list[int], at: float) -> gr.Loop:
        table = dict(zip(NAMES, self.table[joints].T, strict=True))
        plant = gr.Plant(
            self.w(at)[np.ix_(joints, joints)], table["motor_inertia"], table["stiffness"], table["damping"], table["motor_viscous"]
        )
        drives = [gr.Drive(*row) for row in self.table[joints, 5:8]]
        return gr.build_loop(plant, drives, gr.PD(table["kp"], table["kd"]), "motor", self.sample_time or None)

    def limit(self, at: float, joints: tuple[int, ...] = (0, 1, 2)) -> float:
        return gr.gain_limit(self.loop(list(joints), at)).gain

    def tuned(self, far: float, near: float, between: float) -> None:
        """Joint 2 crosses so far down the way that joint 0 falls."""
        target = self.limit(far, (0, 1)) * (1 - between) + self.limit(near, (0, 1)) * between
        for _ in range(3):
            self.table[2, 8:] *= self.limit(1.0, (2,)) / target


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "far", "near", "between", "per_tick"),
    [
        (475, 0.09675, 0.12475, 0.165, 1e-4),
        (481, 0.103, 0.12475, 0.345, 1e-4),
        (563, 0.04375, 0.12475, 0.852, 1e-3),
        (212, 0.07525, 0.12475, 0.486, np.inf),
        (443, -0.02875, -0.125, 0.616, np.inf),
        # A pair of crossings is born beside joint 0's, which stays above joint 2's: its lower one is the limit.
        (17, 0.1218, 0.0173, 0.373, np.inf),
        (325, -0.0770, 0.0142, 0.676, np.inf),
        (88, 0.0159, 0.0566, 0.681, np.inf),
        (352, 0.01065, 0.048494, 0.335, 2.5e-4),
        (115, -0.0400, 0.0257, 0.807, np.inf),
        (553, 0.1470, 0.0852, 0.597, np.inf),
        # Counts contradict what is known from before the jump.
        (494, 0.23143590, 0.13096784, 0.81848051, np.inf),
        (1034, -0.02674817, 0.06457105, 0.73742997, np.inf),
    ],
    ids=[
        "slow",
        "sharp",
        "fast",
        "jump",
        "back",
        "born",
        "born far below",
        "born nearby",
        "born in motion",
        "sharp and born",
        "born close",
        "contradiction",
        "contradiction back",
    ],
)
def test_certified_where_a_resonance_passes(seed: int, far: float, near: float, between: float, per_tick: float):
    """ln W of joint 1's link goes from `far` to `near`, so much per tick or at once, and stays there."""
    machine = Passing(seed)
    machine.tuned(np.exp(far), np.exp(near), between)
    tracker = _core.GainTracker(np.ascontiguousarray(machine.table), machine.sample_time, 3, 0, 1, 0.0, 0.0)
    for _ in range(500):
        tracker.update_inverse(machine.w(np.exp(far)), 0)
    steps = max(round(abs(near - far) / per_tick), 1)
    way = np.exp(np.concatenate([np.linspace(far, near, steps + 1)[1:], np.full(AT_REST, near)]))
    certified, limits = 0, {}
    for place, found in [(at, tracker.update_inverse(machine.w(at), 0)) for at in way][-LOOKED_AT:]:
        if found[2]:
            if place not in limits:
                limits[place] = machine.limit(place)
            assert found[0] <= limits[place] * (1 + ABOVE)
            certified += 1
    assert found[0] <= machine.limit(way[-1]) * (1 + ABOVE)
    assert seed in SHARP or certified > (0.4 if seed in BORN else 0.9) * min(len(way), LOOKED_AT)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "far", "near", "between", "swing", "turn"),
    [(88, 0.08977, 0.127827, 0.4247, 0.000619, 2.174), (622, 0.05738, 0.05751, 0.8526, 0.000295, 2.7906)],
)
def test_crossings_that_cancel_each_other_in_a_count(seed: int, far: float, near: float, between: float, swing: float, turn: float):
    """After a jump the resonance swings about where it came to: a count may agree although two crossings are not known."""
    machine = Passing(seed)
    machine.tuned(np.exp(far), np.exp(near), between)
    tracker = _core.GainTracker(np.ascontiguousarray(machine.table), machine.sample_time, 3, 0, 1, 0.0, 0.0)
    for _ in range(300):
        tracker.update_inverse(machine.w(np.exp(far)), 0)
    way = np.exp(np.concatenate([near + swing * np.sin(turn * np.arange(300)), np.full(AT_REST, near)]))
    found = [(at, tracker.update_inverse(machine.w(at), 0)) for at in way]
    looked = [(at, limit[0]) for at, limit in found[::10] if limit[2]]
    assert len(looked) > 0.8 * len(found[::10])
    assert all(gain <= machine.limit(at) * (1 + ABOVE) for at, gain in looked)
