"""gainroom joint: one joint, exactly."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..report.number_format import model_facts, model_text, own_gains, typed_gains
from .options import AsJson, ExitZero, Report, Strict, Verbose, exit_status, report_stream, typed_command
from .output import closing, column_table, folded_parts, render, show, table, verdict_parts, warned_first
from .progress import progress_bar

if TYPE_CHECKING:
    from ..design.joint_gains import Recommendation
    from ..design.uncertainty_cost import UncertaintyCost
    from ..studies.joint import JointStudy


def joint(
    context: typer.Context,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A joint.yaml; `gainroom example testbed` prints one.", show_default=False)],
    as_json: AsJson = False,
    verbose: Verbose = False,
    strict: Strict = False,
    exit_zero: ExitZero = False,
    report: Report = None,
) -> int:
    """Stability of a joint, its margins, what limits its gains, and recommended gains.

    \b
    Example:
      gainroom joint joint.yaml --report joint.html

    Exit status: 0 safe; 1 not safe: unstable, or a requirement is missed; 2 the file or the call is wrong; 3 not decided: something that
    decides is not known, and the answer names what gives it.
    """
    from ..files.joint_yaml import load_joint

    system = load_joint(file, two_paths=True)
    if system.control.kd_path is not None:
        from .two_paths import two_paths

        return exit_status(two_paths(system, as_json, report), exit_zero)
    with report_stream(report) as page:
        from ..studies.joint import study_joint

        with progress_bar("joint:") as progress:
            progress(0, 0, "margins and gains")
            study, call = study_joint(system), typed_command(context, "report")
        show(as_json, lambda: _facts(study), lambda: _terminal(study, call, report, verbose))
        if page is not None:
            from ..report.joint import joint_page

            page.write(joint_page(study, typed_command(context), call))
    return exit_status(study.verdict, exit_zero)


def _facts(study: "JointStudy") -> dict[str, Any]:
    """What --json prints."""
    from ..report.columns import facts
    from ..report.joint_text import notes, sentence, warnings
    from ..report.margin_columns import margin_columns, required_facts

    margins, requirements, rule = study.margins, study.system.requirements, study.rule
    recommended = study.recommended
    return {
        **study.verdict.facts,
        "stable": margins.stable,
        "stable_in_range": study.stable_in_range,
        "unstable_at": study.unstable_at or None,
        "range_proved": study.range_proved,
        "sentence": sentence(study),
        **model_facts(study.system.control.sample_time),
        "unstable_roots": margins.unstable_roots,
        **facts(margin_columns(), margins),
        "max_kp": study.max_kp,
        "max_kd": study.max_kd,
        "gain_limit": study.limit.gain,
        "lower_gain_limit": study.limit.lower_gain,
        "limit_frequency_rad_s": study.limit.frequency,
        "requirements_met": study.requirements_met,
        "unmet": list(study.unmet),
        "worst": facts(margin_columns(), study.in_range.margins),
        "worst_case": {name: study.case_of(name) or None for name in study.worst},
        "required": required_facts(requirements),
        "recommended": None if recommended is None else _recommended_facts(study, recommended),
        "at_usual_rate": None if study.at_usual_rate is None else _rate_facts(study.at_usual_rate),
        "uncertainty_cost": None if study.uncertainty_cost is None else _cost_facts(study.uncertainty_cost),
        "rule": {"kp": rule.kp, "kd": rule.kd, "stable": rule.margins.stable, "margins": facts(margin_columns(), rule.margins)},
        "warnings": [*warnings(study), *notes(study)],
    }


def _recommended_facts(study: "JointStudy", recommended: "Recommendation") -> dict[str, Any]:
    from ..report.columns import facts
    from ..report.margin_columns import margin_columns
    from ..system.controller import type_of

    controller = recommended.controller
    gains = {name: value for name, value, _ in own_gains(controller)}
    return {
        **gains,
        "controller": {"type": type_of(controller), **gains},
        "plane": {"kp": recommended.kp, "kd": recommended.kd},
        "margins": facts(margin_columns(), recommended.worst),
        "nominal": facts(margin_columns(), recommended.nominal),
        "worst_case": recommended.worst_case,
        "binding": recommended.binding,
        "costs": recommended.costs | ({} if study.exact is None or study.cost is None else {"uncertainty": study.exact.kp}),
        "checked": recommended.certificate,
        "proved": recommended.proved,
    }


def _rate_facts(study: "JointStudy") -> dict[str, Any]:
    """The recommended gains of continuous time at the usual rate, and those that are recommended there."""
    from ..report.columns import facts
    from ..report.margin_columns import margin_columns

    again = study.recommended
    return {
        "sample_rate_hz": 1 / (study.system.control.sample_time or 1.0),
        "margins": facts(margin_columns(), study.in_range.margins),
        "requirements_met": study.requirements_met,
        "unmet": list(study.unmet),
        "recommended": None if again is None else {name: value for name, value, _ in own_gains(again.controller)},
    }


def _cost_facts(found: "UncertaintyCost") -> dict[str, Any]:
    return {
        "cost": found.cost,
        "exact": {"kp": found.exact.kp, "kd": found.exact.kd},
        "half_range": {key: getattr(found.half, key) for key in ("name", "low", "high", "kp", "kd", "proved")},
        "known_exactly": [{"name": one.name, "kp": one.kp, "kd": one.kd, "proved": one.proved} for one in found.known],
    }


def _terminal(study: "JointStudy", call: str, report: Path | None, verbose: bool) -> str:
    """`call`: this command; `verbose`: all margins, too, the largest gains, what limits the recommended ones, what to measure better."""
    from ..report.joint_text import notes, sentence, warnings
    from ..report.verdict import MOST_WARNINGS, joint_to_use

    said = warnings(study)
    use = joint_to_use(study, call)
    doubts, said = warned_first(said, None if verbose else MOST_WARNINGS)
    parts = [*doubts, sentence(study), *verdict_parts(study, use)]
    if verbose:
        return render(*parts, *folded_parts(use), "", *_all_there_is(study), *closing({"Report": report}, said, notes=notes(study)))
    return render(*parts, *closing({"Report": report}, said))


def _all_there_is(study: "JointStudy") -> list[Any]:
    from ..report.joint_tables import gain_columns, gains_beside, largest_gains
    from ..report.joint_text import RULE, cause, recommended_text, uncertainty_cost_text

    model = model_text(study.system.control.sample_time)
    ranges = "; met: at the worst of the ranges" if study.system.uncertainty.names else ""
    own, *others = gains_beside(study)
    parts: list[Any] = [
        *filter(None, [cause(study)]),
        "",
        table(f"Margins ({model}{ranges})", ("", "value", "at", "required", "met"), _margin_rows(study)),
        column_table("Gains", gain_columns(study), [own, *largest_gains(study), *others]),
    ]
    if study.recommended is not None:
        controller = study.recommended.controller
        if len(controller.gain_names()) > 2:  # the table has two columns of gains
            parts.append(f"Recommended controller: {typed_gains(controller)}.")
        parts.append(recommended_text(study.recommended))
    return [*parts, *filter(None, [uncertainty_cost_text(study, ranked=True)]), RULE]


def _margin_rows(study: "JointStudy") -> list[tuple[str, ...]]:
    from ..report.columns import yes
    from ..report.margin_columns import margin_rows

    stable = study.margins.stable
    rows = [("stable", "yes" if stable else "NO", "", "yes", yes(stable))]
    if study.system.uncertainty.names:
        text = "NO" if not study.stable_in_range else "yes" if study.range_proved else "not proved"
        rows.append(("stable in the uncertainty ranges", text, "", "yes", "" if text == "not proved" else yes(study.stable_in_range)))
    return [*rows, *margin_rows(study.margins, study.in_range.margins, study.system.requirements)]
