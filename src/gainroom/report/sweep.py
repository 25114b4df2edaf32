"""Page of a sweep: worst postures, distribution of limits, maps over two joints, gain of a schedule, and coverage."""

import json
import math
from html import escape
from typing import Any

import numpy as np

from ..errors import first_of_many
from ..io.strict_json import strict
from ..studies.state import State
from ..studies.sweep.maps import PairMaps, pair_maps
from ..studies.sweep.summary import CONFIDENCE, SweepSummary
from ..studies.swept_margins import swept_verdict
from . import style
from .columns import definitions, tabulated
from .number_format import digits, hertz, model_kind
from .page import Card, Html, Lead, Section, advice, beside, facts, figure, page, table
from .page_parts import assumptions, margin_card, uncertainty_text
from .robot_columns import state_columns
from .robot_drawing import hero, small
from .robot_skeleton import common_view
from .robot_tables import machine
from .sweep_text import SweepPresentation, advice as use, columns, counted, joint_name, sureness, verdict, warnings
from .words import swept_banner, tone
from .workspace import CURVES, FEW, sample_table

SCALE = [[0, "#08306b"], [0.5, "#6baed6"], [1, "#f7fbff"]]
"""Colour scale: ColorBrewer's Blues (Brewer 2013), the lowest darkest."""


def sweep_page(shown: SweepPresentation, command: str) -> str:
    """HTML page of a sweep; `command`: the command that makes it."""
    found, at_worst, store = shown.found, shown.at_worst, shown.store
    plan, worst, states = found.plan, found.worst_posture, list(at_worst.states)
    maps = pair_maps(plan, store.finished(), np.sum([one.joints for one in found.contacts], axis=0))
    sections = [
        Section("The worst posture", _drawings(states)) if states else None,
        Section("Limits by contact state", [_spreads(found), table(*tabulated(columns(found), found.contacts))]),
        Section("Over two joints", [_map(found, maps)]) if maps.lowest else None,
        Section("What a schedule would gain", [_schedule(found)]),
        Section("Which joint limits", [_limiting(found)]),
        Section("Other requirements", [sample_table(found, at_worst)]) if at_worst.requirements else None,
        Section("Margins in the worst postures", [_margins(states)], "all of them, one posture of each contact state") if states else None,
        Section("How sure the worst case is", [facts(_sure(found))]),
        Section(
            "Inputs and assumptions",
            [facts(_inputs(found)), assumptions("Linear about every posture", plan.system.control, "; contacts neither slip nor lift")],
            "robot, postures, what is assumed",
        ),
    ]
    advised = use(found, at_worst)
    do_this = advice(advised, "") if advised and worst is not None and found.scale < 1 else ""
    how = tone(swept_verdict(found, at_worst))
    lead = Lead(" ".join(verdict(found, at_worst)), how, swept_banner(found) if how == "bad" else "", warnings(found), do_this)
    kind = model_kind(plan.system.control.sample_time)
    return page(f"gainroom sweep: {counted(plan.postures.count)} postures, {kind} model", lead, _cards(found), sections, command)


def _cards(found: SweepSummary) -> list[Card]:
    worst, near = found.worst_posture, found.searched
    if worst is None:
        return []
    asked = found.plan.system.requirements
    where = f"{worst.name}, {found.plan.contacts[worst.contact]}"
    cards = [
        margin_card(asked, "gain_margin", worst.gain, where, label="lowest gain margin"),
        Card("vibration there at", digits(worst.frequency / (2 * math.pi), "", 3), "Hz", note=f"mainly {joint_name(found, worst)}"),
    ]
    if near is not None:
        cards.append(Card("local search from there", digits(near.gain, "", 4), "×", note=f"swept: {digits(worst.gain, '', 4)} ×"))
    proved = found.count - found.unknown - found.uncertified
    note = f"of {counted(found.count)} limits{', those of unstable gains too' * any(one.unstable for one in found.contacts)}"
    cards.append(Card("limits certified in", digits(100 * proved / max(found.count, 1), "", 4), "% of postures", note=note))
    return cards


def _drawings(states: list[State]) -> list[Html]:
    parts = [hero(states[0], len(states) == 1)]
    if len(states) > 1:
        view = common_view(states)
        parts.append(beside(*(small(state, state.limit, view, 0) for state in states[1:])))
    return parts


def _spreads(found: SweepSummary) -> Html:
    """Figure of the share of postures below each gain."""
    traces: list[dict[str, Any]] = []
    for one, (color, dash) in zip(found.contacts[:FEW], CURVES * 2, strict=False):
        if not len(one.spread):
            continue
        shares = 100 * np.concatenate([[0], np.cumsum(one.spread)]) / one.spread.sum()
        keep = np.unique(np.linspace(0, len(shares) - 1, 300).astype(int))
        traces.append(style.line(one.edges[keep], shares[keep], color, dash=dash, name=style.shown(one.name), hoverinfo="x+y+name"))
    shapes = [style.upright(found.margin, style.INK, "dot")] if found.margin > 1 else []
    layout = style.layout(
        xaxis=style.axis("gain limit [× these gains]"),
        yaxis=style.axis("postures below [%]", range=[0, 100]),
        showlegend=True,
        legend=style.switches(1.02),
        shapes=shapes if found.worst_posture is not None and found.worst_posture.gain < 2 * found.margin else [],
        margin={"l": 72, "r": 24, "t": 48, "b": 52},
    )
    more = f" The first {FEW} contact states of {len(found.contacts)}." if len(found.contacts) > FEW else ""
    steep = "A steep curve: posture hardly matters there; a flat one: gains by posture are worth while."
    return figure({"data": traces, "layout": layout}, "How many postures have less", steep + more, 360, style.NARROW)


def _map(found: SweepSummary, maps: PairMaps) -> Html:
    """Map over two joints, chosen from two lists."""
    first = maps.telling
    assert first is not None
    names = [found.plan.robot.joint_names[joint] for joint in maps.joints]
    units = ["m" if found.plan.robot.prismatic[joint] else "rad" for joint in maps.joints]
    middles = [(edges[1:] + edges[:-1]) / 2 for edges in maps.edges]
    trace = {
        "type": "heatmap",
        "x": middles[first[0]],
        "y": middles[first[1]],
        "z": maps.lowest[first].T,
        "colorscale": SCALE,
        "colorbar": {"title": {"text": "lowest<br>limit [×]"}, "thickness": 14},
        "hovertemplate": "%{x:.3g}, %{y:.3g}: %{z:.4g} ×<extra></extra>",
    }
    titles = [f"{style.shown(name)} [{unit}]" for name, unit in zip(names, units, strict=True)]
    layout = style.layout(xaxis=style.axis(titles[first[0]]), yaxis=style.axis(titles[first[1]]))
    picture = figure(
        {"data": [trace], "layout": layout},
        "The lowest limit over two joints",
        "Each cell: the lowest of all postures in it, in any contact state and draw; dark is low. Empty: no posture there.",
        440,
        {"margin.l": 50, "margin.r": 0},
    )
    data = {
        "titles": titles,
        "middles": middles,
        "maps": {f"{x},{y}": lowest for (x, y), lowest in maps.lowest.items()},
    }
    text = json.dumps(strict(data, 5), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")

    def choice(label: str, chosen: int) -> str:
        options = "".join(
            f'<option value="{k}"{" selected" if k == chosen else ""}>{escape(name)}</option>' for k, name in enumerate(names)
        )
        return f"<label>{label} <select>{options}</select></label>"

    return Html(
        f'<div class="pairs"><p>{choice("across", first[0])} {choice("up", first[1])}</p>'
        f'{picture}<script type="application/json" class="maps">{text}</script></div>'
    )


def _schedule(found: SweepSummary) -> Html:
    """Table of factors at the required margin with one set of gains, one set per contact state, and gains by posture."""
    worst = found.worst_posture
    rows = []
    for one in found.contacts:
        if not one.worst or worst is None:
            continue
        own, middle = one.worst[0].gain, one.quantile(0.5)
        more = f"{100 * (middle / worst.gain - 1):.3g} %" if worst.gain > 0 and middle < math.inf else "–"
        rows.append((one.name, *(digits(value / found.margin, "", 3) for value in (worst.gain, own, middle)), more))
    caption = (
        "Factors on these gains with which the gain margin holds. One set: everywhere; by contact: one for each contact state; by posture: "
        "what a schedule that knows the posture allows in half of the postures, and how much more that is than one set."
    )
    return table(("contact", "one set", "by contact", "by posture (median)", "more"), rows, caption)


def _limiting(found: SweepSummary) -> Html:
    names = found.plan.robot.joint_names
    often = np.argsort(-np.sum([one.joints for one in found.contacts], axis=0), kind="stable").tolist()
    shown = [joint for joint in often if any(one.joints[joint] for one in found.contacts)]
    rows = [
        (names[joint], *(digits(100 * one.joints[joint] / max(one.joints.sum(), 1), "", 3) for one in found.contacts)) for joint in shown
    ]
    caption = "Share of postures [%] in whose vibration at the limit the joint moves most; of joints that move equally far, the first."
    return table(("joint", *(one.name for one in found.contacts)), rows, caption)


def _margins(states: list[State]) -> Html:
    shown = state_columns()
    headings, texts = tabulated(shown, states)
    return table(headings, texts, f"{definitions(shown, headings)} Nominal values.")


def _sure(found: SweepSummary) -> list[tuple[str, str]]:
    plan, near = found.plan, found.searched
    pairs = [("coverage", text) for text in sureness(found, near)]
    kinds = {
        "samples": "Sobol's sequence within the limits of every joint: no gap, and no direction preferred",
        "grid": "every combination of a grid; nothing is known between its points",
        "trajectory": "those of the log alone",
    }
    pairs.append(("postures", kinds[plan.postures.kind]))
    if math.isfinite(found.rarer_than):
        text = f"{digits(100 * found.rarer_than, '%', 2)} with {100 * CONFIDENCE:.0f} % confidence, counted as for independent postures"
        pairs.append(("share of the workspace that may lie lower, at most", text))
    if near is not None:
        pairs.append(
            (
                "lowest found by a local search",
                f"{digits(near.gain, '×', 6)} in {plan.contacts[near.contact]}; no proof of a global minimum",
            )
        )
    proof = "no crossing below it at any frequency, by bounds between samples, and one at it; what that cannot decide, by counted roots"
    pairs.append(("each limit", proof))
    pairs.append(("without a certificate", f"{counted(found.uncertified)}; not known: {counted(found.unknown)}"))
    return pairs


def _inputs(found: SweepSummary) -> list[tuple[str, str]]:
    plan = found.plan
    names = plan.robot.joint_names
    spans = zip(names, plan.postures.low, plan.postures.high, strict=True)
    ranges = [f"{name} {digits(low, '', 3)} to {digits(high, '', 3)}" for name, low, high in spans if high > low]
    return [
        *machine(plan.system),
        ("postures", f"{counted(plan.postures.count)}, {plan.postures.kind}, seed {plan.seed}"),
        ("joints that move", first_of_many(ranges) if ranges else "none"),
        ("contact states", first_of_many(plan.contacts)),
        ("draws", f"{len(plan.places) - 1} within {uncertainty_text(plan.system)}" if len(plan.places) > 1 else "none: nominal values"),
        ("not checked", "whether links collide, whether contacts can hold the robot there, whether its joints are strong enough"),
        ("lowest vibration", "–" if found.worst_posture is None else hertz(found.worst_posture.frequency)),
    ]
