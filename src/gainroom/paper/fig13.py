"""Fig. 13's P/PI, told anew: the PID that it is, how far its printed gains are from PD's, and what it buys at equal robustness.

The paper compares Fig. 12 (PD) with Fig. 14 (P/PI), whose gains differ in stiffness and damping, too. The feedback of a P/PI is that of a
PID: u = kp' e + ki' ∫e − kd' v, kp' = Kp Kv + Ki, ki' = Kp Ki, kd' = Kv. Held to the same robustness as PD, it buys what its integral does.
"""

from collections.abc import Iterator
from functools import cache

import numpy as np

from ..design.comparison.objective import Objective
from ..studies.comparison import Comparison, ComparisonSettings, assumed_noise, compare as compare_controllers
from ..system.controller import PID, PPI
from ..system.loop import build_loop
from ..system.system import System
from .biped import COM_KD, COM_KP
from .com_motion import CASCADE_KI, CASCADE_KP, CASCADE_KV, DIRECTIONS, MOTION, PRINTED
from .joints import DRIVE, GAINS, RATIO, SAMPLE_TIME, joint_with_load
from .row import Row, at_least, compare

ALIKE = 0.2
"""Share by which stiffness or damping of the two laws may differ and still count as equal."""
OMEGA = np.geomspace(0.1, 6000.0, 200)  # [rad/s] at which the two laws are compared
ROUND_OFF = 1e-9
NOTHING = 0.01
"""Share of the worst deviation that a search does not resolve."""


def rows() -> Iterator[Row]:
    """P/PI as PID, its printed gains against PD's, and P/PI against PD at equal robustness."""
    yield _as_pid()
    for k, direction in enumerate(DIRECTIONS):
        yield from _against_pd(k, direction)
    yield from _at_equal_robustness()


def _as_pid() -> Row:
    """Largest relative difference of the two return ratios on the joint of Fig. 9, at 2 kHz."""
    kp, kv, ki = 8.0, GAINS.kd, 700.0
    joint = joint_with_load(RATIO)
    laws = PPI(kp, kv, ki), PID(kp * kv + ki, kp * ki, kv)
    cascade, pid = (build_loop(joint, DRIVE, law, sample_time=SAMPLE_TIME).response(OMEGA) for law in laws)
    note = "Return ratios of a P/PI and of the PID kp' = Kp Kv + Ki, ki' = Kp Ki, kd' = Kv on the joint of Fig. 9, sampled."
    return compare("fig13.pid.deviation", 0.0, float(np.abs(cascade / pid - 1).max()), "", ROUND_OFF, note)


def _against_pd(k: int, direction: str) -> Iterator[Row]:
    """One direction: stiffness and damping of Fig. 14's P/PI over those of Fig. 12's PD, and the time in which its integral acts."""
    kp, kv, ki = (float(gains[k]) for gains in (CASCADE_KP, CASCADE_KV, CASCADE_KI))
    stiffness, integral = kp * kv + ki, kp * ki
    pd, ppi = (float(PRINTED[law][k]) for law in ("pd", "ppi"))
    stiffer, damped, time = stiffness / float(COM_KP[k]), kv / float(COM_KD[k]), stiffness / integral
    alone = f"Friction that leaves {pd:g} mm under PD leaves {pd / stiffer:.1f} mm by this stiffness alone; printed: {ppi:g} mm."
    for quantity, ratio, more in (("stiffness_over_pd", stiffer, alone), ("damping_over_pd", damped, "")):
        name = quantity.partition("_")[0]
        told = "As that of PD" if abs(ratio - 1) <= ALIKE else f"Corrected: the figures do not compare equal {name}"
        note = f"{told}. Of the printed gains, P/PI as a PID. {more}".strip()
        yield compare(f"fig13.{direction}.{quantity}", 1.0, ratio, "×", ALIKE, note)
    acts = time <= 2 * MOTION
    told = "Acts within the move" if acts else "Corrected: an integral so slow does nothing within the move"
    note = f"{told} of {MOTION:g} s: kp'/ki' of the printed gains. Tolerance: as long again."
    yield compare(f"fig13.{direction}.integral_time_s", MOTION, time, "s", MOTION, note)


def _at_equal_robustness() -> Iterator[Row]:
    """Gain of P/PI over PD for the joint of Fig. 9 at the Ms, delay reserve and torque noise of PD, everywhere in the usual box."""
    held = "Both tuned to Ms 2, half the delay in reserve and PD's torque noise, for stiffness ± 20 % and 0.5 to 1.5 times the load."
    pd, ppi = (compared("dynamic_stiffness").row(key).worst for key in ("pd", "pid"))
    note = f"Peak of |q/d|, load torque to link, of PD over that of P/PI on the joint of Fig. 9: nothing is bought. {held}"
    yield compare("fig13.equal.dynamic_stiffness", 1.0, pd / ppi, "×", NOTHING, note)
    pd, ppi = (compared("step_load").row(key).worst for key in ("pd", "pid"))
    note = f"Rms deviation in the second after a step of the load, PD over P/PI: what the integral buys. A P/PI contains PD. {held}"
    yield at_least("fig13.equal.step_load", 1.0, pd / ppi, "×", note)


@cache
def compared(objective: str) -> Comparison:
    """PD and P/PI on the joint of Fig. 9 at 2 kHz, tuned for an objective at equal robustness."""
    system = System.of_joint(joint_with_load(RATIO), DRIVE, GAINS, sample_time=SAMPLE_TIME)
    settings = ComparisonSettings(("pd", "pid"), Objective(objective), assumed_noise(system))
    return compare_controllers(system, settings=settings, nominal=False, bound=False)
