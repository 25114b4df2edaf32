"""Stability of PD gains in a training simulator: MuJoCo's own linearisation of one step, closed with the gains.

About a posture at rest, one step takes the small motion x = (δq, h δv) to A x + B τ (mjd_transitionFD). A program's PD, τ = −F x, applied
as torque and held for d steps, closes it to

    x⁺ = (A^d − (I + A + … + A^(d−1)) B F) x

MuJoCo's own actuators are part of its step, so A already contains their gains; the integrator decides which of their forces a step takes
implicitly. The simulation explodes if an eigenvalue lies outside the unit circle.

Gravity is left out, as in an audit of gains, so a motion without gains keeps its position or speed. Positions that nothing holds (of a
floating base, of joints without gains) are divided out: beside a constant speed they would be a double eigenvalue at 1, which the round-off
of differences (1e-10) splits into 1 ± 1e-5.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from ..errors import GainroomError
from ..robot.actuators import Actuators
from ..robot.body import RigidBody, library
from ..robot.contact import Contact
from ..system.linear.arrays import Complexes, Floats
from .mujoco_model import MujocoRobot, build_mujoco

Pd = Literal["explicit", "implicit", "joint-damping"]
ArmatureOf = Literal["file", "motor"]
DIFFERENCE = 1e-6
"""Step of central differences, as MuJoCo's documentation recommends: truncation 1e-12, round-off 1e-10."""
GROWS = 1e-8
"""Excess over 1 at which an eigenvalue counts as outside the unit circle: a motion then takes 10⁸ steps to grow by e.

Less may be round-off.
"""
UNHELD = 1e-7
"""Relative change per step below which nothing holds a position: round-off of differences, with a margin."""
SEARCH_STEP = 1.1
"""Factor between gains, or time steps, tried before bisection; instability within one factor is not found."""
FURTHEST = 1e3
ACCURACY = 1e-6
CONTACT_TIME, CONTACT_IMPEDANCE = (0.02, 1.0), (0.9, 0.95, 1e-3, 0.5, 2.0)
"""Default solref and solimp of MuJoCo's contacts."""


@dataclass(frozen=True, kw_only=True)
class Simulator:
    """Settings of MuJoCo.

    timestep    h [s]
    integrator  MuJoCo's name of it
    pd          explicit: a program computes the torque from the state; implicit: MuJoCo's actuators do, <position kp kv>;
                joint-damping: kp is an actuator's, and kd the joint's damping in place of the file's
    decimation  d, number of steps for which an explicit torque is held
    armature    of the joints: the file's, or the audited motors' inertia
    damping_in_kd   True: the file's joint damping is contained in kd; False: it acts in addition
    flags       the file's option.disableflags, of which those that affect damping are used
    """

    timestep: float
    integrator: str = "Euler"
    pd: Pd = "explicit"
    decimation: int = 1
    armature: ArmatureOf = "file"
    damping_in_kd: bool = False
    flags: int = 0


@dataclass(frozen=True, eq=False)
class SimulatorLimit:
    """Stability limit of a common factor on all gains.

    stable      True: stable with these gains
    gain        factor at which stability changes; inf: none up to 1000; 0: none down to 1/1000
    frequency   of the motion that grows beyond it [rad/s]; 0: without oscillation; NaN where there is no limit
    mode        (n,) joint amplitudes of that motion
    """

    stable: bool
    gain: float
    frequency: float = math.nan
    mode: Complexes = field(default_factory=lambda: np.zeros(0, dtype=complex))


@dataclass(frozen=True, eq=False)
class SimulatedRobot:
    """Robot in the training simulator: rigid joints, no delay, no dry friction, no limits of position or torque, no gravity.

    q         (nq,) posture
    armature  (n,) [kg m²; kg if prismatic]
    contacts  frames held in place, as softly as MuJoCo's contacts are by default

    Damping and springs of the joints are those of the model's file.
    """

    body: RigidBody
    q: Floats
    armature: Floats
    contacts: tuple[Contact, ...] = ()

    def limit(self, simulator: Simulator, kp: Floats, kd: Floats) -> SimulatorLimit:
        """Limit of the common factor on kp, kd (n,) [N m/rad, N m s/rad]; joints whose gains are 0 are free.

        Raises GainroomError for an integrator that MuJoCo does not have.
        """
        return _limit(lambda factor: self._growth(simulator, kp, kd, factor))

    def stable(self, simulator: Simulator, kp: Floats, kd: Floats) -> bool:
        """True if stable with these gains; raises as `limit`."""
        return not self._growth(simulator, kp, kd).unstable

    def largest_timestep(self, simulator: Simulator, kp: Floats, kd: Floats) -> float:
        """Time step [s] below which gains that are unstable become stable; 0: not even at a thousandth of `simulator`'s."""
        found = _limit(lambda factor: self._growth(replace(simulator, timestep=factor * simulator.timestep), kp, kd))
        return found.gain * simulator.timestep

    @cached_property
    def _built(self) -> MujocoRobot:
        nothing, rigid = np.zeros(self.body.size), np.full(self.body.size, math.inf)
        actuators = Actuators(self.armature, rigid, nothing, nothing, nothing)
        robot = build_mujoco(self.body, actuators, self.q, self.contacts, timestep=1e-3, gravity=False)
        robot.model.eq_solref[:], robot.model.eq_solimp[:] = CONTACT_TIME, CONTACT_IMPEDANCE
        return robot

    def _growth(self, simulator: Simulator, kp: Floats, kd: Floats, factor: float = 1.0) -> "_Growth":
        """Largest eigenvalue of the closed step, with `factor` times the gains."""
        step = self._closed(simulator, kp, kd, factor)
        if not np.isfinite(step).all():
            return _Growth(math.inf, 0.0, np.ones(self.body.size, dtype=complex))
        motors, nv = self._built.motor_v, len(step) // 2
        driven = motors[(kp != 0) | (kd != 0)]
        seen = np.eye(2 * nv)[[*driven, *(nv + driven)]]
        _, held, directions = np.linalg.svd(np.vstack([step - np.eye(2 * nv), seen]))
        rest = directions[: np.count_nonzero(held > UNHELD)].T  # all but the places that nothing holds
        values, vectors = np.linalg.eig(rest.T @ step @ rest)
        largest = int(np.argmax(np.abs(values)))
        period = simulator.decimation * simulator.timestep
        mode = (rest @ vectors[:, largest])[motors]
        return _Growth(float(abs(values[largest])), float(abs(np.angle(values[largest]))) / period, mode)

    def _closed(self, simulator: Simulator, kp: Floats, kd: Floats, factor: float) -> Floats:
        """Transition matrix (2 nv, 2 nv) of one control period, on (δq, h δv)."""
        robot, n, h = self._built, self.body.size, simulator.timestep
        mujoco, model, explicit = library("mujoco", "MuJoCo"), robot.model, simulator.pd == "explicit"
        model.opt.timestep, model.opt.integrator = h, _integrator(mujoco, simulator.integrator)
        mask = _damping_flags(mujoco)
        model.opt.disableflags = (model.opt.disableflags & ~mask) | (simulator.flags & mask)
        share = np.minimum(self.body.damping, kd) * simulator.damping_in_kd  # of kd, what is the joints' damping
        beside = self.body.damping - share
        if simulator.pd == "joint-damping":
            share, beside = kd, 0.0 * kd
        model.dof_damping[robot.motor_v] = beside + factor * share
        kp, kd = factor * kp, factor * (kd - share)
        model.actuator_biastype[:n] = mujoco.mjtBias.mjBIAS_NONE if explicit else mujoco.mjtBias.mjBIAS_AFFINE
        data = robot.new_data(self.q)
        model.actuator_biasprm[:n, 0], model.actuator_biasprm[:n, 1] = kp * data.qpos[robot.motor_q], -kp
        model.actuator_biasprm[:n, 2] = -kd
        state, torque = _transition(mujoco, model, data)
        nv = model.nv
        scale = np.repeat([1.0, h], nv)
        state, torque = state * scale[:, None] / scale, scale[:, None] * torque[:, :n]
        if not explicit:
            return state
        feedback = np.zeros((n, 2 * nv))
        feedback[np.arange(n), robot.motor_v], feedback[np.arange(n), nv + robot.motor_v] = kp, kd / h
        powers = [np.eye(2 * nv)]
        for _ in range(simulator.decimation):
            powers.append(state @ powers[-1])
        return powers[-1] - sum(powers[:-1]) @ torque @ feedback


@dataclass(frozen=True, eq=False)
class _Growth:
    """Fastest growth of a motion in one control period: its factor, its frequency [rad/s], its joint amplitudes."""

    factor: float
    frequency: float
    mode: Complexes

    @property
    def unstable(self) -> bool:
        return self.factor > 1 + GROWS


def _limit(growth: Callable[[float], _Growth]) -> SimulatorLimit:
    """Factor nearest to 1 at which stability changes: above 1 if stable, below if not."""
    first = latest = growth(1.0)
    last = tried = 1.0
    while latest.unstable == first.unstable:
        last, tried = tried, tried / SEARCH_STEP if first.unstable else tried * SEARCH_STEP
        if not 1 / FURTHEST <= tried <= FURTHEST:
            return SimulatorLimit(False, 0.0, first.frequency, first.mode) if first.unstable else SimulatorLimit(True, math.inf)
        latest = growth(tried)
    stable, unstable, beyond = (tried, last, first) if first.unstable else (last, tried, latest)
    while unstable > stable * (1 + ACCURACY):
        middle = math.sqrt(stable * unstable)
        here = growth(middle)
        stable, unstable, beyond = (stable, middle, here) if here.unstable else (middle, unstable, beyond)
    return SimulatorLimit(not first.unstable, stable, beyond.frequency, beyond.mode)


def _damping_flags(mujoco: Any) -> int:
    """Bits of MuJoCo's disableflags that affect the joints' damping."""
    bits = mujoco.mjtDisableBit
    return sum(int(getattr(bits, name, 0)) for name in ("mjDSBL_DAMPER", "mjDSBL_PASSIVE", "mjDSBL_EULERDAMP"))


def _integrator(mujoco: Any, name: str) -> Any:
    known = getattr(mujoco.mjtIntegrator, f"mjINT_{name.upper()}", None)
    if known is None:
        raise GainroomError(f"integrator {name}: MuJoCo {mujoco.__version__} does not have it")
    return known


def _transition(mujoco: Any, model: Any, data: Any) -> tuple[Floats, Floats]:
    """Transition matrices A (2 nv, 2 nv) and B (2 nv, nu) of one step, from `data` at rest."""
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:  # which mjd_transitionFD refuses
        return _differences(mujoco, model, data)
    state, torque = np.zeros((2 * model.nv, 2 * model.nv)), np.zeros((2 * model.nv, model.nu))
    mujoco.mjd_transitionFD(model, data, DIFFERENCE, True, state, torque, None, None)
    return state, torque


def _differences(mujoco: Any, model: Any, data: Any) -> tuple[Floats, Floats]:
    """Transition matrices A, B of one step by central differences of whole steps."""
    nv, moved = model.nv, mujoco.MjData(model)

    def after(change: Floats) -> Floats:
        mujoco.mj_resetData(model, moved)
        moved.qpos[:] = data.qpos
        mujoco.mj_integratePos(model, moved.qpos, change[:nv], 1.0)
        moved.qvel[:], moved.ctrl[:] = change[nv : 2 * nv], change[2 * nv :]
        mujoco.mj_step(model, moved)
        place = np.zeros(nv)
        mujoco.mj_differentiatePos(model, place, 1.0, data.qpos, moved.qpos)
        return np.concatenate([place, moved.qvel])

    changes = DIFFERENCE * np.eye(2 * nv + model.nu)
    columns = np.array([(after(change) - after(-change)) / (2 * DIFFERENCE) for change in changes]).T
    return columns[:, : 2 * nv], columns[:, 2 * nv :]
