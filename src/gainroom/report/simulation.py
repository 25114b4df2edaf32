"""The page of a played scenario: answer, numbers, commanded and actual with the torque under them, the vibration close up."""

import math

import numpy as np

from ..simulation.response import Response
from ..studies.joint_simulation import SimulationStudy
from . import style
from .number_format import digits, gain_factor, milli, settling, typed_gains
from .page import Card, Html, Lead, Section, block, facts, page, table
from .played import Curve, Panel, close_up, close_up_words, error_cards, lead, shown_ticks, stacked, vibration_card, vibration_note
from .shared import filters, footer


def simulation_page(study: SimulationStudy, command: str) -> str:
    """The report of a run as one HTML page; `command` is what a reader types to get it again."""
    sections = [Section("In time", [_traces(study)])]
    if study.vibration is not None and study.vibrates:
        sections.append(Section("The vibration", [_close_up(study)]))
    sections += [
        *([] if study.response.diverged else [Section("Numbers", [_numbers(study)])]),
        Section("Inputs and assumptions", [_inputs(study), "Keys and units are those of the file.", _assumptions(study)]),
        Section("This page again", [block(command)]),
    ]
    kind = "linear sampled model" if study.spec.is_linear else "virtual testbed"
    return page(f"gainroom simulate: one joint, {kind}", _lead(study), _cards(study), sections, footer())


def _lead(study: SimulationStudy) -> Lead:
    verdict = "" if study.sound else "DIVERGES" if study.response.diverged else "VIBRATES" if study.vibrates else "UNSTABLE"
    return lead(study.sentence, verdict, study.warnings)


def _cards(study: SimulationStudy) -> list[Card]:
    found, ran = study.tracking, study.response.diverged_at
    if ran is not None:
        cards = [Card("runs away within", digits(ran, "", 3), "s", "must not", met=False)]
    else:
        peak, rms, steady = (float(np.abs(value).max()) for value in (found.peak, found.rms, found.steady_state))
        torque = Card("torque peak", digits(float(study.torque_peak.max()), "", 3), "N m", note=f"of the actual torque{_beyond(study)}")
        errors = error_cards(peak, rms, steady, "mrad")
        cards = [*(errors[:-1] if math.isnan(steady) else errors), torque]
    if study.hidden:
        known = 0 < study.limit.gain < math.inf
        factor = gain_factor(study.limit.gain, 3) if known else "unstable"
        cards.append(Card("linear limit", factor, "× these gains" if known else "", requirement="above 1", met=False))
    return [*cards, vibration_card(study.vibration, study.vibrates, study.limit)]


def _beyond(study: SimulationStudy) -> str:
    """How the actual torque can pass its limit, after the torque's peak."""
    return "; above the limit, which cuts the demand: the current loop overshoots" if study.overshoots_limit else ""


def _traces(study: SimulationStudy) -> Html:
    """Commanded and both sides; the error; target and actual torque."""
    response, end = study.response, _shown_ticks(study)
    notes = [vibration_note(study.vibration)] if study.vibration is not None and study.vibrates else []
    cut = end < len(response.time)
    caption = (
        f"Positions on the joint side of the gearbox, error of the {response.feedback} side, which is fed back; torques at the ticks. "
        + (f"Cut at {digits(response.time[end - 1], 's', 3)}, where the joint is already out of the picture. " if cut else "")
        + _conclusion(study)
    )
    rows = slice(0, end)
    return stacked(
        response.time[rows], _panels(response, rows), "Commanded and actual position, tracking error, torque", caption, 680, notes
    )


def _close_up(study: SimulationStudy) -> Html:
    """The last periods of the vibration."""
    assert study.vibration is not None
    response = study.response
    rows = close_up(study.vibration, response.sample_time, _shown_ticks(study))
    return stacked(response.time[rows], _panels(response, rows), *close_up_words(study.vibration, study.limit), 600)


def _panels(response: Response, rows: slice) -> list[Panel]:
    positions = (
        Curve("motor", response.motor_position[rows, 0], style.BLUE),
        Curve("link", response.link_position[rows, 0], style.VERMILION, "dash"),
        Curve("commanded", response.reference[rows, 0], style.BLACK, "dot"),
    )
    torques = (
        Curve("target torque", response.target_torque[rows, 0], style.ORANGE, "dash"),
        Curve("actual torque", response.actual_torque[rows, 0], style.BLACK),
    )
    return [
        Panel("position", "rad", positions, 0.42),
        Panel("error", "mrad", [Curve("error", 1e3 * response.error[rows, 0], style.BLUE, named=False)], 0.27),
        Panel("torque", "N m", torques, 0.31),
    ]


def _shown_ticks(study: SimulationStudy) -> int:
    response = study.response
    return shown_ticks(response.reference, response.error) if response.diverged else len(response.time)


def _conclusion(study: SimulationStudy) -> str:
    if study.response.diverged:
        return "These gains must not be run."
    if study.hidden:
        return "These gains are unstable, whatever hides it here: lower all of them together, or shorten the delay."
    if study.vibrates:
        return "The vibration does not die away: lower all gains together, or shorten the delay."
    return "Nothing lasts but the error itself: what ends a move short of its goal is friction, gravity or a lasting torque on the joint."


def _numbers(study: SimulationStudy) -> Html:
    found = study.tracking
    columns = ("", "RMS [mrad]", "peak [mrad]", "steady state [mrad]", "overshoot", "settles in", "torque peak [N m]")
    rows = [
        (
            name,
            *(milli(float(value[k])) for value in (found.rms, found.peak, found.steady_state)),
            digits(100 * float(found.overshoot[k]), "%", 3),
            settling(float(found.settling_time[k])),
            digits(float(study.torque_peak[k]), "", 4),
        )
        for k, name in enumerate(study.response.joint_names)
    ]
    caption = (
        "Error: reference less position; steady state: its mean over the last tenth of the run, of a reference that rests then. "
        "Settled: within 2 % of the move for good, and seen to be for a tenth of the run. Only a move has an overshoot; both are judged up "
        f"to a later disturbance. Torque: of the actual torque{_beyond(study)}."
    )
    return table(columns, rows, caption)


def _inputs(study: SimulationStudy) -> Html:
    spec = study.spec.joint
    joint, drive = spec.joint, spec.drive
    pairs = [
        (
            "joint",
            f"J_M {joint.motor_inertia:g}, J_L {joint.link_inertia:g} kg m², K {joint.stiffness:g} N m/rad, B {joint.damping:g} N m s/rad",
        ),
        ("drive", f"current loop {drive.bandwidth:g} rad/s, ζ {drive.damping_ratio:g}, delay {1e3 * drive.delay:g} ms"),
        ("control", f"{typed_gains(spec.controller)}, all × {study.gain:g}; {spec.feedback} side; {filters(spec.controller)}"),
        (
            "ticks",
            f"{digits(1 / study.spec.sample_time, 'Hz')}, {len(study.response.time)} rows over {digits(study.response.time[-1], 's')}",
        ),
    ]
    return facts([*pairs, *study.spec.described.items()])


def _assumptions(study: SimulationStudy) -> str:
    if study.spec.is_linear:
        rubs = "friction beyond the viscous" if study.spec.hardware else "friction"
        return (
            "Linear two-mass joint, stepped exactly from tick to tick: the torque is held in between, velocity is differenced as the "
            f"controller does it, the delay is exact. No {rubs}, gravity, torque limit or encoder steps: the file's scenario adds them."
        )
    sags = (
        " The run starts at rest at the reference and without torque, so that gravity first pulls the joint down: peaks and RMS hold that."
        if "gravity" in study.spec.hardware
        else ""
    )
    return (
        "The same loop on a virtual testbed. Between ticks linear parts are exact; friction and gravity are constant over substeps of "
        f"25 µs and can create no energy. No backlash, no thermal effects.{sags}"
    )
