"""Page of the reproduction: the answer, the pictures in the paper's form, and every number beside the paper's."""

from collections.abc import Sequence
from html import escape

from ..report.number_format import hertz
from ..report.page import Card, Html, Lead, Section, details, facts, page, table
from . import Reproduced, Reproduction, joints
from .drawing import drawn
from .row import BRACKETS, COLUMNS, Row, cells, claims, counts, interval, summary, value_text

FIRST = "Fig. 9"  # the section that comes first
SOURCE = (
    "Jung, Hwang, Lee, Sim, Park: Analysis of Position Tracking in Torque Control of Humanoid Robots Considering Joint Elasticity and "
    "Time Delay. Humanoids 2017."
)
CARDS = {  # the paper's main numbers
    "fig9.both.gain_margin_db": "Fig. 9, gain margin with elasticity and delay",
    "fig9.both.phase_crossover_rad_s": "Fig. 9, frequency of the vibration",
    "testbed.phase_crossover_rad_s": "Testbed, frequency of the vibration",
    "testbed.sampled.kv_limit": "Testbed, largest Kv at Kp 1600, 2 kHz",
    "table1.leaning_pelvis.typical_factor": "Table I, typically off by a factor of",
}


def reproduction_page(result: Reproduction, command: str) -> str:
    """HTML page of the reproduction, self-contained. `command` is the command that makes it."""
    first, *others = sorted(result.figures, key=lambda figure: not figure.title.startswith(FIRST))
    apart = [row for row in result.rows if not row.agrees]
    return page(
        "Jung et al., Humanoids 2017, reproduced",
        _lead(result),
        [_card(CARDS[row.id], row) for row in result.rows if row.id in CARDS],
        [
            Section(first.title, [*map(drawn, first.pictures), details(_agreeing(first), _table(first.rows))]),
            Section("What the paper concludes, checked", [facts(claims(result.rows))]),
            Section("What disagrees, and why", [_table(apart)], f"{len(apart)} of {len(result.rows)} numbers") if apart else None,
            *(Section(figure.title, [*map(drawn, figure.pictures), _table(figure.rows)], _agreeing(figure)) for figure in others),
            Section("Inputs and assumptions", [_inputs()], "and whether the paper prints them"),
        ],
        command,
        [SOURCE],
    )


def _lead(result: Reproduction) -> Lead:
    apart = [figure.title.partition(":")[0] for figure in result.figures if any(row.printed and not row.agrees for row in figure.rows)]
    missed = f" Numbers disagree in {', '.join(apart)}." if apart else ""
    sentence = f"{summary(result.rows)}{missed} Inputs that the paper does not print are inferred."
    return Lead(sentence, "warn" if apart else "good", warnings=result.warnings)


def _card(label: str, row: Row) -> Card:
    paper = f"the paper: {row.printed}" if row.printed else "24 gains, posture inferred"
    paper += f"; {hertz(float(row.computed))}" if row.unit == "rad/s" else ""
    return Card(label, value_text(row.computed), row.unit, paper, None if row.agrees else False)


def _agreeing(figure: Reproduced) -> str:
    return f"{sum(row.agrees for row in figure.rows)} of {len(figure.rows)} numbers agree"


def _table(rows: Sequence[Row]) -> Html:
    caption = "" if counts(rows)[1] == len(rows) else BRACKETS
    return table(COLUMNS, [(_named(row), *cells(row)[1:]) for row in rows], caption)


def _named(row: Row) -> Html:
    said = ". ".join(filter(None, (interval(row), row.note)))
    return Html(f'{escape(row.id)}<div style="max-width: 62ch; color: var(--soft); font-size: 13px">{escape(said)}</div>')


def _inputs() -> Html:
    """Inputs of the reproduction, each with its origin in the paper or by inference."""
    joint, drive, gains, testbed = joints.joint_with_load(joints.RATIO), joints.DRIVE, joints.GAINS, joints.TESTBED
    matching = "inferred from Fig. 9's four cases"
    rows = (
        ("Figs. 4, 5, 7, 9: stiffness, damping", f"{joint.stiffness:g} N·m/rad, {joint.damping:g} N·m·s/rad", "printed"),
        ("Figs. 4, 5, 7, 9: motor inertia", f"{joint.motor_inertia:g} kg·m²", f"{matching}; printed is the rotor's 1.0e-4, before 100:1"),
        ("Figs. 4, 7, 9: load over motor inertia", f"{joints.RATIO:g}", f"{matching}; the largest of Fig. 5"),
        ("Fig. 9: current loop, delay", f"{drive.bandwidth:g} rad/s, ζ {drive.damping_ratio:g}, {1e3 * drive.delay:g} ms", matching),
        ("Fig. 9: gains", f"{gains.kp:g} N·m/rad, {gains.kd:g} N·m·s/rad", f"{matching}; Sec. IV-C names them"),
        ("Testbed: inertias", f"{testbed.motor_inertia:g}, {testbed.link_inertia:g} kg·m²", "printed, behind 100:1"),
        ("Testbed: delay", f"{1e3 * joints.TESTBED_DRIVE.delay:.4g} ms", "inferred; printed are 4 to 6 ticks of 0.5 ms"),
        ("testbed.sampled: torque held, velocity by backward difference", "2 kHz", "printed; a tick of the continuous model's delay"),
        ("Figs. 6, 11: link", "0.6 m, 3.9 kg", "printed"),
        ("Figs. 6, 11: friction of motor and link, torque limit", "1 and 0.2 N·m, 150 N·m", "assumed, with encoders and the swing"),
        ("fig6.identified, testbed.locked: noise of the torque", "0.05 N·m", "assumed; loaded with 30 N·m at 0.2 Hz"),
        ("Biped: dimensions, masses", "as published", "shapes of the links, and soles 0.1 m below the ankles, assumed"),
        ("Biped: motor, gearbox, drive of every joint", "as in Fig. 9", "inferred"),
        ("Claims 2 to 4: posture", "knees 0.6 rad, pelvis level, feet flat and rigid", "assumed"),
        ("Table I: gains of the task, motion", "6 cm in x, y and z", "printed"),
        ("Table I: task, axes", "centre of mass alone, the world's", "assumed; y to the left, feet under the hips"),
        ("Table I: lean, start, rotors counted", "see table1.leaning_pelvis", "inferred by matching the table"),
    )
    note = "The delay is exact, never a Padé approximation; every crossing is certified and polished to machine precision."
    return table(("Input", "Value", "Source"), rows, note)
