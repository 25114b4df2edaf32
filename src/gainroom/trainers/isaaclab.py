"""Actuator of Isaac Lab in which a policy feels command delay, elastic gearbox, rotor and friction.

Written after Isaac Lab's source (isaaclab/actuators, 2.x and 3.0) and not run in it: tests hold it against the names and signatures of that
source. The same model runs in mjlab.
"""

from dataclasses import MISSING, fields
from typing import Any

from isaaclab.actuators import ActuatorBase, ActuatorBaseCfg  # pyright: ignore[reportMissingImports] - users of Isaac Lab alone import this
from isaaclab.utils import configclass  # pyright: ignore[reportMissingImports]

from ..errors import GainroomError
from .elastic_delayed import ElasticDelayed, ElasticDelayedJoints, Library

RENAMED = {"friction": "motor_friction", "viscous": "motor_viscous"}
"""Fields of ElasticDelayed whose names are Isaac Lab's for the joint's own friction."""


class ElasticDelayedActuator(ActuatorBase):
    """Actuator with the model of trainers/elastic_delayed.py; gains and limits are those of an ideal PD."""

    def __init__(self, cfg: Any, *args: Any, **kwargs: Any) -> None:
        super().__init__(cfg, *args, **kwargs)
        library, owner = Library.torch(self._device, cfg.seed), f"joints {', '.join(cfg.joint_names_expr)}"
        inertia = None if cfg.link_inertia is None else [cfg.link_inertia] * self.num_joints
        self.joints = ElasticDelayedJoints(cfg.numbers(), cfg.physics_dt, self._num_envs, self.num_joints, inertia, library, owner)

    def reset(self, env_ids: Any) -> None:
        self.joints.reset(slice(None) if env_ids is None else env_ids)

    def compute(self, control_action: Any, joint_pos: Any, joint_vel: Any) -> Any:
        targets = control_action.joint_positions, control_action.joint_velocities, control_action.joint_efforts
        found = self.joints.torque(joint_pos, joint_vel, *targets, self.stiffness, self.damping, self.effort_limit)
        self.computed_effort[...] = found
        self.applied_effort[...] = found  # what the spring transmits has no limit; the motor's torque had its own
        control_action.joint_efforts = self.applied_effort
        control_action.joint_positions = None
        control_action.joint_velocities = None
        return control_action


@configclass
class ElasticDelayedActuatorCfg(ActuatorBaseCfg):
    """Configuration of an ElasticDelayedActuator: the fields of ElasticDelayed beside those of Isaac Lab.

    stiffness, damping            kp and kd [N m/rad], [N m s/rad]
    physics_dt                    SimulationCfg.dt [s]
    link_inertia                  of each link by itself about its joint, with the motor's where the gearbox is rigid [kg m²]; None: not
                                  known, links are stepped explicitly and need shorter steps
    motor_friction, motor_viscous   friction of the motor [N m], [N m s/rad]; of a rigid gearbox Isaac Lab's friction, viscous_friction

    armature is not given: it is 0 of an elastic joint, whose rotor moves by itself, and motor_inertia of a rigid one.

    Raises GainroomError where a value is not physical.
    """

    class_type: type = ElasticDelayedActuator

    physics_dt: float = MISSING  # type: ignore[assignment] - configclass finds what is missing
    link_inertia: float | None = None
    motor_inertia: float = MISSING  # type: ignore[assignment]
    gearbox_stiffness: float = float("inf")
    gearbox_damping: float = 0.0
    motor_friction: float = 0.0
    motor_viscous: float = 0.0
    delay: float = MISSING  # type: ignore[assignment]
    jitter: float = 0.0
    period: float = MISSING  # type: ignore[assignment]
    kd_delay: float | None = None
    kd_period: float | None = None
    encoder: str = "motor"
    bandwidth: float = float("inf")
    seed: int = 0

    def __post_init__(self) -> None:
        owner = f"ElasticDelayedActuatorCfg of {', '.join(self.joint_names_expr)}"
        missing = [name for name in ("physics_dt", "motor_inertia", "delay", "period") if getattr(self, name) is MISSING]
        if missing:
            raise GainroomError(f"{owner}: {', '.join(missing)}: must be given")
        numbers = self.numbers()
        numbers.require_physical(owner)
        if numbers.is_rigid and (numbers.friction or numbers.viscous):
            raise GainroomError(f"{owner}: motor_friction, motor_viscous: a rigid gearbox has one friction, friction and viscous_friction")
        armature = numbers.motor_inertia if numbers.is_rigid else 0.0
        if self.armature not in (None, armature):  # a copy has what is set here
            raise GainroomError(f"{owner}: armature: leave it out, as motor_inertia has its place")
        self.armature = armature

    def numbers(self) -> ElasticDelayed:
        """Numbers of the model."""
        return ElasticDelayed(**{field.name: getattr(self, RENAMED.get(field.name, field.name)) for field in fields(ElasticDelayed)})
