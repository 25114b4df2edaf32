"""Fig. 5: Bode plot over load ratio; and the claim that the load does not matter to the gain margin."""

import math
from collections.abc import Iterator
from dataclasses import replace

from ..analysis.margins import margins
from ..system.controller import PD
from ..system.loop import build_loop
from ..system.margin_units import to_db
from .joints import DRIVE, GAINS, LOAD_RATIOS, MOTOR_INERTIA, joint_with_load, torque_to_position
from .picture import AXIS, Picture, bode, decibels
from .row import Row, compare

VISIBLE = 0.05  # [dB] less than a line's width on the figure's axis of 400 dB
SLOW_DELAY, SLOW_GAINS = 10e-3, PD(kp=100.0, kd=10.0)  # where the claim ends


def rows() -> Iterator[Row]:
    """The ends of the figure's axis as the inertias give them; the spread of the gain margin over the three loads (Sec. II-A)."""
    for ratio in LOAD_RATIOS:
        loop = torque_to_position(joint_with_load(ratio))
        for end, omega, inertia, text in (
            ("low", AXIS[0], MOTOR_INERTIA * (1 + ratio), "J_M + J_L"),
            ("high", AXIS[1], MOTOR_INERTIA, "J_M alone"),
        ):
            expected = -20 * math.log10(inertia * omega**2)
            key = f"fig5.ratio_{ratio:g}".replace("0.", "0_") + f".{end}_frequency_magnitude_db"
            note = f"The paper prints no number: 1/(J ω²) at {omega:g} rad/s, J = {text} = {inertia:g} kg·m², to less than a line's width."
            yield compare(key, expected, decibels(loop, omega), "dB", VISIBLE, note)
    spread, slow = _spread(DRIVE.delay, GAINS), _spread(SLOW_DELAY, SLOW_GAINS)
    note = (
        f"The gain margin does not depend on the load (claim 2): with Fig. 9's drive and gains it varies by {spread:.2f} dB over the three "
        f"ratios. It holds only while the phase crossover lies well above the resonance: with {1e3 * SLOW_DELAY:g} ms of delay "
        f"(kp {SLOW_GAINS.kp:g}, kd {SLOW_GAINS.kd:g}) it varies by {slow:.1f} dB. Tolerance: a tenth of the factor 2 usually required."
    )
    yield compare("fig5.gain_margin_spread_db", 0.0, spread, "dB", 0.6, note)


def pictures() -> Iterator[Picture]:
    """The figure."""
    loops = {f"motor : load = 1 : {ratio:g}": torque_to_position(joint_with_load(ratio)) for ratio in LOAD_RATIOS}
    apart = 20 * math.log10((1 + LOAD_RATIOS[-1]) / (1 + LOAD_RATIOS[0]))
    caption = (
        f"At low frequency the loads lie {apart:.3g} dB apart (J_M + J_L); at high frequency all three meet, because there only the motor "
        "moves (J_M). Gains are limited at high frequency, so a heavier load needs higher gains and may not have them."
    )
    title = "Fig. 5. Load inertia decides the low frequencies, motor inertia the high ones"
    yield bode(title, caption, loops, (-200, 200), (-190, 10))


def _spread(delay: float, gains: PD) -> float:
    """Largest minus smallest gain margin [dB] over the figure's load ratios."""
    drive = replace(DRIVE, delay=delay)
    sizes = [to_db(margins(build_loop(joint_with_load(ratio), drive, gains)).gain_margin) for ratio in LOAD_RATIOS]
    return max(sizes) - min(sizes)
