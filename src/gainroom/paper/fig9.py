"""Fig. 9: the open loop with PD control in four cases, and the claim that delay and elasticity together do the damage."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

from ..analysis.margin_record import Margins
from ..analysis.margins import margins
from ..system.loop import Loop, build_loop
from ..system.margin_units import from_db, to_db
from .joints import DRIVE, GAINS, RATIO, joint_with_load, rigid
from .picture import Mark, Picture, bode
from .row import Row, compare

CASES = {  # case: label, printed gain margin [dB], half its last digit, printed phase crossover [rad/s]
    "neither": ("neither", "52.1", 0.05, 3970.0),
    "elasticity": ("elasticity only", "27.5", 0.05, 3970.0),
    "delay": ("delay only", "31", 0.5, 619.0),
    "both": ("elasticity and delay", "6.2", 0.05, 620.0),
}


def rows() -> Iterator[Row]:
    """Gain margin and phase crossover of the four cases; what elasticity and delay cost together (Secs. III-A and V)."""
    inferred = "Joint, drive and gains inferred from the four cases together."
    for case, (_, printed, half_digit, crossover) in CASES.items():
        yield compare(f"fig9.{case}.gain_margin_db", float(printed), _gain_margin(case), "dB", half_digit, inferred, printed)
        tolerance, note = 0.5, "Half a rad/s, as printed."
        if crossover > 1000:
            tolerance, note = 1.0, "Tolerance 1 rad/s: the two cases printed as 3970 differ by 0.9."
        key = f"fig9.{case}.phase_crossover_rad_s"
        yield compare(key, crossover, _margins(case).phase_crossover, "rad/s", tolerance, note, f"{crossover:g}")
    lost = {case: _gain_margin("neither") - _gain_margin(case) for case in ("elasticity", "delay", "both")}
    together = lost["elasticity"] + lost["delay"]
    note = (
        f"Claim 1: far less margin is left with both than with either. True: elasticity alone costs {lost['elasticity']:.2f} dB, delay "
        f"alone {lost['delay']:.2f} dB. But one hardly amplifies the other: the sum of the two is {together:.2f} dB, only "
        f"{lost['both'] - together:.2f} dB short of what both cost; the factors multiply. Paper: 52.1 − 6.2, two rounded numbers."
    )
    yield compare("fig9.both.gain_margin_loss_db", 52.1 - 6.2, lost["both"], "dB", 0.1, note, "52.1 − 6.2")


def pictures() -> Iterator[Picture]:
    """The figure."""
    cases = ("both", "elasticity", "delay", "neither")
    marks = tuple(
        Mark(
            _margins(case).phase_crossover,
            -_gain_margin(case),
            f"{_gain_margin(case):.1f} dB<br>{_margins(case).phase_crossover:.0f} rad/s",
            side="right above" if case in ("both", "elasticity") else "left below",
            stem=0.0,
        )
        for case in cases
    )
    caption = (
        "Elasticity frees the motor from its load at high frequency; delay lets the phase reach −180° at "
        f"{_margins('delay').phase_crossover:.0f} instead of {_margins('neither').phase_crossover:.0f} rad/s. With both, "
        f"{_gain_margin('both'):.1f} dB is left: a factor of {from_db(_gain_margin('both')):.2g} on the gains."
    )
    left, whole = _gain_margin("both"), _gain_margin("neither")
    title = f"Fig. 9. The open loop with PD: elasticity and delay together leave {left:.0f} of {whole:.0f} dB"
    yield bode(title, caption, {CASES[case][0]: _loop(case) for case in cases}, (-100, 50), (-900, 180), marks)


@cache
def _margins(case: str) -> Margins:
    return margins(_loop(case))


def _gain_margin(case: str) -> float:
    """Gain margin of one case [dB]."""
    return to_db(_margins(case).gain_margin)


def _loop(case: str) -> Loop:
    joint = joint_with_load(RATIO)
    drive = DRIVE if case in ("delay", "both") else replace(DRIVE, delay=0.0)
    return build_loop(joint if case in ("elasticity", "both") else rigid(joint), drive, GAINS)
