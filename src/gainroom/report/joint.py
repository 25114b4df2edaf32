"""Page of one joint: verdict, numbers, gain map, figures, step response, tables, certification."""

import math

from ..analysis.margin_record import Margins
from ..errors import at_frequency, case_text
from ..studies.joint import JointStudy
from ..system.controller import type_of
from ..system.requirements import REQUIREMENTS, Requirements
from .bode import bode, cases, nyquist
from .columns import Column
from .gain_advice import gains_box
from .gain_map import gain_map
from .joint_tables import JointPresentation, case_table, crossing_table, inputs, margin_table, uncertainty_table
from .joint_text import cause, notes, recommended_text, sentence, uncertainty_cost_text, warnings
from .margin_columns import bounded_columns
from .number_format import digits, frequency, hertz, model_kind, typed_gains
from .over_time import motion_figure
from .page import Card, Html, Lead, Section, facts, page, paragraph
from .page_parts import assumptions, margin_card, unstable_card
from .words import tone

CARDS = ("gain_margin", "phase_margin", "peak_sensitivity", "delay_margin", "dynamic_stiffness")
"""Margins with a card of their own, beside those that are required."""
MOST_CARDS = 5  # but that every required margin has one


def joint_page(shown: JointPresentation, command: str) -> str:
    """HTML page of a joint study; `command`: the command that makes it."""
    study, found = shown.study, shown.study.margins
    pictured = cases(study)
    sections = [
        Section("Gain map", [gain_map(study)]),
        Section("Over time: the link", [motion_figure(study)]),
        Section("Why: the open loop", [*map(paragraph, filter(None, [cause(study)])), bode(study, pictured)]),
        Section("Nyquist plot", [nyquist(study, pictured)], "the open loop beside −1, and the disk about −1 that it stays out of"),
        Section("Margins", [margin_table(study), *_recommended(study)], "this file's gains, the recommended ones, and the 10 Hz rule's"),
        None
        if study.uncertainty_cost is None
        else Section("What the uncertainty costs", [uncertainty_table(study)], uncertainty_cost_text(study, ranked=False)),
        Section("With and without elasticity and delay", [case_table(pictured)], "the same gains on a rigid joint, and without delay"),
        Section("All crossings of this file's loop", [crossing_table(found)], f"{len(found.phase_crossings) + len(found.gain_crossings)}"),
        Section(
            "Inputs and assumptions",
            [
                inputs(study),
                assumptions("Linear two-mass joint", study.system.control),
                *map(paragraph, (*study.system.assumptions, *notes(study))),
            ],
            "what was read, and what it leaves out",
        ),
        Section("Certification", [_certificate(study)], "how each number was checked"),
    ]
    title = f"gainroom joint: gains of one joint, {model_kind(study.system.control.sample_time)} model"
    return page(title, _lead(shown), _cards(study), sections, command)


def _lead(shown: JointPresentation) -> Lead:
    study = shown.study
    found_warnings, do, how = warnings(study), gains_box(study, shown.to_use), tone(study.verdict)
    where = f" within the uncertainty ranges, at {case_text(study.unstable_at)}" if study.unstable_at else ""
    return Lead(sentence(study), how, f"UNSTABLE{where}: do not run these gains" if how == "bad" else "", found_warnings, do)


def _cards(study: JointStudy) -> list[Card]:
    """Cards of the main numbers, three to five."""
    found, asked = study.margins, study.system.requirements
    worst = study.in_range.margins if study.system.uncertainty.names else None
    time = "continuous time" if study.system.rate_is_missing else ""
    required = [column for column in bounded_columns() if column.requirement in asked.asked]
    others = [column for column in bounded_columns() if column.requirement in CARDS and column not in required]
    shown = required + others[max(0, len(required) + len(others) - MOST_CARDS) :]
    cards = [_margin_card(column, found, worst, asked, time) for column in shown]
    if not found.stable:
        cards[0] = unstable_card(asked, study.limit, f"; vibration there {at_frequency(study.limit.frequency, 'at ', hertz)}", "it")
    return cards


def _margin_card(column: Column, found: Margins, worst: Margins | None, asked: Requirements, time: str) -> Card:
    """Card of a margin at the worst of the uncertainty, with the nominal value where there is a `worst`; `time` ends the note."""
    one = REQUIREMENTS[column.requirement]
    note = "" if column.at is None else at_frequency(column.at(found), "at ", hertz)
    nominal = getattr(found, one.name, one.value(found))
    if one.name == "dynamic_stiffness" and 0 < one.value(worst or found) < math.inf:
        time = ", ".join(filter(None, [f"{digits(math.radians(one.value(worst or found)), 'N·m', 3)} turn it by 1°", time]))
    if worst is None:
        return margin_card(asked, one.name, nominal, ", ".join(filter(None, [note, time])), one.value(found))
    note = "" if column.at is None or not found.stable else at_frequency(column.at(worst), "at ", hertz)
    within = f"nominal {one.text(nominal)}" if found.stable else ""
    return margin_card(asked, one.name, one.value(worst), ", ".join(filter(None, [note, within, time])), label=f"{one.label}, worst case")


def _recommended(study: JointStudy) -> list[str]:
    best = study.recommended
    if best is None:
        return ["No gains are recommended: nothing is required, or no PD gains meet it."]
    other = "" if type(best.controller) is type(study.system.control.controller) else f", type {type_of(best.controller)}"
    return [f"Recommended controller{other}: {typed_gains(best.controller)}.", recommended_text(best)]


def _certificate(study: JointStudy) -> Html:
    found, limit = study.margins, study.limit
    crossings = "every crossing and peak was bracketed and polished; bounds between the evaluated frequencies prove that none was missed"
    pairs = [
        ("margins", crossings if found.certified else "estimates: a crossing or peak could not be proved"),
        ("verdict", _verdict(found)),
    ]
    if study.system.uncertainty.names and found.stable:
        verdict = f"unstable at {case_text(study.unstable_at)}" if study.unstable_at else "stable"
        how = "a case that was counted" if study.unstable_at else "proved for every joint within them, between all frequencies"
        if not study.range_proved:
            how = "ends, corners, a filling and a search examined; between them not proved"
        pairs.append(("verdict in the uncertainty ranges", f"{verdict}; {how}"))
    if limit.certificate is not None:
        proof = limit.certificate
        pairs.append(
            (
                "gain limit",
                f"{digits(limit.gain, '', 6)} × these gains at {frequency(limit.frequency)}: {proof.inside} unstable roots at "
                f"(1 − {digits(proof.nudge)}) of it, {proof.outside} at (1 + {digits(proof.nudge)}); "
                f"{'confirmed' if proof.holds else 'NOT confirmed'}",
            )
        )
    pairs.append(("gain map", "boundaries in closed form (D-decomposition), exact on every line drawn, not a pixel grid"))
    if study.recommended is not None:
        pairs.append(("recommended gains", study.recommended.certificate))
    return facts(pairs)


def _verdict(found: Margins) -> str:
    count = "no closed-loop root is" if found.stable else f"{found.unstable_roots} closed-loop roots are"
    return f"{count} unstable, counted by Nyquist's criterion on the certified crossings"
