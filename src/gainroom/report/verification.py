"""The page of a verification: whether simulation and prediction agree, every case in a picture, and closed below table and method."""

import math

from ..errors import listed
from ..studies.verification import Verification
from ..system.requirements import Requirements
from ..system.system import System
from .columns import tabulated
from .margin_columns import requirement
from .number_format import digits, hertz, model_text
from .page import Card, Html, Lead, Section, block, page, table
from .page_parts import assumptions, footer
from .verification_figures import agreement, growth
from .verification_text import CASE, WITNESSES, at_nominal, left_out, percent, sentence, size, what_to_do
from .what_to_do import advice_box


def verification_page(system: System, result: Verification, command: str, judge: str = "") -> str:
    """The report as one HTML page; `command` is the command that makes it, `judge`: see what_to_do."""
    limit, wrong = result.cases[0].predicted_gain, [case for case in result.cases if not case.agrees]
    sample_time, what, model = system.control.sample_time, "a robot", "Robot linearised about each posture, all loops closed"
    if not result.of_robot:
        what, model = "one joint", "Linear two-mass joint"
    count = len(result.cases)
    sections = [
        Section(f"What disagrees: {len(wrong)} of {count} cases" if wrong else "Predicted and simulated", [agreement(result.cases)]),
        *([Section("Growth about the limit", [growth(system, limit)])] if not result.of_robot and 0 < limit < math.inf else []),
        Section("Case by case", [_table(result)], f"{count} case{'s' * (count > 1)} with gains and frequencies"),
        Section(
            "Assumptions",
            [assumptions(model, system.control), _method(result), *(f"Left out: {warning}" for warning in result.warnings)],
            "the model, and how the limits are simulated",
        ),
        Section("Command", [block(command)], "that makes this page"),
    ]
    said = [f"left out: {warning}" for warning in result.warnings]
    state = "bare" if result.least.enough is False or result.least.predicted_gain <= 1 else "good"
    lead = Lead(sentence(result), state, "", said, advice_box(what_to_do(result, judge))) if result.agrees else _disagreement(result, said)
    return page(f"gainroom verify: {what}, {model_text(sample_time)}", lead, _cards(result), sections, footer())


def _disagreement(result: Verification, said: list[str]) -> Lead:
    return Lead(sentence(result), "bad", "Simulation and prediction disagree: do not rely on the predicted limit", said)


def _cards(result: Verification) -> list[Card]:
    cases, right = result.cases, sum(case.agrees for case in result.cases)
    wrong = listed([f"{case.what} ({case.witness})" for case in cases if not case.agrees])
    cards = [Card("cases that agree", str(right), f"of {len(cases)}", "all", result.agrees, f"not: {wrong}" if wrong else "")]
    for witness, name in WITNESSES.items():
        own = [case for case in cases if case.witness == witness]
        if own:
            worst = max(own, key=lambda case: max(size(case.gain_difference), size(case.frequency_difference)))
            gain = size(worst.gain_difference) >= size(worst.frequency_difference)
            difference = worst.gain_difference if gain else worst.frequency_difference
            value, _, unit = percent(difference, worst.tolerance).rpartition(" ")
            note = f"of the {'gain' if gain else 'frequency'}, {worst.what}"
            allowed = f"≤ {digits(100 * worst.tolerance)} %"
            cards.append(Card(f"largest difference, {name}", value or "none found", unit * bool(value), allowed, worst.agrees, note))
    return sorted([*cards, _limit(result)], key=lambda card: card.met is not False)


def _limit(result: Verification) -> Card:
    """The lowest limit, beside the gain margin that is required: what simulate judges it by, too."""
    least, required = result.least, result.least.required
    at = f"{hertz(least.predicted_frequency)}, " if math.isfinite(least.predicted_frequency) else ""
    asked = Requirements() if required is None else Requirements(gain_margin=required)
    wanted = "> 1: stable" if required is None else f"≥ {digits(required, '×', 3)}: gain margin {requirement(asked, 'gain_margin', 3)}"
    met = least.predicted_gain > 1 if required is None else least.enough
    if met and result.uncertain:  # one case of the file's ranges
        met = None
    return Card("vibration starts at", digits(least.predicted_gain, "", 4), "×", wanted, met, f"{at}{least.what}{at_nominal(result)}")


def _table(result: Verification) -> Html:
    return table(
        *tabulated(CASE, result.cases), "Predicted and simulated gains are factors on the file's own.", {"yes": "met", "no": "unmet"}
    )


def _method(result: Verification) -> str:
    return (
        "Every run starts with a torque impulse. A matrix pencil finds the fastest-growing oscillation in its second half, and a bracketed "
        "search the factor at which its growth rate is zero, to one part in a million; in MuJoCo, where the motors start at a small "
        "speed, to one in a thousand. The limits " + left_out(result) + "; gainroom simulate includes the scenario."
    )
