"""Comparison of structures in several joints together, as sentences, a table and JSON."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from ..design.comparison.coupled_joints import COMPLIANCE, DELAY, SENSITIVITY
from ..errors import listed
from ..files.compared_joint import control_section
from ..files.edited_text import plain
from ..studies.coupled_comparison import CoupledComparison, CoupledRow, Elsewhere
from .columns import Column
from .comparison_text import control_lines, name_of, thousandths, wrapped
from .number_format import MISSED, digits, hertz, rate
from .presentation import Part, Presentation, TextTable, Unwrapped, closing

UNIT = "mrad/N·m"
SHOWN = 7
"""Digits of gains, as in files."""
NO_MORE = 1.01
"""Factor of stiffness below which a structure is told to be no stiffer."""
AT_REST = 0.1
"""Frequency [rad/s] below which a peak is the compliance at rest."""


@dataclass(frozen=True)
class CoupledPresentation(Presentation):
    """Presentation of a comparison of several joints together; `assumed`: what was assumed where the file says nothing."""

    found: CoupledComparison
    assumed: Sequence[str] = ()

    def facts(self) -> dict[str, Any]:
        found = self.found
        states = [{"posture": posture, "contact": contact} for posture, contact in found.joint.states]
        return {
            "sentence": sentence(found),
            "joints": found.names,
            "state": states[0],
            "tuned_at": [found.joint.where(spot) for spot in found.tuned],
            "ceilings": {
                "sigma_max_sensitivity": found.ceilings.peak_sensitivity,
                "delay_reserve_ms": 1e3 * found.ceilings.delay_reserve,
                "torque_noise": found.ceilings.torque_noise,
            },
            "rows": [_row_facts(found, row) for row in found.rows],
            "assumed": list(self.assumed),
        }

    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        found = self.found
        step = found.joint.system.control.sample_time or 1.0
        title = f"Peak of σ_max(q/d) [{UNIT}] in {'/'.join(found.joint.states[0])}, {rate(1 / step)}"
        yield [
            sentence(found),
            *filter(None, [_elsewhere_sentence(found)]),
            "",
            TextTable.of(title, TABLE, [(found, row) for row in found.rows], ("gap", "delay disk", "at")),
            _ceilings_text(found),
            *(line for row in found.rows if verbose or row.structure.key == "pd" for line in gains_lines(found, row)),
            *closing({}, assumed=self.assumed, notes=_notes(found)),
            *([] if verbose else ["The controllers of all structures: --verbose, or --json."]),
        ]


def times(found: CoupledComparison, row: CoupledRow) -> float:
    """Peak compliance of PD over that of a row; NaN without a PD."""
    return math.nan if found.pd is None or not row.holds else found.pd.compliance / row.compliance


def sentence(found: CoupledComparison) -> str:
    """Answer: how far a load moves a link with PD, and what other structures make of it."""
    where = f"{listed(found.names, most=2)}, {len(found.names)} joints together, in {'/'.join(found.joint.states[0])}"
    told = []
    if (pd := found.pd) is not None:
        told.append(f"with PD a load moves the links by up to {thousandths(pd.compliance)} {UNIT}")
    told += [f"with {name_of(row.structure.key)} {_against(found, row)}" for row in found.rows if row is not found.pd and row.holds]
    failed = [name_of(row.structure.key) for row in found.rows if not row.holds]
    if failed:
        told.append(f"no {listed(failed, 'or')} was found that keeps the ceilings")
    return f"{where}: {'; '.join(told)}. All other joints are closed by the file's gains."


def _against(found: CoupledComparison, row: CoupledRow) -> str:
    value = f"{thousandths(row.compliance)} {UNIT}"
    if found.pd is None:
        return value
    more = times(found, row)
    return f"{value}, {digits(more, '×', 2)} stiffer" if more >= NO_MORE else f"{value}, no stiffer"


def _elsewhere_sentence(found: CoupledComparison) -> str:
    """Sentence on designs that do not hold where they were not tuned."""
    told = []
    for row in found.rows:
        lost = [one.at for one in (*row.box, *row.states) if not one.stable]
        if lost:
            told.append(f"{name_of(row.structure.key)} is unstable at {listed(lost, most=3)}")
    return f"{'; '.join(told)}." if told else ""


def _ceilings_text(found: CoupledComparison) -> str:
    ceilings = found.ceilings
    held = (
        f"Held to, by all joints together: σ_max(S) ≤ {digits(ceilings.peak_sensitivity)}, "
        f"delay disk ≤ 1 for {digits(1e3 * ceilings.delay_reserve, 'ms', 3)} more in any of them, "
        f"torque noise ≤ {digits(ceilings.torque_noise, 'N·m', 3)} rms in every motor."
    )
    if len(found.tuned) > 1:
        return f"{held} Tuned at the nominal values and every corner of the file's uncertainty."
    return f"{held} Tuned at the nominal values alone, as the file gives no ranges; ± 20 % is of the stiffness of all these joints."


def _notes(found: CoupledComparison) -> list[str]:
    notes = ["that a design is the best of its structure is not proved; gap is how far apart its two best searches ended"]
    if any(row.structure.in_drive for row in found.rows):
        late = digits(1e3 * found.path.delay, "ms", 3)
        notes.append(
            f"kd in the drive: at {rate(1 / found.path.sample_time)}, {late} late; its stability is that of both rates together, "
            "its peaks are without aliases"
        )
    return notes


def _worst(every: Sequence[Elsewhere]) -> str:
    """σ_max(S) at the worst of several spots."""
    if not every:
        return "–"
    lost = sum(not one.stable for one in every)
    return f"{MISSED} {lost} of {len(every)} unstable" if lost else digits(max(one.sensitivity for one in every), "", 3)


def _gap(row: CoupledRow) -> str:
    if row.found is None or math.isnan(row.found.gap):
        return "–"
    gap = math.expm1(row.found.gap)
    return digits(100 * gap, "%", 2) if gap >= 1e-3 else "< 0.1 %"


def _peak(kind: int, text: Any) -> Any:
    return lambda line: "–" if line[1].found is None else text(line[0], line[1].found.peaks[kind])


TABLE = [
    Column("structure", "", lambda line: name_of(line[1].structure.key)),
    Column("σ(q/d)", "", lambda line: thousandths(line[1].compliance) if line[1].holds else f"{MISSED} none"),
    Column("at", "", _peak(COMPLIANCE, lambda found, one: "rest" if one.frequency < AT_REST else hertz(one.frequency))),
    Column("× PD", "", lambda line: times(*line), shown=lambda line: digits(times(*line), "×", 3) if line[1].holds else "–"),
    Column("σ(S)", "", _peak(SENSITIVITY, lambda found, one: digits(found.ceilings.peak_sensitivity * one.value, "", 4))),
    Column("delay disk", "", _peak(DELAY, lambda found, one: digits(one.value, "", 3))),
    Column("gap", "", lambda line: _gap(line[1]), definition="between the two best searches"),
    Column("σ(S), ± 20 %", "", lambda line: _worst(line[1].box)),
    Column("other states", "", lambda line: _worst(line[1].states)),
]
"""Columns of a (comparison, row)."""


def gains_lines(found: CoupledComparison, row: CoupledRow) -> list[Part]:
    """Controllers of a row as lines to copy: of a PD as `control` of a robot.yaml has them, else each joint's as a joint.yaml would."""
    if not row.holds:
        return []
    lines = [f"{name_of(row.structure.key)}:"]
    if row.structure.key == "pd":
        for key in ("kp", "kd"):
            each = {
                name: float(f"{getattr(one.control.controller, key):.{SHOWN}g}") for name, one in zip(found.names, row.systems, strict=True)
            }
            lines += wrapped(f"  {key}: {plain(each)}")
    else:
        for name, one in zip(found.names, row.systems, strict=True):
            lines += [f"  {name}:", *(f"    {line}" for line in control_lines(one))]
    return [Unwrapped(line) for line in lines]


def _row_facts(found: CoupledComparison, row: CoupledRow) -> dict[str, Any]:
    """JSON of a row."""
    made: dict[str, Any] = {
        "structure": row.structure.key,
        "name": name_of(row.structure.key),
        "holds": row.holds,
        "runs": row.structure.where,
        "times_pd": times(found, row),
    }
    if row.found is None:
        return made
    for key, kind, unit in (
        ("sigma_max_compliance", COMPLIANCE, 1.0),
        ("sigma_max_sensitivity", SENSITIVITY, found.ceilings.peak_sensitivity),
        ("delay_disk", DELAY, 1.0),
    ):
        one = row.found.peaks[kind]
        made[key] = {
            "value": unit * one.value,
            "frequency_rad_s": one.frequency,
            "at": found.joint.where(one.spot),
            "proved": one.proved,
        }
    return made | {
        "torque_noise": row.found.noise * (found.ceilings.torque_noise or 1.0),
        "gap": math.expm1(row.found.gap),
        "parameters": {
            name: {key: float(f"{value:.{SHOWN}g}") for key, value in own.items()}
            for name, own in zip(found.names, row.found.by_joint, strict=True)
        },
        "controllers": {name: control_section(one) for name, one in zip(found.names, row.systems, strict=True)},
        "box": [_elsewhere_facts(one) for one in row.box],
        "other_states": [_elsewhere_facts(one) for one in row.states],
    }


def _elsewhere_facts(one: Elsewhere) -> dict[str, Any]:
    return {
        "at": one.at,
        "stable": one.stable,
        "sigma_max_sensitivity": one.sensitivity,
        "sigma_max_compliance": one.compliance,
    }
