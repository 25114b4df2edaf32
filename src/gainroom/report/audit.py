"""The page of an audit: verdict, numbers, the vibration at the limit, headroom by joint, and how it was computed."""

import math
from typing import TYPE_CHECKING

import numpy as np

from ..errors import listed
from ..studies.audit import Audit
from ..system.requirements import Requirements, to_db
from .columns import definitions, tabulated
from .number_format import digits, hertz, model_kind
from .page import Card, Html, Lead, Section, beside, block, facts, page, paragraph, table
from .page_parts import ON_TOP, assumed_and_warned, assumptions, footer, limit_proofs, margin_card, unstable_card
from .robot_columns import AUDITED_JOINT, asked, audited_states, joint_caption
from .robot_coupling import coupling
from .robot_drawing import hero, small
from .robot_headroom import Factors, heat_map
from .robot_skeleton import common_view
from .robot_tables import MARKS, inputs
from .robot_text import audit_sentence, audit_warnings

if TYPE_CHECKING:
    from ..studies.simulator_audit import SimulatorAudit


def audit_page(result: Audit, command: str, simulated: "SimulatorAudit | None" = None) -> str:
    """The report of an audit as one HTML page.

    command     that makes it
    simulated   the simulator's answer
    """
    system, factors = result.system, _factors(result)
    sample_time, further = system.control.sample_time, audit_warnings(result)[ON_TOP:]
    taken = assumptions(f"Linear about posture {result.tightest.posture}", sample_time, "; contacts neither slip nor lift")
    sections = [
        Section("Vibration at the limit", _vibrations(result)),
        Section("Gain headroom", [heat_map(factors, "joint"), _state_table(result)]),
        Section("Joint by joint", [_joint_table(result)]),
        *([] if simulated is None else [Section("In the simulator", _simulator(simulated))]),
        Section("Cost of coupling", [beside(*coupling(factors, "joint"))]),
        Section("Inputs and assumptions", [inputs(system), taken, *assumed_and_warned(system.assumptions, further)]),
        Section("Certification", [_certificate(result)]),
        Section("Command", [block(command)]),
    ]
    title = f"gainroom audit: gains of {len(result.joints)} joints, {model_kind(sample_time)} model"
    return page(title, _lead(result), _cards(result), sections, footer())


def _lead(result: Audit) -> Lead:
    warnings = audit_warnings(result)[:ON_TOP]
    if result.safe:
        return Lead(audit_sentence(result), "good", "", warnings)
    if not result.tightest.limit.stable:
        return Lead(audit_sentence(result), "bad", "NOT SAFE, UNSTABLE: do not run these gains", warnings)
    return Lead(
        audit_sentence(result),
        "warn",
        f"NOT SAFE: stable, but with less than {digits(to_db(result.margin), 'dB', 3)} of gain margin",
        warnings,
    )


def _cards(result: Audit) -> list[Card]:
    """Three or four numbers, each the worst of all states."""
    worst, asked = result.tightest, Requirements(gain_margin=result.margin)
    limit, joints = worst.limit, result.limiting_joints
    at = f"{hertz(limit.frequency)}, {worst.title}" if math.isfinite(limit.frequency) else worst.title
    first = unstable_card(asked, limit, f", {worst.title}", worst.title)
    if limit.stable:
        first = margin_card(asked, "gain_margin", limit.gain, f"all gains together, {at}")
    unsafe = [joint.name for joint in result.joints if not joint.safe]
    vibrates = Card("vibration at", digits(limit.frequency / (2 * math.pi), "", 3), "Hz", note=f"mainly {listed(joints)}")
    return [
        first,
        Card(
            "vibrates from a delay of",
            digits(1e3 * result.delay_limit, "", 3),
            "ms" if math.isfinite(result.delay_limit) else "",
            f"> {digits(1e3 * result.system.delay, 'ms', 3)}, its delay",
            None if math.isnan(result.delay_limit) else result.delay_limit > result.system.delay,
        ),
        Card("unsafe joints", str(len(unsafe)), f"of {len(result.joints)}", "none", not unsafe, listed(unsafe)),
        *([vibrates] if joints else []),
    ]


def _factors(result: Audit) -> Factors:
    return Factors(
        result.states,
        result.system.source.joint_names,
        np.array([state.single_joint_limits for state in result.states]),
        np.array([state.margins.one_loop.gain_margin for state in result.states]),
        tuple(state.limit for state in result.states),
    )


def _vibrations(result: Audit) -> list[Html]:
    parts = [hero(result.tightest, len(result.states) == 1)]
    if len(result.states) > 1:
        view = common_view(result.states)
        parts.append(beside(*(small(state, state.limit, view, 0) for state in result.states)))
    return parts


def _state_table(result: Audit) -> Html:
    columns = audited_states(result.enough_in)
    return table(*tabulated(columns, result.states + result.immobile), f"{definitions(columns)} Safe: {asked(result)} or more.", MARKS)


def _joint_table(result: Audit) -> Html:
    return table(*tabulated(AUDITED_JOINT, result.joints), joint_caption(result), MARKS)


def _simulator(result: "SimulatorAudit") -> list[Html]:
    from .simulator_text import simulator_assumptions, simulator_sentence  # loads MuJoCo's side

    return [paragraph(simulator_sentence(result)), facts([("assumed", text) for text in simulator_assumptions(result)])]


def _certificate(result: Audit) -> Html:
    pairs = limit_proofs(result.states, result.immobile)
    pairs += [
        ("one loop at a time", "each loop's own curve with the other loops closed, sampled until smooth; its crossings polished"),
        (
            "delay",
            "the smallest extra delay in all loops at which a locus passes through −1; for unstable gains, counted from zero delay",
        ),
    ]
    return facts(pairs)
