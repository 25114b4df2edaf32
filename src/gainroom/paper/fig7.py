"""Fig. 7: Bode plot of the joint with and without delay."""

import math

import numpy as np

from .joints import DRIVE, joint_with_load, torque_to_position
from .picture import AXIS, BodePicture, Mark, bode_curve
from .row import Row, compare

RATIO = 16.0
PROBE = 100.0  # [rad/s]
ROUNDING = 1e-9  # the two responses differ by one factor e^{−jωT}; what is left is rounding of ωT up to 200 rad


def rows() -> list[Row]:
    """The delayed response over the undelayed one, across the figure's whole axis."""
    joint = joint_with_load(RATIO)
    omega = np.geomspace(*AXIS, 2000)
    change = torque_to_position(joint, DRIVE.delay).response(omega) / torque_to_position(joint).response(omega)
    magnitude = 20 * np.log10(np.abs(change))
    phase = np.degrees(np.angle(change * np.exp(1j * omega * DRIVE.delay)))
    at_probe = torque_to_position(joint, DRIVE.delay).response(PROBE) / torque_to_position(joint).response(PROBE)
    inferred = f"T = {1e3 * DRIVE.delay:g} ms (inferred; the paper prints about 2 to 3 ms)."
    return [
        compare(
            "fig7.magnitude_change_db",
            0.0,
            float(np.abs(magnitude).max()),
            "dB",
            ROUNDING,
            f"The delay leaves the magnitude alone: largest change over the axis. {inferred}",
        ),
        compare(
            "fig7.phase_change_deg",
            -math.degrees(PROBE * DRIVE.delay),
            float(np.degrees(np.angle(at_probe[0]))),
            "deg",
            ROUNDING,
            f"−ωT at {PROBE:g} rad/s. {inferred}",
        ),
        compare(
            "fig7.phase_deviation_deg",
            0.0,
            float(np.abs(phase).max()),
            "deg",
            ROUNDING,
            "Largest deviation of the phase change from −ωT over the axis; never a Padé approximation.",
        ),
    ]


def pictures() -> list[BodePicture]:
    """The figure."""
    joint = joint_with_load(RATIO)
    curves = (
        bode_curve("with delay", torque_to_position(joint, DRIVE.delay)),
        bode_curve("without delay", torque_to_position(joint)),
    )
    turn = math.pi / DRIVE.delay
    marks = (Mark(0, turn, float(np.interp(turn, curves[0].omega, curves[0].magnitude)), f"−180° more<br>{turn:.4g} rad/s"),)
    caption = (
        f"The magnitudes are one line; the phase falls by ωT, another 180° at {turn:.4g} rad/s for T = {1e3 * DRIVE.delay:g} ms "
        "(inferred). Wherever a controller wants |L| = 1, that phase is gone from its margin."
    )
    # the paper's axis ends at −100 dB, which this joint reaches at 300 rad/s
    title = "Fig. 7. Delay costs phase and nothing else"
    return [BodePicture("fig7", title, caption, curves, marks, (-150, 50), (-720, 10))]
