"""Gain limits of one robot on one set of contacts in many postures, each with its proof or certificate.

For most robots postures differ in W alone. Then the core proves one limit after the other (native/include/gainroom/posture_limits.hpp),
each search started from the crossings of the posture before. Postures without such a proof, and all postures of other robots, go to
gain_limit.
"""

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ...analysis.gain_limit import gain_limit
from ...analysis.margin_record import NUDGE
from ...analysis.modal_loop import ModalLoop
from ...analysis.proved_limit import posture_limits
from ...errors import GainroomError
from ...native import _core
from ...robot.body import RigidBody, is_continuous, library
from ...robot.linearize import linearize
from ...robot.robot import Robot
from ...system.assembly import current_loop
from ...system.linear.arrays import Booleans, Floats, Integers
from ...system.mode_functions import APART, INEXACT
from ...system.modes import ModeStacks, posture_modes
from ...system.plant import OFF_MODES
from ...system.system import System

SOMEWHERE = 1j * np.array([0.7, 1.3, 2.1])
"""Test points s [rad/s]: motors that can move at all respond at one of them."""


class Limits(NamedTuple):
    """Limits in k postures; a factor multiplies all gains.

    gain        the loop is stable for every factor from `lower` up to it; inf: no limit; NaN: not known. Certified: end of the proof,
                NUDGE below the crossing that was found, so that no other crossing as near can lie below it
    lower       0, or the factor below which the loop is unstable; certified: NUDGE above its crossing
    frequency   of the vibration just above `gain` [rad/s]; NaN if there is none
    joint       index of the joint that moves most in that vibration; −1 if there is none
    certified   True: `gain` is proved, or roots have been counted on both sides of it
    """

    gain: Floats
    lower: Floats
    frequency: Floats
    joint: Integers
    certified: Booleans


class StateLimits:
    """Limits of a robot's system, control in joint or task space, in the contact state `contact`.

    Raises GainroomError for an unknown contact state, and for closed loops and passive joints.
    """

    def __init__(self, system: System, contact: str):
        robot = system.source
        if not isinstance(robot, Robot):
            raise GainroomError(f"{robot.name}: a sweep needs a robot: a robot.yaml, or a model")
        robot.body.require_tree(f"{robot.name}: sweep")
        if contact not in robot.contacts:
            raise GainroomError(f"{robot.name}: contact {contact!r} is not one of {', '.join(robot.contacts)}")
        self.system, self._robot, self._body, self._contacts = system, robot, robot.body, robot.contacts[contact]

    def limits(self, angles: Floats) -> Limits:
        """Limits at joint positions `angles` (k, n) [rad; m if prismatic], reproducible to the last bit."""
        gain, lower, frequency = (np.full(len(angles), math.nan) for _ in range(3))
        found = Limits(gain, lower, frequency, np.full(len(angles), -1), np.zeros(len(angles), dtype=bool))
        postures = configurations(self._body, angles)
        core = self._core
        stacks = None if core is None else self._stacks(postures)
        left = np.arange(len(angles))
        if core is not None and stacks is not None:
            usable = np.flatnonzero(stacks.inexact < OFF_MODES)
            chosen = ModeStacks(*(np.ascontiguousarray(part[usable]) for part in stacks))
            proved, answers = core.run(*chosen._replace(inexact=INEXACT * chosen.inexact))
            proved = proved[:, 0] == 1
            done, answers = usable[proved], answers[proved]
            limited = np.isfinite(answers[:, 0])
            found.gain[done], found.lower[done], found.certified[done] = answers[:, 0], 0.0, True
            found.frequency[done] = np.where(limited, answers[:, 1], math.nan)
            found.joint[done] = np.where(limited, answers[:, 2], -1)
            left = np.setdiff1d(left, done)
        for row in left.tolist():
            self._ask(postures[row], row, found)
        found.gain[found.certified] *= 1 - NUDGE
        found.lower[found.certified] *= 1 + NUDGE
        return found

    @property
    def quick(self) -> bool:
        """True if limits are proved in a row by the core."""
        return self._core is not None and posture_modes(np.eye(self._body.size)[None], *self._gearboxes) is not None

    def _ask(self, q: Floats, row: int, found: Limits) -> None:
        """Fill row `row` of `found` by gain_limit, NaN if it fails; no limit where contacts hold every motor."""
        try:
            model = linearize(self._body, self._robot.actuators, q, self._contacts, gravity=bool(self._robot.gravity))
            loop = self.system.loop(model)
            if loop.parts is not None and not np.any(loop.parts.plant.response(SOMEWHERE, "motor")):
                found.gain[row], found.lower[row], found.certified[row] = math.inf, 0.0, True
                return
            limit = gain_limit(loop)
        except GainroomError:
            return
        found.gain[row], found.lower[row], found.frequency[row] = limit.gain, limit.lower_gain, limit.frequency
        counted = [limit.certificate, *([limit.lower_certificate] if limit.lower_gain > 0 else [])]
        found.certified[row] = limit.gain == math.inf or all(one is not None and one.holds for one in counted)
        if math.isfinite(limit.frequency):
            found.joint[row] = int(np.argmax(np.abs(limit.mode)))

    @cached_property
    def _core(self) -> "_core.PostureLimits | None":
        """Core search over postures; None if postures differ in more than W, or no proof is known."""
        robot, body = self._robot, self._body
        if robot.gravity or body.springs or any(contact.stiffness is not None for contact in self._contacts):
            return None
        actuators = robot.actuators
        if np.any(actuators.motor_viscous) or np.any(actuators.link_viscous) or self.system.control.controller is None:
            return None
        if self.system.control.kd_path is not None:
            return None
        q = body.configuration(dict(next(iter(robot.postures.values())).angles))
        modal = ModalLoop.of(self.system.loop(linearize(body, actuators, q, self._contacts)))
        return None if modal is None else posture_limits(modal)

    @property
    def _gearboxes(self) -> tuple[Floats, Floats, Floats]:
        actuators = self._robot.actuators
        return actuators.motor_inertia, actuators.stiffness, actuators.damping

    def _stacks(self, postures: Floats) -> ModeStacks | None:
        drive, step = self.system.drives[0], self.system.control.sample_time
        inverse = self._inverse_inertias(postures)
        none = np.isnan(inverse[:, 0, 0])
        inverse[none] = np.eye(self._body.size)
        stacks = posture_modes(inverse, *self._gearboxes)
        if stacks is not None:
            stacks = stacks._replace(inexact=np.where(none, math.inf, stacks.inexact))
        if stacks is None or step is None or drive.is_ideal:
            return stacks
        # Behind a hold the two poles of the current loop have terms of their own (system/mode_functions.py).
        fast = current_loop(drive).poles
        near = np.abs(np.concatenate([stacks.poles, stacks.partners], axis=1)[:, :, None] - fast) < APART * np.abs(fast)
        return stacks._replace(inexact=np.where(np.any(near, axis=(1, 2)), math.inf, stacks.inexact))

    def _inverse_inertias(self, postures: Floats) -> Floats:
        """Inverse link inertia W (k, n, n); NaN where the mass matrix is singular."""
        pin, model, size = library("pinocchio", "Pinocchio"), self._body.model, self._body.size
        data, found = model.createData(), np.empty((len(postures), size, size))
        held = [(self._body.frame_index(contact.frame), list(contact.rows)) for contact in self._contacts]
        free = np.zeros((0, self._body.nv))
        for row, q in enumerate(postures):
            pin.crba(model, data, q, pin.Convention.WORLD)
            rows = [pin.getFrameJacobian(model, data, frame, pin.LOCAL)[rows] for frame, rows in held]
            try:
                found[row] = _core.link_inverse_inertia(data.M, np.concatenate(rows) if rows else free, size)
            except ValueError:  # no mass moves with some joint in this posture
                found[row] = math.nan
        return found


def configurations(body: RigidBody, angles: Floats) -> Floats:
    """Configurations (k, nq) with joints at `angles` (k, n) and a floating base at the identity."""
    found = np.tile(body.neutral(), (len(angles), 1))
    for joint, values in zip(body.joints, angles.T, strict=True):
        columns = (np.cos(values), np.sin(values)) if is_continuous(joint) else (values,)
        for at, column in enumerate(columns):
            found[:, joint.idx_q + at] = column
    return found
