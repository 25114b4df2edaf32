"""The tables of a joint, and its inputs as text."""

import math
from dataclasses import dataclass

from ..analysis.margin_record import Margins
from ..studies.joint import JointStudy
from ..system.margin_units import to_db
from ..system.requirements import REQUIREMENTS
from ..system.system import System
from .bode import Case
from .columns import Column, yes
from .joint_text import RULE, rise_text, uncertainty_cost_text
from .margin_columns import bounded_columns, compared_rows
from .number_format import digits, frequency, own_gains
from .page import Html, facts, table
from .page_parts import filters, uncertainty_text


@dataclass(frozen=True)
class Gains:
    """Gains on a controller's kp–kd plane under a name, with the margins that they leave; None for the largest, which leave none."""

    name: str
    kp: float | None
    kd: float | None
    margins: Margins | None = None


def gains_beside(study: JointStudy) -> list[Gains]:
    """The file's, the recommended ones, and the 10 Hz rule's."""
    controller, best, rule = study.system.control.controller, study.recommended, study.rule
    kp, kd = controller.plane_gains() if controller.has_plane else (None, None)
    found = [Gains("this file's", kp, kd, study.margins)]
    if best is not None:
        shown = {"recommended": best.nominal}
        if study.system.uncertainty.names:
            shown = {"recommended (worst case)": best.worst, "recommended (nominal)": best.nominal}
        found += [Gains(name, best.kp, best.kd, margins) for name, margins in shown.items()]
    return [*found, Gains("10 Hz rule" if controller.kind == "PD" else "10 Hz rule (plain PD)", rule.kp, rule.kd, rule.margins)]


def largest_gains(study: JointStudy) -> list[Gains]:
    """The largest kd at the file's kp, and the largest kp with the kd that is stable there."""
    (kp_name, kd_name), (own, *_) = study.template.plane_names, gains_beside(study)
    return [
        Gains(f"largest {kd_name} at this {kp_name}", own.kp, study.max_kd),
        Gains(f"largest {kp_name} of all", study.max_kp, study.kd_at_max_kp),
    ]


def plane_columns(study: JointStudy) -> list[Column]:
    """The two gains of the plane, under the names that its controller gives them; the unit is the heading's."""
    kp_name, kd_name = study.template.plane_names
    return [
        Column(kp_name, "kp", lambda row: row.kp, "N·m/rad", shown=lambda row: digits(row.kp)),
        Column(kd_name, "kd", lambda row: row.kd, "N·m·s/rad", shown=lambda row: digits(row.kd)),
    ]


def gain_columns(study: JointStudy) -> list[Column]:
    """Of Gains: name, gains, and the margins that are required, or usually are."""
    asked = study.system.requirements.asked

    def margin(column: Column, verdict: str) -> Column:
        def shown(row: Gains) -> str:
            return "" if row.margins is None else column.text(row.margins) if row.margins.stable else verdict

        return Column(REQUIREMENTS[column.requirement].heading, "", lambda row: row.margins, shown=shown)

    first, *others = (one for one in bounded_columns() if one.requirement in asked or REQUIREMENTS[one.requirement].usual)
    margins = [margin(first, "unstable"), *(margin(column, "") for column in others)]
    return [Column("", "", lambda row: row.name), *plane_columns(study), *margins]


def margin_table(study: JointStudy) -> Html:
    """All margins of the file's gains beside the recommended ones and the 10 Hz rule's."""
    gains = gains_beside(study)
    found = [one.margins for one in gains if one.margins is not None]
    rows = [
        *((f"{column.title} [{column.unit}]", *map(column.text, gains)) for column in plane_columns(study)),
        ("stable", *("yes" if one.stable else "unstable" for one in found)),
        *compared_rows(found),
    ]
    caption = f"{RULE} Margins of an unstable loop are meaningless."
    if study.recommended is not None and study.system.uncertainty.names:
        caption += " Worst case: the least of each margin over the cases examined, which may differ from margin to margin."
    return table(["", *(one.name for one in gains)], rows, caption, sorts=False)


def uncertainty_table(study: JointStudy) -> Html:
    """Recommended gains with what is known, with each uncertain quantity known exactly, and with all of them."""
    found = study.uncertainty_cost
    assert found is not None
    plane, (kp_name, _) = plane_columns(study), study.template.plane_names
    sets = [
        ("as uncertain as it is", study.recommended, ""),
        *((f"{one.name.replace('_', ' ')} known exactly", one, rise_text(study, one)) for one in found.known),
        ("everything known exactly", found.exact, ""),
    ]
    rows = [
        (name, "–", "–", rise, "") if one is None else (name, *(column.text(one) for column in plane), rise, yes(one.proved))
        for name, one, rise in sets
    ]
    headings = ("Recommended gains", *(f"{column.title} [{column.unit}]" for column in plane), f"change of {kp_name}", "proved")
    return table(headings, rows, uncertainty_cost_text(study, ranked=True), sorts=False)


def crossing_table(found: Margins) -> Html:
    """Every crossing of the file's loop, by frequency."""
    rows = [
        (c.omega, ("phase", digits(c.omega), digits(c.omega / (2 * math.pi)), digits(to_db(c.gain), "dB"), "–", "–"))
        for c in found.phase_crossings
    ]
    for c in found.gain_crossings:
        cells = (
            digits(c.omega),
            digits(c.omega / (2 * math.pi)),
            "–",
            digits(math.degrees(c.phase_margin), "°"),
            digits(1e3 * c.delay_margin, "ms"),
        )
        rows.append((c.omega, ("gain", *cells)))
    headers = ["crossing", "ω [rad/s]", "f [Hz]", "gain to −1", "phase to −1", "extra delay to −1"]
    caption = "Phase crossings: L is real and negative. Gain crossings: |L| = 1. The last columns: the change that moves L to −1 there."
    return table(headers, [row for _, row in sorted(rows)], caption)


def case_table(shown: list[Case]) -> Html:
    """The four cases of the Bode picture in numbers."""
    rows = [
        (
            case.name,
            digits(to_db(case.margins.gain_margin), "dB") if case.margins.stable else "unstable",
            frequency(case.margins.phase_crossover),
            digits(math.degrees(case.margins.phase_margin), "°"),
            digits(1e3 * case.margins.delay_margin, "ms"),
        )
        for case in shown
    ]
    return table(["case", "gain margin", "vibration at", "phase margin", "delay margin"], rows)


def inputs(study: JointStudy) -> Html:
    """The joint, the drive, the controller and what is required, as used on the page."""
    system = study.system
    pairs = [
        *machine(system),
        ("controller", _controller(system)),
        ("time", _time(system)),
        ("required", str(system.requirements)),
        ("uncertainty", uncertainty_text(system)),
    ]
    return facts(pairs)


def machine(system: System) -> list[tuple[str, str]]:
    """The joint and its drive."""
    joint, drive = system.source, system.drives[0]
    elastic = math.isfinite(joint.stiffness)
    ideal = "ideal" if drive.is_ideal else f"bandwidth ω_c {digits(drive.bandwidth, 'rad/s')}, ζ {digits(drive.damping_ratio)}"
    return [
        ("motor inertia, joint side", digits(joint.motor_inertia, "kg·m²")),
        ("link inertia", digits(joint.link_inertia, "kg·m²")),
        ("gearbox stiffness", digits(joint.stiffness, "N·m/rad") if elastic else "rigid"),
        ("gearbox damping", digits(joint.damping, "N·m·s/rad")),
        ("viscous friction, motor and link", f"{digits(joint.motor_viscous)} and {digits(joint.link_viscous, 'N·m·s/rad')}"),
        ("anti-resonance, resonance", f"{frequency(joint.antiresonance)}, {frequency(joint.resonance)}" if elastic else "none"),
        ("current loop", ideal),
        ("delay, target to demand torque", _delay(system)),
        ("encoder", f"{system.control.feedback} side of the gearbox"),
    ]


def _delay(system: System) -> str:
    text = digits(1e3 * system.delay, "ms")
    return text if system.control.sample_time is None else f"{text} = {digits(system.delay / system.control.sample_time)} ticks"


def _controller(system: System) -> str:
    controller = system.control.controller
    gains = ", ".join(f"{name} {digits(value, unit)}" for name, value, unit in own_gains(controller))
    return f"{type(controller).__name__}: {gains}; {filters(controller)}"


def _time(system: System) -> str:
    sample_time = system.control.sample_time
    if sample_time is None:
        return "continuous: no sampling, no hold, the velocity is known exactly; the delay is exact"
    return (
        f"sampled at {digits(1 / sample_time, 'Hz')}: torque held between ticks, velocity by difference, plant and delay discretised "
        "exactly; responses at the sample instants"
    )
