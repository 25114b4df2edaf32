"""Simulated run as text: sentences, warnings with remedies, advice; and its presentation."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..analysis.margin_record import GainLimit
from ..errors import apart, beside, frequency_text, listed, printable
from ..simulation.simulation_spec import SimulationSpec
from ..simulation.tracking import SETTLED
from ..studies.oscillation import EXACT, MUJOCO
from ..studies.simulation import USUAL, Outcome
from ..system.requirements import REQUIREMENTS
from .columns import Column
from .number_format import digits, frequency, gain_factor, milli, motion, settling
from .page import Advice
from .presentation import Part, Presentation, TextTable, closing, do_this, warned_first
from .words import NOT_SAFE, UNSTABLE, run_headline

SMALLEST_ERROR = 1e-6
"""Error [m, rad] below which a sentence does not distinguish it from 0."""
PERIODS_SHOWN = 3
"""Fewest periods of a vibration that can show whether it is sustained."""
SHOWN_BY_ALL = 10.0
"""Assumed frequency [Hz] of a vibration if the linear loop has none."""
SLOPING = math.radians(1.0)
"""Slope [rad] of the ground under a flat foot above which it is reported."""
MOST_JOINTS = 6
"""Most joints in the terminal's table of torques."""
NUMBERS = ("rms", "peak", "steady_state", "overshoot", "settling_time")
"""Fields of Tracking in JSON."""
UNEVEN = 1e-3
"""Height difference [m] between feet above which it is reported."""


def tracking_headings(outcome: Outcome) -> tuple[str, ...]:
    """Headings of tracking_cells."""
    return "RMS", "peak", "steady state", overshoot_of(outcome), "settles in"


def overshoot_of(outcome: Outcome) -> str:
    """Name of the overshoot: of the link, where it is known, or of the side that is fed back."""
    return f"{_overshooting(outcome)} overshoot"


def _overshooting(outcome: Outcome) -> str:
    return outcome.run.feedback if outcome.run.links is None else "link"


def floor_of(outcome: Outcome) -> float:
    """Error [m, rad] below which 0 is displayed."""
    return 1e-9 if outcome.spec.is_exact else 1e-7


def tracking_cells(outcome: Outcome, channel: int) -> tuple[str, ...]:
    """Table cells of one channel's tracking, in thousandths of its unit, percent and seconds."""
    found = outcome.tracking
    errors = (milli(float(values[channel]), floor_of(outcome)) for values in (found.rms, found.peak, found.steady_state))
    return *errors, digits(100 * float(found.overshoot[channel]), "%", 3), settling(float(found.settling_time[channel]))


def sentence(outcome: Outcome) -> str:
    """Verdict on these gains, and the result of the run, in two or three short sentences."""
    run, found = outcome.run, outcome.oscillation if outcome.vibrates else None
    at = "" if found is None else frequency_text(found.vibration.frequency)
    if not outcome.completed:
        name = printable(run.channels[outcome.leading[0]])
        text = f"{NOT_SAFE}: {run.reason}; {name} deviates by {_size(outcome, outcome.leading[0], 'peak')}"
        text += f", vibrating at {at}" if at else ""
    elif found is not None:
        how = "irregularly, on average at" if found.irregular else "at"
        text = f"{NOT_SAFE}: vibrates {how} {at}, {growth_text(outcome)}, mainly {printable(found.strongest[0])} by {motion(found.swing)}"
    elif outcome.hidden:
        text = f"{UNSTABLE}, {_excess(outcome.limit)}. This run shows no sustained vibration: {_hiding(outcome)}"
    else:
        late = _unsettled(outcome)
        text = f"{run_headline(outcome)}No vibration{'' if late else ' in this run'}{late}. {_errors(outcome)}"
    return f"{text}. {prediction(outcome.limit, outcome.spec.adds_viscous_friction, outcome.gain)}."


def unsettled(outcome: Outcome) -> list[int]:
    """Indices of moved channels that do not stay within 2 % of the move around the target."""
    times, immovable = outcome.tracking.settling_time.tolist(), set(getattr(outcome.spec, "immovable", ()))
    late = [k for k, time in enumerate(times) if math.isinf(time) and outcome.run.channels[k] not in immovable]
    return late if outcome.completed else []


def left_short(outcome: Outcome) -> list[int]:
    """Indices of unsettled channels with a mean error over the last tenth; the others are still moving, or oscillate."""
    run = outcome.run
    bands = SETTLED * np.abs(run.reference[-1] - run.reference[0] + run.error[0])
    return [k for k in unsettled(outcome) if abs(float(outcome.tracking.steady_state[k])) > bands[k]]


def farthest_off(outcome: Outcome) -> int | None:
    """Index of the unsettled channel with the largest final error relative to its move; None if all settle."""
    run, found = outcome.run, outcome.tracking
    move = np.abs(run.reference[-1] - run.reference[0] + run.error[0])
    left = np.where(np.isnan(found.steady_state), found.peak, np.abs(found.steady_state))
    return max(unsettled(outcome), key=lambda k: float(left[k] / move[k]), default=None)


def _unsettled(outcome: Outcome) -> str:
    missed, names = unsettled(outcome), outcome.run.channels
    if not missed:
        return ""
    most = max(missed, key=lambda k: float(outcome.tracking.overshoot[k]))
    over = float(outcome.tracking.overshoot[most])
    do = "do" if len(missed) > 1 else "does"
    text = f", but {listed([printable(names[k]) for k in missed])} {do} not settle within 2 % of the move in this run"
    whose = "" if outcome.run.links is None else "'s link"
    return text + (f", and {printable(names[most])}{whose} overshoots by {100 * over:.3g} %" if over > 0 else "")


def growth_text(outcome: Outcome) -> str:
    """State of a vibration: sustained, or its doubling or halving time."""
    found = outcome.oscillation
    assert found is not None
    if found.moving:
        return "while it moves"
    if found.sustained:
        return "sustained"
    rate = found.vibration.growth_rate
    return f"{'doubling' if rate > 0 else 'halving'} every {math.log(2) / abs(rate):.3g} s"


def vibration_text(outcome: Outcome) -> tuple[str, str]:
    """Frequency and growth of a vibration; if it is not counted, the reason."""
    found = outcome.oscillation
    if found is None:
        return "none", ""
    growth = "sustained" if found.sustained else digits(found.vibration.growth_rate, "1/s", 3)
    growth += ", irregular" if found.irregular else ", while it moves" if found.moving else ""
    return frequency(found.vibration.frequency), growth if found.lasts else f"{growth}: {not_counted(outcome)}"


def limit_text(limit: GainLimit | None, gain: float = 1.0) -> tuple[str, str]:
    """Onset of vibration of the linear loop: frequency, and factor on the file's gains; `gain`: factor of the run."""
    if limit is None:
        return "none", "no gain acts"
    if limit.gain <= 0:
        return frequency(limit.frequency), "at all gains"
    factor = gain_factor(limit.gain) if gain == 1 else digits(gain * limit.gain, significant=apart(gain * limit.gain, gain, 4))
    return frequency(limit.frequency), f"from {factor} × {whose(gain)}"


def whose(gain: float) -> str:
    """Gains that factors refer to, with the factor of the run if there is one: "the file's gains (this run: 4 ×)"."""
    return _base(gain) if gain == 1 else f"{_base(gain)} (this run: {gain:g} ×)"


def _base(gain: float) -> str:
    """Gains that factors refer to, the file's: "these gains" if the run's factor `gain` is 1."""
    return "these gains" if gain == 1 else "the file's gains"


def not_counted(outcome: Outcome) -> str:
    """Reason why a vibration is not counted."""
    found = outcome.oscillation
    assert found is not None
    if found.vibration.amplitude <= found.least:
        return f"below the threshold, {1e3 * found.vibration.amplitude:.2g} of {1e3 * found.least:.2g} mrad"
    return "decays"


def _size(outcome: Outcome, channel: int, number: str) -> str:
    """Tracking error number with its unit."""
    value, unit = abs(float(getattr(outcome.tracking, number)[channel])), outcome.run.units[channel]
    return motion(value, unit) if value >= SMALLEST_ERROR else f"less than {motion(SMALLEST_ERROR, unit)}"


def _errors(outcome: Outcome) -> str:
    """Sentence on the largest error and the steady-state error of the leading channels, and the largest error of the others."""
    found, names = outcome.tracking, [printable(name) for name in outcome.run.channels]
    first, last = outcome.leading[0], outcome.worst_at_end
    text = f"Largest tracking error {_size(outcome, first, 'peak')} ({names[first]})"
    if math.isnan(found.steady_state[last]):
        return text
    text += f", steady-state error {_size(outcome, last, 'steady_state')} ({names[last]})"
    if outcome.others and found.peak[outcome.others[0]] > MUJOCO.least:
        text += f"; {names[outcome.others[0]]}, held still, deviates by {_size(outcome, outcome.others[0], 'peak')}"
    return text


def _excess(limit: GainLimit | None) -> str:
    """Clause on the excess of the gains over the stability limit."""
    if limit is not None and 0 < limit.gain < math.inf:
        return f"these gains are {beside(1 / limit.gain, 1)} × the limit"
    return "the linear loop is unstable"


def _hiding(outcome: Outcome) -> str:
    """Clause on why the run may not show the vibration."""
    hiding = [name for name in outcome.effects if name in ("friction", "noise", "encoder steps", "the torque limit")]
    text = f"{listed(hiding, 'or')} may hide it, or the run is too short" if hiding else "the run is too short, or excites it too little"
    return text if outcome.rippling is None else f"{text}; {_ripple(outcome, outcome.rippling)}"


def _ripple(outcome: Outcome, joint: int) -> str:
    run = outcome.run
    return f"the torque ripple of {printable(run.joint_names[joint])} is {outcome.torque_ripple[joint]:.3g} {run.torque_units[joint]} RMS"


def prediction(limit: GainLimit | None, viscous: bool, gain: float = 1.0) -> str:
    """Prediction of the linear loop, without a full stop, with factors on the file's gains.

    viscous   True: with the scenario's viscous friction, which verify leaves out
    gain      the factor on the file's gains in this run
    """
    if limit is None:
        return "These gains act on no motion in this state"
    if math.isnan(limit.gain):
        return f"The linear loop is {'stable' if limit.stable else 'unstable'}; its gain limit is not known"
    if math.isinf(limit.gain):
        return "The linear loop does not vibrate at any factor on these gains"
    if limit.gain <= 0:
        return "The linear loop is unstable at any lower gains"
    if limit.frequency == 0:
        return f"The linear loop topples without oscillation at {beside(gain * limit.gain, gain)} × {whose(gain)}"
    damped = ", with the scenario's viscous friction," if viscous else ""
    return f"The linear loop{damped} vibrates from {beside(gain * limit.gain, gain)} × {whose(gain)}, at {frequency_text(limit.frequency)}"


def warnings(outcome: Outcome) -> tuple[str, ...]:
    """Warnings for the user, each with its remedy."""
    spec, limit, texts = outcome.spec, outcome.limit, list(outcome.spec.warnings)
    slowest = PERIODS_SHOWN / spec.duration  # [Hz] that the run can show
    fast = limit.frequency / (2 * math.pi) if limit is not None and limit.frequency > 0 else SHOWN_BY_ALL
    if outcome.completed and not outcome.vibrates and slowest > fast:
        texts.append(f"a run of {spec.duration:g} s cannot show vibration below {slowest:.3g} Hz: lengthen scenario.duration")
    if outcome.completed and spec.moves_late and not spec.fastest:
        texts.append("the reference moves until the end, or nearly: lengthen scenario.duration to measure a steady-state error")
    texts += _place_warnings(spec)
    if outcome.rippling is not None and not outcome.vibrates:
        remedy = "finer encoders, a velocity filter or a lower kd reduce it" if spec.encoder_step else "a lower kd reduces it"
        texts.append(f"{_ripple(outcome, outcome.rippling)} above the frequencies of the move: {remedy}")
    texts += _verdict_warnings(outcome)
    if outcome.at_torque_limit.any():
        texts.append(_limit_warning(outcome))
    if outcome.sound and outcome.noise_motion > EXACT.least:
        causes = [name for name in spec.effects if name in ("noise", "encoder steps")]
        texts.append(f"{listed(causes)} move the joint by {motion(outcome.noise_motion)} RMS, without a sustained vibration")
    if spec.kind == "linear":
        texts.append(
            "this run is linear, without dry friction, gravity, torque limit or encoder steps: the scenario section of the file adds them"
        )
    return tuple(texts)


def _verdict_warnings(outcome: Outcome) -> list[str]:
    """Warnings that the run and the linear loop disagree."""
    if outcome.hidden:
        why = f", and without {listed(outcome.effects, 'or')}," if outcome.effects else ""
        return [f"these gains may vibrate although this run does not show it: lower all gains; a longer run{why} may show it"]
    if outcome.limit is None or outcome.sound:
        return []
    if not outcome.stable:
        fell = "it vibrates before it falls, as the linear loop predicts: lower all gains first, then check what else makes it fall"
        return [fell] if outcome.vibrates and outcome.run.ending == "fell" else []
    if not outcome.completed:
        return ["the linear loop is stable: the move, the feet or friction end the run, not gains that are too high"]
    causes = [*outcome.effects, *([] if outcome.spec.is_exact else ["a large motion"])]
    if len(causes) == 1:
        return [f"the linear loop is stable: {causes[0]} sustains this vibration, or a link with little damping still oscillates"]
    return [f"the linear loop is stable: {listed(causes, 'or')} sustains this vibration; change one at a time"]


def _limit_warning(outcome: Outcome) -> str:
    """Warning with the share of time at the torque limit, and the current loop's overshoot beyond it."""
    worst = int(outcome.at_torque_limit.argmax())
    share, peak = outcome.at_torque_limit[worst], outcome.torque_peak[worst]
    whose = "" if len(outcome.torque_peak) == 1 else f" of {printable(outcome.run.joint_names[worst])}"
    beyond = f"; the current loop overshoots it to {peak:.4g} {outcome.run.torque_units[worst]}" if overshoots(outcome) else ""
    often = f"{100 * share:.2g} %" if share >= 1e-3 else "less than 0.1 %"
    return f"the torque limit cuts the demand torque{whose} {often} of the time{beyond}"


def overshoots(outcome: Outcome) -> bool:
    """True if the actual torque exceeds the limit of the demand torque: the current loop overshoots."""
    return bool((outcome.torque_peak > outcome.spec.torque_limit).any())


def _place_warnings(spec: SimulationSpec) -> list[str]:
    """Warnings about tasks that cannot move, and ground that is not one level floor."""
    texts = []
    if spec.immovable:
        texts.append(f"{listed(spec.immovable)} cannot move in this posture and contact state: choose another state, or move another task")
    steepest = max((footing.slope for footing in spec.footings), default=0.0)
    if steepest > SLOPING:
        frames = listed([footing.frame for footing in spec.footings if footing.slope > steepest - SLOPING])
        texts.append(
            f"the ground slopes by {math.degrees(steepest):.3g}° under {frames}, as the contact frames do in this posture: "
            "for a level floor turn the feet until they are level"
        )
    highest = max(spec.footings, key=lambda footing: footing.height, default=None)
    if highest is not None and highest.height > UNEVEN:
        lowest = min(spec.footings, key=lambda footing: footing.height)
        texts.append(
            f"the feet stand at different heights: {highest.frame} {1e3 * highest.height:.3g} mm above {lowest.frame}: "
            "for one floor change the posture until they are level"
        )
    return texts


def _lower(outcome: Outcome, study_call: str, call: str) -> Advice:
    """Advice with the command that finds gains, and the factor with which this run has every margin."""
    factor, every = outcome.gain_to_try, " in every state" if outcome.spec.kind == "mujoco" else ""
    if math.isnan(factor):
        return Advice(
            f"Find gains that meet every requirement{every} (no single factor on all gains was found to be enough):",
            [study_call],
        )
    needed = outcome.spec.system.requirements.needed or {"gain_margin": USUAL}
    margins = listed([f"{(one := REQUIREMENTS[name]).heading} {one.sign} {one.text(value)}" for name, value in needed.items()])
    where = (" in this state" if outcome.spec.kind == "mujoco" else "") + (
        ", at nominal values" if outcome.spec.system.uncertainty.names else ""
    )
    which = "lower" if factor < outcome.gain else "higher"
    again = f"To see what {which} gains do, repeat this run with {factor:g} × {_base(outcome.gain)}:"
    heading = f"Find gains that meet every requirement{every}. {again}"
    lower = f"With these {which} gains the linear loop has {margins}{where}."
    return Advice(heading, [study_call, f"{call} --gain {factor:g}"], [lower])


def _tracking(outcome: Outcome, more: str) -> str:
    """Advice for motions that do not settle: integral action or a higher kp if an error is left, otherwise damping or time."""
    run, late, left = outcome.run, unsettled(outcome), left_short(outcome)
    names = listed([printable(run.channels[k]) for k in left or late]) if len(run.channels) > 1 else ""
    if not left:
        return f"Let {names or 'it'} come to rest: lengthen `scenario.duration`, slow the move, or raise kd as far as {more} allows."
    where = f" in {names}" if names else ""
    helps = "add integral action, or feed-forward of gravity and friction"
    if outcome.missed:
        return f"This run leaves an error{where}. If the new gains do, too, {helps}."
    return f"An error is left{where}: raise kp as far as {more} allows, {helps}."


@dataclass(frozen=True)
class SimulationPresentation(Presentation):
    """Presentation of a run; `call`: simulates the file's own gains, `study_call`: judges them."""

    outcome: Outcome
    study_call: str = "gainroom joint FILE"

    @property
    def advice(self) -> Advice | None:
        """Advice on the run's gains: keep, lower, or judge them further; None if the warnings suffice."""
        outcome, study_call = self.outcome, self.study_call
        more = f"`gainroom {'joint' if outcome.spec.kind != 'mujoco' else 'robot'}`"
        if not outcome.stable or outcome.missed:
            found, late = _lower(outcome, study_call, self.call), outcome.stable and unsettled(outcome)
            return replace(found, remarks=[*found.remarks, _tracking(outcome, more)]) if late else found
        if outcome.run.ending == "fell":
            return Advice("Make the move smaller or slower, and simulate again: it is not the gains.")
        if not outcome.sound:
            return None
        if unsettled(outcome):
            return Advice(_tracking(outcome, more))
        if outcome.spec.system.uncertainty.names:
            return Advice("Judge these gains over the file's ranges:", [study_call])
        if outcome.spec.kind == "mujoco":
            return Advice("These gains may stay in this state. Judge them in every state:", [study_call])
        return Advice(f"These gains may stay, as far as this run shows. {more} judges all their margins.")

    def facts(self) -> dict[str, Any]:
        outcome, run, log = self.outcome, self.outcome.run, self.files.get("Log")
        found, limit, seen = outcome.tracking, outcome.limit, outcome.oscillation
        return {
            **outcome.verdict.facts,
            "diverged": run.diverged,
            "diverged_at": run.diverged_at,
            "fell": run.ending == "fell",
            "ended_at": run.ended_at,
            "vibrates": outcome.vibrates,
            "unstable": outcome.hidden,
            "sentence": sentence(outcome),
            "model": outcome.spec.kind,
            "sample_rate_hz": 1 / run.sample_time,
            "gain": outcome.gain,
            "tracking": {channel: {name: getattr(found, name)[k] for name in NUMBERS} for k, channel in enumerate(run.channels)},
            "error_of": run.feedback,
            "overshoot_of": _overshooting(outcome),
            "at_torque_limit": dict(zip(run.joint_names, outcome.at_torque_limit.tolist(), strict=True)),
            "torque_peak": dict(zip(run.joint_names, outcome.torque_peak.tolist(), strict=True)),
            "slip": dict(zip(outcome.spec.contact_frames, outcome.slip.tolist(), strict=True)),
            "vibration": None
            if seen is None
            else {
                "frequency_rad_s": seen.vibration.frequency,
                "growth_rate": seen.vibration.growth_rate,
                "amplitude": seen.vibration.amplitude,
                "joints": [name for name in seen.strongest if name in run.joint_names] or list(run.joint_names),
            },
            "predicted": None
            if limit is None
            else {"stable": limit.stable, "gain_limit": limit.gain, "limit_frequency_rad_s": limit.frequency},
            "log": None if log is None else str(log),
            "settled": not unsettled(outcome) if any(time == time for time in found.settling_time.tolist()) else None,
            "warnings": list(warnings(outcome)),
        }

    def screens(self, verbose: bool) -> Iterator[list[Part]]:
        outcome, run = self.outcome, self.outcome.run
        rows = [(f"{channel} [m{run.units[k]}]", *tracking_cells(outcome, k)) for k, channel in enumerate(run.channels)]
        columns = [Column(title, "", lambda row, k=k: row[k]) for k, title in enumerate(("", *tracking_headings(outcome)))]
        title = (
            f"Tracking ({outcome.spec.kind}, {digits(1 / run.sample_time, 'Hz')}, encoders on {outcome.spec.system.control.feedback.where})"
        )
        doubts, others = warned_first(warnings(outcome), verbose)
        yield [
            *doubts,
            sentence(outcome),
            *do_this(self.advice),
            "",
            TextTable.of(title, columns, rows),
            *(_all_there_is(outcome) if verbose else []),
            *closing(self.files, others),
            *([] if verbose else ["Torques and vibration: --verbose."]),
        ]


def _all_there_is(outcome: Outcome) -> list[Part]:
    """Tables of torques, and of the vibration beside the linear loop's."""
    run = outcome.run
    hardest = sorted(range(len(run.joint_names)), key=lambda k: -outcome.torque_peak[k])[:MOST_JOINTS]
    torques = [
        (run.joint_names[k], *(digits(float(values[k]), run.torque_units[k], 3) for values in (outcome.torque_peak, outcome.torque_rms)))
        for k in hardest
    ]
    vibrations = [("simulated", *vibration_text(outcome)), ("linear loop", *limit_text(outcome.limit, outcome.gain))]
    return [
        TextTable("Joints with the largest torques" if len(run.joint_names) > 1 else "Torque", ("", "torque peak", "RMS"), torques),
        TextTable("Vibration", ("", "frequency", "growth"), vibrations),
    ]
