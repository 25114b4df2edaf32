"""Order and names of joints, the unit of length, left and right: they change labels and units, never an answer.

At three levels: the plant and its limits, the operational space, and the command on files.
"""

import json
import re
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pytest import approx

import gainroom as gr
from draws import draw_plant
from gainroom.analysis.disk_margin import disk_margin
from gainroom.cli import main
from gainroom.files.robot_yaml import parse_robot
from gainroom.system.system import System

# Limits are polished to machine precision, of matrices whose condition number is some thousands.
POLISHED = 1e-9
# Interpolated between samples, which are refined until neighbours differ little: they may come out one apart.
SAMPLED = 2e-3
DRIVE = gr.Drive(3000.0, 0.9, 2e-3)
UNIT = 1 / 0.3048  # feet for metres: torques, inertias and gains per radian times its square


def turned(plant: gr.Plant, matrix: np.ndarray, scale: float = 1.0) -> gr.Plant:
    """The plant with joints q' = M q, M a signed permutation, in a unit of length 1/√scale as long."""
    order = np.argmax(np.abs(matrix), axis=1)
    names = ("motor_inertia", "stiffness", "damping", "motor_viscous", "link_viscous")
    gravity = None if plant.gravity_stiffness is None else scale * matrix @ plant.gravity_stiffness @ matrix.T
    return replace(
        plant,
        link_inverse_inertia=matrix @ plant.link_inverse_inertia @ matrix.T / scale,
        gravity_stiffness=gravity,
        joint_names=(),
        **{name: scale * getattr(plant, name)[order] for name in names},
    )


def drawn(seed: int) -> tuple[gr.Plant, gr.PD]:
    """Five joints, mixed rigid and elastic, W singular or not, gains per joint or full matrices."""
    rng = np.random.default_rng([51, seed])
    plant = draw_plant(rng, 5, rank=3 if seed % 3 == 2 else None, rigid=seed % 3, gravity=seed % 2 == 1)
    if plant.gravity_stiffness is not None:
        plant = replace(plant, gravity_stiffness=0.1 * plant.gravity_stiffness)  # weaker than the gains
    full = rng.normal(size=(2, 5, 5)) if seed % 2 else np.zeros((2, 5, 5))
    kp = np.diag(rng.uniform(30, 90, 5)) + 0.1 * (full[0] + full[0].T)
    kd = np.diag(rng.uniform(1, 4, 5)) + 0.1 * (full[1] + full[1].T)
    return plant, gr.PD(kp, kd)


def signed_permutation(seed: int) -> np.ndarray:
    rng = np.random.default_rng([52, seed])
    return np.eye(5)[rng.permutation(5)] * rng.choice([-1, 1], 5)


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, UNIT**2])
@pytest.mark.parametrize("sample_time", [None, 1e-3])
@pytest.mark.parametrize("seed", range(6))
def test_limits_of_a_plant(seed: int, sample_time: float | None, scale: float):
    plant, control = drawn(seed)
    matrix = signed_permutation(seed)
    other = gr.PD(scale * matrix @ control.kp @ matrix.T, scale * matrix @ control.kd @ matrix.T)
    one = gr.build_loop(plant, DRIVE, control, sample_time=sample_time)
    two = gr.build_loop(turned(plant, matrix, scale), DRIVE, other, sample_time=sample_time)
    first, second = gr.joint_margins(one), gr.joint_margins(two)
    assert first.stable
    order = np.argmax(np.abs(matrix), axis=1)
    assert second.limit.gain == approx(first.limit.gain, rel=POLISHED)
    assert second.limit.frequency == approx(first.limit.frequency, rel=1e-6)  # a crossing fixes the factor to second order in ω
    assert_allclose(np.abs(second.limit.mode), np.abs(first.limit.mode)[order], atol=1e-5)
    assert second.phase_margin == approx(first.phase_margin, rel=1e-7)
    assert second.delay_margin == approx(first.delay_margin, rel=1e-7)
    assert_allclose(second.one_loop.gain_margin, first.one_loop.gain_margin[order], rtol=1e-7)
    assert first.one_loop.largest_kp is not None
    assert first.one_loop.largest_kd is not None
    assert second.one_loop.largest_kp is not None
    assert second.one_loop.largest_kd is not None
    assert_allclose(second.one_loop.largest_kp, scale * first.one_loop.largest_kp[order], rtol=1e-7)
    assert_allclose(second.one_loop.largest_kd, scale * first.one_loop.largest_kd[order], rtol=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_disk_margin_of_a_plant(seed: int):
    plant, control = drawn(2 * seed)
    matrix = signed_permutation(seed)
    other = gr.PD(UNIT**2 * matrix @ control.kp @ matrix.T, UNIT**2 * matrix @ control.kd @ matrix.T)
    one = disk_margin(gr.build_loop(plant, DRIVE, control))
    two = disk_margin(gr.build_loop(turned(plant, matrix, UNIT**2), DRIVE, other))
    assert two.certified == one.certified
    assert two.margin == approx(one.margin, rel=2e-3)  # each certified to a thousandth


# A biped whose legs differ, with products of inertia, on rigid and on springy ground, written to files in several manners.
LINKS = {  # mass, centre, (ixx, iyy, izz, ixy, ixz, iyz); right leg: heavier by a fifth
    "hip": None,
    "thigh": (4.0, (0.02, 0.03, -0.18), (0.08, 0.09, 0.02, 0.002, -0.003, 0.004)),
    "foot": (3.5, (-0.01, 0.01, -0.25), (0.06, 0.07, 0.01, 0.001, 0.002, -0.001)),
}
TRUNK = (18.0, (0.03, 0.01, 0.25), (0.6, 0.5, 0.3, 0.01, 0.02, -0.01))
CHAIN = (
    ("roll", "hip", (0.0, 0.1, -0.1), "1 0 0"),
    ("pitch", "thigh", (0.0, 0.0, 0.0), "0 1 0"),
    ("knee", "foot", (0.0, 0.0, -0.4), "0 1 0"),
)
ANGLES = {"left": (0.1, -0.3, 0.6), "right": (-0.05, -0.5, 0.8)}
KP = {"roll": 500.0, "pitch": 400.0, "knee": 300.0}


def body_text(name: str, solid: tuple, heavier: float, unit: float, mirrored: bool) -> str:
    mass, (x, y, z), moments = solid
    side = -1 if mirrored else 1
    ixx, iyy, izz, ixy, ixz, iyz = (value * heavier * unit**2 for value in moments)
    return (
        f'<link name="{name}"><inertial><origin xyz="{unit * x} {unit * side * y} {unit * z}"/><mass value="{mass * heavier}"/>'
        f'<inertia ixx="{ixx}" ixy="{side * ixy}" ixz="{ixz}" iyy="{iyy}" iyz="{side * iyz}" izz="{izz}"/></inertial></link>'
    )


class Biped:
    """The files of a biped.

    order   which leg comes first
    name    label of a joint or link from the plain one
    unit    how many units of length make a metre
    mirrored   left for right
    """

    def __init__(
        self,
        order: tuple[str, str] = ("left", "right"),
        name: Callable[[str], str] = lambda plain: plain,
        unit: float = 1.0,
        mirrored: bool = False,
    ) -> None:
        self.order, self.name, self.unit, self.mirrored = order, name, unit, mirrored

    def side(self, side: str) -> str:
        """The leg that stands where `side` is in the plain robot."""
        return {"left": "right", "right": "left"}[side] if self.mirrored else side

    def urdf(self) -> str:
        unit, parts = self.unit, [body_text(self.name("trunk"), TRUNK, 1.0, self.unit, self.mirrored)]
        for side in self.order:
            heavier = 1.2 if side == "right" else 1.0
            flip = (side == "right") != self.mirrored
            own = self.side(side)
            parent = "trunk"
            for joint, part, (x, y, z), axis in CHAIN:
                child, solid = f"{own}_{part}", LINKS[part]
                text = f'<link name="{self.name(child)}"/>'
                if solid is not None:
                    text = body_text(self.name(child), solid, heavier, unit, flip)
                offset = -y if flip else y
                parts.append(
                    f'{text}<joint name="{self.name(f"{own}_{joint}")}" type="revolute"><parent link="{self.name(parent)}"/>'
                    f'<child link="{self.name(child)}"/><origin xyz="{unit * x} {unit * offset} {unit * z}"/><axis xyz="{axis}"/>'
                    f'<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
                )
                parent = child
        return f'<robot name="biped">{"".join(parts)}</robot>'

    def yaml(self, contacts: tuple[str, ...] = ("both", "one")) -> str:
        square = self.unit**2
        angles, gains, heavy = {}, {}, {}
        for side in self.order:
            for joint, angle in zip(KP, ANGLES[side], strict=True):
                label = self.name(f"{self.side(side)}_{joint}")
                angles[label] = -angle if self.mirrored and joint == "roll" else angle
                gains[label] = square * KP[joint] * (1.1 if side == "right" else 1.0)
                heavy[label] = {"motor_inertia": square * (0.6 if side == "left" else 0.7)}
        feet = {side: self.name(f"{self.side(side)}_foot") for side in ("left", "right")}
        soft = {"frame": feet["right"], "type": "line", "stiffness": [1e5, 2e3 * square], "damping": [50, 3 * square]}
        ground = {"both": [{"frame": feet["left"], "type": "point"}, soft], "one": [{"frame": feet["left"], "type": "line"}]}
        file = {
            "model": {"file": "robot.urdf", "base": "floating"},
            "joints": {"default": {"stiffness": 5e3 * square, "damping": 2 * square}, **heavy},
            "drive": {"bandwidth": 3000, "delay_ms": 2},
            "postures": {"bent": angles},
            "contacts": {contact: ground[contact] for contact in contacts},
            "control": {"type": "pd", "feedback": "motor", "kp": gains, "kd": {label: 0.05 * gain for label, gain in gains.items()}},
            "tasks": [
                {"name": "com", "type": "com", "kp": [40, 60, 90], "kd": [3, 5, 9]},
                {"name": "upright", "type": "orientation", "frame": self.name("trunk"), "kp": 50, "kd": 6},
            ],
            "limits": {"gain_margin_db": 6},
        }
        return json.dumps(file)

    def write(self, folder: Path) -> None:
        folder.mkdir()
        (folder / "robot.urdf").write_text(self.urdf(), "utf-8")
        (folder / "robot.yaml").write_text(self.yaml(("both",)), "utf-8")

    def spec(self, folder: Path) -> System:
        return parse_robot(self.yaml(), "f", folder)

    def label(self, plain: str) -> str:
        """What this robot calls a joint of the plain one."""
        side, _, part = plain.partition("_")
        return self.name(f"{self.side(side)}_{part}" if side in ("left", "right") else plain)


def renamed(plain: str) -> str:
    """Another alphabet, another order of the alphabet, signs that patterns treat as special."""
    return "j." + plain[::-1]


VARIANTS = {
    "other order": Biped(order=("right", "left")),
    "other names": Biped(name=renamed),
    "other order and names": Biped(order=("right", "left"), name=renamed),
    "feet": Biped(unit=UNIT),
    "mirrored": Biped(mirrored=True),
    "all at once": Biped(order=("right", "left"), name=renamed, unit=UNIT, mirrored=True),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bipeds")
    for name, biped in {"plain": Biped(), **VARIANTS}.items():
        biped.write(path / name)
    return path


@pytest.mark.parametrize("contact", ["both", "one"])
@pytest.mark.parametrize("variant", VARIANTS)
def test_operational_space(folder: Path, variant: str, contact: str):
    """Joint gains of the tasks, their limit as a whole and along each direction."""
    biped = VARIANTS[variant]
    one, two = Biped().spec(folder / "plain"), biped.spec(folder / variant)
    first, second = (spec.source.linearize("bent", contact) for spec in (one, two))
    order = [first.joint_names.index(name) for name in sorted(first.joint_names)]
    there = [second.joint_names.index(biped.label(first.joint_names[k])) for k in order]
    flip = np.array([-1.0 if biped.mirrored and "roll" in first.joint_names[k] else 1.0 for k in order])
    signs = np.outer(flip, flip)
    square = biped.unit**2
    inverse = first.link_inverse_inertia[np.ix_(order, order)]
    assert_allclose(second.link_inverse_inertia[np.ix_(there, there)] * square * signs, inverse, atol=1e-9 * np.abs(inverse).max())
    tasks, others = one.source.tasks(first), two.source.tasks(second)
    for gains, found in zip(tasks.joint_gains(), others.joint_gains(), strict=True):
        wanted = gains[np.ix_(order, order)]
        assert_allclose(found[np.ix_(there, there)] * signs / square, wanted, atol=1e-8 * np.abs(wanted).max())
    loops = [spec.loop(model, stack.controller()) for spec, model, stack in ((one, first, tasks), (two, second, others))]
    limits = [gr.gain_limit(loop) for loop in loops]
    assert limits[1].stable == limits[0].stable
    assert limits[1].gain == approx(limits[0].gain, rel=1e-7)  # the gains themselves come to 1e-8
    assert limits[1].frequency == approx(limits[0].frequency, rel=1e-5)


def assert_same(found: Mapping[str, Any], wanted: Mapping[str, Any], factors: Mapping[str, float], rel: float) -> None:
    """The same keys and numbers, those in `factors` times theirs."""
    assert found.keys() == wanted.keys()
    for key, value in wanted.items():
        if isinstance(value, float):
            assert found[key] == approx(factors.get(key, 1.0) * value, rel=rel, abs=1e-9), key
        elif not isinstance(value, list | dict | str):
            assert found[key] == value, key


@pytest.fixture(scope="module")
def told(folder: Path) -> list[dict[str, Any]]:
    """What the command says of the robot, and of all changes at once."""
    answers = []
    for name in ("plain", "all at once"):
        with redirect_stdout(StringIO()) as out:
            main(["robot", str(folder / name / "robot.yaml"), "--json"])
        answers.append(json.loads(out.getvalue()))
    return answers


@pytest.mark.slow
def test_the_command_on_files(told: list[dict[str, Any]]):
    (plain, other), biped = told, VARIANTS["all at once"]
    square = biped.unit**2
    assert other["stable"] is plain["stable"] is True
    names = [row["name"] for row in plain["states"][0]["joints"]]
    sentence = re.sub("|".join(names), lambda found: biped.label(found[0]), plain["sentence"])
    assert other["sentence"] == sentence
    units: dict[str, float] = dict.fromkeys(("link_inertia", "kp", "kd", "kp_max", "kd_max", "dynamic_stiffness"), square)
    for first, second in zip(plain["states"], other["states"], strict=True):
        assert second["limiting_joints"] == [biped.label(name) for name in first["limiting_joints"]]
        assert_same(second, first, {}, 1e-5)  # margins at crossings of the unit circle move with the phase: some digits less
        assert_same(second["kept"], first["kept"], {}, SAMPLED)
        rows = {row["name"]: row for row in second["joints"]}
        for row in first["joints"]:
            assert_same(rows[biped.label(row["name"])], row, units, 1e-5)
        for row, task in zip(second["tasks"], first["tasks"], strict=True):
            assert (row["name"], row["direction"]) == (task["name"], task["direction"])
            assert_same(row, task, {}, 1e-5)


@pytest.mark.slow
def test_recommended_gains_of_the_command_on_files(told: list[dict[str, Any]]):
    (plain, other), biped = told, VARIANTS["all at once"]
    square = biped.unit**2
    for first, second in zip(plain["recommended"], other["recommended"], strict=True):
        joint = first["space"] == "joint"
        there = [second["names"].index(biped.label(name) if joint else name) for name in first["names"]]
        for one, two in zip(first["sets"], second["sets"], strict=True):
            assert two["contact"] == one["contact"]
            for key in ("kp", "kd"):
                wanted = np.array(one[key], dtype=float) * (square if joint else 1.0)
                # kp of each joint alone is rounded down to three digits, 1 % in some units, and its best kd moves by twice as much;
                # searches stop within 2 %.
                assert_allclose(np.array(two[key], dtype=float)[there], wanted, rtol=0.05)
