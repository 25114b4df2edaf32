"""Page of a robot: verdict, numbers, vibration at the limit, gain headroom, causes, remedies, gains to use, tables, proofs."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..analysis.stability_boundary import Boundary, first_grid
from ..errors import at_frequency, listed
from ..native import _core
from ..studies.loop_numbers import margins_of
from ..studies.over_uncertainty import unknown_first
from ..studies.robot import RobotStudy
from ..studies.state import State, limit_headroom, task_headroom
from ..studies.sway import without_sway
from ..system.linear.arrays import Complexes, Floats, Integers
from ..system.requirement import Requirement
from ..system.requirements import REQUIREMENTS
from . import style
from .gain_advice import gains_box
from .margin_columns import margin_value, requirement
from .number_format import digits, frequency, hertz, model_kind
from .over_time import robot_motion
from .page import Card, Html, Lead, Section, beside, details, facts, figure, page, paragraph
from .page_parts import ON_TOP, assumed_and_warned, assumptions, limit_proofs, margin_card, unstable_card
from .robot_drawing import hero, small
from .robot_headroom import coupling, heat_map, joint_factors, task_factors
from .robot_skeleton import common_view
from .robot_tables import RobotPresentation, gain_tables, inputs, joint_table, state_table, task_table
from .robot_text import notes, sentence, warnings
from .robot_units import requirements_text
from .sweep_text import checked_sentence, counted
from .words import tone
from .workspace import workspace_section

FEW = 4
"""Most states with a figure each; of more, the tightest posture of each contact state has one."""
MOST_PICTURES = 8
LOCI = (
    "The eigenvalues λ of L(jω), all loops together, for ω > 0. Multiplying all gains by g multiplies every locus by g: the robot "
    "vibrates where a locus passes through −1, so the limit is one over the distance from 0 where it crosses the thin axis. "
    "A crossing on the thick line, beyond −1, means that these gains are too high."
)
WIDEST = 6.0  # |Re L| beyond which nothing is drawn; crossings outside are labelled
TO_DRAW = 0.012  # longest step between samples, relative to the window
TO_WRITE = 0.012  # points closer than this along a locus are not written into the page
AROUND = math.log(3)  # |ln| of frequency over that at the limit: the part of the critical locus that is drawn bold
MOST, ROUNDS = 40_000, 10  # eigenvalues of one picture, and rounds of halving steps between them


def robot_page(shown: RobotPresentation, command: str) -> str:
    """HTML page of a robot study; `command`: the command that makes it."""
    study, swept = shown.study, shown.swept
    drawn, sample_time = _shown(study), study.system.control.sample_time
    noted = [*warnings(study)[ON_TOP:], *notes(study)]
    taken = assumptions("Linear about each posture", study.system.control, "; contacts neither slip nor lift")
    loci_of = beside(*(loci(state, loci_window(drawn)) for state in drawn))
    sections = [
        Section(_decisive_title(study), [decisive_picture(study)]),
        Section(
            "Gain headroom",
            [paragraph(requirements_text(study.system)), heat_map(joint_factors(study), "joint")],
            "the factor on each joint's gains at which vibration starts, state by state",
        ),
        None
        if swept is None
        else workspace_section(swept, f"Recommended gains in {counted(swept.plan.postures.count)} swept postures", checked_sentence(swept)),
        Section("Vibration by contact state", _vibrations(study, drawn), "each at its own gain limit"),
        *_over_time(study),
        Section("State by state", [state_table(study), *remedies(study)], "all margins of each"),
        Section("Why: the characteristic loci", [LOCI, loci_of], "where the eigenvalues of the coupled loops come near −1"),
        Section("Cost of coupling", [beside(*coupling(joint_factors(study), "joint"))], "each joint alone, and with all others closed"),
        Section("Recommended gains", _gains(study), "by contact state and for all, in both spaces, and what limits them"),
        *_tasks(study, drawn),
        Section("Joints", _joints(study), f"{study.system.source.body.size} joints: loads, gains and largest gains"),
        Section(
            "Inputs and assumptions",
            [inputs(study.system), taken, *assumed_and_warned(study.system.assumptions, noted)],
            "what was read, and what it leaves out",
        ),
        Section("Certification", [_certificate(study)], "how each number was checked"),
    ]
    title = f"gainroom robot: gains of {study.system.source.body.size} joints, {model_kind(sample_time)} model"
    return page(title, _lead(shown), _cards(study), sections, command)


def _over_time(study: RobotStudy) -> list[Section]:
    parts = robot_motion(study)
    return [Section("Over time: the links", parts, "each after a step of its reference, and under a load")] if parts else []


def _shown(study: RobotStudy) -> list[State]:
    """States with figures: all if few; else the tightest posture of each contact state; of many contact states, the tightest."""
    if len(study.states) <= FEW:
        return list(study.states)
    found = study.tightest_by_contact
    order = sorted(found, key=lambda state: limit_headroom(state.limit))[:MOST_PICTURES]
    return [state for state in found if state in order]


def _decisive_title(study: RobotStudy) -> str:
    """Title that names the requirement that fails, or is tightest."""
    motion = study.decisive_motion
    if motion is None:
        return "Vibration at the limit"
    one = REQUIREMENTS[study.decisive]
    what, text = (
        "What is open" if study.sway_is_open else "What fails" if study.unmet else "What is tightest",
        one.text(one.value(motion.state.counted)),
    )
    return f"{what}: {one.label} {text} in {motion.title}, at {hertz(motion.limit.frequency)}"


def decisive_picture(study: RobotStudy) -> Html:
    """Figure of the motion at the decisive requirement, or of the vibration at the gain limit."""
    motion = study.decisive_motion
    if motion is None:
        return hero(study.tightest, len(study.states) == 1)
    what = "joints as they move where all loops together come nearest to vibration"
    if motion.joint:
        what = f"joints as they move with a disturbance of {motion.joint}, whose loop comes nearest to vibration"
    return hero(motion.state, len(study.states) == 1, motion.limit, f"{motion.title}, {hertz(motion.limit.frequency)}: {what}")


def _vibrations(study: RobotStudy, shown: Sequence[State]) -> list[Html]:
    parts = [] if study.decisive_motion is None else [hero(study.tightest, len(study.states) == 1)]
    if len(shown) > 1:
        view = common_view(shown)
        postures = Counter(state.contact for state in study.states)
        others = {state: 0 if len(shown) == len(study.states) else postures[state.contact] - 1 for state in shown}
        parts.append(beside(*(small(state, state.limit, view, count) for state, count in others.items())))
    hidden = len({state.contact for state in study.states} - {state.contact for state in shown})
    words = f"{hidden} contact state{'s' * (hidden > 1)} with more headroom {'are' if hidden > 1 else 'is'} not drawn."
    return [*parts, paragraph(words)] if hidden else parts or [paragraph("One state, drawn above.")]


def _tasks(study: RobotStudy, shown: Sequence[State]) -> list[Section]:
    """Sections on the operational space, if the file has tasks."""
    if not study.system.source.stack:
        return []
    factors = task_factors(study)
    if factors is None:
        return [Section("Operational space", [paragraph("The tasks act on no motion in any posture and contact state.")])]
    tightest = _tightest_tasks(study)
    immobile = [state.title for state in study.states if state.task_limit is None] if study.system.control.space == "joint" else []
    parts = [paragraph(f"The tasks act on no motion in {listed(immobile)}; these states have no task results.")] if immobile else []
    if study.system.control.space == "joint":
        words = "The file's controller closes the joints' loops; here its tasks are closed in their place, with their own gains."
        view = common_view(shown)
        drawings = [small(state, state.task_limit, view, 0) for state in tightest if state.task_limit is not None]
        parts += [paragraph(words), beside(*drawings)]
    parts += [heat_map(factors, "task direction"), beside(*coupling(factors, "task direction"))]
    parts.append(task_table(tightest))
    if len(tightest) < len(study.states):
        parts.append(details("Tasks in every posture and contact state", task_table(study.states)))
    limit = min((state.task_limit for state in tightest if state.task_limit is not None), key=limit_headroom)
    summary = f"tasks in the joints' place: {'stable' if limit.stable else 'UNSTABLE'}, limit {digits(limit.gain, '', 3)} ×"
    return [Section("Operational space", parts, summary)]


def _tightest_tasks(study: RobotStudy) -> list[State]:
    """State of each contact state in which the tasks have the least headroom, at most MOST_PICTURES; [] if no task moves."""
    found: dict[str, State] = {}
    for state in study.states:
        if state.task_limit is not None and (state.contact not in found or task_headroom(state) < task_headroom(found[state.contact])):
            found[state.contact] = state
    order = sorted(found.values(), key=task_headroom)[:MOST_PICTURES]
    return [state for state in found.values() if state in order]


def _gains(study: RobotStudy) -> list[Html]:
    if not study.recommended:
        return [paragraph("No gains are recommended: nothing is required, or none were searched.")]
    parts = []
    for gains in study.recommended:
        words = "Joint space: gains per joint." if gains.space == "joint" else "Operational space: gains per task direction."
        parts += [paragraph(words + " They meet the requirements with every loop closed."), *gain_tables(gains, study.system)]
    return parts


def _joints(study: RobotStudy) -> list[Html]:
    parts = [joint_table([study.tightest], f"{study.tightest.title}.")]
    if len(study.states) > 1:
        parts.append(details("Joints in every posture and contact state", joint_table(study.states)))
    return parts


def _lead(shown: RobotPresentation) -> Lead:
    study = shown.study
    answer, first, do = sentence(study), [*shown.elsewhere, *warnings(study)[:ON_TOP]], gains_box(study, shown.to_use)
    how, unstable = tone(study.verdict), [state.title for state in study.states if not state.limit.stable]
    count, states = len(unstable), len(study.states)
    where = "" if states == 1 else f" in all {states} states" if count == states else f" in {'; '.join(unstable[:3])}"
    where += f" and {count - 3} more" if 3 < count < states else ""
    where = f" within the uncertainty ranges, in {study.unstable_case}" if study.unstable_case else where
    return Lead(answer, how, f"UNSTABLE{where}: do not run these gains" if how == "bad" else "", first, do)


def _cards(study: RobotStudy) -> list[Card]:
    """Cards of the main numbers, three to five, each the worst of all states."""
    cards = _stable_cards(study) if study.stable else _unstable_cards(study)
    if study.stable:
        state = min(study.states, key=lambda state: unknown_first(state.margins.disk_margin))
        proved = "" if state.margins.disk_certified else ", not certified"
        cards.append(Card("disk margin", digits(state.margins.disk_margin, "", 3), note=f"all motors at once, {state.title}{proved}"))
    return cards


def _unstable_cards(study: RobotStudy) -> list[Card]:
    tight, limit, soft = study.tightest, study.tightest.limit, study.softest
    lowered, count = 0 < limit.gain < math.inf, sum(not state.limit.stable for state in study.states)
    vibrates = Card("vibrates at", digits(limit.frequency / (2 * math.pi), "", 3), "Hz", note=", ".join(tight.limiting_joints[:2]))
    return [
        unstable_card(study.system.requirements, limit, f", {(soft or tight).title}", tight.title, soft.lower_gain if soft else math.nan),
        Card("unstable states", f"{count}", f"of {len(study.states)}", "none", False),
        *([vibrates] if lowered else []),
    ]


def _stable_cards(study: RobotStudy) -> list[Card]:
    asked = study.system.requirements

    def at(omega: float) -> str:
        return f"{hertz(omega)}, " if math.isfinite(omega) else ""

    def card(one: Requirement, state: State) -> Card:
        where = f"{at(one.frequency(state.counted))}{state.title}{', continuous time' if study.system.rate_is_missing else ''}"
        label = one.titled(state.counted, len(study.system.source.joint_names) > 1)
        nominal = one.value(state.counted)
        least = study.least(state, one.name)
        if study.unstable_case:
            required = requirement(asked, one.name, 3)
            return Card(f"{label}, worst", "unstable", "", required, False if required else None, f"nominal {one.text(nominal)}, {where}")
        if study.system.uncertainty.names and not math.isnan(least):
            return margin_card(asked, one.name, least, f"nominal {one.text(nominal)}, {where}", label=f"{label}, worst")
        return margin_card(asked, one.name, nominal, where, label=label)

    cards = {name: card(REQUIREMENTS[name], state) for name, state in study.worst.items()}
    return [replace(one, met=None) if study.sway_is_open and name in study.swaying else one for name, one in cards.items()]


def _in_range(study: RobotStudy) -> str:
    return "stable" if study.stable_in_range else f"unstable in {study.unstable_case}" if study.unstable_case else "unstable nominally"


def _disk_words(study: RobotStudy) -> str:
    """Definition and proof of the disk margin, as text."""
    known = [state.margins.disk_certified for state in study.states if state.margins.disk_certified is not None]
    words = "every motor's torque is multiplied by a complex factor of its own (2 + δ)/(2 − δ); no factors with |δ| below the margin"
    if not known:
        return f"{words} would make the robot unstable; an unstable robot has none"
    count = "all" if all(known) else f"{sum(known)} of {len(known)}"
    return f"{words} make the robot unstable: a bound with scalings, proved between frequencies, too, in {count} stable states"


LOOKED_AT = "corners and points between, the rest is not proved"


def _certificate(study: RobotStudy) -> Html:
    pairs = limit_proofs(study.states, study.immobile)
    pairs += [
        (
            "one loop at a time, largest gains",
            "each loop's curve, other loops closed, sampled until smooth; crossings polished",
        ),
        ("disk margin", _disk_words(study)),
        ("phase and Ms of single loops", "searched between refined samples; the candidates for the least are polished"),
        *([("uncertainty ranges", f"{_in_range(study)}; {LOOKED_AT}")] if study.system.uncertainty.names else []),
        (
            "recommended gains",
            f"checked in every posture and contact state; of the uncertainty {LOOKED_AT}",
        ),
    ]
    return facts(pairs)


MORE, LESS = 1.25, 0.8


def remedies(study: RobotStudy) -> list[Html]:
    """Paragraphs, one for every unmet requirement."""
    paragraphs = [paragraph(" ".join(_sentences(study, name, state))) for name, state in study.unmet.items()]
    if paragraphs and any(gains.everywhere is not None for gains in study.recommended):
        paragraphs.append(paragraph("The recommended gains below meet every requirement."))
    return paragraphs


def _sentences(study: RobotStudy, name: str, state: State) -> list[str]:
    asked, one = study.system.requirements, REQUIREMENTS[name]
    value = one.value(state.counted)
    meaning = f"{one.label[0].upper()}{one.label[1:]} of {state.model.size} loops: {one.meaning or 'the worst of all.'}"
    if math.isnan(value):
        return [meaning, f"It is not known in {state.title}."]
    there = f"{state.title}{at_frequency(one.frequency(state.counted), ', at ', hertz)}"
    return [meaning, f"It is {margin_value(asked, name, value, False, 3)} in {there}.", _trials(study, one, state)]


def _trials(study: RobotStudy, one: Requirement, state: State) -> str:
    """Sentence on the margin with 1.25 and 0.8 times the damping gains, and with 0.8 times the stiffness gains."""
    system, asked = study.system, study.system.requirements
    controller = system.controller(state.model)
    rate = controller.damping_name
    better, worse = [], []
    for gain, factor in ((rate, MORE), (rate, LESS), ("kp", LESS)):
        if gain not in controller.gain_names():
            continue
        changed = replace(controller, **{gain: factor * getattr(controller, gain)})
        loop = system.loop(state.model, changed)
        found = without_sway(state.case, margins_of(loop), loop)
        value, own = one.value(found), one.value(state.counted)
        helps = found.stable and (value < own if one.at_most else value > own)
        known = "not known" if math.isnan(value) else margin_value(asked, one.name, value, None, 3)
        outcome = known if found.stable else "unstable"
        (better if helps else worse).append(f"{outcome} with all {gain} × {factor:g}")
    if not (better or worse):
        return ""
    if not better:
        return f"No small change of all gains improves it ({listed(worse)}). Less delay, or stiffer or better damped gearboxes, would."
    without = f", but {listed(worse)}" if worse else ""
    return f"It would be {listed(better)}{without}."


def loci_window(states: Sequence[State]) -> tuple[float, float]:
    """Window (left end, half the height) that shows −1 and the crossings of the loci, equal for every state."""
    crossings = [1 / state.limit.gain for state in states if 0 < state.limit.gain < math.inf]
    left = -min(max([1.25, *(1.2 * one for one in crossings)]), WIDEST)
    return left, 0.4 * (0.35 - left)


def loci(state: State, window: tuple[float, float]) -> Html:
    """Figure of the loci for ω > 0; the one that sets the limit is bold near it."""
    left, half = window
    right = left + 1.15 * (0.35 - left)
    omega, curves = _sampled(state, window)
    critical = _critical(state, omega, curves)
    others: Complexes = np.concatenate([np.append(_drawn(curve, window)[1], np.nan) for curve in curves.T])
    traces = [style.line(others.real, others.imag, "#9a9a9a", width=1.3, name="other loci")]
    if critical is not None:
        near = np.abs(np.log(omega / state.limit.frequency)) < AROUND
        traces.append(_bold(omega[near], curves[near, critical], window))
    traces.append(style.markers([-1], [0], "x", style.VERMILION, 13, hoverinfo="text", text="the critical point −1", cliponaxis=False))
    notes = [style.label(-1, 0, "−1", style.VERMILION, xanchor="right", yanchor="top", xshift=-5, yshift=-4)]
    crossing, crossing_notes = _crossing(state, window)
    wide = {"zeroline": True, "zerolinecolor": "#999", "fixedrange": True}
    picture = style.layout(
        xaxis=style.axis("Re λ(L)", range=[left, right], constrain="domain", **wide),
        yaxis=style.axis("Im λ(L)", range=[-half, half], scaleanchor="x", constrain="domain", **wide),
        annotations=[*notes, *crossing_notes],
        shapes=[_beyond(left)],
        plot_bgcolor="white" if state.limit.stable else style.UNSTABLE_GROUND,
        margin={"l": 62, "r": 8, "t": 8, "b": 48},
    )
    return figure({"data": [*traces, *crossing], "layout": picture}, _title(state), _caption(state, critical), 370, style.NARROW)


def _sampled(state: State, window: tuple[float, float]) -> tuple[Floats, Complexes]:
    """Frequencies (k,) [rad/s] and characteristic loci (k, r) there: the eigenvalues of L(jω), each column one continuous branch.

    Samples are dense enough for straight lines between them within `window` of the complex plane, as loci_window returns it.
    """
    boundary = Boundary(state.loop)
    omega = first_grid(state.loop, boundary.last)
    loci = np.linalg.eigvals(boundary.core(omega))
    longest = -TO_DRAW * window[0]
    for _ in range(ROUNDS):
        curves = _followed(omega, loci)
        start, end = curves[:-1], curves[1:]
        near = np.minimum(np.abs(start), np.abs(end)) < -1.6 * window[0]
        places = np.flatnonzero(np.any(near & (np.abs(end - start) > longest), axis=1) & (np.diff(omega) > 1e-6 * omega[1:]))
        if not len(places) or loci.size > MOST:
            break
        middle = 0.5 * (omega[places] + omega[places + 1])
        loci = np.insert(loci, places + 1, np.linalg.eigvals(boundary.core(middle)), axis=0)
        omega = np.insert(omega, places + 1, middle)
    return omega, _followed(omega, loci)


def _followed(omega: Floats, loci: Complexes) -> Complexes:
    """Eigenvalues (k, r) at ω (k,), each column one locus: the next one is that closest to where the last two point."""
    curves = loci.copy()
    for k in range(1, len(omega)):
        ahead = curves[k - 1]
        if k > 1:
            ahead = ahead + (curves[k - 1] - curves[k - 2]) * min((omega[k] - omega[k - 1]) / (omega[k - 1] - omega[k - 2]), 2.0)
        distance = np.abs(ahead[:, None] - curves[k])
        order = np.argmin(distance, axis=1)
        curves[k] = curves[k, order if len(set(order.tolist())) == len(order) else _core.assigned(distance)]
    return curves


def _critical(state: State, omega: Floats, curves: Complexes) -> int | None:
    """Index of the locus that crosses the negative real axis at the limit; None without a limit."""
    if not math.isfinite(state.limit.frequency):
        return None
    k = int(np.clip(np.searchsorted(omega, state.limit.frequency), 1, len(omega) - 1))
    share = (state.limit.frequency - omega[k - 1]) / (omega[k] - omega[k - 1])
    there = curves[k - 1] + share * (curves[k] - curves[k - 1])
    return int(np.argmin(np.abs(there + 1 / state.limit.gain)))


def _drawn(curve: Complexes, window: tuple[float, float]) -> tuple[Integers, Complexes]:
    """Samples to draw and their values: those visible in the window and their neighbours, thinned; −1 and NaN break the line."""
    reach, close = -1.6 * window[0], -TO_WRITE * window[0]
    inside = np.abs(curve) <= reach
    edge = np.convolve(inside, [1, 1, 1], "same").astype(bool) & ~inside
    travelled = np.append(0.0, np.cumsum(np.minimum(np.abs(np.diff(curve)), reach)))
    index = np.flatnonzero(edge | (inside & np.append(True, np.diff(np.floor(travelled / close)) > 0)))
    leaves = np.flatnonzero(edge[index][1:] & edge[index][:-1]) + 1
    index = np.insert(index, leaves, -1)
    return index, np.where(index < 0, np.nan, np.round(curve[index], 4))


def _bold(omega: Floats, curve: Complexes, window: tuple[float, float]) -> style.Trace:
    """Locus near the limit, with its frequencies."""
    index, values = _drawn(curve, window)
    text = ["" if k < 0 else frequency(float(omega[k])) for k in index]
    return style.line(values.real, values.imag, style.BLACK, width=2.8, hoverinfo="text", text=text)


def _crossing(state: State, window: tuple[float, float]) -> tuple[list[style.Trace], list[style.Annotation]]:
    """Crossing that sets the limit, with its frequency."""
    limit = state.limit
    if not math.isfinite(limit.frequency):
        return [], []
    at = -1 / limit.gain
    text = (
        f"λ = {digits(at, '', 3)} at {frequency(limit.frequency, 3)}<br>limit 1/{digits(-at, '', 3)} = <b>{digits(limit.gain, '', 3)} ×</b>"
    )
    half = window[1]
    inside = at > window[0]
    place = {"axref": "x", "ayref": "y", "showarrow": True, "arrowhead": 2, "arrowwidth": 1.4, "arrowcolor": style.INK, "standoff": 6}
    reach = 0.62 * window[0] if at > 0.4 * window[0] else 0.3 * window[0]
    note = style.label(max(at, window[0]), 0, text, style.INK, ax=reach, ay=0.72 * half, **place)
    if not inside:
        note["text"] = f"left of the picture:<br>{text}"
    return [style.markers([at], [0], "circle", style.BLACK, 10)] if inside else [], [note]


def _beyond(left: float) -> dict:
    """Bar on the real axis from −1 to `left`, as a plotly shape: a locus that crosses it is beyond its stability limit."""
    line = {"color": style.VERMILION, "width": 4}
    return {"type": "line", "x0": left, "x1": -1, "y0": 0, "y1": 0, "line": line, "opacity": 0.55, "layer": "below"}


def _title(state: State) -> str:
    verdict = "" if state.limit.stable else "UNSTABLE; "
    if math.isnan(state.limit.gain):
        return f"{state.title}: {verdict}limit not known"
    if not math.isfinite(state.limit.frequency):
        return f"{state.title}: {verdict}no crossing sets a limit"
    return f"{state.title}: {verdict}{'crosses' if state.limit.stable else 'crossed'} at {digits(-1 / state.limit.gain, '', 3)}"


def _caption(state: State, critical: int | None) -> str:
    limit = state.limit
    if math.isnan(limit.gain):
        return "These loci could not be followed to a limit; the drawing may be incomplete."
    if critical is None:
        return "No locus crosses the negative real axis where it would set a limit."
    if limit.stable:
        return f"At {digits(limit.gain, '', 3)} × these gains the bold locus passes through −1."
    return f"The loci encircle −1; below {digits(limit.gain, '', 3)} × these gains they do not."
