"""The actuator in mjlab itself, on the CPU: vibration starts where gainroom predicts it, and training runs with it stay finite.

pip install mjlab && pytest tests/test_mjlab_actuator.py
"""

import math
import runpy
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("mjlab", reason="mjlab is not installed: pip install mjlab, which brings torch")
import mujoco
import torch
from mjlab.entity import EntityArticulationInfoCfg, EntityCfg
from mjlab.scene import Scene, SceneCfg
from mjlab.sim import MujocoCfg, Simulation, SimulationCfg

from elastic_actuators import EVERY, JOINTS, LEG, Held, first_speeds, onset
from gainroom.cli import main
from gainroom.errors import GainroomError
from gainroom.trainers.elastic_delayed import ElasticDelayed
from gainroom.trainers.mjlab import ElasticDelayedActuator, ElasticDelayedActuatorCfg

STEP, DURATION = 1e-3, 2.0
"""Physics step and length of a run [s]."""


def configured(held: Held, **others: Any) -> tuple[ElasticDelayedActuatorCfg, ...]:
    """One configuration for each joint."""
    shared = [field.name for field in fields(ElasticDelayed)]
    return tuple(
        ElasticDelayedActuatorCfg(
            target_names_expr=(name,), stiffness=kp, damping=kd, **{key: getattr(actuator, key) for key in shared}, **others
        )
        for (name, actuator), kp, kd in zip(held.actuators.items(), held.kp, held.kd, strict=True)
    )


class Trainer:
    """A scene with one robot in many environments, as mjlab's own environments step it."""

    def __init__(self, held: Held, envs: int, step: float, cfgs: tuple[ElasticDelayedActuatorCfg, ...], gravity: float = 0.0):
        posture = dict(zip(held.actuators, held.posture, strict=True))
        robot = EntityCfg(
            spec_fn=lambda: mujoco.MjSpec.from_string(held.xml),
            init_state=EntityCfg.InitialStateCfg(joint_pos=posture),
            articulation=EntityArticulationInfoCfg(actuators=cfgs),
        )
        self.scene = Scene(SceneCfg(num_envs=envs, entities={"robot": robot}), device="cpu")
        options = MujocoCfg(timestep=step, gravity=(0.0, 0.0, gravity), disableflags=("contact",))
        self.sim = Simulation(num_envs=envs, cfg=SimulationCfg(mujoco=options), model=self.scene.compile(), device="cpu")
        self.scene.initialize(mj_model=self.sim.mj_model, model=self.sim.model, data=self.sim.data)
        self.robot, self.step = self.scene["robot"], step
        self.posture = torch.tensor(held.posture).repeat(envs, 1)
        self.actuators: list[ElasticDelayedActuator] = self.robot.actuators
        self.start(torch.tensor(first_speeds(held), dtype=torch.float).repeat(envs, 1))

    def start(self, speeds: Any) -> None:
        """Joints at their posture with these speeds (envs, joints), set-points at the posture."""
        self.scene.reset()
        self.robot.write_joint_state_to_sim(self.posture, speeds)
        self.robot.set_joint_position_target(self.posture)
        self.sim.forward()

    def advance(self) -> Any:
        """Torques (envs, joints) of the next step."""
        self.scene.write_data_to_sim()
        self.sim.step()
        self.scene.update(self.step)
        return self.robot.data.qfrc_actuator.clone()


@pytest.mark.slow
@pytest.mark.parametrize("step", [STEP, 4e-3])
@pytest.mark.parametrize("name", EVERY)
def test_vibration_starts_at_the_predicted_factor(name: str, step: float):
    """Within 1 %: what the physics step costs is less (tests/test_elastic_delayed.py has it by step); the loop's code is not shared."""
    held = EVERY[name]

    def run(factors: np.ndarray) -> np.ndarray:
        trainer = Trainer(held, len(factors), step, configured(held))
        for actuator, kp, kd in zip(trainer.actuators, held.kp, held.kd, strict=True):
            actuator.set_gains(slice(None), torch.tensor(factors * kp), torch.tensor(factors * kd))
        return np.array([(trainer.advance() ** 2).sum(1).numpy() for _ in range(round(DURATION / step))])

    near = held.limit()
    found = onset(run, near)
    print(f"{name} at {1e3 * step:g} ms: predicted {near:.5g}, in mjlab {found:.5g}, {100 * (found / near - 1):+.3f} %")
    assert found == pytest.approx(near, rel=0.01)


def noisy(held: Held) -> Held:
    """`held` with friction and with delays that vary."""
    return replace(held, actuators={name: replace(each, friction=0.5, viscous=0.1, jitter=5e-4) for name, each in held.actuators.items()})


def test_training_runs_with_it_and_stays_finite():
    """400 steps in 8 environments as a policy drives them: gravity, set-points at 50 Hz, resets and other gains."""
    held = noisy(LEG)
    with torch.inference_mode():
        trainer = Trainer(held, 8, 2e-3, configured(held, effort_limit=80.0), -9.81)
        drawn = torch.Generator().manual_seed(0)
        largest = torch.zeros(8)
        for k in range(400):
            if k % 10 == 0:
                trainer.robot.set_joint_position_target(trainer.posture + 0.3 * (torch.rand(8, 3, generator=drawn) - 0.5))
            if k % 100 == 50:
                some = torch.tensor([1, 5])
                trainer.robot.write_joint_state_to_sim(trainer.posture[some], torch.zeros(2, 3), env_ids=some)
                trainer.scene.reset(some)
                trainer.actuators[0].set_gains(some, torch.tensor([150.0, 250.0]), torch.tensor([5.0, 7.0]))
            largest = torch.maximum(largest, trainer.advance().abs().amax(1))
        assert torch.isfinite(trainer.robot.data.joint_pos).all()
        assert torch.isfinite(largest).all()
        assert (largest > 5.0).all()  # the legs are moved
        assert len(set(largest.tolist())) == 8  # each in its own way
        assert (trainer.robot.data.joint_pos - trainer.posture).abs().max() < 1.0


def test_the_model_has_the_rotor_once():
    """Elastic: in the actuator, so that the model's armature is 0. Rigid: as armature, and friction as the joint's."""
    for name, armature, loss in (("soft", 0.0, 0.0), ("rigid", 0.05, 0.5)):
        held = noisy(JOINTS[name])
        xml = held.xml.replace('axis="0 1 0"', 'axis="0 1 0" armature="7" damping="0.2" actuatorfrcrange="-1 1"')
        model = Trainer(replace(held, xml=xml), 1, STEP, configured(held, effort_limit=30.0)).sim.mj_model
        assert model.dof_armature[0] == pytest.approx(armature)
        assert model.dof_frictionloss[0] == pytest.approx(loss)
        assert np.ravel(model.dof_damping[0])[0] == pytest.approx(0.2 + (0.1 if loss else 0.0))
        assert not model.jnt_actfrclimited[0]


def test_what_it_cannot_be_is_refused_in_one_line():
    with pytest.raises(GainroomError, match="armature: leave it out"):
        configured(JOINTS["soft"], armature=0.1)
    with pytest.raises(GainroomError, match=r"joint knee: gearbox_stiffness 8000 N·m/rad .* needs a physics step below 6"):
        Trainer(LEG, 1, 1e-2, configured(LEG))
    with pytest.raises(GainroomError, match="must be multiples of one time"):
        Trainer(JOINTS["soft"], 1, 0.7071e-3, configured(JOINTS["soft"]))


def test_an_exported_file_is_what_mjlab_takes(tmp_path: Path):
    """A joint.yaml with the numbers of a joint gives its configuration, which runs."""
    held = JOINTS["split"]
    ((name, own),) = held.actuators.items()
    joint = {"motor_inertia": own.motor_inertia, "link_inertia": 0.3, "stiffness": own.gearbox_stiffness, "damping": own.gearbox_damping}
    path = {"delay_ms": 1e3 * (own.kd_delay or 0.0), "sample_rate_hz": 1 / (own.kd_period or 1.0)}
    control = {"type": "pd", "kp": held.kp[0], "kd": held.kd[0], "feedback": "motor", "sample_rate_hz": 1 / own.period, "kd_path": path}
    data = {"joint": joint, "drive": {"delay_ms": 1e3 * own.delay, "bandwidth": math.inf}, "control": control}
    (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(data), "utf-8")
    assert main(["export", str(tmp_path / f"{name}.yaml"), "--to", "mjlab-actuator", "--output", str(tmp_path / "a.py"), "--write"]) == 0
    (cfg,), (expected,) = runpy.run_path(str(tmp_path / "a.py"))["ACTUATORS"], configured(held)
    for field in fields(expected):
        assert getattr(cfg, field.name) == (pytest.approx(value) if isinstance(value := getattr(expected, field.name), float) else value)
    assert torch.isfinite(Trainer(held, 2, STEP, (cfg,)).advance()).all()
