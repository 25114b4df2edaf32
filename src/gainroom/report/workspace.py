"""Whole workspace as a part of another command's answer: text, JSON, and page section."""

import math
from typing import Any

import numpy as np

from ..studies.audited_workspace import AuditedWorkspace
from ..studies.factors import typed_factor
from ..studies.sweep.summary import ContactSummary, SweepSummary
from ..studies.swept_margins import WorstStates, worst_states
from ..system.margin_units import to_db
from ..system.requirements import Requirements
from . import style
from .columns import tabulated
from .number_format import digits
from .page import Advice, Card, Html, Section, facts, figure, paragraph, table
from .page_parts import margin_card
from .robot_drawing import hero
from .sweep_text import (
    columns,
    counted,
    joint_name,
    looked_at,
    posture_facts,
    safe_share,
    sample_columns,
    sample_facts,
    sentence,
    sureness,
    unmet_text,
    warnings,
)


def workspace_text(swept: AuditedWorkspace, advised: bool) -> str:
    """Terminal text of an audit on its workspace; `advised`: with the factor of advice_there."""
    found = swept.summary
    texts = [sentence(found), *sureness(found, None), later_there(swept), *warnings(found)]
    texts += [workspace_advice(swept) if advised else "", unmet_there(swept)]
    return " ".join(["Workspace:", *filter(None, texts), sample_text(swept)])


def in_workspace(verdict: str, swept: AuditedWorkspace | None) -> str:
    """Verdict of an audit, restricted to the postures asked for if others in the workspace are not safe."""
    if swept is None or swept.safe:
        return verdict
    found = swept.tightest
    if not found.unsafe:
        return f"In this posture: {verdict} In the workspace not all that is required holds."
    at_most = "at most " if swept.summary.unsafe and found is swept.later else ""
    return f"In this posture: {verdict} In the workspace {at_most}{safe_share(found)} of {counted(found.count)} limits hold."


def advice_there(swept: AuditedWorkspace) -> Advice:
    """Advice with a common factor with which gain margin and extra delay hold in the workspace, and what fails there."""
    lower = "Lower the gains: what is required does not hold in all of the workspace."
    return Advice(workspace_advice(swept) or lower, (), [*filter(None, (later_there(swept), unmet_there(swept)))])


def later_there(swept: AuditedWorkspace) -> str:
    """Sentence on stability with the required extra delay in all postures; "" if none is required."""
    if swept.later is None:
        return ""
    extra = f"With {digits(1e3 * (swept.asked.delay_margin or 0.0), 'ms', 3)} more delay, as required"
    text = sentence(swept.later)
    return f"{extra}, all are stable, too." if swept.later.margin_held else f"{extra}: {text[0].lower()}{text[1:]}"


def unmet_there(swept: AuditedWorkspace) -> str:
    """Sentence on other requirements that fail in the sample; "" if none does."""
    return unmet_text(swept.summary, swept.sample, swept.asked)


def sample_text(swept: AuditedWorkspace) -> str:
    """Sentence on where each requirement was judged."""
    return looked_at(swept.summary, swept.sample) or "Judged there: the gain margin alone."


def audited_facts(swept: AuditedWorkspace) -> dict[str, Any]:
    """JSON of an audited workspace: workspace_facts, the extra delay, and the sample of other requirements."""
    later, facts = swept.later, workspace_facts(swept.summary)
    return facts | {
        "safe": swept.safe,
        "safe_share": 1 - swept.tightest.unsafe / swept.summary.count,
        "scale": swept.scale,
        "unmet": list(swept.unmet),
        "extra_delay": None if later is None else {"extra_delay_ms": 1e3 * (swept.asked.delay_margin or 0.0), **workspace_facts(later)},
        "judged": sample_facts(swept.summary, swept.sample),
    }


def workspace_advice(swept: AuditedWorkspace) -> str:
    """Sentence with the common factor that keeps gain margin and extra delay in the whole workspace; "" if these gains do."""
    if swept.summary.margin_held and (swept.later is None or swept.later.margin_held):
        return ""
    predicate = "keep the gain margin" if swept.later is None else "keep the gain margin, and are stable with that extra delay,"
    if not math.isfinite(swept.scale):
        return "No common factor is known that does so in every posture swept."
    return f"All gains × {typed_factor(swept.scale):.4g} {predicate} in every posture swept."


def workspace_facts(found: SweepSummary) -> dict[str, Any]:
    """JSON of a workspace, as a part of another command's answer."""
    return {
        "sentence": sentence(found),
        "count": found.plan.postures.count,
        "limits": found.count,
        "stable": found.stable,
        "gain_margin_met": found.margin_held,
        "safe_share": 1 - found.unsafe / found.count,
        "unstable_share": sum(one.unstable for one in found.contacts) / found.count,
        "below_margin_share": sum(one.short for one in found.contacts) / found.count,
        "unknown": found.unknown,
        "uncertified": found.uncertified,
        "rarer_than": found.rarer_than,
        "scale": found.scale,
        "worst": posture_facts(found, found.worst_posture),
    }


CURVES = ((style.BLUE, "solid"), (style.VERMILION, "dash"), (style.GREEN, "dot"), (style.PURPLE, "dashdot"), (style.SKY, "longdash"))
FEW = 6
"""Most contact states in a figure."""
BARS = 40
"""Number of bars of a histogram, over all contact states."""
FAR = 3.0
"""Multiple of the required margin: if all limits are above, the figure leaves the margin out."""


def workspace_section(found: SweepSummary, title: str, verdict: str = "", audited: AuditedWorkspace | None = None) -> Section:
    """Section on a workspace; `verdict`: its sentence, if not that of a sweep; `audited`: further results there."""
    worst = found.worst_posture
    states = () if worst is None else worst_states(found, 0).states if audited is None else audited.sample.states
    later = "" if audited is None else later_there(audited)
    parts: list[Html] = [
        paragraph(" ".join([verdict or sentence(found), *sureness(found, None), *filter(None, [later]), *warnings(found)]))
    ]
    if worst is not None:
        parts.append(facts(_numbers(found, audited is not None and audited.later is not None)))
    if audited is not None and audited.sample.requirements:
        usual = [one.requirement.label for one in audited.sample.requirements if one not in audited.requirements]
        note = f" Not required of these gains, but usual: {', '.join(usual)}." if usual else ""
        parts.append(sample_table(found, audited.sample, note))
    if any(len(one.spread) for one in found.contacts):
        parts.append(histogram(found))
    parts.append(table(*tabulated(columns(found), found.contacts)))
    if states:
        first = states[0]
        parts.append(hero(first, False, first.limit, f"The worst posture, {first.contact}: {_limit(found)}"))
    return Section(title, parts)


def workspace_card(swept: AuditedWorkspace) -> Card:
    """Card of the workspace's lowest gain margin, with the required one."""
    found = swept.summary
    worst, asked = found.worst_posture, Requirements(gain_margin=found.margin if found.margin > 1 else None)
    note = f"{safe_share(found)} of {counted(found.count)} limits have it"
    if worst is None:
        return Card("gain margin, workspace", "–", "", "", False, note)
    return margin_card(asked, "gain_margin", worst.gain, note, label="gain margin, workspace")


def sample_table(found: SweepSummary, sample: WorstStates, note: str = "") -> Html:
    """Table of requirements other than the gain margin, with the worst of a sample of postures."""
    caption = f"{looked_at(found, sample)} Worst found and missed: among these; at random: how many of those chosen so miss it.{note}"
    return table(*tabulated(sample_columns(found, sample), sample.requirements), caption)


def _numbers(found: SweepSummary, later: bool) -> list[tuple[str, str]]:
    worst = found.worst_posture
    assert worst is not None
    names = found.plan.robot.joint_names
    low, high = found.plan.postures.low, found.plan.postures.high
    units = ["m" if slides else "rad" for slides in found.plan.robot.prismatic]
    moving = zip(names, worst.angles, units, high > low, strict=True)
    angles = ", ".join(f"{name} {angle:.3f} {unit}" for name, angle, unit, moves in moving if moves)
    margin = f"gain margin of {digits(to_db(found.margin), 'dB', 3)}" if found.margin > 1 else "stable"
    return [
        (f"postures with {margin}", f"{safe_share(found)} of {counted(found.count)} limits"),
        ("worst posture", f"{angles}; mainly {joint_name(found, worst)}"),
        (
            "judged everywhere",
            f"the gain margin{' and the extra delay' if later else ' alone'}: other requirements may fail in other postures",
        ),
    ]


def _limit(found: SweepSummary) -> str:
    worst = found.worst_posture
    assert worst is not None
    if not math.isfinite(worst.gain):
        return "no vibration at any factor"
    return f"gain limit {digits(worst.gain, '×', 3)}" + (f", mainly {joint_name(found, worst)}" if worst.joint >= 0 else "")


def histogram(found: SweepSummary) -> Html:
    """Figure of the share of postures by gain limit, one line for each contact state."""
    shown = [one for one in found.contacts if len(one.spread)][:FEW]
    low, high = min(one.edges[0] for one in shown), max(one.edges[-1] for one in shown)
    edges = np.geomspace(low, max(high, low * 1.01), BARS + 1)
    traces: list[dict[str, Any]] = []
    for one, (color, dash) in zip(shown, CURVES * 2, strict=False):
        shares = 100 * _binned(one, edges) / one.spread.sum()
        name = style.shown(one.name)
        x, y = np.append(edges, edges[-1]), np.concatenate([[0], shares, [0]])
        traces.append(
            style.line(x, y, color, dash=dash, name=name, hoverinfo="x+y+name") | {"line": {"shape": "vh", "color": color, "dash": dash}}
        )
    near = found.margin > 1 and low < FAR * found.margin
    if near:
        low = min(low, found.margin) / 1.02
    layout = style.layout(
        xaxis=style.axis("gain limit [× these gains]"),
        yaxis=style.axis("postures [%]", rangemode="tozero"),
        showlegend=len(traces) > 1,
        legend=style.switches(1.02),
        shapes=[style.upright(found.margin, style.INK, "dot")] if near else [],
        margin={"l": 72, "r": 24, "t": 48 if len(traces) > 1 else 16, "b": 52},
    )
    dotted = f" Dotted: the gain margin of {digits(to_db(found.margin), 'dB', 3)} that is asked for." if near else ""
    caption = f"Of all postures of a contact state, how many have this limit.{dotted}"
    return figure({"data": traces, "layout": layout}, "How limits spread over the workspace", caption, 320, style.NARROW)


def _binned(one: ContactSummary, edges: np.ndarray) -> np.ndarray:
    """Counts of the summary's narrow bins in wider ones."""
    middles = np.sqrt(one.edges[1:] * one.edges[:-1])
    places = np.clip(np.searchsorted(edges, middles, side="right") - 1, 0, len(edges) - 2)
    return np.bincount(places, one.spread, len(edges) - 1)
