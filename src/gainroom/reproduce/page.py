"""The reproduction as a page: the answer, the pictures in the paper's form, and every number beside the paper's."""

import datetime
from html import escape

from .. import __version__
from ..io.numbers import digits
from ..report.page import Card, Html, Lead, Section, block, facts, figure, page, table
from . import Reproduction, joints
from .drawing import drawing
from .row import Row

TITLES = {
    "fig4": "Fig. 4: elasticity",
    "fig5": "Fig. 5: load inertia",
    "fig7": "Fig. 7: delay",
    "fig9": "Fig. 9: the open loop with PD control",
    "testbed": "Testbed: how large the gains can be",
}
FIRST = "fig9"  # what a reader came for
SOURCE = (
    "Jung, Hwang, Lee, Sim, Park: Analysis of Position Tracking in Torque Control of Humanoid Robots Considering Joint Elasticity and "
    "Time Delay. Humanoids 2017."
)


def reproduction_page(result: Reproduction, command: str) -> str:
    """A self-contained HTML page. `command` is what a reader types to get it again."""
    figures = sorted({figure_of(row): None for row in result.rows}, key=lambda name: name != FIRST)
    return page(
        "Jung et al., Humanoids 2017, reproduced",
        _lead(result.rows),
        _cards(result.rows),
        [*(_section(name, result) for name in figures), _claims(result.rows), _assumptions(command)],
        (SOURCE, f"gainroom {__version__}, {datetime.date.today():%d %B %Y}."),
    )


def figure_of(row: Row) -> str:
    """The figure that a row belongs to."""
    return row.id.partition(".")[0]


def _lead(rows: tuple[Row, ...]) -> Lead:
    wrong = [row.id for row in rows if not row.agrees]
    if not wrong:
        printed = sum(bool(row.printed) for row in rows)
        others = len(rows) - printed
        return Lead(
            f"With the inputs that it does not print inferred, all {printed} numbers of the paper come out; {others} further checks hold."
        )
    few = ", ".join(wrong[:4]) + (" and more" if len(wrong) > 4 else "")
    return Lead(f"{len(rows) - len(wrong)} of {len(rows)} numbers agree with the paper; {few} do not.", "warn")


def _cards(rows: tuple[Row, ...]) -> list[Card]:
    """The numbers that the paper is known for."""
    named = {row.id: row for row in rows}
    wanted = (
        ("Fig. 9, gain margin with elasticity and delay", "fig9.both.gain_margin_db"),
        ("Fig. 9, it would vibrate at", "fig9.both.phase_crossover_rad_s"),
        ("Testbed, it would vibrate at", "testbed.phase_crossover_rad_s"),
        ("Testbed, largest Kv at Kp 1600, 2 kHz", "testbed.sampled.kv_limit"),
    )
    return [
        Card(label, _value(row.computed), row.unit, f"the paper: {row.printed}", None if row.agrees else False)
        for label, row in ((label, named[name]) for label, name in wanted)
    ]


def _section(name: str, result: Reproduction) -> Section:
    rows = [row for row in result.rows if figure_of(row) == name]
    pictures = [picture for picture in result.pictures if picture.id == name]
    parts: list[str] = [figure(drawing(picture), picture.title, picture.caption, 620, {"margin.r": 8}) for picture in pictures]
    parts.append(
        table(
            ("Quantity", "Paper", "Computed", "Difference", "Unit", "Agrees"),
            [_cells(row) for row in rows],
            "" if all(row.printed for row in rows) else "In brackets: not printed in the paper; the note says what it is.",
            {"yes": "met", "no": "unmet"},
        )
    )
    return Section(TITLES.get(name, name), parts)


def _cells(row: Row) -> tuple[str, ...]:
    name = Html(f'{escape(row.id)}<div style="max-width: 62ch; color: var(--soft); font-size: 13px">{escape(row.note)}</div>')
    paper = row.printed or f"({_value(row.paper)})"
    difference = "inside" if row.is_range and row.agrees else "–" if row.difference is None else _difference(row.difference)
    return name, paper, _value(row.computed), difference, row.unit or "–", "yes" if row.agrees else "no"


def _value(value: float | bool) -> str:
    if isinstance(value, bool):
        return "stable" if value else "vibrates"
    return "0" if abs(value) < 1e-9 else digits(value)


def _difference(value: float) -> str:
    if abs(value) < 1e-9:
        return "0"
    return ("+" if value > 0 else "") + digits(value, significant=2)


def _claims(rows: tuple[Row, ...]) -> Section:
    """The paper's conclusions that a number here confirms or corrects."""
    return Section("What the paper concludes, checked", [row.note for row in rows if row.note.startswith("Claim:")])


def _assumptions(command: str) -> Section:
    joint, drive, gains = joints.joint_with_load(16.0), joints.DRIVE, joints.GAINS
    testbed, testbed_delay = joints.TESTBED, 1e3 * joints.TESTBED_DRIVE.delay
    stiffness, damping, bandwidth, kp, kd = map(digits, (joint.stiffness, joint.damping, drive.bandwidth, gains.kp, gains.kd))
    pairs = [
        (
            "Joint of Figs. 4, 5, 7, 9",
            f"Printed: K {stiffness} N m/rad, B {damping} N m s/rad, the load ratios of Fig. 5. Inferred: J_M {joint.motor_inertia:g} kg "
            "m² (1.0e-4 is printed, the rotor's, behind 100:1; Fig. 9's margins require it; whether Figs. 4 and 5 use it unreflected "
            "cannot be told), and ratio 16 in Figs. 4, 7 and 9.",
        ),
        (
            "Drive and gains of Fig. 9",
            f"Inferred, by matching all four cases: current loop {bandwidth} rad/s with ζ {drive.damping_ratio:g}, delay "
            f"{1e3 * drive.delay:g} ms, Kp {kp} N m/rad, Kv {kd} N m s/rad.",
        ),
        (
            "Testbed",
            f"Printed: J_M {testbed.motor_inertia:g} (0.2e-4 behind 100:1), J_L {testbed.link_inertia:g} kg m², K. Inferred: B, current "
            f"loop, and the delay of {testbed_delay:g} ms; the paper measures 4 to 6 ticks of 0.5 ms.",
        ),
        (
            "Continuous or sampled",
            "The paper's model is continuous, and so are all rows here except testbed.sampled. Those hold the torque between ticks of "
            "0.5 ms and difference the position backwards, as the hardware does; in the continuous model these two half ticks are part of "
            "the delay.",
        ),
        (
            "How it was computed",
            "The delay is exact everywhere, never a Padé approximation. Every crossing is certified (nothing between two evaluated "
            "frequencies can be missed) and polished to machine precision. Resonances are searched on the exact response.",
        ),
    ]
    return Section("Inputs, assumptions, and how it was computed", [facts(pairs), block(command)])
