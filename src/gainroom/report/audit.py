"""The page of an audit: verdict, gains to use, numbers, what fails, the vibration, and closed below all tables and how it was computed."""

import math
from typing import TYPE_CHECKING

import numpy as np

from ..errors import apart, at_frequency, listed
from ..studies.audit import Audit
from ..system.linear.arrays import first_least
from ..system.requirement import Requirement, enough
from ..system.requirements import REQUIREMENTS
from .audit_advice import what_to_do
from .audit_headroom import PATHS, headroom, headroom_rows, row_of_verdict
from .audit_text import audit_sentence, audit_warnings, besides, reason, verdict
from .columns import Column, definitions, tabulated, yes
from .gearboxes import gearbox_assumptions, needed_table
from .margin_columns import margin_value, requirement
from .number_format import digits, hertz, model_kind, rate, rounded_up, span
from .page import Card, Html, Lead, Section, advice_box, beside, facts, page, paragraph, table
from .page_parts import ON_TOP, assumed_and_warned, assumptions, limit_proofs, margin_card, unstable_card
from .robot_columns import asked, audited_joints, audited_states, joint_caption
from .robot_drawing import hero, small
from .robot_headroom import coupling, heat_map, joint_factors
from .robot_skeleton import common_view
from .robot_tables import inputs
from .robot_units import joint_units
from .sweep_text import counted
from .words import in_simulator, safe_means, tone
from .workspace import advice_there, in_workspace, workspace_card, workspace_section

UNSAFE_STATES = 3
"""The place of that card."""

if TYPE_CHECKING:
    from ..studies.audited_workspace import AuditedWorkspace
    from ..studies.simulator_audit import SimulatorAudit


def audit_page(
    result: Audit,
    command: str,
    simulated: "SimulatorAudit | None" = None,
    swept: "AuditedWorkspace | None" = None,
    call: str = "gainroom audit MODEL --delay-ms MS",
) -> str:
    """The report of an audit as one HTML page.

    command     that makes it
    simulated   the simulator's answer
    swept       the whole workspace
    call        the command of this audit alone, to go on from
    """
    system, factors, count = result.system, joint_factors(result), len(result.joints)
    assumed = (*system.assumptions, *gearbox_assumptions(result))
    sample_time, further = system.control.sample_time, audit_warnings(result)[ON_TOP:]
    taken = assumptions(f"Linear about posture {result.tightest.posture}", system.control, "; contacts neither slip nor lift")
    headings, texts = tabulated(audited_joints(result), result.joints)
    joints = table(headings, texts, joint_caption(result, headings))
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
    return page(title, _lead(result, simulated, swept, call), cards, sections, command)


def _reasons(result: Audit) -> list[Section]:
    """What is open: the picture of what fails, what the verdict rests on, and the motion."""
    gain, picture = _gain_margin_text(result), [headroom(result)]
    if result.safe:
        first = [Section(f"Gain margin {gain}", picture)]
    elif "gain_margin" in result.missed:
        first = [Section(f"What fails: gain margin {gain}", picture)]
    else:
        names = {name for state in result.states for name in result.joints_that_miss_in(state)}
        joints = [joint.name for joint in result.joints if joint.name in names]
        where = [paragraph(f"Joints whose loops miss it, or that move there: {listed(joints)}.")]
        unknown = all(math.isnan(result.value_in(result.worst[one.name], one)) for one in (REQUIREMENTS[name] for name in result.missed))
        what = "; ".join(besides(result))
        first = [
            Section(f"{what[0].upper()}{what[1:]}", []) if unknown else Section(f"What fails: {what}", where),
            Section(f"Gain margin {gain}, is enough", picture),
        ]
    return [
        *first,
        *([] if result.needed is None else [Section("Elastic gearboxes that were checked", [needed_table(result, result.needed)])]),
        Section("The motion of the vibration", [hero(result.tightest, len(result.states) == 1)]),
    ]


def _gain_margin_text(result: Audit) -> str:
    """The row with the least headroom, in its state."""
    row = row_of_verdict(result, headroom_rows(result))
    state = result.states[first_least(row.factors)] if math.isfinite(row.least) else result.tightest
    where = f" in {state.contact}" if len(result.states) > 1 else ""
    return f"{REQUIREMENTS['gain_margin'].text(row.least)} ({digits(row.least, '×', apart(row.least, 1, 3))}), {row.title}{where}"


def _lead(result: Audit, simulated: "SimulatorAudit | None", swept: "AuditedWorkspace | None", call: str) -> Lead:
    said, do, sentence = list(audit_warnings(result)[:ON_TOP]), _do_this(result, call), verdict(result)
    if not result.stable and result.to_use is None and not result.withheld:
        sentence = audit_sentence(result)
    sentence = in_workspace(in_simulator(sentence, simulated), swept)
    if swept is not None and not swept.safe:
        advice = advice_there(swept)
        if result.safe:
            do = advice_box(advice)
        else:
            said.insert(0, " ".join([*advice.remarks, advice.heading]))
    how = tone(result.verdict_with(simulated, swept))
    where = " in the simulator: do not train with" if result.stable else ": do not run"
    return Lead(sentence, how, f"UNSTABLE{where} these gains" if how == "bad" else "", said, do)


def _do_this(result: Audit, call: str) -> Html | str:
    """What to do, with the margins of these gains and of those to use."""
    found = what_to_do(result, call)
    if not result.stable and result.to_use is None:
        return advice_box(found)
    units = joint_units(result.system.source.body)
    caption = "" if result.ready_to_use is None else f"kp {units['kp']}, kd {units['kd']}"
    beside_it = table(*tabulated(audited_margins(result), shown_requirements(result)), caption, sorts=False)
    return advice_box(found, beside_it, paragraph(reason(result)))


def _cards(result: Audit) -> list[Card]:
    """The margins that are required, the delay, the joints and the gearboxes, each the worst of all states."""
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
    joints = [joint.name for joint in result.joints_tightest_first if not joint.safe]
    base = "no contacts" if result.system.source.body.base == "floating" else "fixed base, no contacts"
    judged = listed([state.contact if state.model.contacts else f"{state.contact} ({base})" for state in result.states])
    note = f"{f'{listed(joints)}; ' if joints else ''}judged: {judged}"
    return [
        first,
        *(_margin(result, one) for one, _ in asked.asked_for if result.stable and one.name not in ("gain_margin", "delay_margin")),
        delay,
        Card("joints that fail", str(len(joints)), f"of {len(result.joints)}", "none allowed", not joints, note),
        _gearboxes(result),
    ]


def _margin(result: Audit, one: Requirement) -> Card:
    """What a requirement bounds, in the state that has least left of it."""
    state = result.worst[one.name]
    where = f"{at_frequency(one.frequency(state.counted), '', hertz)}, {state.contact}".lstrip(", ")
    label = one.titled(state.counted, len(result.joints) > 1)
    return margin_card(result.required, one.name, result.value_in(state, one), where, label=label)


def _gearboxes(result: Audit) -> Card:
    """What the verdict takes them for, or needs of them."""
    actuators, rigid = result.system.source.actuators, result.assumed_rigid
    units, count = joint_units(result.system.source.body), int(np.count_nonzero(rigid))
    revolute = units["kp"].partition(";")[0]
    if result.needed is not None and result.needed.least is not None:
        least = np.where(result.needed.unknown, result.needed.least.stiffness, 0.0)
        name = result.joints[first_least(-least)].name
        return Card(
            "checked gearboxes hold from", digits(rounded_up(float(least.max()))), revolute, "not known", note=f"{name}, the stiffest"
        )
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
    """What is required first; then what is not."""
    return sorted(REQUIREMENTS.values(), key=lambda one: one.name not in result.required.asked)


def audited_margins(result: Audit) -> list[Column]:
    """Of requirements: what the present gains have of each, in the worst state, and those to use where there are some."""
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
