"""Fig. 7: Bode plot of the joint with and without delay."""

import math
from collections.abc import Iterator

import numpy as np

from .joints import DRIVE, RATIO, joint_with_load, torque_to_position
from .picture import AXIS, Mark, Picture, bode, decibels
from .row import Row, compare

JOINT = joint_with_load(RATIO)
PROBE = 100.0  # [rad/s]
ROUNDING = 1e-9  # the two responses differ by one factor e^{−jωT}; what is left is rounding of ωT up to 200 rad


def rows() -> Iterator[Row]:
    """The delayed response over the undelayed one, across the figure's whole axis."""
    omega = np.append(np.geomspace(*AXIS, 2000), PROBE)
    change = torque_to_position(JOINT, DRIVE.delay).response(omega) / torque_to_position(JOINT).response(omega)
    magnitude = float(np.abs(20 * np.log10(np.abs(change))).max())
    deviation = float(np.abs(np.degrees(np.angle(change * np.exp(1j * omega * DRIVE.delay)))).max())
    inferred = f"T = {1e3 * DRIVE.delay:g} ms (inferred; the paper prints about 2 to 3 ms)."
    note = f"The delay leaves the magnitude alone: largest change over the axis. {inferred}"
    yield compare("fig7.magnitude_change_db", 0.0, magnitude, "dB", ROUNDING, note)
    expected, found = -math.degrees(PROBE * DRIVE.delay), float(np.degrees(np.angle(change[-1])))
    yield compare("fig7.phase_change_deg", expected, found, "deg", ROUNDING, f"−ωT at {PROBE:g} rad/s. {inferred}")
    note = "Largest deviation of the phase change from −ωT over the axis; never a Padé approximation."
    yield compare("fig7.phase_deviation_deg", 0.0, deviation, "deg", ROUNDING, note)


def pictures() -> Iterator[Picture]:
    """The figure."""
    loops = {"with delay": torque_to_position(JOINT, DRIVE.delay), "without delay": torque_to_position(JOINT)}
    turn = math.pi / DRIVE.delay
    mark = Mark(turn, decibels(loops["with delay"], turn), f"−180° more<br>{turn:.4g} rad/s", side="right above")
    caption = (
        f"The magnitudes are one line; the phase falls by ωT, another 180° at {turn:.4g} rad/s for T = {1e3 * DRIVE.delay:g} ms "
        "(inferred). Wherever a controller wants |L| = 1, that phase is gone from its margin."
    )
    # the paper's axis ends at −100 dB, which this joint reaches at 300 rad/s
    yield bode("Fig. 7. Delay costs phase and nothing else", caption, loops, (-150, 50), (-720, 10), (mark,))
