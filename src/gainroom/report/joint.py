"""The page of one joint: verdict, numbers, gain map, figures, tables, certification."""

import math

from ..analysis.margins import Margins
from ..errors import case_text
from ..studies.joint import JointStudy
from ..system.requirements import REQUIREMENTS, Requirements
from .bode import bode, cases
from .columns import Column
from .gain_map import gain_map
from .joint_tables import case_table, crossing_table, inputs, margin_table, uncertainty_table
from .joint_text import cause, notes, recommended_text, sentence, severity, uncertainty_cost_text, warnings
from .margin_columns import bounded_columns
from .number_format import digits, frequency, hertz, model_kind, typed_gains
from .nyquist import nyquist
from .page import Card, Html, Lead, Section, block, facts, page, paragraph
from .page_parts import assumptions, footer, margin_card, unstable_card
from .time_response import time_response
from .verdict import advice_box, joint_to_use


def joint_page(study: JointStudy, command: str, call: str = "gainroom joint FILE") -> str:
    """The report of a study as one HTML page; `command` is the command that makes it, `call` the one without a page."""
    shown = cases(study)
    found = study.margins
    sections = [
        Section("Gain map", [gain_map(study)]),
        Section("Why: the open loop", [*map(paragraph, filter(None, [cause(study)])), bode(study, shown)]),
        Section("Nyquist plot", [nyquist(study, shown)], "the open loop beside −1, and what the requirements exclude"),
        Section("Over time", [time_response(study)], "responses to a step and to a disturbance"),
        Section("Margins", [margin_table(study), *_recommended(study)], "this file's gains, the recommended ones, and the 10 Hz rule's"),
        *(
            [Section("What the uncertainty costs", [uncertainty_table(study)], uncertainty_cost_text(study, ranked=False))]
            if study.uncertainty_cost is not None
            else []
        ),
        Section("With and without elasticity and delay", [case_table(shown)], "the same gains on a rigid joint, and without delay"),
        Section("All crossings of this file's loop", [crossing_table(found)], f"{len(found.phase_crossings) + len(found.gain_crossings)}"),
        Section(
            "Inputs and assumptions",
            [inputs(study), assumptions("Linear two-mass joint", study.system.control), *map(paragraph, notes(study))],
            "what was read, and what it leaves out",
        ),
        Section("Certification", [_certificate(study)], "how each number was checked"),
        Section("Command", [block(command)], "that makes this page"),
    ]
    title = f"gainroom joint: gains of one joint, {model_kind(study.system.control.sample_time)} model"
    return page(title, _lead(study, call), _cards(study), sections, footer())


def _lead(study: JointStudy, call: str) -> Lead:
    said, do = warnings(study), advice_box(study, joint_to_use(study, call))
    if not study.margins.stable:
        return Lead(sentence(study), "bad", "UNSTABLE: do not run these gains", said, do)
    if study.unstable_at:
        where = case_text(study.unstable_at)
        return Lead(sentence(study), "bad", f"UNSTABLE within the uncertainty ranges, at {where}: do not run these gains", said, do)
    return Lead(sentence(study), severity(study), "", said, do)


def _cards(study: JointStudy) -> list[Card]:
    """Three to five numbers."""
    found, asked = study.margins, study.system.requirements
    worst = study.in_range.margins if study.system.uncertainty.names else None
    cards = [_margin_card(column, found, worst, asked) for column in bounded_columns()]
    if not found.stable:
        cards[0] = unstable_card(asked, study.limit, f"; vibration there {_at(study.limit.frequency)}", "it")
    if "delay_margin" not in REQUIREMENTS:
        least = found if worst is None else worst
        label = "delay margin" if worst is None else "delay margin, worst case"
        nominal = "" if worst is None else f", nominal {digits(1e3 * found.delay_margin, 'ms', 3)}"
        delay = digits(1e3 * least.delay_margin, "", 3)
        cards.append(Card(label, delay, "ms" if found.stable else "", note=_at(least.delay_crossover) + nominal))
    return cards


def _margin_card(column: Column, found: Margins, worst: Margins | None, asked: Requirements) -> Card:
    """The margin at the worst of the uncertainty, the nominal one beside it where there is one (`worst`)."""
    one = REQUIREMENTS[column.requirement]
    note = "" if column.at is None else _at(column.at(found))
    nominal = getattr(found, one.name, one.value(found))
    if worst is None:
        return margin_card(asked, one.name, nominal, note, one.value(found))
    note = "" if column.at is None or not found.stable else _at(column.at(worst))
    within = f"nominal {one.text(nominal)}" if found.stable else ""
    return margin_card(asked, one.name, one.value(worst), ", ".join(filter(None, [note, within])), label=f"{one.label}, worst case")


def _at(omega: float) -> str:
    return f"at {hertz(omega)}" if math.isfinite(omega) else ""


def _recommended(study: JointStudy) -> list[str]:
    best = study.recommended
    if best is None:
        return ["No gains are recommended: nothing is required, or no PD gains meet it."]
    return [f"Recommended controller: {typed_gains(best.controller)}.", recommended_text(best)]


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
                f"(1 − {proof.nudge:.0e}) of it, {proof.outside} at (1 + {proof.nudge:.0e}); "
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
