"""Page of an audit: verdict, gains to use, numbers, failures, vibration, and, folded below, all tables and methods."""

import math
import re
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from ..errors import apart, at_frequency, listed
from ..studies.audit import Audit
from ..system.linear.arrays import Floats, first_least, rank
from ..system.margin_units import to_db
from ..system.requirement import Requirement, enough
from ..system.requirements import REQUIREMENTS
from . import style
from .audit_text import AuditPresentation, audit_sentence, audit_warnings, besides, reason, verdict, what_to_do
from .columns import Column, alike_rows, definitions, shared_row, tabulated, yes
from .gearboxes import gearbox_assumptions
from .margin_columns import margin_value, requirement
from .number_format import digits, hertz, model_kind, rate, span
from .page import Card, Html, Lead, Section, advice_box, beside, facts, figure, page, paragraph, table
from .page_parts import ON_TOP, assumed_and_warned, assumptions, limit_proofs, margin_card, unstable_card
from .robot_columns import asked, audited_joints, audited_states, joint_caption
from .robot_drawing import hero, small
from .robot_headroom import TOGETHER, coupling, heat_map, joint_factors
from .robot_skeleton import common_view
from .robot_tables import inputs
from .robot_units import joint_units
from .sweep_text import counted
from .words import in_simulator, safe_means, tone
from .workspace import advice_there, in_workspace, workspace_card, workspace_section

UNSAFE_STATES = 3
"""Index of the card of unsafe states."""

if TYPE_CHECKING:
    from ..studies.simulator_audit import SimulatorAudit
MOST_ROWS = 12
"""Most rows of the headroom picture, the tightest; the heat map has all joints."""
ALIKE = 5e-3
"""Relative difference of least factors up to which joints of both sides share a row."""
PATHS = "kp or kd by itself"
WHOLE = (TOGETHER, PATHS)
"""Names of the rows that belong to no joint."""
WIDEST = 30.0
"""Largest ratio of the factors on the axis; factors beyond are drawn at its end."""


def audit_page(shown: AuditPresentation, command: str) -> str:
    """HTML page of an audit; `command`: the command that makes it."""
    result, simulated, swept = shown.result, shown.simulated, shown.swept
    system, factors, count = result.system, joint_factors(result), len(result.joints)
    assumed = (*system.assumptions, *gearbox_assumptions(result))
    sample_time, further = system.control.sample_time, audit_warnings(result)[ON_TOP:]
    taken = assumptions(f"Linear about posture {result.tightest.posture}", system.control, "; contacts neither slip nor lift")
    headings, texts = tabulated(audited_joints(result), result.joints)
    joints = table(headings, [shared_row(texts, group) for group in alike_rows(texts)], joint_caption(result, headings))
    sections = [
        *_reasons(result),
        None
        if swept is None
        else workspace_section(swept.summary, f"The workspace: {counted(swept.summary.plan.postures.count)} postures", audited=swept),
        None if simulated is None else Section("In the simulator", _simulator(simulated)),
        Section("Joint by joint", [joints], f"{count} joints with their gains and factors"),
        Section(
            "State by state",
            [_state_table(result), heat_map(factors, "joint")],
            f"each joint in {listed([state.contact for state in result.every])}",
        ),
        Section("Vibration by state", _vibrations(result), "each at its own gain limit") if len(result.states) > 1 else None,
        Section("Cost of coupling", [beside(*coupling(factors, "joint"))], "each joint alone, and with all others closed"),
        Section(
            "Inputs and assumptions",
            [inputs(system), taken, *assumed_and_warned(assumed, further)],
            f"what was read, and {len(assumed)} assumptions",
        ),
        Section("Certification", [_certificate(result)], "how each number was checked"),
    ]
    title = f"gainroom audit: gains of {count} joints, {model_kind(sample_time)} model"
    cards = _cards(result)
    if swept is not None:  # a workspace says more than whether one state is safe
        cards[UNSAFE_STATES : UNSAFE_STATES + (len(result.states) == 1)] = [workspace_card(swept)]
    return page(title, _lead(shown), cards, sections, command)


def _reasons(result: Audit) -> list[Section]:
    """Unfolded sections: the picture of the failure, the basis of the verdict, and the motion."""
    gain, picture = _gain_margin_text(result), [headroom(result)]
    if result.safe:
        first = [Section(f"Gain margin {gain}", picture)]
    elif "gain_margin" in result.missed:
        first = [Section(f"What fails: gain margin {gain}", picture)]
    else:
        names = {name for state in result.states for name in result.joints_that_miss_in(state)}
        joints = [joint.name for joint in result.joints if joint.name in names]
        where = [paragraph(f"Joints whose loops miss it, or that move there: {listed(joints)}.")] * bool(joints)
        unknown = all(math.isnan(result.value_in(result.worst[one.name], one)) for one in (REQUIREMENTS[name] for name in result.missed))
        what = "; ".join(besides(result))
        first = [
            Section(f"{what[0].upper()}{what[1:]}", []) if unknown else Section(f"What fails: {what}", where),
            Section(f"Gain margin {gain}, is enough", picture),
        ]
    return [
        *first,
        Section("The motion of the vibration", [hero(result.tightest, len(result.states) == 1)]),
    ]


def _gain_margin_text(result: Audit) -> str:
    """Gain margin of the row with the least headroom, with its state, as text."""
    row = row_of_verdict(result, headroom_rows(result))
    state = result.states[first_least(row.factors)] if math.isfinite(row.least) else result.tightest
    where = f" in {state.contact}" if len(result.states) > 1 else ""
    return f"{REQUIREMENTS['gain_margin'].text(row.least)} ({digits(row.least, '×', apart(row.least, 1, 3))}), {row.title}{where}"


def _lead(shown: AuditPresentation) -> Lead:
    result, swept = shown.result, shown.swept
    warnings, do, sentence = list(audit_warnings(result)[:ON_TOP]), _do_this(result, shown.call), verdict(result)
    if not result.stable and result.to_use is None and not result.withheld:
        sentence = audit_sentence(result)
    sentence = in_workspace(in_simulator(sentence, shown.simulated), swept)
    if swept is not None and not swept.safe:
        advice = advice_there(swept)
        if result.safe:
            do = advice_box(advice)
        else:
            warnings.insert(0, " ".join([*advice.remarks, advice.heading]))
    how = tone(shown.verdict)
    where = " in the simulator: do not train with" if result.stable else ": do not run"
    return Lead(sentence, how, f"UNSTABLE{where} these gains" if how == "bad" else "", warnings, do)


def _do_this(result: Audit, call: str) -> Html | str:
    """Advice box with the margins of these gains and of the gains to use."""
    found = what_to_do(result, call)
    if not result.stable and result.to_use is None:
        return advice_box(found)
    units = joint_units(result.system.source.body)
    caption = "" if result.ready_to_use is None else f"kp {units['kp']}, kd {units['kd']}"
    beside_it = table(*tabulated(audited_margins(result), shown_requirements(result)), caption, sorts=False)
    return advice_box(found, beside_it, paragraph(reason(result)))


def _cards(result: Audit) -> list[Card]:
    """Cards of the required margins, the delay, the joints and the gearboxes, each the worst of all states."""
    worst, asked = result.tightest, result.required
    limit = worst.limit
    first, paths = unstable_card(asked, limit, f", {worst.contact}", worst.contact), worst.margins.paths
    if limit.stable and paths is not None and paths.headroom < limit.gain:
        first = margin_card(asked, "gain_margin", paths.headroom, f"{PATHS}, up or down, {worst.contact}")
    elif limit.stable:
        first = margin_card(
            asked, "gain_margin", limit.gain, f"all gains together{at_frequency(limit.frequency, ', ', hertz)}, {worst.contact}"
        )
    extra = result.least_extra_delay if result.stable else math.nan
    until = digits(1e3 * result.delay_limit, "ms", apart(result.delay_limit, result.system.delay, 3))
    delay = Card(
        "delay margin",
        digits(1e3 * extra, "", 3),
        "ms" if math.isfinite(extra) else "",
        requirement(asked, "delay_margin", 3),
        None if not result.delay_margin or (math.isnan(extra) and result.stable) else enough(extra, result.delay_margin),
        f"vibrates from {until} of delay, {digits(1e3 * result.system.delay, 'ms', 3)} given" if 0 < result.delay_limit < math.inf else "",
    )
    failing = [joint for joint in result.joints_tightest_first if joint.safe is False]
    open_still = sum(joint.safe is None for joint in result.joints)
    rows = tabulated(audited_joints(result), failing)[1]
    joints = [shared_row(rows, group)[0] for group in alike_rows(rows)]
    held = None if open_still and not joints else not joints
    base = "no contacts" if result.system.source.body.base == "floating" else "fixed base, no contacts"
    judged = listed([state.contact if state.model.contacts else f"{state.contact} ({base})" for state in result.states])
    note = f"{f'{listed(joints)}; ' if joints else ''}{f'not known of {open_still}; ' if open_still else ''}judged: {judged}"
    return [
        first,
        *(_margin(result, one) for one, _ in asked.asked_for if result.stable and one.name not in ("gain_margin", "delay_margin")),
        delay,
        Card(
            "joints that fail",
            str(len(failing)),
            f"of {len(result.joints)}",
            "none allowed",
            held,
            note,
        ),
        _gearboxes(result),
    ]


def _margin(result: Audit, one: Requirement) -> Card:
    """Card of one requirement's margin in the contact state with the least of it, its frequency, and whether it is met."""
    state = result.worst[one.name]
    where = f"{at_frequency(one.frequency(state.counted), '', hertz)}, {state.contact}".lstrip(", ")
    label = one.titled(state.counted, len(result.joints) > 1)
    return margin_card(result.required, one.name, result.value_in(state, one), where, label=label)


def _gearboxes(result: Audit) -> Card:
    """Card of the gearbox stiffness that the verdict is based on."""
    actuators, rigid = result.system.source.actuators, result.assumed_rigid
    units, count = joint_units(result.system.source.body), int(np.count_nonzero(rigid))
    revolute = units["kp"].partition(";")[0]
    if rigid.all():
        return Card("gearboxes", "rigid", "", "assumed", note="optimistic; give yours with --stiffness and --damping")
    value, known = span(actuators.stiffness[~rigid]), "as given" if result.over is None else "the worst of the range"
    others = f"; {count} rigid" if count else ""
    return Card("gearbox stiffness", value, revolute, known, note=f"damping {span(actuators.damping[~rigid], units['kd'])}{others}")


def _vibrations(result: Audit) -> list[Html]:
    view = common_view(result.states)
    return [beside(*(small(state, state.limit, view, 0) for state in result.states))]


def _state_table(result: Audit) -> Html:
    columns = audited_states(result.enough_in)
    headings, texts = tabulated(columns, result.states + result.immobile)
    return table(headings, texts, f"{definitions(columns, headings)} {safe_means(asked(result))}.")


def _simulator(result: "SimulatorAudit") -> list[Html]:
    from .simulator_text import simulator_assumptions, simulator_sentence  # loads MuJoCo's side

    return [paragraph(simulator_sentence(result)), facts([("assumed", text) for text in simulator_assumptions(result)])]


def _certificate(result: Audit) -> Html:
    pairs = limit_proofs(result.states, result.immobile)
    pairs += [
        ("one loop at a time", "each loop's own curve with the other loops closed, sampled until smooth; its crossings polished"),
        ("delay", "the smallest extra delay in all loops at which a locus passes through −1; for unstable gains, counted from zero delay"),
    ]
    return facts(pairs)


def shown_requirements(result: Audit) -> list[Requirement]:
    """All requirements, required ones first."""
    return sorted((REQUIREMENTS[name] for name in result.worst), key=lambda one: one.name not in result.required.asked)


def audited_margins(result: Audit) -> list[Column]:
    """Columns with requirements as rows: the margin of the present gains in the worst state, and of the gains to use, if any."""
    step, required = result.system.control.sample_time, result.required

    def value(one: Requirement, found: Audit) -> float:
        if not found.stable:  # of an unstable robot only by how much the gains are too high
            return found.tightest.limit.gain if one.name == "gain_margin" else math.nan
        return found.value_in(found.worst[one.name], one)

    def met(one: Requirement) -> bool | None:
        return required.met(one.name, value(one, result)) and result.stable

    def unknown(one: Requirement) -> bool:
        return result.stable and math.isnan(value(one, result))

    columns = [
        Column(
            "in continuous time" if step is None else f"at {rate(1 / step)}",
            "",
            lambda one: one.titled(result.worst[one.name].counted, len(result.joints) > 1),
        ),
        Column("these gains", "", lambda one: margin_value(required, one.name, value(one, result), met(one), 3)),
        Column("required", "", lambda one: requirement(required, one.name, 3) or "not required"),
        Column("met", "", lambda one: "" if met(one) is None else "not known" if unknown(one) else yes(met(one))),
    ]
    if result.ready_to_use is not None:
        use = result.ready_to_use.audited
        columns.append(Column("new gains", "", lambda one: margin_value(required, one.name, value(one, use), None, 3)))
    return columns


@dataclass(frozen=True)
class HeadroomRow:
    """Row of the headroom figure: by state (k,) the factor on the gains at which vibration starts; NaN: none.

    A row may stand for several joints that differ in their side ("left", "right") alone: `sides`. It then has their least factors.
    """

    name: str
    sides: tuple[str, ...]
    factors: Floats

    @property
    def title(self) -> str:
        """Names of its joints, for a sentence."""
        return ", ".join(f"{side}{self.name}" for side in self.sides) or self.name

    @property
    def least(self) -> float:
        """Least factor over the states."""
        return float(np.min(self.factors, initial=math.inf, where=~np.isnan(self.factors)))


def headroom_rows(result: Audit) -> list[HeadroomRow]:
    """Rows of the headroom picture: all gains together, single paths if kd has its own, and every joint as judged, least headroom first."""
    rows = [HeadroomRow(TOGETHER, (), np.array([state.limit.gain for state in result.states]))]
    paths = [state.margins.paths for state in result.states]
    if any(path is not None for path in paths):
        rows.append(HeadroomRow(PATHS, (), np.array([math.nan if path is None else path.headroom for path in paths])))
    judged = np.array([result.joint_limits_in(state) for state in result.states])
    joints: list[HeadroomRow] = []
    for name, factors in zip(result.system.source.joint_names, judged.T, strict=True):
        side, _, rest = re.sub(r"([^A-Za-z0-9]+)", r"\0\1", name, count=1).partition("\0")
        own = HeadroomRow(rest, (side,), factors) if rest else HeadroomRow(name, (), factors)
        twin = next(
            (k for k, row in enumerate(joints) if own.sides and row.name == rest and math.isclose(row.least, own.least, rel_tol=ALIKE)),
            None,
        )
        if twin is None:
            joints.append(own)
        else:
            joints[twin] = HeadroomRow(rest, (*joints[twin].sides, side), np.fmin(joints[twin].factors, factors))
    single = [HeadroomRow(row.title, (), row.factors) if len(row.sides) == 1 else row for row in joints]
    return rows + sorted(single, key=lambda row: rank(row.least))


def row_of_verdict(result: Audit, rows: list[HeadroomRow]) -> HeadroomRow:
    """Row that the verdict names, the least of those that count: all gains together and single paths.

    For a stable robot that misses the gain margin the rows of joints count too.
    """
    short = result.stable and "gain_margin" in result.missed
    return min([row for row in rows if short or row.name in WHOLE], key=lambda row: rank(row.least))


def _is_named(result: Audit) -> bool:
    """True if the verdict rests on a factor on the gains: they are safe, or a gain margin is missed."""
    return result.safe or "gain_margin" in result.missed


def headroom(result: Audit) -> Html:
    """Figure of the factors at which vibration starts: a row for all gains together and for each of the tightest joints.

    A row has a mark for each contact state: the worst is filled, the one that the verdict names is a star.
    """
    every = headroom_rows(result)
    rows = every[:MOST_ROWS]
    decides = row_of_verdict(result, every) if _is_named(result) else None
    known = [value for row in rows for value in row.factors.tolist() if math.isfinite(value) and value > 0]
    low, high = min([1.0, *known]), max([result.margin, *known])
    right = max(1.7 * min(high, WIDEST * low), 7.6 * low)
    left, far = (low * (low / right) ** share for share in (0.2, 0.6))  # room for a number left of its mark, where its row has no other
    edge = (right / left) ** 0.02
    traces, numbers = [], []
    for place, row in enumerate(rows):
        worst = first_least(row.factors) if not np.isnan(row.factors).all() else -1
        for k, value in enumerate(row.factors.tolist()):
            if math.isnan(value) or (k != worst and value < row.least * (1 + ALIKE)):
                continue  # under the worst one's mark
            color = style.BLUE if value >= result.margin else style.VERMILION
            symbol, size = ("star", 20) if row is decides and k == worst else ("circle", 12) if k == worst else ("circle-open", 9)
            hover = f"{escape(row.title)}<br>{escape(result.states[k].contact)}<br>{digits(value, '×')} ({_level(value)})"
            x = min(max(value, left * edge), right / edge)
            mark = style.markers([x], [place], symbol, color, size)
            traces.append(mark | {"hoverinfo": "text", "hovertext": [hover], "cliponaxis": False})
            if k == worst:
                beside = {"xanchor": "left", "xshift": 0.6 * size} if value < x else {"xanchor": "right", "xshift": -0.6 * size}
                numbers.append(style.label(math.log10(x), place, digits(value, "×", 3), **beside))
    names = [f"<b>{row.name}</b>" if row.name == TOGETHER else _label(row) for row in rows]
    words = {"yref": "paper", "yanchor": "bottom", "bgcolor": "rgba(0,0,0,0)"}
    picture = style.layout(
        xaxis=style.log_axis("factor on the gains at which vibration starts [×]", left, right, fixedrange=True),
        yaxis=style.axis("", tickvals=list(range(len(rows))), ticktext=names, range=[len(rows) - 0.4, -0.6], fixedrange=True, ticks=""),
        shapes=[
            style.stretch(far, result.margin, style.UNSTABLE_GROUND, 1.0),
            style.upright(1.0, style.INK, "dot", 1.4),
            style.upright(result.margin, style.VERMILION, "solid", 2),
        ],
        annotations=[
            *numbers,
            style.label(0.0, 1, "these gains", style.SOFT, **words, xanchor="right" if result.margin < 1.5 else "center", name="wide"),
            style.label(math.log10(result.margin), 1, f"required {digits(result.margin, '×', 4)}", style.VERMILION, **words),
        ],
        margin={"l": 20, "r": 24, "t": 30, "b": 48},
    )
    narrow = {"margin.l": 8, "margin.r": 8, "xaxis.title.text": "factor [×]", "xaxis.range": [math.log10(far), math.log10(right)]}
    return figure(
        {"data": traces, "layout": picture}, _title(result), _caption(result, len(every) - len(rows)), 32 * len(rows) + 96, narrow
    )


def _level(value: float) -> str:
    return digits(to_db(value), "dB", 3) if value > 0 else "stable at no factor"


def _label(row: HeadroomRow) -> str:
    """Row label: the name, and in smaller letters its sides."""
    below = f'<br><span style="font-size:11px;color:{style.SOFT}">{escape(", ".join(row.sides), quote=False)}</span>' if row.sides else ""
    return escape(row.name.lstrip("_- ") if row.sides else row.name, quote=False) + below


def _title(result: Audit) -> str:
    others = "the other loops closed" if result.stable else "all others switched off"
    return (
        f"Factor on the gains at which vibration starts, {f'of each joint, {others}, and ' if len(result.joints) > 1 else ''}all together"
    )


def _caption(result: Audit, hidden: int) -> str:
    paths = any(state.margins.paths is not None for state in result.states)
    words = "Factors on kp or kd by itself count up and down: at 10 × also a tenth. " if paths else ""
    words += "Star: what the verdict names. " if _is_named(result) else ""
    words += "Dotted: factor 1, these gains; what vibrates at less is unstable. Left of the other line the margin is too small."
    if len(result.states) > 1:
        words += " Filled: the worst state; open: the others."
    return words + (f" {hidden} more rows with no less headroom are not drawn; the tables below have all joints." if hidden > 0 else "")
