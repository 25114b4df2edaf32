"""A joint's scenario played and judged: how it tracks, whether it vibrates or runs away, and what the linear loop had predicted."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from .arrays import Floats
from .limits import GainLimit, gain_limit
from .simulation.oscillation import LONGEST, Vibration, response_vibration, vibration
from .simulation.response import Response, Tracking, joined, track
from .simulation.run import BLOCK, simulate, stream
from .simulation.trajectories import Trajectory
from .simulation_spec import SimulationSpec

PORTION = 0.25  # [s] played between two looks at progress and interruption, where a block of ticks would be longer
NOTICED = 10.0  # times an encoder's step, or the noise's deviation: a vibration below that is their own doing
LASTING = 1e-3  # damping ratio below which a vibration on hardware keeps up: what ends its growth there is friction or the torque limit
SETTLING = 0.1  # damping ratio above which an oscillation is a joint coming to rest
GONE = 1e-9  # [rad] what has died away so far is none
HARMONICS = 5.0  # times a moving reference's own frequency: most of what friction makes of it lies below


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
    vibration     the strongest after the reference came to rest, also one that slowly dies away; None where nothing rings
    vibrates      it grows, or keeps up: see `LASTING`
    limit         what the linear sampled loop predicts, as a factor on the gains played
    sentence, warnings   in words
    """

    spec: SimulationSpec
    gain: float
    response: Response
    tracking: Tracking
    torque_peak: Floats
    vibration: Vibration | None
    vibrates: bool
    limit: GainLimit
    sentence: str
    warnings: tuple[str, ...]

    @property
    def keeps_up(self) -> bool:
        """It vibrates, and hardware holds the vibration at its size."""
        return self.vibrates and self.vibration is not None and _keeps_up(self.spec, self.vibration)

    @property
    def sound(self) -> bool:
        """It neither ran away nor vibrates."""
        return not (self.response.diverged or self.vibrates)


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
    found = that_rings(_vibration(spec, gain, response), GONE)
    vibrates = found is not None and _vibrates(spec, found)
    tracking, limit = track(response), gain_limit(spec.loop(gain))
    if spec.swings:  # such a reference goes nowhere
        tracking = replace(tracking, overshoot=np.full(1, math.nan), settling_time=np.full(1, math.nan))
    return SimulationStudy(
        spec,
        gain,
        response,
        tracking,
        np.abs(response.actual_torque).max(axis=0),
        found,
        vibrates,
        limit,
        _sentence(spec, response, tracking, found, vibrates, limit),
        _warnings(spec, response, vibrates, limit),
    )


def that_rings(found: Vibration | None, gone: float) -> Vibration | None:
    """`found`; None where that is something coming to rest, or has died away below an amplitude of `gone`."""
    if found is not None and (found.damping_ratio > SETTLING or (found.growth_rate < 0 and found.amplitude < gone)):
        return None
    return found


@dataclass(frozen=True)
class _Resting(Trajectory):
    """`moving` until `end` [s], and held where it is then."""

    moving: Trajectory
    end: float

    @property
    def size(self) -> int:
        return self.moving.size

    def position(self, time: ArrayLike) -> Floats:
        return self.moving.position(np.minimum(time, self.end))


def _vibration(spec: SimulationSpec, gain: float, response: Response) -> Vibration | None:
    """What is left once the reference rests.

    Where it moves to the end, what follows it is no vibration: a linear loop is run on for a while with the reference held; on hardware,
    where friction might stop it then, only what is much faster than the reference counts.
    """
    if response.diverged or not spec.moves_late:
        return response_vibration(response)
    if not spec.is_linear:
        return response_vibration(response, HARMONICS * spec.own_frequency)
    scenario, rest = spec.scenario, min(spec.ticks, LONGEST)
    assert isinstance(scenario.reference, Trajectory)
    longer = scenario.duration + rest * spec.sample_time
    after = simulate(spec.loop(gain), replace(scenario, reference=_Resting(scenario.reference, scenario.duration), duration=longer))
    return vibration(after.error[-rest:], spec.sample_time)


def _vibrates(spec: SimulationSpec, found: Vibration) -> bool:
    """Whether anyone would call it that, and it does not die away."""
    steps = max(float(spec.hardware.get(f"{side}_resolution", 0.0)) for side in ("motor", "link"))
    if found.amplitude <= NOTICED * max(steps, float(spec.scenario.noise)):
        return False
    return lasts(found, spec.is_linear)


def _keeps_up(spec: SimulationSpec, found: Vibration) -> bool:
    return not spec.is_linear and keeps_up(found)


def lasts(found: Vibration, linear: bool) -> bool:
    """Whether it does not die away; `linear`: nothing there could hold it at its size."""
    return found.growth_rate > 0 if linear else found.damping_ratio < LASTING


def keeps_up(found: Vibration) -> bool:
    """Whether it neither grows nor dies away."""
    return abs(found.damping_ratio) < LASTING


def _sentence(
    spec: SimulationSpec, response: Response, tracking: Tracking, vibration: Vibration | None, vibrates: bool, limit: GainLimit
) -> str:
    """The answer in one sentence."""
    side, shakes = f"the {response.feedback} side", vibration if vibrates else None
    if response.diverged:
        shaking = "" if shakes is None else f", vibrating at {frequency_in_words(shakes.frequency)}"
        text = f"Diverges: {side} runs away within {response.diverged_at:.3g} s{shaking}"
    elif shakes is not None:
        growth = f"keeping up at {_mrad(shakes.amplitude)}" if _keeps_up(spec, shakes) else doubling(shakes)
        text = f"Vibrates at {frequency_in_words(shakes.frequency)}, {growth}"
    else:
        peak, rms, last = (float(np.abs(value).max()) for value in (tracking.peak, tracking.rms, tracking.steady_state))
        text = f"No vibration: {side} stays within {_mrad(peak)} of its reference (RMS {_mrad(rms)}) and ends {_mrad(last)} off"
    return f"{text}; {prediction_in_words(limit)}."


def doubling(found: Vibration) -> str:
    """How fast it grows."""
    return f"doubling every {math.log(2) / found.growth_rate:.3g} s"


def frequency_in_words(omega: float) -> str:
    """Hz, and rad/s."""
    return f"{omega / (2 * math.pi):.3g} Hz ({omega:.4g} rad/s)"


def _mrad(angle: float) -> str:
    return f"{1e3 * angle:.3g} mrad" if angle >= 1e-6 else "less than 0.001 mrad"


def prediction_in_words(limit: GainLimit) -> str:
    """What the linear loop says, to set against what was seen."""
    if math.isnan(limit.gain):
        return f"the linear loop is {'stable' if limit.stable else 'unstable'}, how far its gains may go is not known"
    if math.isinf(limit.gain):
        return "no factor on these gains makes the linear loop vibrate"
    if limit.gain <= 0:
        return "no lower gains make the linear loop stable"
    if limit.frequency == 0:
        return f"the linear loop topples, without swinging, at {limit.gain:.3g} times these gains"
    return f"the linear loop begins to vibrate at {limit.gain:.3g} times these gains, at {frequency_in_words(limit.frequency)}"


def _warnings(spec: SimulationSpec, response: Response, vibrates: bool, limit: GainLimit) -> tuple[str, ...]:
    """What a user should know or do, each with the remedy."""
    told = []
    if spec.moves_late and not (spec.swings or response.diverged):
        told.append("the reference comes to rest late or not at all: lengthen scenario.duration for a steady state worth the name")
    if limit.stable and vibrates and not spec.is_linear:
        told.append("the linear loop is stable: friction, encoder steps or the torque limit keep this vibration up; raise one at a time")
    if not limit.stable and not vibrates and not response.diverged:
        told.append(
            "the linear loop is unstable all the same: "
            + ("friction hides it, or the run is too short" if not spec.is_linear else "the run is too short, lengthen scenario.duration")
        )
    if spec.is_linear:
        told.append("linear run, without friction, gravity, torque limit or encoder steps: the scenario section of the file adds them")
    return tuple(told)
