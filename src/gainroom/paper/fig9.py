"""Fig. 9: the open loop with PD control in four cases, and the claim that delay and elasticity together do the damage."""

from dataclasses import replace

from ..analysis.margins import Margins, from_db, margins, to_db
from ..system.loop import Loop, build_loop
from .joints import DRIVE, GAINS, joint_with_load, rigid
from .picture import BodePicture, Mark, bode_curve
from .row import Row, compare

RATIO = 16.0  # inferred
CASES = {  # case: label, elastic, delayed, printed gain margin [dB] with half its last digit, printed phase crossover [rad/s]
    "both": ("elasticity and delay", True, True, "6.2", 0.05, 620.0),
    "elasticity": ("elasticity only", True, False, "27.5", 0.05, 3970.0),
    "delay": ("delay only", False, True, "31", 0.5, 619.0),
    "neither": ("neither", False, False, "52.1", 0.05, 3970.0),
}
PRINTED_ORDER = ("neither", "elasticity", "delay", "both")


def rows() -> list[Row]:
    """Gain margin and phase crossover of the four cases; what elasticity and delay cost together."""
    result = []
    found = {case: margins(_loop(case)) for case in PRINTED_ORDER}
    for case in PRINTED_ORDER:
        _, _, _, printed, half_digit, printed_crossover = CASES[case]
        note = "Joint, drive and gains inferred from the four cases together."
        decibels, crossover = to_db(found[case].gain_margin), found[case].phase_crossover
        result.append(compare(f"fig9.{case}.gain_margin_db", float(printed), decibels, "dB", half_digit, note, printed))
        at = "Tolerance 1 rad/s: the two cases printed as 3970 differ by 0.9." if printed_crossover > 1000 else "Half a rad/s, as printed."
        tolerance = 1.0 if printed_crossover > 1000 else 0.5
        result.append(
            compare(f"fig9.{case}.phase_crossover_rad_s", printed_crossover, crossover, "rad/s", tolerance, at, f"{printed_crossover:g}")
        )
    return [*result, _claim(found)]


def pictures() -> list[BodePicture]:
    """The figure."""
    curves, marks, room = [], [], {}
    for place, (case, (label, elastic, *_)) in enumerate(CASES.items()):
        loop = _loop(case)
        found = margins(loop)
        curves.append(bode_curve(label, loop))
        room[case] = to_db(found.gain_margin)
        text = f"{room[case]:.1f} dB<br>{found.phase_crossover:.0f} rad/s"
        marks.append(Mark(place, found.phase_crossover, -room[case], text, stem=True, above=elastic))
    start = room["neither"]
    lost = {case: start - margin for case, margin in room.items()}
    early, late = (marks[list(CASES).index(case)].omega for case in ("delay", "neither"))
    caption = (
        f"Of {start:.1f} dB of room, elasticity alone takes {lost['elasticity']:.1f} dB (at high frequency the motor no longer carries "
        f"its load) and delay alone {lost['delay']:.1f} dB (the phase reaches −180° at {early:.0f} instead of {late:.0f} rad/s). Together "
        f"they take {lost['both']:.1f} dB, hardly more than the sum. What is left, {room['both']:.1f} dB, is a factor of "
        f"{from_db(room['both']):.2g} on the gains."
    )
    title = f"Fig. 9. The open loop with PD: elasticity and delay together leave {room['both']:.0f} of {start:.0f} dB"
    return [BodePicture("fig9", title, caption, tuple(curves), tuple(marks), (-100, 50), (-900, 180))]


def _loop(case: str) -> Loop:
    _, elastic, delayed, *_ = CASES[case]
    joint = joint_with_load(RATIO)
    drive = DRIVE if delayed else replace(DRIVE, delay=0.0)
    return build_loop(joint if elastic else rigid(joint), drive, GAINS)


def _claim(found: dict[str, Margins]) -> Row:
    """Sec. III-A and V: the margin falls far more when both meet; delay "amplifies" the effect of elasticity."""
    start = to_db(found["neither"].gain_margin)
    lost = {case: start - to_db(found[case].gain_margin) for case in ("elasticity", "delay", "both")}
    together = lost["elasticity"] + lost["delay"]
    note = (
        f"Claim 1: far less margin is left with both than with either. True: elasticity alone costs {lost['elasticity']:.2f} dB, delay "
        f"alone {lost['delay']:.2f} dB. But one hardly amplifies the other: the sum of the two is {together:.2f} dB, only "
        f"{lost['both'] - together:.2f} dB short of what both cost; the factors multiply. Paper: 52.1 − 6.2, two rounded numbers."
    )
    return compare("fig9.both.gain_margin_loss_db", 52.1 - 6.2, lost["both"], "dB", 0.1, note, "52.1 − 6.2")
