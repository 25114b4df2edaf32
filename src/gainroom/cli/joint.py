"""gainroom joint: one joint, exactly."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..report.number_format import (
    digits,
    model_kind,
    model_text,
    own_gains,
    plane_names,
    quantity,
    typed_gains,
)
from .options import AsJson, Report, Verbose, command_line, report_stream
from .output import emit, emit_json, file_line, render, table

if TYPE_CHECKING:
    from ..analysis.margins import Margins
    from ..design.joint_gains import Recommendation
    from ..design.uncertainty_cost import UncertaintyCost
    from ..studies.joint import JointStudy


def joint(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="A joint.yaml; `gainroom example testbed` prints one.", show_default=False),
    ],
    as_json: AsJson = False,
    verbose: Verbose = False,
    report: Report = None,
) -> int:
    """Stability of a joint, its margins, what limits its gains, and recommended gains.

    \b
    Example:
      gainroom joint joint.yaml --report joint.html

    Exit status: 0 stable, also in every case within `uncertainty`; 1 unstable; 2 the file or the call is wrong.
    """
    from ..files.joint_yaml import load_joint

    system = load_joint(file)
    with report_stream(report) as page:
        from ..studies.joint import study_joint

        study = study_joint(system)
        if as_json:
            emit_json(_facts(study))
        else:
            emit(_terminal(study, report, verbose))
        if page is not None:
            from ..report import joint_page

            page.write(joint_page(study, command_line("joint", file, "--report", report)))
    return 0 if study.stable_in_range else 1


def _facts(study: "JointStudy") -> dict[str, Any]:
    """What --json prints."""
    from ..report.columns import facts, margin_columns, required_facts
    from ..report.joint_text import sentence, warnings

    margins, requirements, rule = study.margins, study.system.requirements, study.rule
    sample_time, recommended = study.system.control.sample_time, study.recommended
    return {
        "stable": margins.stable,
        "stable_in_range": study.stable_in_range,
        "unstable_at": study.unstable_at or None,
        "range_proved": study.range_proved,
        "sentence": sentence(study),
        "model": model_kind(sample_time),
        "sample_rate_hz": None if sample_time is None else 1 / sample_time,
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
        "required": required_facts(requirements),
        "recommended": None if recommended is None else _recommended_facts(study, recommended),
        "uncertainty_cost": None if study.uncertainty_cost is None else _cost_facts(study.uncertainty_cost),
        "rule": {"kp": rule.kp, "kd": rule.kd, "stable": rule.margins.stable, "margins": facts(margin_columns(), rule.margins)},
        "warnings": list(warnings(study)),
    }


def _recommended_facts(study: "JointStudy", recommended: "Recommendation") -> dict[str, Any]:
    from ..report.columns import facts, margin_columns

    controller = recommended.controller
    gains = {name: value for name, value, _ in own_gains(controller)}
    return {
        **gains,
        "controller": {"type": type(controller).__name__.lower(), **gains},
        "plane": {"kp": recommended.kp, "kd": recommended.kd},
        "margins": facts(margin_columns(), recommended.worst),
        "nominal": facts(margin_columns(), recommended.nominal),
        "worst_case": recommended.worst_case,
        "binding": recommended.binding,
        "costs": recommended.costs | ({} if study.exact is None or study.cost is None else {"uncertainty": study.exact.kp}),
        "checked": recommended.certificate,
        "proved": recommended.proved,
    }


def _cost_facts(found: "UncertaintyCost") -> dict[str, Any]:
    return {
        "cost": found.cost,
        "exact": {"kp": found.exact.kp, "kd": found.exact.kd},
        "known_exactly": [{"name": one.name, "kp": one.kp, "kd": one.kd, "proved": one.proved} for one in found.known],
    }


def _terminal(study: "JointStudy", report: Path | None, verbose: bool) -> str:
    """`verbose`, or with a report, which has it too: also which parameter to measure better."""
    from ..report.columns import bounded_columns
    from ..report.joint_text import sentence, uncertainty_cost_text, warnings

    model, bounded = model_text(study.system.control.sample_time), [column.title for column in bounded_columns()]
    ranges = "; met: at the worst of the ranges" if study.system.uncertainty.names else ""
    parts: list[Any] = [
        sentence(study),
        "",
        table(f"Margins ({model}{ranges})", ("", "value", "at", "required", "met"), _margin_rows(study)),
        table("Gains", ("", *plane_names(study.system.control.controller), *bounded), _gain_rows(study)),
    ]
    if study.recommended is not None:
        controller = study.recommended.controller
        if len(controller.gain_names()) > 2:  # the table has two columns of gains
            parts.append(f"Recommended controller: {typed_gains(controller)}.")
        parts.append(_limits_text(study.recommended))
    parts += filter(None, [uncertainty_cost_text(study, ranked=verbose or report is not None)])
    parts.append("10 Hz rule: kp = J ω², kd = 2 ζ J ω with ω = 2π·10 rad/s, ζ = 2, J the motor inertia.")
    if report is not None:
        parts.append(file_line("Report", report))
    parts += [f"Warning: {warning}" for warning in warnings(study)]
    return render(*parts)


def _limits_text(recommended: "Recommendation") -> str:
    """The requirement that limits kp, and the largest kp without each."""
    from ..system.requirements import title_of

    words = {name: f"without the {title_of(name)}" for name in recommended.costs}
    kp_name, _ = plane_names(recommended.controller)
    worst = ", ".join(quantity(name, value) for name, value in recommended.worst_case.items())
    parts = [f"Recommended gains are limited by the {recommended.held_back_by()}" + (f" (worst case: {worst})." if worst else ".")]
    felt = ", ".join(f"{digits(kp, 'N·m/rad')} {words[name]}" for name, kp in recommended.felt.items())
    if felt:
        parts.append(f"The largest {kp_name} would be {felt}.")
    idle = [words[name].removeprefix("without ") for name in words if name not in recommended.felt]
    if idle:
        parts.append(f"Without {' or '.join(idle)} alone it would be the same.")
    return " ".join([*parts, f"Checked: {recommended.certificate}."])


def _margin_rows(study: "JointStudy") -> list[tuple[str, ...]]:
    from ..report.columns import judged_rows, yes

    stable = study.margins.stable
    rows = [("stable", "yes" if stable else "NO", "", "yes", yes(stable))]
    if study.system.uncertainty.names:
        text = "NO" if not study.stable_in_range else "yes" if study.range_proved else "not proved"
        rows.append(("stable in the uncertainty ranges", text, "", "yes", "" if text == "not proved" else yes(study.stable_in_range)))
    return [*rows, *judged_rows(study.margins, study.in_range.margins, study.system.requirements)]


def _gain_rows(study: "JointStudy") -> list[tuple[str, ...]]:
    controller, recommended, rule = study.system.control.controller, study.recommended, study.rule
    kp_name, kd_name = plane_names(controller)
    kp, kd = controller.plane_gains()
    rows = [("this file's", digits(kp), digits(kd), *_margin_cells(study.margins))]
    nothing = ("",) * (len(rows[0]) - 3)
    rows.append((f"largest {kd_name} at this {kp_name}", digits(kp), digits(study.max_kd), *nothing))
    rows.append((f"largest {kp_name} of all", digits(study.max_kp), digits(_kd_at_the_top(study)), *nothing))
    if recommended is not None:
        gains = digits(recommended.kp), digits(recommended.kd)
        if study.system.uncertainty.names:
            rows.append(("recommended (worst case)", *gains, *_margin_cells(recommended.worst)))
            rows.append(("recommended (nominal)", *gains, *_margin_cells(recommended.nominal)))
        else:
            rows.append(("recommended", *gains, *_margin_cells(recommended.nominal)))
    name = "10 Hz rule" if len(controller.gain_names()) == 2 else "10 Hz rule (plain PD)"
    rows.append((name, digits(rule.kp), digits(rule.kd), *_margin_cells(rule.margins)))
    return rows


def _kd_at_the_top(study: "JointStudy") -> float:
    """The kd at which the largest kp is stable; NaN where no kp is the largest or kd has no bound there."""
    if not math.isfinite(study.max_kp):
        return math.nan
    (stable,) = study.region.columns(study.max_kp * (1 - 1e-6))
    return float(stable[-1].mean()) if len(stable) and math.isfinite(stable[-1, 1]) else math.nan


def _margin_cells(margins: "Margins") -> tuple[str, ...]:
    """The margins that requirements may bound."""
    from ..report.columns import bounded_columns

    bounded = bounded_columns()
    return tuple(column.text(margins) for column in bounded) if margins.stable else ("unstable", *("" for _ in bounded[1:]))
