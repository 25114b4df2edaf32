"""Responses of one joint, at one place in its uncertainty, on which the search for a structure's parameters closes its laws.

A law runs on a path: "host", over the drive's delay at the loop's rate, or "drive", at a rate and delay of its own. With the host alone the
responses are those of ExactJoint, exact at the samples. With both, two rates meet; here each path is then a hold and a delay in continuous
time, e^(−sT) (1 − e^(−sT_s))/(s T_s), and aliases, of frequencies above half the slower rate, are left out: below that rate the error is
that of what the current loop lets through there. What is found so is proved on the lifted loop (analysis/multirate.py).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...errors import GainroomError
from ...system.assembly import Parts, current_loop
from ...system.controller import PD
from ...system.feedback import feedback_of
from ...system.gain_path import GainPath
from ...system.linear.arrays import Complexes, Floats, distinct
from ...system.linear.state_space import StateSpace
from ...system.system import System
from .exact_joint import COMMAND, LOAD, ExactJoint, sensed_state

HOST, DRIVE = "host", "drive"
"""Paths that a law may run on."""
LOWEST = 2e-3  # of the slowest of antiresonance and the lag's inverse: there the return ratio is the position gain on the rigid joint
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


@dataclass(frozen=True)
class Joint:
    """One joint at one place in its uncertainty.

    sample_times   of the paths [s], by path
    reserves       extra delay [s] that each path must keep a reserve for
    delay          of the host's path [s]
    poles          of the joint in v, (z − 1)/T_s or s
    """

    system: System
    reserves: Mapping[str, float]
    path: GainPath | None
    poles: Complexes
    _exact: ExactJoint | None
    _continuous: StateSpace

    @classmethod
    def of(cls, system: System, reserve: float, path: GainPath | None) -> "Joint":
        """Joint of `system` with its own values; `reserve` [s] on the host's path, the same share of its delay on the drive's `path`."""
        source = system.source
        if math.isinf(source.link_inertia):
            raise GainroomError("a comparison needs a link that a load can move: joint.link_inertia is .inf")
        parts = Parts(source.linearize(), system.drives, PD(0.0, 0.0), feedback_of("motor", PD), system.control.sample_time)
        continuous = sensed_state(parts)
        exact = ExactJoint.of(parts) if path is None else None
        matrix = continuous.a if exact is None else exact.state_space.a
        share = reserve / system.delay if system.delay > 0 else 0.0
        reserves = {HOST: reserve} if path is None else {HOST: reserve, DRIVE: share * path.delay}
        return cls(system, reserves, path, np.linalg.eigvals(matrix).astype(complex), exact, continuous)

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
        """Frequencies (m,) [rad/s], rising: over all decades, closer about resonance and antiresonance; m depends on `density` alone."""
        joint = self.system.source
        corners = [one for one in (joint.antiresonance, joint.resonance) if math.isfinite(one)]
        low = LOWEST * min([1 / self.system.lag, *corners])
        beside = BESIDE if density <= 1 else np.geomspace(BESIDE[0] / density, BESIDE[-1], round(density * len(BESIDE)))
        about = np.concatenate([-beside[::-1], [0.0], beside])
        parts = [np.geomspace(low, self.fastest * (1 - 1e-6), round(95 * density))]
        parts += [np.minimum(one * (1 + about), self.fastest * (1 - 1e-6 * (2 + np.arange(len(about))))) for one in corners]
        return np.sort(np.concatenate(parts))

    def start_angle(self, omega: float) -> float:
        """Sum of the angles of jω − p, or e^(jωT_s) − p, over the joint's poles p [rad]."""
        host = self.sample_times[HOST]
        v = 1j * omega if self._exact is None else np.expm1(1j * omega * host) / host
        return float(np.angle(v - self.poles).sum())

    def at(self, omega: Floats) -> Responses:
        """Responses at omega (m,) [rad/s]."""
        if self._exact is not None:
            found = self._exact.at(omega)
            return Responses(omega, {HOST: found[:, :, COMMAND]}, found[:, :, LOAD], {HOST: np.ones(len(omega))})
        s = 1j * omega
        found = self._continuous.at(s)
        assert self.path is not None
        drive = self.system.drives[0]
        loop = np.abs(current_loop(drive).at(s)) ** 2
        delays = {HOST: drive.delay, DRIVE: self.path.delay}
        commands, heard = {}, {}
        for path, step in self.sample_times.items():
            held = np.sinc(omega * step / (2 * math.pi))
            commands[path] = found[:, :, COMMAND] * (held * np.exp(-s * (delays[path] + step / 2)))[:, None]
            heard[path] = loop * held**2
        return Responses(omega, commands, found[:, :, LOAD], heard)


def quadrature(omega: Floats) -> Floats:
    """Weights (m,) of the trapezoidal rule over rising omega (m,), with what lies below the first of them."""
    weights, steps = np.zeros_like(omega), np.diff(omega)
    weights[:-1] += steps / 2
    weights[1:] += steps / 2
    weights[0] += omega[0]
    return weights


def joined(parts: list[Floats]) -> Floats:
    """Frequencies of several grids, rising, each once."""
    return distinct(np.concatenate(parts))
