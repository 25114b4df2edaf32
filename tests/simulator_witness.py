"""MuJoCo, stepped: at which factor on all gains does a small motion of a robot grow? Nothing of gainroom's, no linearisation.

The witness compiles the MJCF text itself (or lets MuJoCo read a URDF), adds actuators and held feet as one would in a training script, and
writes torques in a Python loop, as such a script does. Without gravity, as gainroom judges small motions about equilibrium.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import files
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

SPEED = 1e-4
"""Of the first motion [rad/s]: nonlinear effects are a ten thousandth of it, and the solver's noise (1e-9) is far below."""
DECAYED, GROWN = 1e-4, 1e2
STEPS = 8000
FAR = 1e3


@dataclass(frozen=True)
class Witness:
    """A robot with PD in MuJoCo. gains: (kp, kd) by joint; feet: bodies welded to the world where they are; angles: the posture;
    armature: of all joints with gains, where the text has none."""

    text: str
    gains: Mapping[str, tuple[float, float]]
    timestep: float
    integrator: str = "Euler"
    pd: str = "explicit"
    decimation: int = 1
    feet: tuple[str, ...] = ()
    angles: Mapping[str, float] | None = None
    floating: bool = False
    armature: float | None = None

    def model(self, factor: float) -> Any:
        """Compiled, with all gains times `factor`."""
        spec = mujoco.MjSpec.from_string(self.text)
        if self.floating:
            spec.worldbody.first_body().add_freejoint()
        for actuator in list(spec.actuators):
            spec.delete(actuator)
        spec.option.timestep, spec.option.gravity = self.timestep, np.zeros(3)
        spec.option.tolerance, spec.option.iterations = 1e-14, 200
        spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{self.integrator.upper()}")
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_CONTACT)
        for joint, (kp, kd) in self.gains.items():
            actuator = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            actuator.gainprm[0] = 1.0
            if self.armature is not None:
                spec.joint(joint).armature = self.armature
            if self.pd != "explicit":
                actuator.gainprm[0], actuator.biastype = factor * kp, mujoco.mjtBias.mjBIAS_AFFINE
                actuator.biasprm[1:3] = -factor * kp, -factor * kd * (self.pd == "implicit")
            if self.pd == "joint-damping":
                damping = np.zeros_like(np.atleast_1d(spec.joint(joint).damping))
                damping[0] = factor * kd
                spec.joint(joint).damping = damping if np.ndim(spec.joint(joint).damping) else damping[0]
        return self._held(spec)

    def _held(self, spec: Any) -> Any:
        """With the feet welded at their places in the posture, as softly as MuJoCo's constraints are by default."""
        if not self.feet:
            return spec.compile()
        standing = spec.compile()
        data = self.start(standing)
        mujoco.mj_forward(standing, data)
        for foot in self.feet:
            here = standing.body(foot).id
            spec.worldbody.add_site(name=f"{foot} world", pos=data.xpos[here], quat=data.xquat[here])
            spec.body(foot).add_site(name=f"{foot} foot")
            spec.add_equality(type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_SITE, name1=f"{foot} foot", name2=f"{foot} world")
        return spec.compile()

    def start(self, model: Any) -> Any:
        """In the posture, at rest."""
        data = mujoco.MjData(model)
        for joint, angle in (self.angles or {}).items():
            data.joint(joint).qpos = angle
        return data

    def grows(self, factor: float) -> bool:
        """Whether a small random motion grows with all gains times `factor`."""
        model = self.model(factor)
        data = self.start(model)
        joints = [model.joint(name) for name in self.gains]
        places, rates = [joint.qposadr[0] for joint in joints], [joint.dofadr[0] for joint in joints]
        kp, kd = factor * np.array(list(self.gains.values())).T
        rest = data.qpos[places].copy()
        data.qvel[rates] = SPEED * np.random.default_rng(0).standard_normal(len(rates))
        data.ctrl[:] = 0.0 if self.pd == "explicit" else rest
        seen = []
        for step in range(STEPS):
            if self.pd == "explicit" and step % self.decimation == 0:
                data.ctrl[:] = kp * (rest - data.qpos[places]) - kd * data.qvel[rates]
            mujoco.mj_step(model, data)
            seen.append(float(np.abs(data.qvel[rates]).max()))
            if step % 100 == 99:
                latest = max(seen[-100:])
                if not latest < GROWN * SPEED:  # not a number: it has grown, too
                    return True
                if latest < DECAYED * SPEED:
                    return False
        quarter = STEPS // 4
        return max(seen[-quarter:]) > max(seen[-2 * quarter : -quarter])

    def onset(self, tolerance: float = 4e-3) -> tuple[float, float]:
        """A factor at which motion decays and a larger one, near it, at which it grows; (inf, inf): at none up to 1000."""
        low = high = 1.0
        while not self.grows(high):
            low, high = high, 1.5 * high
            if high > FAR:
                return np.inf, np.inf
        while self.grows(low):
            low, high = low / 1.5, low
            assert low > 1 / FAR
        while high / low > 1 + tolerance:
            middle = (low * high) ** 0.5
            low, high = (low, middle) if self.grows(middle) else (middle, high)
        return low, high


def urdf_text(path: Path) -> str:
    """A URDF as MuJoCo can read it: without shapes, with its base as a body of its own."""
    text = re.sub(r"<(visual|collision)\b.*?</\1>", "", path.read_text("utf-8"), flags=re.DOTALL)
    return re.sub(r"(<robot\b[^>]*>)", r'\1<mujoco><compiler fusestatic="false" balanceinertia="true"/></mujoco>', text, count=1)


def public_urdf(name: str) -> Path:
    """Of the package example-robot-data."""
    (found,) = [file for file in files("example-robot-data") or () if file.name == name]
    return Path(str(found.locate()))
