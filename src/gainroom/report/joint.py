"""The page of one joint: answer, numbers, gain map, the pictures that explain it, tables, and how it was computed."""

import math
from datetime import UTC, datetime

from .. import __version__
from ..io.numbers import decibels, digits, frequency, hertz, model_kind, own_gains, plane_names, typed_gains
from ..robustness import Margins
from ..study import JointStudy
from .bode import bode, cases
from .gain_map import gain_map
from .nyquist import nyquist
from .page import Card, Html, Lead, Section, block, facts, page
from .tables import case_table, crossing_table, inputs, margin_table
from .time_response import time_response


def joint_page(study: JointStudy, command: str) -> str:
    """The report of a study as one HTML page; `command` is what a reader types to get it again."""
    shown = cases(study)
    sections = [
        Section("Gain map", [gain_map(study)]),
        Section("Why: the open loop", [bode(study, shown), nyquist(study, shown)]),
        Section("In time", [time_response(study)]),
        Section("Margins", [margin_table(study), _binding(study)]),
        Section("With and without elasticity and delay", [case_table(shown)]),
        Section("All crossings of this file's loop", [crossing_table(study.margins)]),
        Section("Inputs and assumptions", [inputs(study), _assumptions(study)]),
        Section("What was certified, and how", [_certificate(study)]),
        Section("This page again", [block(command)]),
    ]
    today = datetime.now(UTC).date().isoformat()
    title = f"gainroom joint: gains of one joint, {model_kind(study.spec.sample_time)} model"
    return page(title, _lead(study), _cards(study), sections, [f"gainroom {__version__}, {today}"])


def _lead(study: JointStudy) -> Lead:
    if not study.margins.stable:
        return Lead(study.sentence, "bad", "UNSTABLE: do not run these gains", study.warnings)
    unmet = [card.label for card in _cards(study) if card.met is False]
    if unmet:
        return Lead(study.sentence, "warn", f"Stable, but not with the required margin: {', '.join(unmet)}", study.warnings)
    return Lead(study.sentence, "good", "", study.warnings)


def _cards(study: JointStudy) -> list[Card]:
    """Three to five numbers for the first glance."""
    found, asked = study.margins, study.spec.requirements
    cards = [_gain_card(study)]
    cards.append(
        Card(
            "phase margin",
            digits(math.degrees(found.phase_margin), "°", 3),
            "",
            "" if asked.phase_margin is None else f"≥ {digits(math.degrees(asked.phase_margin), '°', 3)}",
            _met(found, asked.phase_margin, abs(found.phase_margin) >= (asked.phase_margin or 0)),
            _at(found.gain_crossover),
        )
    )
    cards.append(
        Card(
            "peak sensitivity Ms",
            digits(found.peak_sensitivity, "", 3),
            "",
            "" if asked.peak_sensitivity is None else f"≤ {digits(asked.peak_sensitivity, '', 3)}",
            _met(found, asked.peak_sensitivity, found.peak_sensitivity <= (asked.peak_sensitivity or math.inf)),
            _at(found.peak_sensitivity_frequency),
        )
    )
    cards.append(
        Card("delay margin", digits(1e3 * found.delay_margin, "", 3), "ms" if found.stable else "", note=_at(found.delay_crossover))
    )
    if study.recommended is not None:
        (name, value, unit), *others = own_gains(study.recommended.controller)
        with_ = ", ".join(f"{other} {digits(gain, its_unit, 3)}" for other, gain, its_unit in others)
        cards.append(Card(f"recommended {name}", digits(value, "", 3), unit, note=f"with {with_}"))
    return cards


def _gain_card(study: JointStudy) -> Card:
    found, needed = study.margins, study.spec.requirements.gain_margin
    if not found.stable:
        required = "" if needed is None else f"gain margin ≥ {digits(decibels(needed), 'dB', 3)}"
        if not 0 < study.limit.gain < math.inf:
            return Card("stable factor on these gains", "none", "", required, False, "no factor makes it stable")
        note = f"times these gains; there it would vibrate at {_hz(study.limit.frequency)}"
        return Card("stable only below", digits(study.limit.gain, "", 3), "×", required, False, note)
    return Card(
        "gain margin",
        digits(decibels(found.gain_margin), "", 3),
        "dB",
        "" if needed is None else f"≥ {digits(decibels(needed), 'dB', 3)}",
        _met(found, needed, min(found.gain_margin, _inverse(found.lower_gain_margin)) >= (needed or 0)),
        _at(found.phase_crossover),
    )


def _inverse(factor: float) -> float:
    return 1 / factor if factor > 0 else math.inf


def _met(found: Margins, needed: float | None, enough: bool) -> bool | None:
    return None if needed is None else found.stable and enough


def _at(omega: float) -> str:
    return f"at {_hz(omega)}" if math.isfinite(omega) else ""


def _hz(omega: float) -> str:
    return f"{digits(omega, 'rad/s', 3)} ({hertz(omega)})" if math.isfinite(omega) else "no frequency"


def _binding(study: JointStudy) -> str | Html:
    best = study.recommended
    if best is None:
        return "No gains are recommended: nothing is required, or no PD gains keep it."
    kp_name, _ = plane_names(best.controller)
    told = {True: "{} could be {}", False: "dropping it alone changes nothing"}
    costs = [
        (f"without {name.replace('_', ' ')}", told[name in best.felt].format(kp_name, digits(kp, "N·m/rad", 3)))
        for name, kp in best.costs.items()
    ]
    return facts([("recommended controller", typed_gains(best.controller)), ("held back by", best.held_back_by()), *costs])


def _assumptions(study: JointStudy) -> str:
    text = (
        "Linear two-mass joint, small motions: no friction other than viscous, no torque limit, no backlash, no quantisation. "
        "The delay is exact, never approximated by a rational function."
    )
    if study.spec.sample_time is None:
        text += " The model is continuous; a sampled controller is worse by about one more tick of delay."
    return text


def _certificate(study: JointStudy) -> Html:
    found, limit = study.margins, study.limit
    crossings = "every crossing and peak was bracketed and polished; bounds between the evaluated frequencies prove that none was missed"
    pairs = [
        ("margins", crossings if found.certified else "estimates: a crossing or peak could not be proved"),
        ("verdict", _verdict(found)),
    ]
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
