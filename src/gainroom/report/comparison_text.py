"""Comparison of structures as sentences and columns, and its presentation."""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from ..design.comparison.best_known import BestKnown
from ..design.comparison.objective import Objective
from ..errors import listed
from ..files.compared_joint import control_section, gains_section
from ..files.edited_text import plain
from ..studies.comparison import Comparison, ComparisonSettings, Row
from ..system.controller import type_of
from ..system.requirements import Requirements
from ..system.system import System
from .columns import Column, facts
from .margin_columns import MARGIN
from .number_format import MISSED, digits, hertz, milli, rate
from .page import Advice
from .page_parts import uncertainty_text
from .presentation import Part, Presentation, TextTable, closing, do_this
from .words import lower_gains

EQUAL = "at equal Ms, delay reserve and torque noise"
NAMES = {
    "pd": "PD",
    "pid": "PID (= P/PI)",
    "dob": "disturbance observer",
    "observer": "Kalman filter",
    "split": "kd in the drive",
    "torque_feedback": "torque sensor",
}
"""Names of structures without their options."""
CEILINGS = {"peak_sensitivity": "Ms", "delay_reserve": "delay reserve", "torque_noise": "torque noise"}
"""Names of ceilings."""
LEAST_PLAIN, MOST_PLAIN = 1e-3, 99.95
"""Numbers that are written with three digits, zeros at their end among them, so that columns and cards agree."""
NOT_HELD = "A robot.yaml cannot hold it: filters, and a rate of kd's own, are those of all its joints"
"""What is said of a controller that one joint of a robot's file cannot have alone."""
UNSURE = 0.02
"""Gap of the two best starts above which it is told in sentences."""
SMALL = {
    "dynamic_stiffness": ("peak of |q/d|", "mrad/N·m", "stiffer"),
    "low_frequency_compliance": ("peak of |q/d| up to {0}", "mrad/N·m", "stiffer"),
    "white_load": ("rms deviation for a white load", "mrad/N·m·√Hz", "quieter"),
    "step_load": ("rms deviation in the second after a step of the load", "mrad/N·m", "quieter"),
}
"""Objectives: what they are, their unit in thousandths, and what a link with less of it is."""


def name_of(structure: str) -> str:
    """Name of a structure for people: "PD + biquad", "kd in the drive"."""
    law, *options = structure.split("+")
    return " + ".join([NAMES[law], *(option.replace("biquad", " biquad").strip() for option in options)])


def measure(objective: Objective) -> str:
    """Name of the objective, in words."""
    return SMALL[objective.name][0].format(hertz(objective.below))


def unit(objective: Objective) -> str:
    """Unit of the objective's thousandths."""
    return SMALL[objective.name][1]


def capital(text: str) -> str:
    """Text with a capital letter first."""
    return text[:1].upper() + text[1:]


def thousandths(value: float) -> str:
    """Objective in thousandths with three digits, without unit; ∞ where unstable."""
    if math.isinf(value):
        return "∞"
    return f"{1e3 * value:#.3g}" if LEAST_PLAIN <= 1e3 * value < MOST_PLAIN else milli(value, 0.0)


def times(found: Comparison, value: float) -> float:
    """Worst objective of PD over `value`; NaN without a PD that holds the box."""
    pd = pd_row(found)
    return math.nan if pd is None or not pd.holds or not value > 0 else pd.worst / value


def pd_row(found: Comparison) -> Row | None:
    """Row of PD; None where it was not asked for."""
    return next((row for row in found.rows if row.structure == "pd"), None)


def winner(found: Comparison) -> Row | None:
    """Row to use as the joint is: PD, or what beats it on the same sensor and host; the best of all where PD was not asked for."""
    pd, best = pd_row(found), found.best_beside_pd
    if pd is not None and pd.holds:
        return pd if found.leave_pd or best is None or best.worst >= pd.worst else best
    holding = [row for row in found.rows if row.holds]
    return best or min(holding, key=lambda row: row.worst, default=None)


def sentence(found: Comparison) -> str:
    """Answer: what to do about PD, then what else would buy what, then what nothing can beat; of a robot, for which joint and where."""
    first = _verdict(found) if found.joint.is_single else f"{found.joint.name}: {_verdict(found)}"
    return " ".join(filter(None, [first, _others(found), _bound(found), _of_robot(found)]))


def _of_robot(found: Comparison) -> str:
    """Sentence on the state in which a robot's joint was compared; "" of a single joint."""
    joint = found.joint
    if joint.is_single or len(joint.system.drives) == 1:
        return ""
    count, every, first = len(joint.states), len(joint.system.source.states), "/".join(joint.states[0])
    where = f"all {count} states" if count == every else f"the {count} softest of {every} states"
    where = f"{where}; the link is softest in {first}" if count > 1 else first
    return f"All other joints are closed by the file's gains, in {where}."


def _verdict(found: Comparison) -> str:
    pd, best = pd_row(found), found.best_beside_pd
    if pd is None:
        first = winner(found)
        if first is None:
            return "None of these structures holds the box."
        return f"Best of these: {name_of(first.structure)}. {_moves(found, first)}"
    if not pd.holds:
        return f"PD does not hold the box: {pd.broken}."
    moves, much = _moves(found, pd), SMALL[found.objective.name][2]
    if best is None or best.worst >= pd.worst:
        others = [row for row in found.rows if row is not pd and (row.sensors, row.where) == (pd.sensors, pd.where)]
        why = "is better" if best is not None else "holds the box"
        return f"Leave PD: nothing else here on the same encoder and host {why}. {moves}" if others else moves
    name, more = name_of(best.structure), times(found, best.worst)
    if found.leave_pd:
        return f"Leave PD: the best here on the same encoder and host, {name}, is only {digits(more, '×', 3)} {much}. {moves}"
    return f"PD is not the best here: {name} makes the link {digits(more, '×', 2)} {much} {EQUAL}, without a sensor. {moves}"


def _moves(found: Comparison, row: Row) -> str:
    """Sentence on the worst objective of a row."""
    value, name = f"{thousandths(row.worst)} {unit(found.objective)}", name_of(row.structure)
    states = " and of the states" if len(found.joint.states) > 1 else ""
    box = f"at the worst of the box{states} ({uncertainty_text(found.system)})"
    if found.objective.name == "dynamic_stiffness":
        return f"With {name} a load moves the link by up to {value}, {box}."
    return f"With {name} it is {value}, {box}: {measure(found.objective)}."


def _others(found: Comparison) -> str:
    """Sentence on what other places and sensors buy, against PD; "" without a PD that holds the box."""
    pd = pd_row(found)
    if pd is None or not pd.holds:
        return ""
    every = [row for row in found.rows if row.holds and row is not pd]
    elsewhere = [row for row in every if row.sensors == pd.sensors and row.where != pd.where]
    sensed = [row for row in every if row.sensors != pd.sensors]
    parts = []
    if elsewhere:
        best = min(elsewhere, key=lambda row: row.worst)
        parts.append(f"{name_of(best.structure)} {_factor(found, best)}, no sensor needed")
    if sensed:
        best, without = (min(rows, key=lambda row: row.worst) for rows in (sensed, [pd, *(row for row in every if row not in sensed)]))
        share = without.worst / best.worst
        name = name_of(without.structure)
        worth = (
            f"{digits(share, '×', 2)} as stiff as the best of these without it, {name}"
            if share > 1
            else f"no better than {name} without it"
        )
        parts.append(f"a torque sensor {_factor(found, best)}, {worth}")
    return f"Against PD: {'; '.join(parts)}." if parts else ""


def _factor(found: Comparison, row: Row) -> str:
    return digits(times(found, row.worst), "×", 2)


def is_bounded(row: Row) -> bool:
    """True if the bound is of controllers such as a row's: on the position's encoder and the host alone."""
    return row.where == "host" and "torque" not in row.sensors


def _bound(found: Comparison) -> str:
    if found.bound is None:
        return ""
    pd = pd_row(found)
    value = f"{thousandths(found.bound)} {unit(found.objective)}"
    against = f", {digits(times(found, found.bound), '×', 2)} as stiff as PD" if pd is not None and pd.holds else ""
    best = min((row for row in found.rows if row.holds and is_bounded(row)), key=lambda row: row.worst, default=None)
    near = "" if best is None else f"; {name_of(best.structure)} is within {digits(best.worst / found.bound, '×', 2)} of that"
    return f"No linear controller on this encoder and the host, at this rate and delay, does better than {value}{against}{near}."


def best_known_sentence(found: Comparison) -> str:
    """Sentence on the best controller known beside the bound; "" where it was not asked for."""
    if found.bound is None or found.best_known is None:
        return ""
    value = found.best_known.value
    apart = digits(100 * (value / found.bound - 1), "%", 2)
    return (
        f"The best known linear controller, of any structure, reaches {thousandths(value)} {unit(found.objective)} at {found.bound_at}, "
        f"where the bound is proved, and for that joint alone: what can be reached there is at most {apart} above the bound."
    )


def missed_text(given: System, row: Row) -> str:
    """Sentence on requirements of the joint's file, or the usual ones, that a controller misses in the box; "" where there is none."""
    missed = row.missed(given.requirements)
    if not missed:
        return ""
    found = [f"{one.heading} {one.text(value)} ({one.sign} {one.text(needed)})" for one, needed, value in missed]
    held = "Structures are held to Ms, delay reserve and torque noise alone"
    return f"{held}: of what is required of the joint, {name_of(row.structure)} misses {listed(found)}."


def fragile_text(row: Row) -> str:
    """Table cell on the same structure tuned at nominal: in how many perturbed joints it is unstable."""
    one = row.fragile
    if one is None:
        return "–"
    if one.unstable:
        return f"{MISSED} {one.unstable} of {one.tried}"
    return f"{MISSED} {_worse(row)}" if one.fragile else f"0 of {one.tried}"


def _worse(row: Row) -> str:
    """How much worse the design tuned at nominal is in the box."""
    assert row.fragile is not None
    return f"{digits(row.fragile.worst / row.worst, '×', 2)} worse"


def fragile_sentence(found: Comparison) -> str:
    """Sentence on designs that look best at nominal values and fall apart; "" where there is none."""
    texts = []
    for row in found.rows:
        if row.fragile is not None and row.fragile.fragile:
            unstable = f"unstable in {row.fragile.unstable} of {row.fragile.tried} perturbed joints"
            texts.append(f"{name_of(row.structure)} ({unstable if row.fragile.unstable else _worse(row)})")
    if not texts:
        return ""
    return f"Fragile where tuned at the nominal values alone: {listed(texts, most=6)}. What stands here was tuned in the box."


@dataclass(frozen=True)
class Line:
    """Line of the table: a structure's row, or without one a `value` of the objective with its `name`, and `sign` before it."""

    found: Comparison
    row: Row | None
    value: float = math.nan
    name: str = ""
    sign: str = ""

    @property
    def worst(self) -> float:
        """Worst objective in the box."""
        return self.value if self.row is None else self.row.worst


def _of(value: Any) -> Any:
    """Function of a line from one of its row; a dash for the bound and for what was not found."""
    return lambda line: "–" if line.row is None or not line.row.holds else value(line.row)


BOUND_NAME, KNOWN_NAME = "no linear controller", "best known, one corner"
TABLE = [
    Column("structure", "", lambda line: line.name if line.row is None else name_of(line.row.structure)),
    Column("worst", "", lambda line: line.worst, shown=lambda line: _worst(line), definition="in the box"),
    Column("× PD", "", lambda line: times(line.found, line.worst), shown=lambda line: _against(line), definition="PD's worst over it"),
    Column("nominal", "", _of(lambda row: thousandths(row.objective)), definition="the same design at the nominal values"),
    Column("Ms", "", _of(lambda row: digits(row.worst_margins.peak_sensitivity, "", 3))),
    Column("reserve", "", _of(lambda row: digits(1e3 * row.delay_reserve, "ms", 3)), definition="any delay up to it may be added"),
    Column("noise", "", _of(lambda row: digits(row.noise, "N·m", 3)), definition="rms torque command"),
    Column("gap", "", _of(lambda row: gap_text(row)), definition="between the two best starts of the search"),
    Column("limited by", "", _of(lambda row: _limits(row)), definition="ceilings that it reaches in the box"),
    Column("fragile", "", _of(fragile_text), definition="tuned at nominal alone: unstable in so many perturbed joints"),
]
"""Columns of a Line."""
SHORT = [column for column in TABLE if column.title not in ("needs", "noise", "gap", "limited by")]
"""Columns on a terminal: the rest is in the names, or told where it matters."""


def _worst(line: Line) -> str:
    if line.row is None:
        return f"{line.sign} {thousandths(line.worst)}".strip()
    if line.row.holds:
        return thousandths(line.row.worst)
    return f"{MISSED} none"


def _against(line: Line) -> str:
    if line.row is not None and not line.row.holds:
        return "–"
    text = digits(times(line.found, line.worst), "×", 3)
    return f"≤ {text}" if line.sign else text


def _limits(row: Row) -> str:
    return ", ".join(CEILINGS[one.ceiling] for one in row.limited_by) or "none"


def limited_texts(found: Comparison) -> list[str]:
    """Sentences on the ceilings that limit each structure, and at which place of the box."""
    made = []
    for row in found.rows:
        if row.holds:
            reached = [f"{CEILINGS[one.ceiling]} at {one.at}" for one in row.limited_by]
            made.append(f"{name_of(row.structure)} is limited by {listed(reached) if reached else 'no ceiling: more would not help it'}.")
    return made


def gap_text(row: Row) -> str:
    """Gap of the two best starts, in percent."""
    return "–" if math.isnan(row.gap) else f"{digits(100 * row.gap, '%', 2)}" if row.gap >= 1e-3 else "< 0.1 %"


def lines(found: Comparison) -> list[Line]:
    """Lines of the table: the structures, then the best known controller and the bound."""
    known = [] if found.best_known is None else [Line(found, None, found.best_known.value, KNOWN_NAME)]
    bound = [] if found.bound is None else [Line(found, None, found.bound, BOUND_NAME, "≥")]
    return [*(Line(found, row) for row in found.rows), *known, *bound]


def broken_texts(found: Comparison) -> list[str]:
    """Sentences on what breaks the box, of every structure that does not hold it; PD's stands in the first sentence."""
    failed = [row for row in found.rows if not row.holds and row is not pd_row(found)]
    return [f"{name_of(row.structure)} does not hold the box: {row.broken}." for row in failed]


def ceilings_text(shown: "ComparisonPresentation") -> str:
    """Sentence on the ceilings of every structure, and where they come from."""
    found, given, settings = shown.found, shown.given, shown.settings
    ceilings, usual = found.ceilings, Requirements.usual().peak_sensitivity
    reserve = "limits" if "delay_reserve" in given.requirements.asked else "half of the delay"
    parts = [
        f"Ms ≤ {digits(ceilings.peak_sensitivity)} ({'usual' if ceilings.peak_sensitivity == usual else 'limits'})",
        f"delay reserve ≥ {digits(1e3 * ceilings.delay_reserve, 'ms', 3)} ({reserve})",
    ]
    if ceilings.torque_noise is not None:
        asked = settings.torque_noise is not None or "torque_noise" in given.requirements.asked
        noise = digits(ceilings.torque_noise, "N·m", 3)
        parts.append(f"torque noise ≤ {noise} rms ({'as asked' if asked else 'what the best PD makes'})")
    boxed = "The box is the file's" if given.uncertainty.names else "The file gives no ranges: the box is the usual one"
    return f"Held to, everywhere in the box: {', '.join(parts)}. {boxed}."


@dataclass(frozen=True)
class ComparisonPresentation(Presentation):
    """Presentation of a comparison.

    given     the joint as its file describes it
    settings  what was asked
    file      name of the file
    assumed   what was assumed where the file says nothing
    taken     row whose controller is written; None: none
    """

    found: Comparison
    given: System
    settings: ComparisonSettings
    file: str = "joint.yaml"
    assumed: Sequence[str] = ()
    taken: Row | None = None

    @property
    def chosen(self) -> Row | None:
        """Row that is written, or that may be used as the joint is."""
        return self.taken or winner(self.found)

    @property
    def advice(self) -> Advice | None:
        """Controller to use, as lines of `control`, and what to do with it."""
        row, written = self.chosen, self.files.get("Joint") or self.files.get("Robot")
        if row is None or row.controller is None:
            return None
        name = name_of(row.structure)
        if written is not None:
            single = self.found.joint.is_single
            judged = [f"gainroom joint {written}", f"gainroom simulate {written}"] if single else [f"gainroom robot {written}"]
            return Advice(f"{name} is in {written}:", judged)
        if not self.found.joint.is_single:
            return self._in_robot(row)
        lines = [] if type_of(row.controller.control.controller) == "lti" else control_lines(row.controller)
        copy = [f"{self.call} --write better.yaml", "gainroom joint better.yaml"]
        then = f"{'Or as' if lines else 'As'} a copy of {self.file} with these limits and this box:", copy
        return Advice(f"Use {name}{f', in {self.file} under control:' if lines else '.'}", lines, self._what_else, then=then)

    def _in_robot(self, row: Row) -> Advice:
        """Controller to use in one joint of a robot, as lines of `control` where a robot.yaml can hold it."""
        name, joint = name_of(row.structure), self.found.joint.name
        copy = f"{self.call} --write better.yaml --take"
        if row.robot is not None:
            lines = robot_gains(joint, row.robot)
            then = f"Or as a copy of {self.file}:", [f"{copy} {row.structure}", "gainroom robot better.yaml"]
            return Advice(f"Use {name} in {joint}, in {self.file} under control:", lines, self._what_else, then=then)
        pd = pd_row(self.found)
        held = pd is not None and pd.holds and pd.robot is not None
        then = ("The best PD, which it can hold, as a copy:", [f"{copy} pd", "gainroom robot better.yaml"]) if held else ("", [])
        why = f"{NOT_HELD}, and gainroom robot does not judge it."
        return Advice(f"Use {name} in {joint}:", control_lines(row.controller), [why, *self._what_else], then=then)  # type: ignore[arg-type]

    @property
    def _what_else(self) -> list[str]:
        """Remarks on what the drive's own loop would buy, and a torque sensor, where none was compared."""
        row, found = self.chosen, list[str]()
        driven = [one for one in self.found.rows if one.holds and one.where != "host" and "torque" not in one.sensors]
        best = min(driven, key=lambda one: one.worst, default=None)

        def take(one: Row) -> str:
            return f" (`--take {one.structure}`)" if self.found.joint.is_single else ""

        if best is not None and row is not None and row is not best and best.worst < row.worst:
            found.append(f"If the drive can run kd: {name_of(best.structure)} is {_factor(self.found, best)} PD{take(best)}.")
        asked = self.given.requirements
        if row is not None and self.found.joint.is_single and row.missed(asked):
            keepers = [one for one in self.found.rows if one.holds and one.worst_margins is not None and not one.missed(asked)]
            keeper = min(keepers, key=lambda one: one.worst, default=None)
            if keeper is not None:
                found.append(f"Of those that keep all that is required of the joint: {name_of(keeper.structure)}{take(keeper)}.")
        if "torque" not in self.found.ceilings.sensor_noise and math.isfinite(self.given.source.stiffness):
            found.append("What a torque sensor would buy: the same with `--torque-sensor 0.05`, its noise in N·m rms.")
        return found

    @property
    def all_assumed(self) -> list[str]:
        """Assumptions where the file says nothing, that on the drive's own loop among them."""
        path = next((one for row in self.found.rows if row.controller and (one := row.controller.control.kd_path)), None)
        if path is None or self.settings.path is not None:
            return list(self.assumed)
        own = f"the drive's own loop runs at {rate(1 / path.sample_time)}, {digits(1e3 * path.delay, 'ms', 3)} late (compare.drive_path)"
        return [*self.assumed, own]

    @property
    def cautions(self) -> list[str]:
        """Sentences to know before the controller to use is run."""
        row = self.chosen
        if row is None or row.worst_margins is None:
            return []
        limits = missed_text(self.given, row) if self.found.joint.is_single else ""  # else they are of all joints
        return [*filter(None, [lower_gains(row.worst_margins.limit), limits])]

    def facts(self) -> dict[str, Any]:
        found = self.found
        return {
            "sentence": sentence(found),
            "joint": None if found.joint.is_single else joint_facts(found),
            "findings": findings(found),
            "objective": {"name": found.objective.name, "below_rad_s": found.objective.below},
            "recommended": None if self.chosen is None else self.chosen.structure,
            "rows": [row_facts(found, row) for row in found.rows],
            "bound": None if found.bound is None else bound_facts(found),
            "best_known": None if found.best_known is None else best_known_facts(found, found.best_known),
            "ceilings": {
                "peak_sensitivity": found.ceilings.peak_sensitivity,
                "delay_reserve_ms": 1e3 * found.ceilings.delay_reserve,
                "torque_noise": found.ceilings.torque_noise,
                "sensor_noise": dict(found.ceilings.sensor_noise),
            },
            "box": {name: [float(end) for end in getattr(found.system.uncertainty, name)] for name in found.system.uncertainty.names},
            "cautions": self.cautions,
            "assumed": self.all_assumed,
        }

    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        found = self.found
        model = f"{measure(found.objective)} [{unit(found.objective)}], {rate(1 / (self.given.control.sample_time or 1.0))}"
        yield [
            sentence(found),
            *filter(None, [best_known_sentence(found), fragile_sentence(found)]),
            *broken_texts(found),
            "",
            TextTable.of(capital(model), TABLE if verbose else SHORT, lines(found), ("reserve", "nominal", "Ms", "gap", "needs")),
            ceilings_text(self),
            *(limited_texts(found) if verbose else []),
            *self.cautions,
            *do_this(self.advice),
            *closing(self.files, assumed=self.all_assumed, notes=[*unsure(found), *(not_asked(found) if verbose else [])]),
        ]


WIDE = 78
"""Most characters of a line to type."""


def control_lines(system: System) -> list[str]:
    """Lines of `control` in a joint.yaml, without what the file has already."""
    found = []
    for key, value in control_section(system).items():
        if key not in ("sample_rate_hz", "feedback") or (key == "feedback" and isinstance(value, dict)):
            found += wrapped(f"{key}: {plain(value)}")
    return found


def wrapped(line: str) -> list[str]:
    """Line to type as lines of at most WIDE characters, broken behind commas."""
    found = []
    while len(line) > WIDE and (cut := line.rfind(", ", 0, WIDE)) > 0:
        found.append(line[: cut + 1])
        line = "  " + line[cut + 2 :]
    return [*found, line]


def robot_gains(joint: str, robot: System) -> list[str]:
    """Lines of `control` in a robot.yaml with other gains in one joint."""
    return [f"{key}: {plain(value)}" for key, value in gains_section(joint, robot).items()]


def unsure(found: Comparison) -> list[str]:
    """Notes on searches whose two best starts ended apart, and on a bound that was not found."""
    rows = [f"{name_of(row.structure)} {gap_text(row)}" for row in found.rows if row.gap > UNSURE]
    told = [f"the two best starts of a search ended apart, so a better design may be left: {listed(rows, most=6)}"] if rows else []
    if not found.joint.is_single and any(row.where != "host" and row.holds for row in found.rows):
        told.append(
            "with kd in the drive of one joint, stability is counted with both rates; Ms and reserve are of the search, without aliases"
        )
    return told + ([f"no bound: {found.unbounded}"] if found.unbounded else [])


def not_asked(found: Comparison) -> list[str]:
    """Note on the flag that tells how near a controller comes to the bound; [] where it was given, or there is no bound."""
    if found.bound is None or found.best_known is not None:
        return []
    return ["how near any linear controller is known to come to the bound: --best-known (pip install 'gainroom[compare]')"]


def joint_facts(found: Comparison) -> dict[str, Any]:
    """JSON of the joint of a robot: its name, the state in which it was tuned, and all that its ceilings were looked at in."""
    states = [{"posture": posture, "contact": contact} for posture, contact in found.joint.states]
    return {"name": found.joint.name, "state": states[0], "states": states}


def row_facts(found: Comparison, row: Row) -> dict[str, Any]:
    """JSON of a row."""
    return {
        "structure": row.structure,
        "name": name_of(row.structure),
        "controller": None if row.controller is None else control_section(row.controller),
        "parameters": dict(row.parameters),
        "nominal": row.objective,
        "worst": row.worst,
        "worst_at": row.worst_at,
        "times_pd": times(found, row.worst),
        "holds": row.holds,
        "broken": row.broken,
        "margins": None if row.margins is None else facts(MARGIN, row.margins),
        "lower_gain_limit": None if row.worst_margins is None else row.worst_margins.limit.lower_gain,
        "worst_margins": None if row.worst_margins is None else facts(MARGIN, row.worst_margins),
        "places_proved": row.proved,
        "delay_reserve_ms": 1e3 * row.delay_reserve,
        "torque_noise": row.noise,
        "sensors": list(row.sensors),
        "runs": row.where,
        "gap": row.gap,
        "limited_by": [{"ceiling": one.ceiling, "share": one.share, "at": one.at} for one in row.limited_by],
        "fragile": None if row.fragile is None else _fragile_facts(row),
        "robot_holds": None if found.joint.is_single else row.robot is not None,
    }


def _fragile_facts(row: Row) -> dict[str, Any]:
    one = row.fragile
    assert one is not None
    return {
        "fragile": one.fragile,
        "nominal": one.objective,
        "worst": one.worst,
        "unstable": one.unstable,
        "tried": one.tried,
        "parameters": dict(one.parameters),
    }


def bound_facts(found: Comparison) -> dict[str, Any]:
    """JSON of the bound with its certificate."""
    certificate = None if found.certificate is None else json.loads(found.certificate.to_json())
    return {
        "value": found.bound,
        "at": found.bound_at,
        "times_pd": times(found, found.bound or math.nan),
        "certificate": certificate,
    }


def best_known_facts(found: Comparison, known: BestKnown) -> dict[str, Any]:
    """JSON of the best known controller, which is one at the place of the bound alone."""
    return {
        "value": known.value,
        "at": found.bound_at,
        "times_pd": times(found, known.value),
        "sensors": list(known.sensors),
        "peak_sensitivity": known.peak_sensitivity,
        "delay_share": known.delay_share,
        "torque_noise": known.torque_noise,
    }


def findings(found: Comparison) -> list[dict[str, Any]]:
    """JSON of what a program would act on: leave PD or not, boxes that do not hold, fragile designs."""
    pd, best, made = pd_row(found), found.best_beside_pd, list[dict[str, Any]]()
    if pd is not None and pd.holds and best is not None:
        code = "leave_pd" if found.leave_pd else "pd_beaten"
        made.append({"code": code, "structure": best.structure, "times_pd": times(found, best.worst)})
    made += [{"code": "box_not_held", "structure": row.structure, "broken": row.broken} for row in found.rows if not row.holds]
    return made + [
        {"code": "fragile", "structure": row.structure, "unstable": row.fragile.unstable, "tried": row.fragile.tried}
        for row in found.rows
        if row.fragile is not None and row.fragile.fragile
    ]
