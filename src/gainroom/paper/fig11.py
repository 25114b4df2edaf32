"""Fig. 11: the testbed under Kp:Kv 1600:80 and 1600:70, with friction, sampling and encoders; and the simulated limit between the two.

The paper does not print the trajectory; here the joint swings about −0.5 rad, where its figure shows it, fast enough to leave stiction.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from ..analysis.gain_limit import gain_limit
from ..simulation import Chirp, Run, Scenario, Start, Vibration, simulate, vibration
from ..simulation.onset import Onset, find_onset, linear_vibration
from .joints import SAMPLE_TIME, STABLE_KV, TESTBED, TESTBED_KP, VIBRATING_KV
from .picture import Curve, Panel, Picture
from .row import Row, compare, same, within
from .virtual_testbed import BUS_DELAY, MOTOR_RESOLUTION, loop_of_testbed, virtual_testbed

DURATION = 4.0  # [s] the figure shows 2.8 to 3.5 s
CENTRE, SWING, RATE = -0.5, 0.5, math.pi  # [rad], [rad], [rad/s]
SHOWN = (2.8, 3.5)  # [s] the figure's axis
LAST = 1.0  # [s] that are searched for a vibration


@dataclass(frozen=True)
class Trial:
    """One run of the figure, and the vibration of the gearbox's twist in its last second; None where there is none."""

    response: Run
    vibration: Vibration | None

    @property
    def vibrates(self) -> bool:
        """True if the trial vibrates by more than ten encoder steps without decay."""
        found = self.vibration
        return found is not None and found.amplitude > 10 * MOTOR_RESOLUTION and found.growth_rate > -1.0

    @property
    def last(self) -> Run:
        """Part of the run in its last second."""
        return self.response.rows(slice(-round(LAST / SAMPLE_TIME), None))

    @property
    def largest_errors(self) -> tuple[float, float]:
        """Largest errors of link and motor in the last second [rad]."""
        run = self.last
        return float(np.abs(run.reference - run.link_position).max()), float(np.abs(run.reference - run.motor_position).max())

    @property
    def link_share(self) -> float:
        """Swing of the link over that of the motor at the vibration's frequency, by least squares beside the sine that is followed."""
        if self.vibration is None:
            return math.nan
        run = self.last
        turns = np.outer(run.time, [self.vibration.frequency, RATE])
        basis = np.hstack([np.cos(turns), np.sin(turns), np.ones((len(turns), 1)), run.time[:, None]])
        parts = np.linalg.lstsq(basis, np.hstack([run.link_position, run.motor_position]), rcond=None)[0]
        link, motor = np.hypot(parts[0], parts[2])
        return float(link / motor)


def link_over_motor(frequency: float) -> complex:
    """Position of the testbed's link per position of its motor, moved at `frequency` [rad/s]."""
    s = 1j * frequency
    gearbox = TESTBED.stiffness + TESTBED.damping * s
    return gearbox / (TESTBED.link_inertia * s * s + gearbox)


def rows() -> Iterator[Row]:
    """The two trials, the vibration, and the limit between them."""
    hardware = "Virtual testbed: friction, gravity, encoders and torque limit (assumed), the inferred delay, a sine about −0.5 rad."
    for kv, stable in ((STABLE_KV, True), (VIBRATING_KV, False)):
        link, motor = (1e3 * error for error in trial(kv).largest_errors)
        errors = f"Largest error in the last second: of the link {link:.1f} mrad, of the motor {motor:.1f}."
        yield same(f"fig11.kv_{kv:g}.stable", stable, not trial(kv).vibrates, f"Kp:Kv 1600:{kv:g}, simulated. {hardware} {errors}")
    predicted, seen = gain_limit(loop_of_testbed(TESTBED_KP, VIBRATING_KV)).frequency, trial(VIBRATING_KV).vibration
    note = (
        "Not printed: the sampled linear loop's at its limit, against the vibration simulated at Kv 80. Tolerance: 3 %, as the torque "
        "limit and friction, which the linear loop lacks, shift it."
    )
    frequency = math.nan if seen is None else seen.frequency
    yield compare("fig11.vibration_frequency_rad_s", predicted, frequency, "rad/s", 0.03 * predicted, note)
    expected = abs(link_over_motor(frequency))
    note = (
        f"What the link does of the vibration at Kv {VIBRATING_KV:g}: its swing over the motor's, simulated. Not printed: two masses move "
        "so at that frequency, |(B s + K)/(J_L s² + B s + K)|. Tolerance: 5 %, as dry friction acts on the link, too."
    )
    yield compare(f"fig11.kv_{VIBRATING_KV:g}.link_over_motor", expected, trial(VIBRATING_KV).link_share, "×", 0.05 * expected, note)
    limit = simulated_limit()
    note = f"The Kv at which the linear loop, simulated at 2 kHz, starts to vibrate at Kp 1600 ({limit.runs} runs). The paper: 70 to 80."
    yield within("fig11.kv_limit", STABLE_KV, VIBRATING_KV, limit.gain, "N·m·s/rad", note)


def pictures() -> Iterator[Picture]:
    """The figure: tracking under both gains, and the torque that it takes."""
    panels = []
    for title, heights, signal, scale in (
        ("error [mrad]", (-12.0, 14.0), "error", 1e3),
        ("torque [N·m]", (-190.0, 190.0), "actual_torque", 1.0),
    ):
        curves = []
        for kv in (VIBRATING_KV, STABLE_KV):
            run = trial(kv).response
            shown = (run.time >= SHOWN[0]) & (run.time <= SHOWN[1])
            curves.append(Curve(f"Kv {kv:g}", run.time[shown], scale * getattr(run, signal)[shown, 0]))
        panels.append(Panel(title, heights, tuple(curves)))
    seen = trial(VIBRATING_KV).vibration
    frequency = "" if seen is None else f" at {seen.frequency / (2 * math.pi):.3g} Hz ({seen.frequency:.4g} rad/s)"
    caption = (
        f"Kp 1600. With Kv {VIBRATING_KV:g} the joint vibrates{frequency} and the torque runs between its limits; with Kv {STABLE_KV:g} "
        "only the error due to friction remains. The paper does not print the trajectory: here the joint oscillates about −0.5 rad."
    )
    title = "Fig. 11. Tracking on the virtual testbed: Kv 80 vibrates, Kv 70 does not"
    yield Picture(title, caption, "time [s]", SHOWN, tuple(panels))


@cache
def trial(kv: float) -> Trial:
    """The joint follows a sine under Kp 1600 and `kv` [N m s/rad]."""
    reference = Chirp(SWING, RATE, RATE, DURATION, base=CENTRE)
    start = Start(CENTRE, CENTRE, SWING * RATE, SWING * RATE)
    response = simulate(virtual_testbed(loop_of_testbed(TESTBED_KP, kv)), Scenario(reference, DURATION, start=start))
    twist = (response.motor_position - response.link_position)[-round(LAST / SAMPLE_TIME) :]
    return Trial(response, vibration(twist, SAMPLE_TIME))


@cache
def simulated_limit(delay: float = BUS_DELAY) -> Onset:
    """The Kv at which the linear loop starts to vibrate at Kp 1600, by simulation; `delay` [s] in the drive."""
    return find_onset(lambda kv: linear_vibration(loop_of_testbed(TESTBED_KP, kv, delay)), 40.0, 130.0)
