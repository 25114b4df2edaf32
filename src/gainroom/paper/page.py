"""The reproduction as a page: the answer, the pictures in the paper's form, and every number beside the paper's."""

import datetime
from html import escape

from .. import __version__
from ..report.number_format import digits
from ..report.page import Card, Html, Lead, Section, block, facts, figure, page, table
from . import Picture, Reproduction, joints, table1
from .drawing import drawing
from .row import Row, split

TITLES = {
    "fig4": "Fig. 4: elasticity",
    "fig5": "Fig. 5: load inertia",
    "fig6": "Fig. 6: the delay in a log of torque steps, simulated",
    "fig7": "Fig. 7: delay",
    "fig9": "Fig. 9: the open loop with PD control",
    "eq4": "Eq. (4): reference, noise and disturbance",
    "testbed": "Testbed: how large the gains can be",
    "fig11": "Fig. 11: the two trials, simulated",
    "fig12": "Fig. 12: the centre of mass under PD, in MuJoCo",
    "fig14": "Fig. 14: the centre of mass under P/PI, in MuJoCo",
    "eq10": "Eqs. (5) to (10): gains between joints and operational space",
    "table1": "Table I: joint gains of centre-of-mass control",
    "claim2": "Claim 2: the motor's inertia decides",
    "claim3": "Claim 3: a large load cannot track",
    "claim4": "Claim 4: limits in operational space",
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
        _lead(result),
        _cards(result.rows),
        [
            _section(figures[0], result),
            _claims(result.rows),
            *(_section(name, result) for name in figures[1:]),
            _assumptions(result, command),
        ],
        (SOURCE, f"gainroom {__version__}, {datetime.date.today():%d %B %Y}."),
    )


def figure_of(row: Row) -> str:
    """The figure that a row belongs to."""
    return row.id.partition(".")[0]


def _lead(result: Reproduction) -> Lead:
    printed, further = split(result.rows)
    agree, hold = (sum(row.agrees for row in rows) for rows in (printed, further))
    numbers = f"all {len(printed)}" if agree == len(printed) else f"{agree} of {len(printed)}"
    sentence = f"With the inputs that it does not print inferred, {numbers} numbers of the paper come out"
    missed = {TITLES.get(figure_of(row), figure_of(row)).partition(":")[0] for row in printed if not row.agrees}
    if missed:
        sentence += f" (the others: {', '.join(sorted(missed))})"
    checks = f"all {len(further)}" if hold == len(further) else f"{hold} of {len(further)}"
    return Lead(f"{sentence}; {checks} further checks hold.", "good" if agree == len(printed) else "warn", warnings=result.warnings)


def _cards(rows: tuple[Row, ...]) -> list[Card]:
    """The numbers that the paper is known for."""
    named = {row.id: row for row in rows}
    wanted = (
        ("Fig. 9, gain margin with elasticity and delay", "fig9.both.gain_margin_db"),
        ("Fig. 9, it would vibrate at", "fig9.both.phase_crossover_rad_s"),
        ("Testbed, it would vibrate at", "testbed.phase_crossover_rad_s"),
        ("Testbed, largest Kv at Kp 1600, 2 kHz", "testbed.sampled.kv_limit"),
        ("Table I, typically off by a factor of", "table1.leaning_pelvis.typical_factor"),
    )
    return [
        Card(
            label,
            _value(row.computed),
            row.unit,
            f"the paper: {row.printed}" if row.printed else "24 gains, posture inferred",
            None if row.agrees else False,
        )
        for label, row in ((label, named[name]) for label, name in wanted if name in named)
    ]


def _section(name: str, result: Reproduction) -> Section:
    rows = [row for row in result.rows if figure_of(row) == name]
    pictures = [picture for picture in result.pictures if picture.id == name]
    parts: list[str] = [_figure(picture) for picture in pictures]
    parts.append(
        table(
            ("Quantity", "Paper", "Computed", "Difference", "Unit", "Agrees"),
            [_cells(row) for row in rows],
            "" if all(row.printed for row in rows) else "In brackets: not printed in the paper; the note says what it is.",
            {"yes": "met", "no": "unmet"},
        )
    )
    return Section(TITLES.get(name, name), parts)


def _figure(picture: Picture) -> Html:
    drawn, height = drawing(picture)
    return figure(drawn, picture.title, picture.caption, height, {"margin.r": 8})


def _cells(row: Row) -> tuple[str, ...]:
    name = Html(f'{escape(row.id)}<div style="max-width: 62ch; color: var(--soft); font-size: 13px">{escape(row.note)}</div>')
    paper = row.printed or f"({'≥ ' if row.is_least else ''}{_value(row.paper)})"
    difference = "–" if row.difference is None else _difference(row.difference)
    if row.agrees and (row.is_range or row.is_least):
        difference = "inside" if row.is_range else "above"
    return name, paper, _value(row.computed), difference, row.unit or "–", "yes" if row.agrees else "no"


def _value(value: float | bool) -> str:
    if isinstance(value, bool):
        return "stable" if value else "vibrates"
    return "0" if abs(value) < 1e-9 else digits(value)


def _difference(value: float) -> str:
    if abs(value) < 1e-9:
        return "0"
    return ("+" if value > 0 else "") + digits(float(f"{value:.2g}"))


def _claims(rows: tuple[Row, ...]) -> Section:
    """The paper's conclusions that a number here confirms or corrects."""
    notes = sorted(row.note for row in rows if row.is_claim)
    return Section(
        "What the paper concludes, checked",
        [facts([(name, text[0].upper() + text[1:]) for name, _, text in (note.partition(": ") for note in notes)])],
    )


def _assumptions(result: Reproduction, command: str) -> Section:
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
            "The paper's model is continuous, and so are all rows here except those of testbed.sampled. Those hold the torque between "
            "ticks of 0.5 ms and difference the position backwards, as the hardware does; in the continuous model these two half ticks "
            "are part of the delay.",
        ),
        (
            "Figs. 6 and 11",
            "Run on a virtual testbed at 2 kHz. Printed: the link of 0.6 m and 3.9 kg, the 4 to 6 ticks, the gains. Assumed: Coulomb "
            "friction of 1 N m on the motor and 0.2 N m on the link, half as much again to break loose, encoders, a torque limit of "
            "150 N m, the swing.",
        ),
        (
            "How it was computed",
            "The delay is exact everywhere, never a Padé approximation. Every crossing is certified (nothing between two evaluated "
            "frequencies can be missed) and polished to machine precision. Resonances are searched on the exact response.",
        ),
    ]
    if not result.warnings:
        pairs[3:3] = _robot_assumptions()
    return Section("Inputs, assumptions, and how it was computed", [facts(pairs), block(command)])


def _robot_assumptions() -> list[tuple[str, str]]:
    lean, start = table1.LEAN, table1.START
    return [
        (
            "The biped",
            "Dimensions, masses and centres of mass as published for the paper's robot; the shapes of the links, and soles 0.1 m below "
            "the ankles, are assumed. Every joint with the motor, gearbox and drive of Fig. 9 (inferred). Claims 2 to 4: knees at 0.6 "
            "rad, pelvis level, feet flat and rigid on the ground, both or the left one; the controller's model counts the rotors.",
        ),
        (
            "Table I",
            "Printed: the task's gains, and a motion of 6 cm in x, y and z at once. Assumed: the centre of mass alone, in the world's "
            "axes; both feet flat and rigid, straight ahead under the hips; y to the left; the largest diagonal entry of Kpq and Kvq "
            f"along the motion. Inferred, by matching the table: a start {-start[0]:g} m behind the ankles and {start[2]:g} m above the "
            "soles (the paper's 0.83 m must have another origin: with the soles here the legs could not rise 6 cm from it), a pelvis that "
            f"leans back {-lean.pitch:g} rad, and rotors in the controller's model; {table1.why_a_quarter()}.",
        ),
    ]
