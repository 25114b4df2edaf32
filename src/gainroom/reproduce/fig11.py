"""Fig. 11: the testbed under Kp:Kv 1600:80 and 1600:70, with friction, sampling and encoders; and the limit between the two, simulated.

The paper does not print the trajectory; here the joint swings about −0.5 rad, where its figure shows it, fast enough to leave stiction.
"""

import math
from dataclasses import dataclass

from ..simulation import Chirp, Response, Scenario, Start, Vibration, simulate, vibration
from ..simulation.onset import Onset, find_onset, linear_vibration
from ..stability import rightmost_roots
from .joints import SAMPLE_TIME, TESTBED_KP
from .virtual import BUS_DELAY, MOTOR_RESOLUTION, loop_of_testbed, virtual_testbed

DURATION = 4.0  # [s] the figure shows 2.8 to 3.5 s
CENTRE, SWING, RATE = -0.5, 0.5, math.pi  # [rad], [rad], [rad/s]
LAST = 1.0  # [s] that are searched for a vibration


@dataclass(frozen=True)
class Trial:
    """One run of the figure.

    kv          [N m s/rad]
    response    the run
    vibration   of the gearbox's twist in the last second; None where there is none
    predicted   frequency [rad/s] and growth [1/s] of the sampled linear loop's rightmost root
    """

    kv: float
    response: Response
    vibration: Vibration | None
    predicted: tuple[float, float]

    @property
    def vibrates(self) -> bool:
        """A vibration that anyone would notice: over ten steps of the encoder, and not dying away."""
        found = self.vibration
        return found is not None and found.amplitude > 10 * MOTOR_RESOLUTION and found.growth_rate > -1.0


def trial(kv: float) -> Trial:
    """The joint swings under Kp 1600 and `kv` [N m s/rad]."""
    loop = loop_of_testbed(TESTBED_KP, kv)
    reference = Chirp(SWING, RATE, RATE, DURATION, base=CENTRE)
    start = Start(CENTRE, CENTRE, SWING * RATE, SWING * RATE)
    response = simulate(virtual_testbed(loop), Scenario(reference, DURATION, start=start))
    last = round(LAST / SAMPLE_TIME)
    twist = response.motor_position[-last:] - response.link_position[-last:]
    root = rightmost_roots(loop).roots[0]
    return Trial(kv, response, vibration(twist, SAMPLE_TIME), (float(abs(root.imag)), float(root.real)))


def simulated_limit(delay: float = BUS_DELAY) -> Onset:
    """The Kv at which the linear loop begins to vibrate at Kp 1600, by stepping it; `delay` [s] in the drive."""
    return find_onset(lambda kv: linear_vibration(loop_of_testbed(TESTBED_KP, kv, delay)), 40.0, 130.0)
