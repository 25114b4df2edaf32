"""Robots to read, and MuJoCo as the witness of what they are."""

import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from gainroom.robot import RigidBody

# Two programs add the same products in another order: a few round-offs of the largest entry, 1e-15 of it, and a thousand to spare.
AGREE = 1e-12
BALL = '<geom size="0.1" mass="{0}"/>'
INERTIAL = '<inertial pos="{0}" mass="{1}" diaginertia="{2}" euler="{3}"/>'

# Masses, places and orientations without any symmetry, so that a mistake in any of them shows.
TREE = f"""<mujoco><option gravity="0.3 -0.2 -9.7"/><worldbody><body name="trunk" pos="0.1 0.2 1">
  <freejoint/>{INERTIAL.format(".01 .02 .03", 5, ".2 .3 .4", "10 20 30")}<site name="back" pos="-.1 .2 .3" euler="20 -40 70"/>
  <body name="thigh" pos=".1 .2 -.1" euler="5 6 7"><joint name="hip" axis="0 1 .2" pos=".01 .02 .03"/>
    {INERTIAL.format("0 .01 -.2", 2, ".02 .03 .04", "30 10 5")}
    <body name="shank" pos=".02 0 -.4" quat=".9 .1 .2 .3"><joint name="knee" axis="0 1 0" range="-100 5"/>
      {INERTIAL.format(".01 0 -.2", 1, ".02 .02 .003", "0 10 5")}<body name="sole" pos="0 0 -.4" euler="10 0 0"/></body></body>
  <body name="arm" pos="0 -.2 .3"><joint name="shoulder" axis="1 0 0"/>{INERTIAL.format("0 -.1 .02", 0.7, ".01 .002 .01", "0 0 9")}</body>
</body></worldbody></mujoco>"""
SLIDES = f"""<mujoco><worldbody><body name="cart" euler="10 20 30"><joint name="rail" type="slide" axis="1 .5 .2" range="-1 2"/>
  {INERTIAL.format(".1 .2 .3", 3, ".1 .2 .25", "3 4 5")}<body name="lift" pos=".1 .2 .3" euler="40 0 10">
  <joint name="lift" type="slide" axis="0 1 1" pos="9 9 9"/>{INERTIAL.format("0 .1 0", 1, ".1 .1 .1", "0 0 0")}
  <body name="pole"><joint name="hinge" axis="0 0 1" pos="0 .1 .2"/>{INERTIAL.format(".4 0 0", 2, ".1 .2 .2", "0 0 0")}
  <site name="tip" pos="1 0 0"/></body></body></body></worldbody></mujoco>"""
# Several joints in one body turn about axes that those before have moved; ref shifts their zero.
COMPOUND = f"""<mujoco><worldbody><body name="arm" pos="0 0 1" euler="0 30 0">
  <joint name="yaw" axis="0 0 1" pos=".1 0 0" ref="30"/><joint name="out" type="slide" axis="1 0 .3" ref=".2"/>
  <joint name="roll" axis="1 .3 0" pos="0 .2 .1" ref="-20"/><geom type="box" size=".1 .2 .3" pos=".1 .1 .2" euler="10 20 30" mass="3"/>
  <body name="hand" pos="0 0 .5"><joint name="wrist" axis="0 1 0" pos=".05 .02 -.1"/><joint name="twist" axis="1 1 1"/>
  <geom type="capsule" fromto="0 0 0 .1 .2 .3" size=".05" density="700"/><site name="tool" pos=".1 .1 .1" euler="1 2 3"/></body>
  <body name="cover" pos="0 .3 0">{BALL.format(0.4)}</body></body></worldbody></mujoco>"""
TWO_ARMS = f"""<mujoco><worldbody><body name="table" pos="0 0 1">{BALL.format(9)}
  <body name="left"><joint name="l1" axis="0 1 0"/>{INERTIAL.format(".2 0 0", 1, ".01 .02 .02", "0 0 5")}
    <body name="left2" pos=".4 0 0"><joint name="l2" axis="0 1 0"/>{INERTIAL.format(".2 .1 0", 1, ".01 .02 .02", "0 0 5")}
    </body></body></body>
  <body name="right" pos="1 0 0"><joint name="r1" axis="1 1 0"/>{INERTIAL.format(".3 0 0", 2, ".01 .02 .02", "0 7 5")}</body>
</worldbody></mujoco>"""
# The walker's base must come first although a door stands before it; the ball belongs to no robot.
WALKER_AND_DOOR = f"""<mujoco><worldbody><geom type="plane" size="1 1 1"/>
  <body name="door" pos="2 0 0"><joint name="door" axis="0 0 1"/>{INERTIAL.format(".4 0 1", 8, ".3 .4 .2", "0 0 5")}</body>
  <body name="ball"><freejoint/>{BALL.format(1)}</body>
  <body name="walker" pos="0 0 1"><freejoint/>{INERTIAL.format("0 0 .1", 4, ".1 .1 .1", "0 0 0")}
    <body name="leg" pos="0 .1 0"><joint name="leg" axis="0 1 0"/>{INERTIAL.format("0 0 -.3", 2, ".1 .1 .01", "0 5 0")}</body></body>
</worldbody></mujoco>"""
# Masses that come from a default class, from group limits and from settotalmass.
CLASSES = """<mujoco><compiler settotalmass="7" inertiagrouprange="0 1"/><default><geom density="300"/>
  <default class="heavy"><geom mass="2" group="1"/></default><default class="shown"><geom group="2"/></default></default>
  <worldbody><body name="a" childclass="heavy"><joint name="a" axis="1 0 0"/><geom type="box" size=".1 .2 .3" pos="0 .1 .2"/>
  <geom class="shown" type="mesh" mesh="missing"/><body name="b" pos="0 0 .5"><joint name="b" axis="0 1 0"/>
  <frame pos=".1 0 0" euler="0 40 0"><geom class="main" type="cylinder" size=".1 .2"/></frame></body></body></worldbody>
  <asset><mesh name="missing" file="missing.stl"/></asset></mujoco>"""
FAMILY = {
    "tree": TREE,
    "slides": SLIDES,
    "compound": COMPOUND,
    "two arms": TWO_ARMS,
    "walker and door": WALKER_AND_DOOR,
    "classes": CLASSES,
}


@dataclass
class Witness:
    """MuJoCo's model of the same robot, at the same posture; columns in the body's order."""

    model: Any
    data: Any
    columns: np.ndarray

    @classmethod
    def of(cls, model: Any, body: RigidBody, angles: dict[str, float]) -> "Witness":
        data = mujoco.MjData(model)
        data.qpos[:] = 0
        columns = []
        for joint in range(model.njnt):
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
                data.qpos[model.jnt_qposadr[joint] + 3] = 1
                if model.body_subtreemass[model.jnt_bodyid[joint]] > model.body_mass[model.jnt_bodyid[joint]] and body.base == "floating":
                    columns.extend(model.jnt_dofadr[joint] + np.arange(6))
        for name in body.joint_names:
            data.qpos[model.joint(name).qposadr[0]] = angles.get(name, 0.0)
            columns.append(model.joint(name).dofadr[0])
        mujoco.mj_forward(model, data)
        return cls(model, data, np.array(columns))

    def mass_matrix(self) -> np.ndarray:
        columns = []
        for direction in np.eye(self.model.nv):
            column = np.zeros(self.model.nv)
            mujoco.mj_mulM(self.model, self.data, column, direction)
            columns.append(column)
        full = np.array(columns) - np.diag(self.model.dof_armature)
        return full[np.ix_(self.columns, self.columns)]

    def jacobian(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Rows and placement of a body or site: (6, N) in its own axes."""
        rows = np.zeros((6, self.model.nv))
        body = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, name)
        if body >= 0:
            mujoco.mj_jacBody(self.model, self.data, rows[:3], rows[3:], body)
            rotation, place = self.data.xmat[body].reshape(3, 3), self.data.xpos[body]
        else:
            site = self.model.site(name).id
            mujoco.mj_jacSite(self.model, self.data, rows[:3], rows[3:], site)
            rotation, place = self.data.site_xmat[site].reshape(3, 3), self.data.site_xpos[site]
        local = np.kron(np.eye(2), rotation.T) @ rows
        return local[:, self.columns], np.column_stack([rotation, place])


def assert_close(found: np.ndarray, truth: np.ndarray, tolerance: float = AGREE) -> None:
    np.testing.assert_allclose(found, truth, rtol=0, atol=tolerance * max(1.0, np.abs(truth).max()))


def write(folder: Path, text: str, name: str = "robot.xml") -> Path:
    path = folder / name
    path.write_text(text, "utf-8")
    return path


def random_angles(body: RigidBody, seed: int) -> dict[str, float]:
    return dict(zip(body.joint_names, np.random.default_rng(seed).uniform(-2, 2, body.size).tolist(), strict=True))


def compiled(text: str) -> Any:
    """By MuJoCo from the whole file, only without the mesh that is not there."""
    text = re.sub(r'<geom class="shown"[^>]*/>', "", text)
    spec = mujoco.MjSpec.from_string(re.sub(r"<asset>.*</asset>", "", text))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # settotalmass is on its way out
        return spec.compile()


def example(file: str) -> dict[str, str]:
    return {"package": "example-robot-data", "file": file}


PLANAR_URDF = """<robot name="planar"><link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 -{c1}"/><mass value="{m1}"/>
    <inertia ixx="9" iyy="{i1}" izz="9" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0 0 -{c2}"/><mass value="{m2}"/>
    <inertia ixx="9" iyy="{i2}" izz="9" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="tip"/>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 -{l1}"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="2" effort="1" velocity="1"/></joint>
  <joint name="end" type="fixed"><parent link="lower"/><child link="tip"/><origin xyz="0 0 -{l2}"/></joint></robot>"""
PLANAR_MJCF = """<mujoco><compiler angle="radian"/><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0"/>
  <inertial pos="0 0 -{c1}" mass="{m1}" diaginertia="9 {i1} 9"/><body name="lower" pos="0 0 -{l1}">
  <joint name="elbow" axis="0 1 0" range="-1 2"/><inertial pos="0 0 -{c2}" mass="{m2}" diaginertia="9 {i2} 9"/>
  <body name="tip" pos="0 0 -{l2}"/></body></body></worldbody></mujoco>"""
PLANAR = {"m1": 2.0, "m2": 1.5, "i1": 8.99, "i2": 8.5, "c1": 0.2, "c2": 0.3, "l1": 0.5, "l2": 0.7}
