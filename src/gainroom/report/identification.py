"""The pages of `gainroom identify`: the answer with its interval, the pictures that show it, the numbers, what to record next."""

from collections.abc import Sequence

from ..identification import Estimate, GainsFit, JointFit, Record, StiffnessFit, TorqueDelay
from .estimates import TITLES, Answer, interval_text, warranted_digits
from .identification_advice import delay_advice, gains_advice, joint_advice, stiffness_advice
from .identification_figures import autocorrelation, frequency_response, gains_beside, hysteresis, jitter, predicted, torques
from .identified_text import ASKED_TITLES, asked_rows
from .number_format import digits
from .page import Card, Lead, Section, page, table


def delay_page(found: TorqueDelay, record: Record, answer: Answer, command: str) -> str:
    """Of `identify delay` from torques."""
    cards = [
        _card("delay", found.delay.scaled(1e3), "ms"),
        _card("in ticks", found.ticks, f"of {digits(1e3 * found.sample_time, 'ms')}"),
        _card("current loop ω_c", found.bandwidth, "rad/s"),
        _card("delay + lag", None if found.lag is None else found.lag.scaled(1e3), "ms"),
    ]
    return _page("delay", answer, "warn" if found.confounded else "good", cards, _torques(found, record), delay_advice(found), command)


def _torques(found: TorqueDelay, record: Record) -> list[Section | None]:
    return [Section("Torques", [torques(found, record)]), Section("Jitter", [jitter(found)]) if len(found.jitter.ticks) else None]


def setpoint_delay_page(answer: Answer, command: str) -> str:
    """Of `identify delay` from set-point and position: numbers alone."""
    return _page("delay", answer, "warn" if answer.warnings else "good", [], [], [], command)


def joint_page(fit: JointFit, record: Record, answer: Answer, command: str) -> str:
    """Of `identify joint`."""
    found, delay = fit.parameters, fit.parameters.get("delay")
    cards = [
        _card("stiffness K", found.get("stiffness"), "N·m/rad"),
        _card("motor inertia J_M", found.get("motor_inertia", found.get("inertia")), "kg·m²"),
        _card("link inertia J_L", found.get("link_inertia"), "kg·m²"),
        _card("delay", None if delay is None else delay.scaled(1e3), "ms"),
        Card("model", "adequate" if fit.adequate else "not adequate", met=fit.adequate, note=fit.model),
    ]
    sections = [
        Section("Measured and fitted", [frequency_response(fit)]),
        Section("What the model leaves", [autocorrelation(fit)]),
        *([] if fit.delay is None else _torques(fit.delay, record)),
    ]
    return _page("joint", answer, "good" if fit.adequate and not fit.warnings else "warn", cards, sections, joint_advice(fit), command)


def stiffness_page(fit: StiffnessFit, answer: Answer, command: str) -> str:
    """Of `identify stiffness`."""
    cards = [
        _card("stiffness K", fit.stiffness, "N·m/rad"),
        _card("friction", fit.friction, "N·m"),
        _card("hysteresis", fit.hysteresis.scaled(1e3), "mrad"),
        _card("hardening", fit.hardening.scaled(100.0), "%"),
    ]
    sections = [Section("Torque and deflection", [hysteresis(fit)])]
    return _page("stiffness", answer, "warn" if fit.warnings else "good", cards, sections, stiffness_advice(fit), command)


def gains_page(fit: GainsFit, record: Record, asked: Sequence[tuple[str, float]], answer: Answer, command: str) -> str:
    """Of `identify gains`; `asked`: gains by name."""
    cards = [
        _card("kp", fit.kp, "N·m/rad"),
        _card("kd", fit.kd, "N·m·s/rad"),
        Card("explained", digits(100 * fit.explained, "", 4), "%", note=f"of {fit.torque}'s power"),
    ]
    sections = [Section("Predicted and logged torque", [predicted(fit, record)])]
    if asked:
        beside = [gains_beside(fit, asked), table(ASKED_TITLES, asked_rows(fit, asked), sorts=False)]
        sections.append(Section("Beside what was asked for", beside))
    state = "warn" if fit.warnings or fit.unit_errors else "good"
    return _page("gains", answer, state, cards, sections, gains_advice(fit), command)


def _page(
    what: str,
    answer: Answer,
    state: str,
    cards: Sequence[Card | None],
    sections: Sequence[Section | None],
    advice: Sequence[str],
    command: str,
) -> str:
    numbers = table(TITLES, answer.rows(), "Intervals contain the true value in 95 of 100 logs.", sorts=False)
    sections = [*sections, Section("What to record next", advice) if advice else None, Section("Parameters", [numbers])]
    lead = Lead(answer.sentence, state, "", answer.warnings)  # type: ignore[arg-type]
    return page(f"gainroom identify {what}", lead, cards, sections, command)


def _card(label: str, estimate: Estimate | None, unit: str) -> Card | None:
    """A value with its interval; None where there is none."""
    if estimate is None:
        return None
    value = digits(estimate.value, "", warranted_digits(estimate.value, estimate.low, estimate.high))
    return Card(label, value, unit, note=interval_text(estimate.low, estimate.high))
