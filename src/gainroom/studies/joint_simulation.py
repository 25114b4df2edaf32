"""A joint's scenario played and judged: how it tracks, whether it vibrates or runs away, and what the linear loop had predicted."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..analysis.gain_limit import GainLimit, gain_limit
from ..errors import beside, frequency_in_words, listed
from ..linear.arrays import Floats
from ..simulation.oscillation import Vibration
from ..simulation.response import Response, Tracking, joined, track
from ..simulation.run import BLOCK, stream
from ..simulation.spec import PERIODS, SimulationSpec
from .joint_vibration import SEEN, Seen, keeps_up, lasts, seen_in, that_rings

PORTION = 0.25  # [s] played between two looks at progress and interruption, where a block of ticks would be longer


class Interrupted(Exception):  # noqa: N818 - asked for, not an error
    """The run was asked to end; `time` [s] is what was played, and is in the log."""

    def __init__(self, time: float) -> None:
        super().__init__(f"interrupted at {time:g} s")
        self.time = time


@dataclass(frozen=True)
class SimulationStudy:
    """What `gainroom simulate` tells.

    gain          factor on all gains
    response      the run, tick by tick
    tracking      numbers of the side that is fed back
    torque_peak   (n,) of the actual torque [N m]
    at_torque_limit   share of the ticks at which the demand torque is cut; 0 without a torque limit
    seen          what of it is a vibration
    limit         what the linear sampled loop predicts, the scenario's viscous friction included, as a factor on the gains played
    sentence, warnings   in words
    """

    spec: SimulationSpec
    gain: float
    response: Response
    tracking: Tracking
    torque_peak: Floats
    at_torque_limit: float
    seen: Seen
    limit: GainLimit
    sentence: str = ""
    warnings: tuple[str, ...] = ()

    @property
    def vibration(self) -> Vibration | None:
        """The strongest, also one that slowly dies away."""
        return self.seen.vibration

    @property
    def vibrates(self) -> bool:
        """It grows, or keeps up."""
        return self.seen.vibrates

    @property
    def keeps_up(self) -> bool:
        """It vibrates, and hardware holds the vibration at its size."""
        return self.seen.keeps_up

    @property
    def hidden(self) -> bool:
        """Nothing that lasts is seen, and the linear loop is unstable all the same."""
        return not (self.response.diverged or self.vibrates or self.limit.stable)

    @property
    def overshoots_limit(self) -> bool:
        """The actual torque passes the limit, which cuts what the current loop is asked for, not what it makes of that."""
        return float(self.torque_peak.max()) > self.spec.hardware.get("torque_limit", math.inf)

    @property
    def sound(self) -> bool:
        """It neither ran away nor vibrates, and the linear loop is stable."""
        return not (self.response.diverged or self.vibrates or self.hidden)


def simulate_joint(
    spec: SimulationSpec,
    gain: float = 1.0,
    rows: Callable[[Response], None] = lambda part: None,
    progress: Callable[[int, int, str], None] = lambda done, total, what: None,
    interrupted: Callable[[], bool] = lambda: False,
) -> SimulationStudy:
    """Play the scenario with all gains times `gain`.

    rows          takes every part of the run as it is computed, for a log
    progress      is told ticks done, ticks in all, ""
    interrupted   is asked between parts whether to stop

    Raises Interrupted, and GainroomError where the hardware does not fit the loop.
    """
    block = max(1, min(BLOCK, round(PORTION / spec.sample_time)))
    parts, done = [], 0
    for part in stream(spec.system(gain), spec.scenario, block):
        rows(part)
        parts.append(part)
        done += len(part.time)
        progress(done, spec.ticks + 1, "")
        if interrupted():
            raise Interrupted(done * spec.sample_time)
    response = joined(parts)
    limit = gain_limit(spec.loop(gain))
    study = SimulationStudy(
        spec,
        gain,
        response,
        _tracking(spec, response),
        np.abs(response.actual_torque).max(axis=0),
        float(np.mean(np.abs(response.demand_torque) >= spec.hardware.get("torque_limit", math.inf))),
        seen_in(spec, gain, response, limit),
        limit,
    )
    return replace(study, sentence=_sentence(study), warnings=_warnings(study))


def _tracking(spec: SimulationSpec, response: Response) -> Tracking:
    """A move is judged up to a disturbance that comes after it; a reference that swings goes nowhere."""
    until = spec.disturbed_from if spec.disturbed_from > spec.moves_until else math.inf
    found, nothing = track(response, until), np.full(1, math.nan)
    if spec.swings:
        found = replace(found, overshoot=nothing, settling_time=nothing)
    return replace(found, steady_state=nothing) if spec.swings_on else found


def _sentence(study: SimulationStudy) -> str:
    """The answer in one sentence."""
    response, tracking, limit = study.response, study.tracking, study.limit
    side, shakes = f"the {response.feedback} side", study.vibration if study.vibrates else None
    if response.diverged:
        shaking = "" if shakes is None else f", vibrating at {frequency_in_words(shakes.frequency)}"
        text = f"Diverges: {side} runs away within {response.diverged_at:.3g} s{shaking}"
    elif shakes is not None:
        size = f"at {_mrad(shakes.amplitude)} of the {study.seen.side} side"
        growth = f"keeping up {size}" if study.keeps_up else doubling(shakes) if shakes.growth_rate > 0 else f"{halving(shakes)}, {size}"
        how = "irregularly, in the mean at" if study.seen.irregular else "at"
        text = f"Vibrates {how} {frequency_in_words(shakes.frequency)}, {growth}"
    elif study.hidden:
        text = f"No lasting vibration is seen, but {_excess(limit)}: unstable; {_hiding(study)}"
    else:
        peak, rms, last = (float(np.abs(value).max()) for value in (tracking.peak, tracking.rms, tracking.steady_state))
        text = f"No vibration: {side} stays {_within(peak)} of its reference (RMS {_mrad(rms)})"
        text += "" if math.isnan(last) else f", over the last tenth {_mrad(last)} off on average"
    return f"{text}; {prediction_in_words(limit)}."


def _excess(limit: GainLimit) -> str:
    """How far the gains are beyond what is stable."""
    if 0 < limit.gain < math.inf:
        return f"these gains are {beside(1 / limit.gain, 1)} times the limit"
    return "the linear loop is not stable"


def _hiding(study: SimulationStudy) -> str:
    """What in the file keeps it from being seen."""
    spec = study.spec
    there = {
        "friction": spec.rubs,
        "noise": bool(spec.scenario.noise),
        "encoder steps": spec.encoder_step > 0,
        "the torque limit": study.at_torque_limit > 0,
    }
    names = [name for name, given in there.items() if given]
    if not names:
        return "the run is too short, or too quiet, to show it"
    return f"{listed(names, 'or')} may hide it, or the run is too short"


def doubling(found: Vibration) -> str:
    """How fast it grows."""
    return f"doubling every {math.log(2) / found.growth_rate:.3g} s"


def halving(found: Vibration) -> str:
    """How slowly it dies away."""
    return f"halving every {-math.log(2) / found.growth_rate:.3g} s"


def _mrad(angle: float) -> str:
    return f"{1e3 * angle:.3g} mrad" if angle >= 1e-6 else "less than 0.001 mrad"


def _within(angle: float) -> str:
    return f"within {_mrad(angle)}" if angle >= 1e-6 else "less than 0.001 mrad"


def prediction_in_words(limit: GainLimit) -> str:
    """What the linear loop says, to set against what was seen."""
    if math.isnan(limit.gain):
        return f"the linear loop is {'stable' if limit.stable else 'unstable'}, how far its gains may go is not known"
    if math.isinf(limit.gain):
        return "no factor on these gains makes the linear loop vibrate"
    if limit.gain <= 0:
        return "no lower gains make the linear loop stable"
    if limit.frequency == 0:
        return f"the linear loop topples, without swinging, at {beside(limit.gain, 1)} times these gains"
    return f"the linear loop begins to vibrate at {beside(limit.gain, 1)} times these gains, at {frequency_in_words(limit.frequency)}"


def _warnings(study: SimulationStudy) -> tuple[str, ...]:
    """What a user should know or do, each with the remedy."""
    spec, seen = study.spec, study.seen
    told = list(spec.joint.unusual())
    slowest = PERIODS / spec.scenario.duration  # [Hz] that the run can show
    if slowest > study.limit.frequency / (2 * math.pi) > 0 and not study.vibrates:
        told.append(f"a run of {spec.scenario.duration:g} s shows no vibration below {slowest:.3g} Hz: lengthen scenario.duration")
    if spec.moves_late and not (spec.swings or study.response.diverged):
        told.append("the reference comes to rest late or not at all: lengthen scenario.duration for a steady state worth the name")
    if study.limit.stable and study.vibrates:
        told.append(f"the linear loop is stable: {_kept_up_by(spec)}")
    if study.hidden:
        told.append("lengthen scenario.duration, and take away what may hide it, to see it; lower the gains before the joint is run")
    if study.at_torque_limit > 0:
        beyond = f"; the current loop overshoots it to {study.torque_peak[0]:.4g} N·m" if study.overshoots_limit else ""
        told.append(f"the torque limit cuts the demand torque {share_in_words(study.at_torque_limit)} of the time{beyond}")
    if study.sound and seen.shaking > SEEN:
        causes = "noise and encoder steps shake" if spec.encoder_step and spec.scenario.noise else "encoder steps shake"
        causes = causes if spec.encoder_step else "noise shakes"
        told.append(f"no vibration lasts, but {causes} the joint: {_mrad(seen.shaking)} RMS")
    if spec.is_linear:
        rest = "friction beyond the viscous" if spec.hardware else "friction"
        told.append(f"linear run, without {rest}, gravity, torque limit or encoder steps: the scenario section of the file adds them")
    return tuple(told)


def _kept_up_by(spec: SimulationSpec) -> str:
    """What in the file may hold a vibration of a stable loop, and what to do."""
    there = {
        "friction": spec.rubs,
        "noise": bool(spec.scenario.noise),
        "encoder steps": spec.encoder_step > 0,
        "the torque limit": "torque_limit" in spec.hardware,
        "gravity": "gravity" in spec.hardware,
        "jitter": "jitter" in spec.hardware,
        "the rounding of delays to whole ticks": "whole_ticks" in spec.hardware,
    }
    names = [name for name, given in there.items() if given]
    if len(names) == 1:
        return f"{names[0]} must be what keeps this vibration up, or a link that rings on by itself"
    return f"{listed(names, 'or')} must be what keeps this vibration up; change one at a time"


def share_in_words(share: float) -> str:
    """A share of the time."""
    return f"{100 * share:.2g} %" if share >= 1e-3 else "less than 0.1 %"


__all__ = [
    "Interrupted",
    "SimulationStudy",
    "doubling",
    "halving",
    "keeps_up",
    "lasts",
    "prediction_in_words",
    "simulate_joint",
    "that_rings",
]
