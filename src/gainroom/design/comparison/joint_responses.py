"""Responses of one joint, at one place in its uncertainty, on which the search for a structure's parameters closes its laws.

A law runs on a path: "host", over the drive's delay at the loop's rate, or "drive", at a rate and delay of its own. With the host alone the
responses are those of ExactJoint, exact at the samples. With both, two rates meet; here each path is then a hold and a delay in continuous
time, e^(−sT) (1 − e^(−sT_s))/(s T_s), and aliases, of frequencies above half the slower rate, are left out: below that rate the error is
that of what the current loop lets through there. What is found so is proved on the lifted loop (analysis/multirate.py).
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
from ...system.linear.state_space import StateSpace, hold, split_delay
from ...system.system import System
from .exact_joint import COMMAND, LOAD, sensed_state

HOST, DRIVE = "host", "drive"
"""Paths that a law may run on."""
LOWEST = 2e-3  # of the slowest of antiresonance and the lag's inverse: there the return ratio is the position gain on the rigid joint
BUSY = 0.02
"""Share of the lag's inverse from which on loops close and filters act."""
LIGHT = 0.1
"""Damping ratio below which a pole of the joint is taken out of a count of turns."""
SPACING = 0.05
"""Distance of frequencies, in ln, at density 1: a pole with a damping of 0.04 is seen."""
BESIDE = np.geomspace(2e-3, 0.25, 8)  # relative distances from resonance and antiresonance that are sampled


def parts_of(system: System) -> Parts:
    """Parts of a joint's loop, whatever its gains."""
    return Parts(system.source.linearize(), system.drives, PD(0.0, 0.0), feedback_of("motor", PD), system.control.sample_time)


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


@dataclass(frozen=True)
class Joint:
    """One joint at one place in its uncertainty, with the paths that laws run on.

    reserves   extra delay [s] that is kept in reserve, by path
    path       of the drive; None: all runs on the host
    state      from (torque command, load torque) to SENSORS, in continuous time without delays; of the host alone sampled, without `ticks`
    ticks      whole ticks of delay, of the host alone
    """

    system: System
    reserves: Mapping[str, float]
    path: GainPath | None
    state: StateSpace
    ticks: int

    @classmethod
    def of(cls, system: System, reserves: Mapping[str, float], path: GainPath | None) -> "Joint":
        """Joint of `system` with its own values."""
        tick = system.control.sample_time
        parts = parts_of(system)
        state, ticks = sensed_state(parts), 0
        if path is None:
            assert tick is not None
            whole, fraction = split_delay(parts.delays[0], tick)
            state, ticks = hold(state, np.array([float(fraction) * tick, 0.0]), tick), int(whole)
        return cls(system, reserves, path, state, ticks)

    @property
    def sample_times(self) -> dict[str, float]:
        """Sample time [s] of each path."""
        host = self.system.control.sample_time
        assert host is not None
        return {HOST: host} if self.path is None else {HOST: host, DRIVE: self.path.sample_time}

    @property
    def fastest(self) -> float:
        """Highest frequency [rad/s]: half the fastest rate."""
        return math.pi / min(self.sample_times.values())

    def grid(self, density: float = 1.0) -> Floats:
        """Frequencies (m,) [rad/s], rising: over all decades, closer about resonance and antiresonance."""
        joint = self.system.source
        corners = [one for one in (joint.antiresonance, joint.resonance) if math.isfinite(one)]
        low = LOWEST * min([1 / self.system.lag, *corners])
        beside = BESIDE if density <= 1 else np.geomspace(BESIDE[0] / density, BESIDE[-1], round(density * len(BESIDE)))
        about = np.concatenate([-beside[::-1], beside])  # not at the resonance itself, where an undamped joint has a pole
        top, busy = self.fastest * (1 - 1e-6), max(BUSY / self.system.lag, 2 * low)
        parts = [np.geomspace(low, busy, 13)[:-1], np.geomspace(busy, top, math.ceil(density * math.log(top / busy) / SPACING))]
        parts += [np.minimum(one * (1 + about), self.fastest * (1 - 1e-6 * (2 + np.arange(len(about))))) for one in corners]
        return np.sort(np.concatenate(parts))

    @cached_property
    def _poles(self) -> Complexes:
        return np.linalg.eigvals(self.state.a).astype(complex)

    def turns(self, omega: Floats) -> "Turns":
        """Data of the joint for a count of turns at omega (m,) [rad/s], rising."""
        host, v = self.sample_times[HOST], self.variable(omega)
        start = float(np.angle(v[0] - self._poles).sum()) + self.ticks * float(omega[0]) * host
        upper = self._poles[self._poles.imag > 0]
        s = upper if self.path is not None else np.log(1 + host * upper) / host
        light = upper[-s.real < LIGHT * np.abs(s)]
        pairs = np.concatenate([light, light.conj()])
        flat = np.prod((v[:, None] - pairs) / np.abs(pairs), axis=1)
        if self.path is None:  # a pair inside the circle takes a whole turn on the way from 1 to −1
            turned = 2 * math.pi * len(light) - float(np.angle(v[0] - pairs).sum())
        else:
            inside = pairs - 1e-9 * np.abs(pairs)
            turned = float((np.angle(v[-1] - inside) - np.angle(v[0] - inside)).sum())
        return Turns(flat, start + turned)

    def variable(self, omega: Floats) -> Complexes:
        """Points (m,) at which `state` is evaluated: jω, or (e^(jωT_s) − 1)/T_s."""
        host = self.sample_times[HOST]
        return 1j * omega if self.path is not None else np.expm1(1j * omega * host) / host

    def at(self, omega: Floats) -> Responses:
        """Responses at omega (m,) [rad/s]."""
        return responses([self], omega, np.zeros(len(omega), dtype=int))


def responses(joints: Sequence[Joint], omega: Floats, rows: Integers) -> Responses:
    """Responses at omega (m,) [rad/s], each of the joint whose index `rows` (m,) has."""
    size = max(len(joint.state.a) for joint in joints)  # a fraction of a tick is one state more
    a, b, c = np.zeros((len(joints), size, size)), np.zeros((len(joints), size, 2)), np.zeros((len(joints), 3, size))
    for k, joint in enumerate(joints):
        own = len(joint.state.a)
        a[k, :own, :own], b[k, :own], c[k, :, :own] = joint.state.a, joint.state.b, joint.state.c
    v = joints[0].variable(omega)
    resolvent = np.zeros((len(omega), size, size), dtype=complex)
    resolvent -= a[rows]
    diagonal = np.arange(size)
    resolvent[:, diagonal, diagonal] += v[:, None]
    found = c[rows] @ np.linalg.solve(resolvent, b[rows].astype(complex))
    drives, path, steps = [joint.system.drives[0] for joint in joints], joints[0].path, joints[0].sample_times
    if path is None:
        late = np.array([joint.ticks for joint in joints])[rows] * steps[HOST]
        commands = {HOST: found[:, :, COMMAND] * np.exp(-1j * omega * late)[:, None]}
        return Responses(omega, commands, found[:, :, LOAD], {HOST: np.ones(len(omega))})
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
