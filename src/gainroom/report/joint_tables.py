"""Presentation of a joint study; its tables, and its inputs as text."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..analysis.margin_record import Margins
from ..studies.joint import JointStudy, NoGainsError
from ..system.controller import type_of
from ..system.margin_units import to_db
from ..system.requirements import REQUIREMENTS, Requirements
from ..system.system import System
from .columns import Column, facts as row_facts, yes
from .gain_advice import ToUse, joint_to_use, verdict_lines
from .joint_text import (
    RULE,
    cause,
    made_largest,
    no_gains,
    notes,
    nothing_limits,
    recommended_text,
    rise_text,
    sentence,
    uncertainty_cost_text,
    warnings,
)
from .margin_columns import bounded_columns, compared_rows, margin_rows, reported_columns, required_facts
from .number_format import digits, frequency, model_facts, model_text, own_gains, typed_gains
from .over_time import motion_facts, motion_text
from .page import Html, facts, table
from .page_parts import filters, uncertainty_text
from .presentation import Part, Presentation, TextTable, closing, folded, warned_first

if TYPE_CHECKING:  # which loads the pictures
    from ..design.joint_gains import Recommendation
    from ..design.uncertainty_cost import UncertaintyCost
    from .bode import BodeLoop


@dataclass(frozen=True)
class JointPresentation(Presentation):
    """Presentation of a joint study."""

    study: JointStudy

    @property
    def to_use(self) -> ToUse:
        """Recommended gains with their heading and margins."""
        return joint_to_use(self.study, self.call)

    def facts(self) -> dict[str, Any]:
        study = self.study
        margins, rule, best, usual = study.margins, study.rule, study.recommended, study.at_usual_rate
        asked = study.system.requirements
        return {
            **study.verdict.facts,
            "stable": margins.stable,
            "stable_in_range": study.stable_in_range,
            "unstable_at": study.unstable_at or None,
            "range_proved": study.range_proved,
            "sentence": sentence(study),
            **model_facts(study.system.control.sample_time),
            "unstable_roots": margins.unstable_roots,
            **_margins(asked, margins),
            "torque_per_count": study.torque_per_count,
            "max_kp": study.max_kp,
            "max_kd": study.max_kd,
            "gain_limit": study.limit.gain,
            "lower_gain_limit": study.limit.lower_gain,
            "limit_frequency_rad_s": study.limit.frequency,
            "requirements_met": study.requirements_met,
            "unmet": list(study.unmet),
            "worst": _margins(study.system.requirements, study.in_range.margins),
            "worst_case": {name: study.case_of(name) or None for name in study.worst},
            "required": required_facts(study.system.requirements),
            **motion_facts(study.response),
            "recommended": None if best is None else _recommended_facts(study, best),
            "at_usual_rate": None if usual is None else _rate_facts(usual),
            "uncertainty_cost": None if study.uncertainty_cost is None else _cost_facts(study.uncertainty_cost),
            "rule": {"kp": rule.kp, "kd": rule.kd, "stable": rule.margins.stable, "margins": _margins(asked, rule.margins)},
            "assumptions": list(study.system.assumptions),
            "warnings": [*warnings(study), *notes(study)],
        }

    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        study, use = self.study, self.to_use
        doubts, others = warned_first(warnings(study), verbose)
        parts = [*doubts, sentence(study), *verdict_lines(study, use)]
        parts += [*folded(use), "", *_all_there_is(study)] if verbose else []
        yield [*parts, *closing(self.files, others, study.system.assumptions, notes(study) if verbose else ())]


@dataclass(frozen=True)
class NoGains(Presentation):
    """Answer to a file without gains where none are recommended."""

    nothing: NoGainsError

    def facts(self) -> dict[str, Any]:
        findings = [{"code": "no_gains", "bounds": list(self.nothing.prevented_by)}]
        return {"verdict": "unsafe", "findings": findings, "sentence": self._sentence, "recommended": None}

    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        yield [self._sentence]

    @property
    def _sentence(self) -> str:
        bounds = self.nothing.prevented_by
        text = nothing_limits() if self.nothing.unlimited and not bounds else no_gains(self.nothing.system, bounds)
        return f"{text[:1].upper()}{text[1:]}."


def _margins(asked: Requirements, margins: Margins) -> dict[str, Any]:
    return row_facts(reported_columns(asked, margins), margins)


def _own_gains(controller: Any) -> dict[str, float]:
    return {name: value for name, value, _ in own_gains(controller)}


def _recommended_facts(study: JointStudy, recommended: "Recommendation") -> dict[str, Any]:
    gains = _own_gains(recommended.controller)
    return {
        **gains,
        "controller": {"type": type_of(recommended.controller), **gains},
        "plane": {"kp": recommended.kp, "kd": recommended.kd},
        "objective": recommended.objective,
        "dynamic_stiffness": recommended.stiffness,
        **motion_facts(study.recommended_response or study.response),
        "margins": _margins(study.system.requirements, recommended.worst),
        "nominal": _margins(study.system.requirements, recommended.nominal),
        "worst_case": recommended.worst_case,
        "binding": recommended.binding,
        "costs": recommended.costs | ({} if study.exact is None or study.cost is None else {"uncertainty": study.exact.value}),
        "checked": recommended.certificate,
        "proved": recommended.proved,
    }


def _rate_facts(study: JointStudy) -> dict[str, Any]:
    """JSON of the recommended gains at the usual rate, and of those recommended for that rate."""
    return {
        "sample_rate_hz": 1 / (study.system.control.sample_time or 1.0),
        "margins": _margins(study.system.requirements, study.in_range.margins),
        "requirements_met": study.requirements_met,
        "unmet": list(study.unmet),
        "recommended": None if study.recommended is None else _own_gains(study.recommended.controller),
    }


def _cost_facts(found: "UncertaintyCost") -> dict[str, Any]:
    return {
        "cost": found.cost,
        "exact": {"kp": found.exact.kp, "kd": found.exact.kd, "value": found.exact.value},
        "half_range": {key: getattr(found.half, key) for key in ("name", "low", "high", "kp", "kd", "value", "proved")},
        "known_exactly": [{"name": one.name, "kp": one.kp, "kd": one.kd, "value": one.value, "proved": one.proved} for one in found.known],
    }


def _all_there_is(study: JointStudy) -> list[Part]:
    """Tables of all margins, the largest gains, what limits the recommended ones, and what to measure better."""
    model = model_text(study.system.control.sample_time)
    ranges = "; met: at the worst of the ranges" if study.system.uncertainty.names else ""
    own, *others = gains_beside(study)
    parts: list[Part] = [
        *filter(None, [cause(study)]),
        "",
        TextTable(f"Margins ({model}{ranges})", ("", "value", "at", "required", "met"), _margin_rows(study)),
        TextTable.of("Gains", gain_columns(study), [own, *largest_gains(study), *others]),
    ]
    if study.recommended is not None:
        controller = study.recommended.controller
        if len(controller.gain_names()) > 2:  # the table has two columns of gains
            parts.append(f"Recommended controller: {typed_gains(controller)}.")
        parts.append(recommended_text(study.recommended))
    return [*parts, *filter(None, [motion_text(study), uncertainty_cost_text(study, ranked=True)]), RULE]


def _margin_rows(study: JointStudy) -> list[tuple[str, ...]]:
    stable = study.margins.stable
    rows = [("stable", "yes" if stable else "NO", "", "yes", yes(stable))]
    if study.system.uncertainty.names:
        text = "NO" if not study.stable_in_range else "yes" if study.range_proved else "not proved"
        rows.append(("stable in the uncertainty ranges", text, "", "yes", "" if text == "not proved" else yes(study.stable_in_range)))
    return [*rows, *margin_rows(study.margins, study.in_range.margins, study.system.requirements)]


@dataclass(frozen=True)
class Gains:
    """Gains on a controller's kp–kd plane under a name, with their margins; None for the largest gains, which have none."""

    name: str
    kp: float | None
    kd: float | None
    margins: Margins | None = None


def gains_beside(study: JointStudy) -> list[Gains]:
    """Gains to compare: the file's, the recommended ones, and the 10 Hz rule's."""
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
    """Gains at the limit: the largest kd at the file's kp, and the largest kp with a kd that is stable there."""
    (kp_name, kd_name), (own, *_) = study.template.plane_names, gains_beside(study)
    return [
        Gains(f"largest {kd_name} at this {kp_name}", own.kp, study.max_kd),
        Gains(f"largest {kp_name} of all", study.max_kp, study.kd_at_max_kp),
    ]


def plane_columns(study: JointStudy) -> list[Column]:
    """Columns of the plane's two gains, named as in the controller; the unit is in the heading."""
    kp_name, kd_name = study.template.plane_names
    return [
        Column(kp_name, "kp", lambda row: row.kp, "N·m/rad", shown=lambda row: digits(row.kp)),
        Column(kd_name, "kd", lambda row: row.kd, "N·m·s/rad", shown=lambda row: digits(row.kd)),
    ]


def gain_columns(study: JointStudy) -> list[Column]:
    """Columns of a row Gains: name, gains, and the margins that are required, or are by default."""
    asked = study.system.requirements.asked

    def margin(column: Column, verdict: str) -> Column:
        def shown(row: Gains) -> str:
            return "" if row.margins is None else column.text(row.margins) if row.margins.stable else verdict

        return Column(REQUIREMENTS[column.requirement].heading, "", lambda row: row.margins, shown=shown)

    first, *others = (one for one in bounded_columns() if one.requirement in asked or REQUIREMENTS[one.requirement].usual)
    margins = [margin(first, "unstable"), *(margin(column, "") for column in others)]
    return [Column("", "", lambda row: row.name), *plane_columns(study), *margins]


def margin_table(study: JointStudy) -> Html:
    """Table of all margins of the file's gains, the recommended ones and the 10 Hz rule's."""
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
    """Table of recommended gains under the given uncertainty, with each uncertain quantity known exactly, and with all."""
    found = study.uncertainty_cost
    assert found is not None
    plane = plane_columns(study)
    sets = [
        ("as uncertain as it is", study.recommended, ""),
        *((f"{one.name.replace('_', ' ')} known exactly", one, rise_text(study, one)) for one in found.known),
        ("everything known exactly", found.exact, ""),
    ]
    rows = [
        (name, "–", "–", rise, "") if one is None else (name, *(column.text(one) for column in plane), rise, yes(one.proved))
        for name, one, rise in sets
    ]
    headings = (
        "Recommended gains",
        *(f"{column.title} [{column.unit}]" for column in plane),
        f"change of the {made_largest(found.exact)}",
        "proved",
    )
    return table(headings, rows, uncertainty_cost_text(study, ranked=True), sorts=False)


def crossing_table(found: Margins) -> Html:
    """Table of every crossing of the file's loop, by frequency."""
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


def case_table(shown: "list[BodeLoop]") -> Html:
    """Table of the loops in the Bode figure."""
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
    """Inputs used on the page: joint, drive, controller and requirements."""
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
    """Names and values of the joint and its drive."""
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
        ("encoder", system.control.feedback.place),
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
