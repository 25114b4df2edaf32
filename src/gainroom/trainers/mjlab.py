"""Actuator of mjlab in which a policy feels command delay, elastic gearbox, rotor and friction; run with mjlab 1.6.

mjlab's own delay lets set-points come late, and the feedback not: a loop that is stable without it is stable with it. Here the feedback is
late.
"""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mjlab.actuator.actuator import TransmissionType  # pyright: ignore[reportMissingImports] - users of mjlab alone import this module
from mjlab.actuator.pd_actuator import IdealPdActuator, IdealPdActuatorCfg  # pyright: ignore[reportMissingImports]
from mjlab.utils.spec import create_motor_actuator  # pyright: ignore[reportMissingImports]

from ..errors import GainroomError
from ..system.linear.arrays import Floats
from .elastic_delayed import ElasticDelayed, ElasticDelayedJoints, Library


@dataclass(kw_only=True)
class ElasticDelayedActuatorCfg(ElasticDelayed, IdealPdActuatorCfg):
    """Configuration of an ElasticDelayedActuator: the fields of ElasticDelayed beside those of an ideal PD.

    stiffness, damping   kp and kd [N m/rad], [N m s/rad]
    effort_limit         of the motor's torque on the joint's side [N m]; the gearbox's is not limited
    frictionloss, viscous_damping   of the link, as mjlab has them; the motor's are friction and viscous
    delay_min_lag, delay_max_lag    of set-points, as mjlab has them

    armature is not given: it is 0 of an elastic joint, whose rotor moves by itself, and motor_inertia of a rigid one.

    Raises GainroomError where a value is not physical.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        owner = f"{type(self).__name__} of {', '.join(self.target_names_expr)}"
        self.require_physical(owner)
        if self.armature is not None:
            raise GainroomError(f"{owner}: armature: leave it out, as motor_inertia has its place")
        if self.transmission_type != TransmissionType.JOINT:
            raise GainroomError(f"{owner}: transmission_type: must be a joint")

    def build(self, entity: Any, target_ids: list[int], target_names: list[str]) -> "ElasticDelayedActuator":
        return ElasticDelayedActuator(self, entity, target_ids, target_names)


class ElasticDelayedActuator(IdealPdActuator[ElasticDelayedActuatorCfg]):
    """Actuator with the model of trainers/elastic_delayed.py; gains and limits are set as those of an ideal PD."""

    cfg: ElasticDelayedActuatorCfg
    joints: ElasticDelayedJoints
    """State of the rotors and of the commands under way, once mjlab has initialised the actuator."""

    def edit_spec(self, spec: Any, target_names: list[str]) -> None:
        cfg, rigid = self.cfg, self.cfg.is_rigid
        for name in target_names:
            joint = spec.joint(name)
            loss = joint.frictionloss if cfg.frictionloss is None else cfg.frictionloss
            viscous = joint.damping[0] if cfg.viscous_damping is None else cfg.viscous_damping
            joint.actfrclimited = False  # limits are the motor's: what the spring transmits has none
            actuator = create_motor_actuator(
                spec,
                name,
                effort_limit=float("inf"),
                armature=cfg.motor_inertia if rigid else 0.0,
                frictionloss=loss + (cfg.friction if rigid else 0.0),
                viscous_damping=viscous + (cfg.viscous if rigid else 0.0),
            )
            self._mjs_actuators.append(actuator)

    def initialize(self, mj_model: Any, model: Any, data: Any, device: str) -> None:
        super().initialize(mj_model, model, data, device)
        step = float(mj_model.opt.timestep)
        dofs = [mj_model.jnt_dofadr[mj_model.actuator_trnid[actuator.id, 0]] for actuator in self._mjs_actuators]
        inverse = _inverse_inertia(mujoco, mj_model)[dofs].tolist()
        for name, each in zip(self.target_names, inverse, strict=True):
            self.cfg.require_step(f"joint {name}", step, each)
        library, owner = Library.torch(device, self.cfg.seed), f"joints {', '.join(self.cfg.target_names_expr)}"
        inertia = [1 / each for each in inverse]
        self.joints = ElasticDelayedJoints(self.cfg, step, data.nworld, len(inverse), inertia, library, owner)

    def compute(self, cmd: Any) -> Any:
        targets = cmd.position_target, cmd.velocity_target, cmd.effort_target
        return self.joints.torque(cmd.pos, cmd.vel, *targets, self.stiffness, self.damping, self.force_limit).float()

    def reset(self, env_ids: Any = None) -> None:
        super().reset(env_ids)
        self.joints.reset(slice(None) if env_ids is None else env_ids)


def _inverse_inertia(mujoco: Any, model: Any) -> Floats:
    """Accelerations (nv,) of each degree of freedom by a torque on it alone, in the posture in which mjlab starts [1/(kg m²)]."""
    data = mujoco.MjData(model)
    data.qpos[:] = model.key("init_state").qpos
    mujoco.mj_forward(model, data)
    answers = np.zeros((model.nv, model.nv))
    mujoco.mj_solveM(model, data, answers, np.eye(model.nv))
    return np.diagonal(answers)
