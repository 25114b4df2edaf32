"""Presentation of a joint or robot whose kd has a separate path: sentence, tables, JSON."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ..errors import listed
from ..studies.gain_paths import PathCase, PathStudy
from ..system.margin_units import to_db
from ..system.plausibility import unusual_values
from ..system.requirements import REQUIREMENTS
from .columns import Column, definitions, facts, yes
from .margin_columns import margin_facts, required_facts
from .number_format import digits, hertz, model_facts, model_text, path_facts
from .presentation import Legend, Part, Presentation, TextTable, closing, warned_first
from .words import UNSTABLE, path_headline

NOT_MADE = "gain maps, largest gains, recommended gains and curves over frequency are of loops with one path, and are not made here"
COLUMNS = [
    Column("state", "state", lambda case: case.title or None, shown=lambda case: case.title),
    Column("stable", "stable", lambda case: case.limit.stable, shown=lambda case: yes(case.limit.stable)),
    Column("all gains", "gain_limit", lambda case: case.limit.gain, "×", "the factor on kp and kd together at which it starts to vibrate"),
    Column("at", "limit_frequency_rad_s", lambda case: case.limit.frequency, shown=lambda case: hertz(case.limit.frequency)),
    Column(
        "kp",
        "kp_gain_limits",
        lambda case: _ends(case, "others"),
        "",
        "factors on kp alone between which it is stable",
        shown=lambda c: _range(c, "others"),
    ),
    Column("kd", "kd_gain_limits", lambda case: _ends(case, "kd"), "", "the same of kd", shown=lambda c: _range(c, "kd")),
    Column("phase", "phase_margin_deg", lambda case: math.degrees(case.margins.common_phase_margin), "°", "a common phase"),
    Column("kp's delay", "kp_delay_limit_ms", lambda case: 1e3 * case.delay_limit, "ms", "the whole delay of kp's path that is too long"),
    Column("", "delay_margin_ms", lambda case: 1e3 * case.margins.delay_margin),
    Column("", "certified", lambda case: case.margins.certified),
]
"""Columns of a state at the nominal values."""


def _ends(case: PathCase, path: str) -> list[float] | None:
    paths = case.margins.paths
    return None if paths is None else [getattr(paths, f"lower_{path}"), getattr(paths, path)]


def _range(case: PathCase, path: str) -> str:
    ends = _ends(case, path)
    return "–" if ends is None else f"{digits(ends[0], '', 3)} to {digits(ends[1], '×', 3)}"


def sentence(study: PathStudy) -> str:
    """Verdict, missed requirements, and the factors at which vibration starts, as text."""
    case, paths = study.tightest, study.tightest.margins.paths
    if not study.stable:
        gain = case.limit.gain
        below = (
            f"scaled together these gains are stable only below {digits(gain, '×', 3)}"
            if gain > 0
            else "no lower gains in the same ratio are stable"
        )
        below = "whether lower gains are stable is not known" if math.isnan(gain) else below
        return f"{UNSTABLE}{_where(case)}; {below}."
    text = path_headline(study)
    if study.unstable_at:
        return text
    starts = {"kp and kd together": case.limit.gain} | ({} if paths is None else {"kp alone": paths.others, "kd alone": paths.kd})
    factors = [f"{digits(factor, '×', 3)} {what}" for what, factor in starts.items() if math.isfinite(factor)]
    text += f" Vibration starts{_where(case)} at {listed(factors, 'or')}." if factors else " No factor on these gains makes it vibrate."
    if math.isfinite(case.delay_limit):
        text += f" kp's path may have {1e3 * case.delay_limit:.3g} ms of delay (given: {1e3 * study.system.delay:.3g} ms)."
    return text


def _where(case: PathCase) -> str:
    return f" in {case.title}" if case.title else ""


def requirement_rows(study: PathStudy) -> list[tuple[str, ...]]:
    """Table rows of the requirements: worst value, its case, required value, and whether it is met."""
    rows = []
    for name, needed in study.system.requirements.needed.items():
        one, (value, case), met = REQUIREMENTS[name], study.worst[name], study.met(name)
        verdict = "not known" if met is None else yes(met)
        rows.append((one.title, one.text(value), case.text, f"{one.sign} {one.text(needed)}", verdict))
    return rows


def warnings(study: PathStudy) -> tuple[str, ...]:
    """Warnings for the user."""
    system, texts = study.system, []
    if study.unknown:
        names = listed([REQUIREMENTS[name].title for name in study.unknown])
        texts.append(f"{names}: not known of this loop, and not judged")
    if system.uncertainty.names:
        texts.append("within the ranges every corner and points between were examined; the rest is not proved")
    if not all(case.margins.certified for case in study.cases if case.limit.stable):
        texts.append("a margin is not known as far as others are searched, or its eigenvalues could not be counted on both sides")
    return (*texts, *system.warnings, *(text for text in unusual_values(system) if text not in system.warnings))


def assumptions(study: PathStudy) -> tuple[str, ...]:
    """Assumptions about the two paths."""
    control = study.system.control
    assert control.kd_path is not None
    assert control.sample_time is not None
    return (
        f"kd runs at {1 / control.kd_path.sample_time:g} Hz, {1e3 * control.kd_path.delay:g} ms from measurement to torque; kp at "
        f"{1 / control.sample_time:g} Hz with {1e3 * study.system.delay:g} ms; both sample together, on one clock",
        *study.system.assumptions,
    )


@dataclass(frozen=True)
class PathPresentation(Presentation):
    """Presentation of a PathStudy, a joint or robot whose kd has a separate path: terminal and JSON, no page."""

    study: PathStudy

    def facts(self) -> dict[str, Any]:
        control, case = self.study.system.control, self.study.tightest
        return {
            **self.study.verdict.facts,
            "stable": self.study.stable,
            "stable_in_range": self.study.stable_in_range,
            "unstable_at": self.study.unstable_at or None,
            "sentence": sentence(self.study),
            **model_facts(control.sample_time),
            "delay_ms": 1e3 * self.study.system.delay,
            "command_delay_ms": 1e3 * control.command_delay,
            "kd_path": path_facts(control.kd_path),
            "gain_limit": case.limit.gain,
            "gain_margin_db": to_db(case.margins.gain_margin),
            "limit_frequency_rad_s": case.limit.frequency,
            "requirements_met": self.study.requirements_met,
            "unmet": list(self.study.unmet),
            "not_known": list(self.study.unknown),
            "required": required_facts(self.study.system.requirements),
            "worst": {
                name: {"value": REQUIREMENTS[name].in_unit(value), "at": at.text or None} for name, (value, at) in self.study.worst.items()
            },
            "states": [facts(COLUMNS, one) | {"margins": margin_facts(one.margins)} for one in self.study.nominal],
            "assumptions": list(assumptions(self.study)),
            "warnings": [*warnings(self.study), NOT_MADE],
        }

    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        study, control = self.study, self.study.system.control
        columns = COLUMNS if study.nominal[0].title else COLUMNS[1:]
        nominal = TextTable.of(f"Nominal ({model_text(control.sample_time, control.kd_path)})", columns, study.nominal, ("at", "phase"))
        doubts, others = warned_first(warnings(study), every=True)
        yield [
            *doubts,
            sentence(study),
            "",
            nominal,
            Legend([nominal], lambda headings: definitions(columns, headings)),
            "",
            TextTable("Requirements, at their worst", ("", "value", "at", "required", "met"), requirement_rows(study)),
            *closing(self.files, others, assumptions(study), [NOT_MADE]),
        ]
