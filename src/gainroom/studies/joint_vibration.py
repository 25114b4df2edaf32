"""What vibrates in a joint's played scenario: where it is looked for, and what counts as a vibration that lasts."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..analysis.gain_limit import GainLimit
from ..analysis.stability import rightmost_roots
from ..linear.arrays import Floats
from ..simulation.oscillation import LONGEST, SHORTEST, Vibration, parts_in, rows_after, vibration
from ..simulation.response import Response
from ..simulation.run import simulate
from ..simulation.spec import LATE, SimulationSpec
from ..simulation.trajectories import Trajectory

LASTING = 1e-3  # damping ratio below which a vibration on hardware keeps up: what ends its growth there is friction or the torque limit
SETTLING = 0.1  # damping ratio above which an oscillation is a joint coming to rest
GONE = 1e-9  # [rad] what has died away so far is none
SEEN = 1e-6  # [rad] on hardware nobody sees less
THEIR_OWN = 3.0  # times the encoder's step, or the noise's deviation: what these make of a stable loop by themselves is no vibration
HARMONICS = 5.0  # times a moving reference's own frequency: most of what friction makes of it lies below
STEADY = 0.1  # of itself: a vibration that changes less over what is looked at keeps up
PATIENCE = 7.0  # time constants: what comes to rest has left a thousandth then
HELD = 0.7  # of its size before: shaking that falls below dies away


@dataclass(frozen=True)
class Seen:
    """What of a run is a vibration.

    vibration   the strongest once nothing changes from outside any more, also one that slowly dies away; None where nothing rings
    vibrates    it grows, or keeps up
    keeps_up    it does neither grow nor die away over what was looked at
    irregular   noise or encoder steps drive it so that it has no tone: `vibration` is one of the same power at its mean frequency
    side        that swings most, "motor" or "link"; "" unless it vibrates
    shaking     how noise and encoder steps shake the joint then, the side that they shake most [rad], RMS; 0 without them
    """

    vibration: Vibration | None
    vibrates: bool = False
    keeps_up: bool = False
    irregular: bool = False
    side: str = ""
    shaking: float = 0.0


@dataclass(frozen=True)
class _Quiet:
    """The error of motor and link (k, 2) [rad] where nothing changes from outside; only what is faster than `above` [rad/s] counts."""

    error: Floats
    sample_time: float
    above: float = 0.0


def seen_in(spec: SimulationSpec, gain: float, response: Response, limit: GainLimit) -> Seen:
    """The vibration in a run with all gains times `gain`; `limit` of its linear loop, as a factor on the gains played.

    A linear loop vibrates only where it is unstable, whatever a short record looks like.
    """
    seen = _judged(spec, _quiet(spec, gain, response), limit.stable, response.diverged)
    if not (seen.vibrates and limit.stable) or response.diverged:
        return seen
    again = _judged(spec, _settled(spec, gain), stable=True, diverged=False)
    return seen if again.vibrates else again


def _judged(spec: SimulationSpec, quiet: "_Quiet", stable: bool, diverged: bool) -> Seen:
    """What vibrates in `quiet`; `stable`: the linear loop."""
    found = that_rings(vibration(quiet.error, quiet.sample_time, above=quiet.above), GONE)
    unsteady = max(float(spec.scenario.noise), spec.encoder_step)
    least = 0.0 if spec.is_linear else SEEN if not stable else max(SEEN, THEIR_OWN * unsteady)
    possible = not (spec.is_linear and stable)
    if possible and found is not None and lasts(found, spec.is_linear):
        told = _told(spec, quiet, found)
        if min(found.amplitude, 0.0 if told.vibration is None else told.vibration.amplitude) > least:
            return told
    if unsteady == 0 or diverged or quiet.above > 0:
        return Seen(found)
    shaken, side, held = _shaking(quiet)
    if shaken is None:
        return Seen(found)
    size = shaken.amplitude / math.sqrt(2)
    if possible and held and shaken.amplitude > least:
        return Seen(shaken, vibrates=True, keeps_up=True, irregular=True, side=side, shaking=size)
    return Seen(found, shaking=size)


def that_rings(found: Vibration | None, gone: float) -> Vibration | None:
    """`found`; None where that is something coming to rest, or has died away below an amplitude of `gone`."""
    if found is not None and (found.damping_ratio > SETTLING or (found.growth_rate < 0 and found.amplitude < gone)):
        return None
    return found


def lasts(found: Vibration, linear: bool) -> bool:
    """Whether it does not die away; `linear`: nothing there could hold it at its size."""
    return found.growth_rate > 0 if linear else found.damping_ratio < LASTING


def keeps_up(found: Vibration) -> bool:
    """Whether it neither grows nor dies away."""
    return abs(found.damping_ratio) < LASTING


def _told(spec: SimulationSpec, quiet: _Quiet, found: Vibration) -> Seen:
    """A vibration that lasts, with its size over the last periods: over a whole record a pole and a limit cycle drift apart in phase."""
    parts = np.abs(parts_in(quiet.error, quiet.sample_time, found))
    length = min(len(quiet.error), LONGEST) * quiet.sample_time
    steady = not spec.is_linear and keeps_up(found) and abs(found.growth_rate) * length < STEADY
    side = ("motor", "link")[int(np.argmax(parts))]
    return Seen(replace(found, amplitude=float(parts.max())), vibrates=True, keeps_up=steady, side=side)


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


def _quiet(spec: SimulationSpec, gain: float, response: Response) -> _Quiet:
    """Where to look.

    Where something still changes late in the run, what follows that is no vibration: the same is run on for as long again, its reference
    held. On hardware, where friction might stop it then, a reference that swings goes on, and only what is much faster counts.
    """
    duration, late = spec.scenario.duration, spec.last_event
    if response.diverged:
        return _Quiet(_after(response, late), spec.sample_time)
    swings = spec.swings and spec.moves_until >= duration and not spec.is_linear
    if swings and spec.disturbed_from <= LATE * duration:
        above = HARMONICS * spec.own_frequency
        return _Quiet(_after(response, max(spec.disturbed_from, duration / 2)), spec.sample_time, above)
    if late <= LATE * duration:
        return _Quiet(_after(response, late), spec.sample_time)
    rest = min(spec.ticks, LONGEST)
    return _run_on(spec, gain, rest, rest, swings)


def _settled(spec: SimulationSpec, gain: float) -> _Quiet:
    """Run on until the stable linear loop has come to rest, and looked at for as long as a link takes whose motor friction holds.

    What a short record shows may be a joint on its way to rest; a vibration that friction, steps or a limit keep up is still there then.
    """
    joint, longest = spec.joint.joint, LONGEST * spec.sample_time
    rate = -float(rightmost_roots(spec.loop(gain), count=1).roots[0].real)
    held = joint.damping / (2 * joint.link_inertia) or rate  # B/2J_L: the link swings against a motor that stands
    wait, look = (min(PATIENCE / max(slow, PATIENCE / longest), longest) for slow in (rate, min(rate, held)))
    rest = round(look / spec.sample_time)
    return _run_on(spec, gain, round(wait / spec.sample_time) + rest, rest, spec.swings and spec.moves_until >= spec.scenario.duration)


def _run_on(spec: SimulationSpec, gain: float, further: int, rest: int, swings: bool) -> _Quiet:
    """The last `rest` of `further` ticks after the run; `swings`: its reference goes on, else it is held."""
    scenario, duration = spec.scenario, spec.scenario.duration
    assert isinstance(scenario.reference, Trajectory)
    reference = scenario.reference if swings else _Resting(scenario.reference, duration)
    after = simulate(spec.system(gain), replace(scenario, reference=reference, duration=duration + further * spec.sample_time))
    return _Quiet(_both(after)[-rest:], spec.sample_time, HARMONICS * spec.own_frequency if swings else 0.0)


def _both(response: Response) -> Floats:
    """(k, 2) the true error of both sides [rad]."""
    return response.reference - np.hstack([response.motor_position, response.link_position])


def _after(response: Response, event: float) -> Floats:
    """Both errors after `event` [s], or where too little is left then, of the last half."""
    return _both(response)[rows_after(response, event)]


def _shaking(quiet: _Quiet) -> tuple[Vibration | None, str, bool]:
    """What moves without a lasting tone in the last third, which side moves most, and whether the third before was no stronger.

    Told as an oscillation with the power of that side, at the mean of its frequency (root of the mean square, by power); None where
    nothing moves.
    """
    third = len(quiet.error) // 3
    if third < SHORTEST:
        return None, "", False
    line = np.linspace(-1, 1, third)[:, None] ** np.arange(2)
    parts = (quiet.error[-2 * third : -third], quiet.error[-third:])
    before, last = (part - line @ np.linalg.lstsq(line, part, rcond=None)[0] for part in parts)
    most = int(np.argmax(last.std(axis=0)))
    size = float(last[:, most].std())
    if size == 0:
        return None, "", False
    power = np.abs(np.fft.rfft(last[:, most] * np.hanning(third))) ** 2
    omega = 2 * math.pi * np.fft.rfftfreq(third, quiet.sample_time)
    mean = math.sqrt(float(np.average(omega**2, weights=power)))
    held = bool(size >= HELD * before.std(axis=0).max())
    return Vibration(mean, 0.0, math.sqrt(2) * size), ("motor", "link")[most], held
