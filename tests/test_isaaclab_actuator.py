"""The actuator of Isaac Lab against the names and signatures of its source, without it: a stand-in for its base classes, and for torch."""

import importlib
import inspect
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from gainroom.errors import GainroomError
from gainroom.trainers.elastic_delayed import ElasticDelayed, ElasticDelayedJoints

NUMBERS = ElasticDelayed(motor_inertia=0.1, gearbox_stiffness=800.0, gearbox_damping=0.3, friction=0.2, delay=3.3e-3, period=1e-3)


class ActuatorBase:
    """As in isaaclab/actuators/actuator_base.py: what it gives to its subclasses, and what they override."""

    is_implicit_model = False

    def __init__(
        self,
        cfg: Any,
        joint_names: list[str],
        joint_ids: Any,
        num_envs: int,
        device: str,
        stiffness: Any = 0.0,
        damping: Any = 0.0,
        armature: Any = 0.0,
        friction: Any = 0.0,
        dynamic_friction: Any = 0.0,
        viscous_friction: Any = 0.0,
        effort_limit: Any = math.inf,
        velocity_limit: Any = math.inf,
    ):
        self.cfg, self._num_envs, self._device, self._joint_names, self._joint_indices = cfg, num_envs, device, joint_names, joint_ids
        self.stiffness, self.damping, self.effort_limit = (
            np.full((num_envs, len(joint_names)), default if given is None else given, dtype=np.float32)
            for given, default in ((cfg.stiffness, stiffness), (cfg.damping, damping), (cfg.effort_limit, effort_limit))
        )
        self.computed_effort = np.zeros((num_envs, self.num_joints), dtype=np.float32)
        self.applied_effort = np.zeros_like(self.computed_effort)

    @property
    def num_joints(self) -> int:
        return len(self._joint_names)

    def reset(self, env_ids: Sequence[int]):
        raise NotImplementedError

    def compute(self, control_action: Any, joint_pos: Any, joint_vel: Any) -> Any:
        raise NotImplementedError


def configclass(cls: Any) -> Any:
    """As isaaclab/utils/configclass.py makes dataclasses: every member, of bases too, becomes a field whose default may be MISSING."""
    hints, members = {}, {}
    for base in reversed(cls.__mro__[:-1]):
        hints.update(inspect.get_annotations(base))
        members.update({key: value for key, value in base.__dict__.items() if key in hints})
        members.update(base.__dict__.get("__dataclass_fields__", {}))
    cls.__annotations__ = hints
    for key in hints:
        value = members.get(key, MISSING)
        setattr(cls, key, value if hasattr(value, "default_factory") else field(default_factory=lambda value=value: value))
    cls.copy = lambda self: replace(self)
    return dataclass(cls)


class ActuatorBaseCfg:
    """As in isaaclab/actuators/actuator_base_cfg.py, fields that a PD uses."""

    class_type: type = MISSING  # type: ignore[assignment]
    joint_names_expr: list = MISSING  # type: ignore[assignment]
    effort_limit: Any = None
    velocity_limit: Any = None
    effort_limit_sim: Any = None
    velocity_limit_sim: Any = None
    stiffness: Any = MISSING
    damping: Any = MISSING
    armature: Any = None
    friction: Any = None
    dynamic_friction: Any = None
    viscous_friction: Any = None


@pytest.fixture
def ours(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The module, imported where stand-ins are."""
    actuators, utils, torch = (ModuleType(name) for name in ("isaaclab.actuators", "isaaclab.utils", "torch"))
    actuators.ActuatorBase, actuators.ActuatorBaseCfg = ActuatorBase, configclass(type("ActuatorBaseCfg", (), dict(vars(ActuatorBaseCfg))))
    utils.configclass = configclass
    random = np.random.default_rng(0)
    torch.float64, torch.clip, torch.einsum, torch.where, torch.minimum = np.float64, np.clip, np.einsum, np.where, np.minimum
    torch.as_tensor = lambda values, dtype, device: np.asarray(values, dtype)
    torch.Generator = lambda device: SimpleNamespace(manual_seed=lambda seed: None)
    torch.rand = lambda shape, generator, dtype, device: random.random(shape)
    for name, module in (
        ("isaaclab", ModuleType("isaaclab")),
        ("isaaclab.actuators", actuators),
        ("isaaclab.utils", utils),
        ("torch", torch),
    ):
        monkeypatch.setitem(sys.modules, name, module)
    yield importlib.import_module("gainroom.trainers.isaaclab")
    del sys.modules["gainroom.trainers.isaaclab"]


def config(ours: ModuleType, **others: Any) -> Any:
    own = {ours.RENAMED.get(each.name, each.name): getattr(NUMBERS, each.name) for each in fields(ElasticDelayed)}
    return ours.ElasticDelayedActuatorCfg(
        **{"joint_names_expr": [".*_knee"], "stiffness": 150.0, "damping": 8.0, "effort_limit": 40.0, "physics_dt": 2e-3, **own, **others}
    )


def test_it_is_called_as_isaac_lab_calls_it(ours: ModuleType):
    for name in ("compute", "reset"):
        assert [*inspect.signature(getattr(ours.ElasticDelayedActuator, name)).parameters] == [
            *inspect.signature(getattr(ActuatorBase, name)).parameters
        ]
    assert ours.ElasticDelayedActuatorCfg.__dataclass_fields__.keys() >= {
        *ActuatorBaseCfg.__annotations__,
        *(ours.RENAMED.get(each.name, each.name) for each in fields(ElasticDelayed)),
    }
    assert config(ours).copy().class_type is ours.ElasticDelayedActuator


def test_defaults_are_those_of_the_model(ours: ModuleType):
    given = {"motor_inertia": 0.1, "delay": 1e-3, "period": 1e-3}
    made = ours.ElasticDelayedActuatorCfg(joint_names_expr=["a"], stiffness=1.0, damping=1.0, physics_dt=1e-3, **given)
    assert made.numbers() == ElasticDelayed(**given)


def test_torques_are_those_of_the_model(ours: ModuleType):
    """In the place of positions and velocities, as IdealPDActuator puts them, with a reset in between."""
    cfg = config(ours, link_inertia=0.4).copy()
    made = cfg.class_type(cfg, ["left_knee", "right_knee"], [3, 7], 2, "cpu", stiffness=1.0, damping=1.0, effort_limit=7.0)
    model = ElasticDelayedJoints(NUMBERS, 2e-3, 2, 2, [0.4, 0.4])
    shape, random = (2, 2), np.random.default_rng(1)
    for k in range(30):
        position, velocity, target, speed, effort = (random.standard_normal(shape) for _ in range(5))
        if k == 20:
            made.reset([1])
            model.reset([1])
        action = SimpleNamespace(joint_positions=target, joint_velocities=speed, joint_efforts=effort, joint_indices=[3, 7])
        found = made.compute(action, position, velocity)
        expected = model.torque(position, velocity, target, speed, effort, np.full(shape, 150.0), np.full(shape, 8.0), np.full(shape, 40.0))
        assert_allclose(found.joint_efforts, expected, rtol=1e-6)  # single precision
        assert_allclose(made.applied_effort, expected, rtol=1e-6)
        assert found.joint_positions is None
        assert found.joint_velocities is None


def test_the_model_has_the_rotor_once(ours: ModuleType):
    assert config(ours).copy().armature == 0.0
    rigid = config(ours, gearbox_stiffness=math.inf, gearbox_damping=0.0, motor_friction=0.0)
    assert rigid.copy().armature == 0.1


REFUSED = [
    ({"delay": MISSING}, "delay: must be given"),
    ({"armature": 0.3}, "armature: leave it out"),
    ({"gearbox_stiffness": -1.0}, "gearbox_stiffness"),
    ({"gearbox_stiffness": math.inf, "gearbox_damping": 0.0}, "a rigid gearbox has one friction"),
]


@pytest.mark.parametrize(("others", "said"), REFUSED, ids=lambda value: "" if isinstance(value, str) else "/".join(value))
def test_what_cannot_be_is_refused(ours: ModuleType, others: dict[str, Any], said: str):
    with pytest.raises(GainroomError, match=said):
        config(ours, **others)
