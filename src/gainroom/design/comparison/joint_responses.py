"""Responses of one joint, at one place in its uncertainty, on which the search for a structure's parameters closes its laws.

A law runs on a path: "host", over the drive's delay at the loop's rate, or "drive", at a rate and delay of its own. With the host alone the
responses are those of ExactJoint, exact at the samples. With both, two rates meet; here each path is then a hold and a delay in continuous
time, e^(−sT) (1 − e^(−sT_s))/(s T_s), that of the other joints' loops, too. Aliases, of frequencies above half the slower rate, are left
out: below that rate the error is that of what the current loop lets through there. What is found so for a single joint is proved on the
lifted loop (analysis/multirate.py).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...system.assembly import Parts, current_loop
from ...system.controller import PD
from ...system.feedback import feedback_of
from ...system.gain_path import GainPath
from ...system.linear.arrays import Complexes, Floats, Integers
from ...system.linear.state_space import StateSpace, split_delay
from ...system.linear.triangular import TriangularForm
from ...system.system import System
from .exact_joint import COMMAND, LOAD, OWN, SENSORS, others_of, sampled_state, sensed_state

HOST, DRIVE = "host", "drive"
"""Paths that a law may run on."""
LOWEST = 2e-3  # of the slowest of antiresonance and the lag's inverse: there the return ratio is the position gain on the rigid joint
BELOW = 0.1  # of the slowest pole that is no drift: closed loops turn but little below it
DRIFT = 1e-3
"""Rate [rad/s] of poles that are those of a joint free to turn, or of a robot free to float, and come out of round-off."""
SHARP = 0.3
"""Damping ratio below which a pole or a zero has frequencies about it."""
ONE = 1e-3
"""Relative distance up to which two of them are one."""
FIRM = 1e3
"""Return ratio, at half of half the rate, of a loop that holds a position firmly."""
BUSY = 0.02
"""Share of the lag's inverse from which on loops close and filters act."""
CALM = 13
"""Frequencies of one joint below that, where its curves turn but little."""
LIGHT = 0.1
"""Damping ratio below which a pole of the joint is taken out of a count of turns."""
SPACING = 0.05
"""Distance of frequencies, in ln, at density 1: a pole with a damping of 0.04 is seen."""
BESIDE = np.geomspace(2e-3, 0.25, 8)  # relative distances from resonance and antiresonance that are sampled


@dataclass(frozen=True)
class Responses:
    """Responses (m, …) at omega (m,) [rad/s].

    commands   by path, from its torque command to SENSORS (m, 3)
    load       from load torque on the link to SENSORS (m, 3)
    heard      by path, share of a command's white noise that the torque has, in power, per sample of the path (m,)
    """

    omega: Floats
    commands: Mapping[str, Complexes]
    load: Complexes
    heard: Mapping[str, Floats]

    def part(self, which: slice) -> "Responses":
        """Responses at some of the frequencies."""
        commands = {path: one[which] for path, one in self.commands.items()}
        return Responses(self.omega[which], commands, self.load[which], {path: one[which] for path, one in self.heard.items()})


@dataclass(frozen=True)
class Turns:
    """Data of a joint for a count of turns.

    flat    factor (m,) that takes its lightly damped poles out of 1 + L, where L leaps by half a turn between two frequencies
    asked   angle [rad] by which (1 + L) · `flat` turns where the closed loop is stable, with a law whose poles are stable
    """

    flat: Complexes
    asked: float


class Opened:
    """One or several joints (n) of `parts`, their loops open and those of all other joints closed by the laws of `parts`.

    sampled   state space of sampled_state without whole ticks of the joints' own delays, of which there are `ticks` (n,)
    """

    def __init__(self, parts: Parts, *joints: int) -> None:
        assert parts.sample_time is not None
        self.parts, self.joints, self.sample_time = parts, joints or (0,), parts.sample_time
        self.ticks, fraction = split_delay(self.delays, parts.sample_time)
        self._fraction = fraction * parts.sample_time

    @property
    def size(self) -> int:
        """Number n of open joints."""
        return len(self.joints)

    @property
    def delays(self) -> Floats:
        """Delays (n,) [s] of the open joints' drives."""
        return self.parts.delays[list(self.joints)]

    @cached_property
    def sampled(self) -> StateSpace:
        return sampled_state(self.parts, self.joints, self._fraction)

    @cached_property
    def response(self) -> TriangularForm:
        """Sampled responses, from COMMAND without whole ticks and LOAD to SENSORS."""
        return TriangularForm.of(self.sampled)

    @cached_property
    def in_time(self) -> TriangularForm:
        """Responses in continuous time without delays, all loops open: see sensed_state."""
        return TriangularForm.of(sensed_state(self.parts, self.joints))

    @cached_property
    def poles(self) -> Complexes:
        """Poles in δ, the other loops closed."""
        return np.linalg.eigvals(self.sampled.a).astype(complex)

    @cached_property
    def poles_in_time(self) -> Complexes:
        """Poles in s [1/s], without those of delays, which have none."""
        return _in_s(self.poles, self.sample_time)

    @cached_property
    def sharp(self) -> Floats:
        """Frequencies [rad/s] of the poles with little damping, and of such zeros of the position that is measured."""
        roots: Complexes = np.concatenate([self.poles_in_time, self._zeros_in_time])
        size = np.abs(roots)
        kept = (roots.imag > 0) & (np.abs(roots.real) < SHARP * size) & (size > DRIFT) & (size < math.pi / self.sample_time)
        found = np.sort(size[kept])
        return found[np.append(True, found[1:] > (1 + ONE) * found[:-1])] if len(found) else found

    @property
    def _zeros_in_time(self) -> Complexes:
        """Zeros in s [1/s] of the position that is measured: poles of a loop that holds it firmly, which is 100 times as quick to find."""
        side, state, size = SENSORS.index(self.parts.feedback.position), self.sampled, self.size
        at = np.expm1(0.5j * math.pi) / self.sample_time  # half of half the rate
        commands, measured = slice(0, size), slice(side * size, (side + 1) * size)
        gain = FIRM / np.abs(np.diagonal(self.response.at(np.array([at]))[0, measured, commands]))
        return _in_s(np.linalg.eigvals(state.a - (state.b[:, commands] * gain) @ state.c[measured]).astype(complex), self.sample_time)

    @property
    def lag(self) -> float:
        """Longest lag of the joints' own torques [s]: delay, current loop, and a tick for hold and difference."""
        drives = [self.parts.drives[joint] for joint in self.joints]
        return max(drive.delay + 2 * drive.damping_ratio / drive.bandwidth for drive in drives) + self.sample_time

    @property
    def lowest(self) -> float:
        """Lowest frequency [rad/s] of the responses."""
        size = np.abs(self.poles_in_time)
        return min(LOWEST / self.lag, LOWEST * self.sharp.min(initial=math.inf), BELOW * size[size > DRIFT].min(initial=math.inf))


def _in_s(roots: Complexes, step: float) -> Complexes:
    """Roots in δ as those in s [1/s]; without those at z = 0 and left of it on the real axis, which are of sampling."""
    z: Complexes = 1 + step * roots
    return np.log(z[(np.abs(z) > 1e-6) & ((z.imag != 0) | (z.real > 0))]) / step


def opened(system: System) -> Opened:
    """The one joint of `system`, whatever its gains."""
    control, nothing = system.control, PD(0.0, 0.0)
    parts = Parts(system.source.linearize(), system.drives, nothing, feedback_of(control.feedback.position, nothing), control.sample_time)
    return Opened(parts)


@dataclass(frozen=True)
class Joint:
    """One joint, or several opened together, at one place in its uncertainty, with the paths that laws run on.

    reserves   extra delay [s] that is kept in reserve, by path
    path       of the drive; None: all runs on the host
    """

    opened: Opened
    reserves: Mapping[str, float]
    path: GainPath | None

    @property
    def sample_times(self) -> dict[str, float]:
        """Sample time [s] of each path."""
        host = self.opened.sample_time
        return {HOST: host} if self.path is None else {HOST: host, DRIVE: self.path.sample_time}

    @property
    def fastest(self) -> float:
        """Highest frequency [rad/s]: half the fastest rate."""
        return math.pi / min(self.sample_times.values())

    def grid(self, density: float = 1.0) -> Floats:
        """Frequencies (m,) [rad/s], rising: over all decades, closer about every resonance and antiresonance."""
        corners, low = self.opened.sharp, self.opened.lowest
        beside = BESIDE if density <= 1 else np.geomspace(BESIDE[0] / density, BESIDE[-1], round(density * len(BESIDE)))
        about = np.concatenate([-beside[::-1], beside])  # not at the resonance itself, where an undamped joint has a pole
        top, busy = self.fastest * (1 - 1e-6), max(BUSY / self.opened.lag, 2 * low)
        slow = CALM if self.opened.size == 1 else math.ceil(density * math.log(busy / low) / SPACING)  # where several joints sway together
        parts = [np.geomspace(low, busy, slow)[:-1], np.geomspace(busy, top, math.ceil(density * math.log(top / busy) / SPACING))]
        parts += [np.minimum(one * (1 + about), self.fastest * (1 - 1e-6 * (2 + np.arange(len(about))))) for one in corners]
        return np.sort(np.concatenate(parts))

    def turns(self, omega: Floats) -> "Turns":
        """Data of the joint for a count of turns at omega (m,) [rad/s], rising; poles outside the circle count as those inside."""
        host, v, one = self.sample_times[HOST], self.variable(omega), self.opened
        poles = one.poles if self.path is None else one.poles_in_time
        start = float(np.angle(v[0] - poles).sum()) + (one.ticks.sum() * float(omega[0]) * host if self.path is None else 0.0)
        upper = poles[poles.imag > 0]
        s = upper if self.path is not None else np.log(1 + host * upper) / host
        light = upper[-s.real < LIGHT * np.abs(s)]
        pairs = np.concatenate([light, light.conj()])
        away = v[:, None] - pairs
        flat = np.prod(away / np.abs(away), axis=1)
        if self.path is None:  # a pair inside the circle takes a whole turn on the way from 1 to −1
            turned = 2 * math.pi * len(light) - float(np.angle(v[0] - pairs).sum())
        else:
            inside = pairs - 1e-9 * np.abs(pairs)
            turned = float((np.angle(v[-1] - inside) - np.angle(v[0] - inside)).sum())
        return Turns(flat, start + turned)

    def variable(self, omega: Floats) -> Complexes:
        """Points (m,) at which responses are evaluated: jω, or (e^(jωT_s) − 1)/T_s."""
        host = self.sample_times[HOST]
        return 1j * omega if self.path is not None else np.expm1(1j * omega * host) / host

    def at(self, omega: Floats) -> Responses:
        """Responses at omega (m,) [rad/s]."""
        return responses([self], omega, np.zeros(len(omega), dtype=int))

    def sensed(self, omega: Floats) -> Complexes:
        """Responses (m, SENSORS n, 2 n) from torque commands, without hold and delay where there is a path, and from load torques."""
        v, one = self.variable(omega), self.opened
        if self.path is None:
            found = one.response.at(v)
            found[:, :, : one.size] *= np.exp(-1j * np.multiply.outer(omega, one.ticks * self.sample_times[HOST]))[:, None, :]
            return found
        found, sensors, inputs = one.in_time.at(v), len(SENSORS) * one.size, OWN * one.size
        own, others = found[:, :sensors, :inputs], others_of(one.parts, one.joints)
        if not others:
            return own
        size = one.parts.plant.size
        delta = np.expm1(1j * omega * one.sample_time) / one.sample_time
        late = np.exp(-1j * np.multiply.outer(omega, one.parts.delays[others] + one.sample_time / 2))
        held = np.sinc(omega * one.sample_time / (2 * math.pi))
        law = one.parts.controller.matrix(1j * omega, delta, size, one.sample_time)[:, others] * (late * held[:, None])[:, :, None]
        reached, seen = found[:, :, inputs:], found[:, sensors:]
        pushed = np.linalg.solve(np.eye(len(others)) + law @ seen[:, :, inputs:], law @ seen[:, :, :inputs])
        return own - reached[:, :sensors] @ pushed


def responses(joints: Sequence[Joint], omega: Floats, rows: Integers) -> Responses:
    """Responses at omega (m,) [rad/s], each of the joint whose index `rows` (m,) has."""
    found = np.empty((len(omega), len(SENSORS), OWN), dtype=complex)
    for k, joint in enumerate(joints):
        if np.any(own := rows == k):
            found[own] = joint.sensed(omega[own])
    path, steps = joints[0].path, joints[0].sample_times
    if path is None:
        return Responses(omega, {HOST: found[:, :, COMMAND]}, found[:, :, LOAD], {HOST: np.ones(len(omega))})
    drives = [joint.opened.parts.drives[joint.opened.joints[0]] for joint in joints]
    passed = np.abs(current_loop(drives[0]).at(1j * omega)) ** 2
    delays = {HOST: np.array([drive.delay for drive in drives])[rows], DRIVE: path.delay}
    commands, heard = {}, {}
    for name, step in steps.items():
        held = np.sinc(omega * step / (2 * math.pi))
        commands[name] = found[:, :, COMMAND] * (held * np.exp(-1j * omega * (delays[name] + step / 2)))[:, None]
        heard[name] = passed * held**2
    return Responses(omega, commands, found[:, :, LOAD], heard)


def quadrature(omega: Floats) -> Floats:
    """Weights (m,) of the trapezoidal rule over rising omega (m,), with what lies below the first of them."""
    weights, steps = np.zeros_like(omega), np.diff(omega)
    weights[:-1] += steps / 2
    weights[1:] += steps / 2
    weights[0] += omega[0]
    return weights
