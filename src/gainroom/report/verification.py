"""The page of a verification: whether simulation and prediction agree, every case in a picture, and closed below table and method."""

import math

from ..errors import listed
from ..studies.verification import Case, Verification
from ..system.system import System
from .columns import tabulated
from .number_format import digits, hertz, model_text
from .page import Card, Html, Lead, Section, advice, block, coded, page, table
from .page_parts import assumptions, footer
from .verification_figures import agreement, growth
from .verification_text import CASE, WITNESSES, left_out, percent, sentence, size


def verification_page(system: System, result: Verification, command: str) -> str:
    """The report as one HTML page; `command` is the command that makes it."""
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
            [assumptions(model, sample_time), _method(result), *(f"Left out: {warning}" for warning in result.warnings)],
            "the model, and how the limits are simulated",
        ),
        Section("Command", [block(command)], "that makes this page"),
    ]
    said = [f"left out: {warning}" for warning in result.warnings]
    lead = Lead(sentence(result), "good", "", said, _advice(result)) if result.agrees else _disagreement(result, said)
    return page(f"gainroom verify: {what}, {model_text(sample_time)}", lead, _cards(result), sections, footer())


def _disagreement(result: Verification, said: list[str]) -> Lead:
    return Lead(sentence(result), "bad", "Simulation and prediction disagree: do not rely on the predicted limit", said)


def _advice(result: Verification) -> Html:
    """That agreement is no margin: what the limit means for these gains."""
    least = _least(result)
    if not least.predicted_gain < math.inf:
        return advice("The prediction may be relied on: no factor on these gains makes it vibrate.", "")
    if least.predicted_gain < 1:
        return advice("The predicted limit may be relied on, and these gains are beyond it: they are UNSTABLE. Lower them.", "")
    what = "robot" if result.of_robot else "joint"
    text = f"The predicted limit may be relied on. It is no margin: `gainroom {what}` says how far to stay below, and recommends gains."
    return advice(coded(text), "")


def _least(result: Verification) -> Case:
    """The case with the lowest predicted limit; first one in which it is not known."""
    return min(result.cases, key=lambda case: -math.inf if math.isnan(case.predicted_gain) else case.predicted_gain)


def _cards(result: Verification) -> list[Card]:
    cases, right, least = result.cases, sum(case.agrees for case in result.cases), _least(result)
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
    at = f"{hertz(least.predicted_frequency)}, " if math.isfinite(least.predicted_frequency) else ""
    limit = Card(
        "vibration starts at", digits(least.predicted_gain, "", 4), "×", "> 1: stable", least.predicted_gain > 1, f"{at}{least.what}"
    )
    return [*cards, limit]


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
