"""Claim 2: high-frequency magnitude and gain margin depend on the motor's inertia only, load inertia matters little (Sec. II-A).

Gain margins as gain limits: the factor on Fig. 9's gains at the edge of stability, which exists where those gains are unstable, too.
"""

import math
from collections.abc import Iterator
from functools import cache

import numpy as np

from ..system.linear.arrays import Floats
from ..system.margin_units import to_db
from .biped import NAMES, SUPPORTS, free_loads
from .joints import DRIVE, MOTOR_INERTIA, joint_with_load, limit_with_load
from .picture import Curve, Panel, Picture
from .row import Row, compare

RATIOS = np.unique(np.concatenate([np.geomspace(1e-3, 1e3, 25), np.geomspace(1e-2, 1.0, 61)]))  # denser where loads are light
HEAVY, LIGHT = (0.1, 100.0), (0.01, 0.1)  # load over motor: Fig. 5 starts at 0.1; a swinging foot has 0.02 to 0.1
DELAYS = (2e-3, 3e-3, 5e-3)  # [s] the paper's range and beyond
TOLERANCE = 0.6  # [dB] a tenth of the factor 2 usually required


def rows() -> Iterator[Row]:
    """The spread of the gain limit over the load: heavy as the delay grows, and light."""
    for delay in DELAYS:
        spread = _spread(delay, HEAVY)
        note = _claim() if delay == DRIVE.delay else _note(delay, spread)
        yield compare(f"claim2.heavy_load_{1e3 * delay:g}_ms.gain_limit_spread_db", 0.0, spread, "dB", TOLERANCE, note)
    note = (
        f"Corrected: loads of {LIGHT[0]:g} to {LIGHT[1]:g} times the motor move the gain limit at T = {1e3 * DRIVE.delay:g} ms, as their "
        "resonance meets the frequency at which the joint would vibrate."
    )
    yield compare("claim2.light_load.gain_limit_spread_db", 0.0, _spread(DRIVE.delay, LIGHT), "dB", TOLERANCE, note)


def biped_rows() -> Iterator[Row]:
    """Rows for equal gains on every joint of the biped by itself, with its own load: the spread over the twelve joints."""
    for contact, support in SUPPORTS.items():
        loads = free_loads(contact)
        found = [to_db(limit_with_load(load).gain) for load in loads.tolist()]
        spread = max(found) - min(found)
        worst = NAMES[int(np.argmin(found))].replace("_", " ")
        verdict = "Confirmed" if spread <= TOLERANCE else f"Corrected: least on the {worst}, in the leg that swings"
        note = (
            f"{verdict}. Fig. 9's gains on every joint alone, neighbours free, in {support}: loads of {loads.min():.2g} to "
            f"{loads.max():.3g} kg·m², limits of {min(found):.2f} to {max(found):.2f} dB."
        )
        yield compare(f"claim2.biped_{contact}.gain_limit_spread_db", 0.0, spread, "dB", TOLERANCE, note)


def pictures() -> Iterator[Picture]:
    """The gain limit over the load ratio, against that of the heaviest load."""
    curves = tuple(Curve(f"T = {1e3 * delay:g} ms", RATIOS, change(delay)) for delay in DELAYS)
    caption = (
        "Flat to the right: the motor alone sets the limit of heavy loads. The load matters where the resonance √(K (1/J_M + 1/J_L)) comes "
        f"near the frequency of vibration. Grey: within {TOLERANCE:g} dB. Less damping than the printed B of 1 makes the dips deeper."
    )
    title = "Claim 2. The gain limit hardly depends on the load while the joint's resonance lies well below its vibration frequency"
    panel = Panel("gain limit against heaviest load [dB]", (-5.5, 3.5), curves, band=(-TOLERANCE, TOLERANCE))
    yield Picture(title, caption, "load inertia / motor inertia", (1e-3, 1e3), (panel,), logarithmic=True)


@cache
def limits(delay: float) -> tuple[Floats, Floats]:
    """Gain limits over RATIOS, as factors on Fig. 9's gains, and the frequency of the vibration there [rad/s]."""
    found = [limit_with_load(ratio * MOTOR_INERTIA, delay=delay) for ratio in RATIOS.tolist()]
    return np.array([limit.gain for limit in found]), np.array([limit.frequency for limit in found])


def change(delay: float) -> Floats:
    """Gain limit over RATIOS relative to that of the heaviest load [dB]."""
    gains = limits(delay)[0]
    return 20 * np.log10(gains / gains[-1])


def _spread(delay: float, loads: tuple[float, float]) -> float:
    """Largest minus smallest gain limit [dB] over a range of load ratios."""
    slack = 1 + 1e-9  # the ends are on the grid but for rounding
    inside = change(delay)[(loads[0] <= RATIOS * slack) & (loads[1] * slack >= RATIOS)]
    return float(np.ptp(inside))


def _ending(delay: float) -> tuple[float, float]:
    """The heaviest load ratio at which the limit is off by more than the tolerance, and resonance over frequency of vibration there."""
    off = np.flatnonzero(np.abs(change(delay)) > TOLERANCE)
    if not len(off):
        return 0.0, math.nan
    ratio = RATIOS[off[-1]]
    joint = joint_with_load(float(ratio))
    return float(ratio), joint.resonance / float(limits(delay)[1][off[-1]])


def _note(delay: float, spread: float) -> str:
    verdict = "Confirmed" if spread <= TOLERANCE else "Corrected: the load matters"
    ending, meets = _ending(delay)
    return (
        f"{verdict}. Loads of {HEAVY[0]:g} to {HEAVY[1]:g} times the motor, T = {1e3 * delay:g} ms. From {ending:.2g} times the motor "
        f"down the load moves the limit by more; there the resonance lies at {meets:.2f} of the frequency at which the joint would "
        "vibrate."
    )


def _claim() -> str:
    meets = min(_ending(delay)[1] for delay in DELAYS)
    return (
        "Claim 2: high-frequency magnitude and gain margin depend on the motor's inertia only (Fig. 5, Sec. II-A). Confirmed for loads "
        f"of {HEAVY[0]:g} to {HEAVY[1]:g} times the motor at the paper's delays: the gain limit varies by "
        f"{_spread(DELAYS[0], HEAVY):.2f} dB at {1e3 * DELAYS[0]:g} ms and {_spread(DELAYS[1], HEAVY):.2f} dB at {1e3 * DELAYS[1]:g} ms. "
        f"Corrected elsewhere: loads of {LIGHT[0]:g} to {LIGHT[1]:g}, as in a swinging foot, move it by {_spread(DELAYS[0], LIGHT):.1f} "
        f"dB, and at {1e3 * DELAYS[2]:g} ms it varies by {_spread(DELAYS[2], HEAVY):.1f} dB. Safe to use while the joint's resonance "
        f"stays below {meets:.2f} of the frequency of vibration."
    )
