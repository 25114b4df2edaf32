"""Sec. IV-A: the stiffness of the joint by fixing its output and applying torques, as the paper has it; on the virtual testbed."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np

from ..identification import StiffnessFit, identify_stiffness
from ..simulation import Scenario, simulate
from .joints import SAMPLE_TIME, STIFFNESS, TESTBED
from .picture import Curve, Panel, Picture
from .row import Row, compare
from .virtual_testbed import MOTOR_FRICTION, logged, loop_of_testbed, virtual_testbed, with_interval

TORQUE, FREQUENCY, DURATION = 30.0, 0.2, 20.0  # [N m], [Hz], [s] assumed: slowly, four times back and forth
ACCURACY = 0.02  # of stiffness and friction
DRAWN = 20  # every so many rows of the log are drawn


def rows() -> Iterator[Row]:
    """Stiffness, and the friction that shows as hysteresis."""
    found = identified()
    known = (
        f"From actual torque and motor position of a log of {DURATION:g} s, written to a file and read from it: a slow sine of "
        f"{TORQUE:g} N·m on the virtual testbed with its output fixed."
    )
    note = f"Tolerance: 2 %. The virtual gearbox has the paper's stiffness: that the log shows it, not a second measurement. {known}"
    row = compare("testbed.locked.stiffness_nm_rad", STIFFNESS, found.stiffness.value, "N·m/rad", ACCURACY * STIFFNESS, note, "1.0e4")
    yield with_interval(row, found.stiffness)
    held = MOTOR_FRICTION.static or MOTOR_FRICTION.coulomb
    note = f"Half the hysteresis; the motor's static friction (assumed), as the joint turns far below its Stribeck velocity. {known}"
    row = compare("testbed.locked.friction_nm", held, found.friction.value, "N·m", ACCURACY * held, note)
    yield with_interval(row, found.friction)


def pictures() -> Iterator[Picture]:
    """Torque over deflection."""
    found = identified()
    ends = np.array([found.deflection.min(), found.deflection.max()])
    line = found.offset + found.stiffness.value * ends
    branches = np.concatenate([line + found.friction.value, [math.nan], line - found.friction.value])
    curves = (
        Curve("log", 1e3 * found.deflection[::DRAWN], found.torque[::DRAWN]),
        Curve(f"K = {found.stiffness.value:.0f} N·m/rad ({found.stiffness.low:.0f} to {found.stiffness.high:.0f})", 1e3 * ends, line),
        Curve(f"± {found.friction.value:.2f} N·m friction", 1e3 * np.concatenate([ends, [math.nan], ends]), branches),
    )
    caption = (
        "The motor turns by torque over stiffness while the output is fixed; friction holds it back on the way out and on the way back, so "
        "that the two branches lie twice the friction apart. The line between them is fitted to the log, in brackets its 95 % interval."
    )
    reach = 1.1 * 1e3 * float(np.abs(ends).max())
    title = "Testbed. The stiffness from torque and deflection, output fixed"
    panel = Panel("torque [N·m]", (-1.1 * TORQUE, 1.1 * TORQUE), curves)
    yield Picture(title, caption, "deflection of the motor [mrad]", (-reach, reach), (panel,))


@cache
def identified() -> StiffnessFit:
    """The torque–deflection line of the log."""
    loop = loop_of_testbed(0.0, 0.0, joint=replace(TESTBED, link_inertia=math.inf))
    time = SAMPLE_TIME * np.arange(round(DURATION / SAMPLE_TIME) + 1)
    torque = TORQUE * np.sin(2 * math.pi * FREQUENCY * time)
    run = simulate(replace(virtual_testbed(loop), gravity=0.0), Scenario(0.0, DURATION, feedforward=torque[:, None]))
    return identify_stiffness(logged(run, "actual_torque", "motor_position"))
