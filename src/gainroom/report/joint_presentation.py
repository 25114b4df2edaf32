"""A joint's study as it is shown: keys of --json, lines of the terminal, page."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..studies.joint import JointStudy
from ..system.controller import type_of
from .columns import facts, yes
from .joint_text import RULE, cause, notes, recommended_text, sentence, uncertainty_cost_text, warnings
from .margin_columns import margin_columns, margin_rows, required_facts
from .number_format import model_facts, model_text, own_gains, typed_gains
from .presentation import Grid, Part, Presentation, closing, folded, warned_first
from .verdict import joint_to_use, verdict_lines

if TYPE_CHECKING:
    from ..analysis.margin_record import Margins
    from ..design.joint_gains import Recommendation
    from ..design.uncertainty_cost import UncertaintyCost


@dataclass(frozen=True)
class JointPresentation(Presentation):
    """All that is shown of a joint's study."""

    study: JointStudy

    def facts(self) -> dict[str, Any]:
        study = self.study
        margins, rule, best, usual = study.margins, study.rule, study.recommended, study.at_usual_rate
        return {
            **study.verdict.facts,
            "stable": margins.stable,
            "stable_in_range": study.stable_in_range,
            "unstable_at": study.unstable_at or None,
            "range_proved": study.range_proved,
            "sentence": sentence(study),
            **model_facts(study.system.control.sample_time),
            "unstable_roots": margins.unstable_roots,
            **_margins(margins),
            "max_kp": study.max_kp,
            "max_kd": study.max_kd,
            "gain_limit": study.limit.gain,
            "lower_gain_limit": study.limit.lower_gain,
            "limit_frequency_rad_s": study.limit.frequency,
            "requirements_met": study.requirements_met,
            "unmet": list(study.unmet),
            "worst": _margins(study.in_range.margins),
            "worst_case": {name: study.case_of(name) or None for name in study.worst},
            "required": required_facts(study.system.requirements),
            "recommended": None if best is None else _recommended_facts(study, best),
            "at_usual_rate": None if usual is None else _rate_facts(usual),
            "uncertainty_cost": None if study.uncertainty_cost is None else _cost_facts(study.uncertainty_cost),
            "rule": {"kp": rule.kp, "kd": rule.kd, "stable": rule.margins.stable, "margins": _margins(rule.margins)},
            "warnings": [*warnings(study), *notes(study)],
        }

    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        study, use = self.study, joint_to_use(self.study, self.call)
        doubts, said = warned_first(warnings(study), verbose)
        parts = [*doubts, sentence(study), *verdict_lines(study, use)]
        parts += [*folded(use), "", *_all_there_is(study)] if verbose else []
        yield [*parts, *closing(self.files, said, notes=notes(study) if verbose else ())]

    def page(self, command: str) -> str:
        from .joint import joint_page  # loads the pictures

        return joint_page(self.study, command, self.call)


def _margins(margins: "Margins") -> dict[str, Any]:
    return facts(margin_columns(), margins)


def _own_gains(controller: Any) -> dict[str, float]:
    return {name: value for name, value, _ in own_gains(controller)}


def _recommended_facts(study: JointStudy, recommended: "Recommendation") -> dict[str, Any]:
    gains = _own_gains(recommended.controller)
    return {
        **gains,
        "controller": {"type": type_of(recommended.controller), **gains},
        "plane": {"kp": recommended.kp, "kd": recommended.kd},
        "margins": _margins(recommended.worst),
        "nominal": _margins(recommended.nominal),
        "worst_case": recommended.worst_case,
        "binding": recommended.binding,
        "costs": recommended.costs | ({} if study.exact is None or study.cost is None else {"uncertainty": study.exact.kp}),
        "checked": recommended.certificate,
        "proved": recommended.proved,
    }


def _rate_facts(study: JointStudy) -> dict[str, Any]:
    """The recommended gains of continuous time at the usual rate, and those that are recommended there."""
    return {
        "sample_rate_hz": 1 / (study.system.control.sample_time or 1.0),
        "margins": _margins(study.in_range.margins),
        "requirements_met": study.requirements_met,
        "unmet": list(study.unmet),
        "recommended": None if study.recommended is None else _own_gains(study.recommended.controller),
    }


def _cost_facts(found: "UncertaintyCost") -> dict[str, Any]:
    return {
        "cost": found.cost,
        "exact": {"kp": found.exact.kp, "kd": found.exact.kd},
        "half_range": {key: getattr(found.half, key) for key in ("name", "low", "high", "kp", "kd", "proved")},
        "known_exactly": [{"name": one.name, "kp": one.kp, "kd": one.kd, "proved": one.proved} for one in found.known],
    }


def _all_there_is(study: JointStudy) -> list[Part]:
    """All margins, the largest gains, what limits the recommended ones, what to measure better."""
    from .joint_tables import gain_columns, gains_beside, largest_gains  # loads the pictures

    model = model_text(study.system.control.sample_time)
    ranges = "; met: at the worst of the ranges" if study.system.uncertainty.names else ""
    own, *others = gains_beside(study)
    parts: list[Part] = [
        *filter(None, [cause(study)]),
        "",
        Grid(f"Margins ({model}{ranges})", ("", "value", "at", "required", "met"), _margin_rows(study)),
        Grid.of("Gains", gain_columns(study), [own, *largest_gains(study), *others]),
    ]
    if study.recommended is not None:
        controller = study.recommended.controller
        if len(controller.gain_names()) > 2:  # the table has two columns of gains
            parts.append(f"Recommended controller: {typed_gains(controller)}.")
        parts.append(recommended_text(study.recommended))
    return [*parts, *filter(None, [uncertainty_cost_text(study, ranked=True)]), RULE]


def _margin_rows(study: JointStudy) -> list[tuple[str, ...]]:
    stable = study.margins.stable
    rows = [("stable", "yes" if stable else "NO", "", "yes", yes(stable))]
    if study.system.uncertainty.names:
        text = "NO" if not study.stable_in_range else "yes" if study.range_proved else "not proved"
        rows.append(("stable in the uncertainty ranges", text, "", "yes", "" if text == "not proved" else yes(study.stable_in_range)))
    return [*rows, *margin_rows(study.margins, study.in_range.margins, study.system.requirements)]
