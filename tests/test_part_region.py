"""The stable gains of one joint or task direction, others closed, against a count of the roots at random gains."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.part_region import PartRegion
from gainroom.analysis.part_region_margins import required_columns
from gainroom.analysis.stability import is_stable
from gainroom.app.channels import Channels
from gainroom.app.messages import View
from gainroom.app.robot_curves import part_of
from gainroom.cli.example import example_texts
from gainroom.files.robot_yaml import parse_robot
from gainroom.studies.state import State
from gainroom.system.loop_part import LoopPart
from gainroom.system.requirements import Requirements

pytest.importorskip("pinocchio")
TEXT = example_texts()["biped"].replace("sample_rate_hz: 2000", "#")
SAMPLED = TEXT.replace("  kd: 100.0 ", "  sample_rate_hz: 2000\n  kd: 100.0 ")
SOFT = TEXT.replace("kp: 2000.0 ", "kp: 4000.0 ").replace("kd: 100.0 ", "kd: 420.0 ")


def inside(columns: np.ndarray, kd: float) -> bool:
    return bool(np.any((columns[:, 0] < kd) & (kd < columns[:, 1])))


def nearest_end(columns: np.ndarray, kd: float) -> float:
    ends = columns[np.isfinite(columns)]
    return float(np.abs(ends - kd).min()) if len(ends) else np.inf


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "joint", "state"),
    [
        (TEXT, "left_knee", ("stand", "left")),
        (SAMPLED, "left_ankle_pitch", ("stand", "double")),
        (SOFT, "right_hip_roll", ("crouch", "flight")),
        (SAMPLED, "right_knee", ("crouch", "left")),
    ],
)  # fmt: skip
def test_random_gains_of_one_joint_are_stable_where_the_plane_says_so(text: str, joint: str, state: tuple[str, str]):
    """The truth is the package's own certified count of the whole robot's roots, at gains that the plane has not seen."""
    system = parse_robot(text, "biped.yaml")
    model = system.source.linearize(*state)
    k, size = model.joint_names.index(joint), model.size
    own = system.controller(model)
    kp, kd = (np.broadcast_to(np.asarray(gain, dtype=float), size).copy() for gain in (own.kp, own.kd))
    unit, window = np.eye(size)[k], (12 * kp[k], 12 * kd[k])
    plane = PartRegion.of(system.loop(model), LoopPart(unit, unit, own.on_joint(k, size)), window)
    draw = np.random.default_rng(5)
    stable = 0
    for _ in range(60):
        kp[k], kd[k] = draw.uniform(0.01, 1, 2) * window
        truth = is_stable(system.loop(model, replace(own, kp=kp.copy(), kd=kd.copy())))
        (columns,) = plane.columns(np.array([kp[k]]))
        stable += truth
        if nearest_end(columns, kd[k]) > 2e-3 * window[1]:  # closer, the picture's line is as wide
            assert inside(columns, kd[k]) == truth, (kp[k], kd[k], columns)
    assert 3 <= stable <= 57


@pytest.mark.parametrize("text", [TEXT, SAMPLED])
def test_at_the_edge_the_loop_vibrates_at_the_edges_frequency(text: str):
    """det(1 + L) vanishes there: some eigenvalue of L, from the whole robot's loop at these gains, is −1."""
    system = parse_robot(text, "biped.yaml")
    model = system.source.linearize("stand", "double")
    k, size = model.joint_names.index("left_knee"), model.size
    own = system.controller(model)
    kp, kd = (np.broadcast_to(np.asarray(gain, dtype=float), size).copy() for gain in (own.kp, own.kd))
    unit, window = np.eye(size)[k], (4 * kp[k], 12 * kd[k])
    plane = PartRegion.of(system.loop(model), LoopPart(unit, unit, own.on_joint(k, size)), window)
    edge = np.array(plane.edge(np.linspace(0.1, 1, 7) * window[0]))
    edge = edge[:, edge[1] > 0]  # no negative gain is ever drawn
    assert edge.shape[1] >= 7
    for kp[k], kd[k], omega in edge.T:
        loop = system.loop(model, replace(own, kp=kp.copy(), kd=kd.copy()))
        away = np.abs(1 + np.linalg.eigvals(loop.response(np.array([omega])).reshape(size, size)))
        assert away.min() < 5e-3  # the picture's line is 2e-3 of the window wide: of an edge at 0.4 of it, 5e-3 of the loop


def test_one_direction_of_a_task():
    text = (
        TEXT.replace("space: joint", "space: task")
        .replace("  kp: 2000.0 ", "  # ")
        .replace("  kd: 100.0 ", "  # ")
        .replace("  type: pd\n", "  type: pd\n")
    )
    system = parse_robot(text, "biped.yaml")
    model = system.source.linearize("stand", "double")
    tasks = system.source.tasks(model)
    k = tasks.directions.index("com z")
    window = (400 * tasks.kp[k], 100 * tasks.kd[k])
    plane = PartRegion.of(system.loop(model), LoopPart(tasks.torque[:, k], tasks.jacobian[k], tasks.of_direction(k)), window)
    draw, stable = np.random.default_rng(6), 0
    for _ in range(40):
        kp, kd = tasks.kp.copy(), tasks.kd.copy()
        kp[k], kd[k] = draw.uniform(0.01, 1, 2) * window
        truth = is_stable(system.loop(model, system.filtered(replace(tasks, kp=kp, kd=kd).controller())))
        (columns,) = plane.columns(np.array([kp[k]]))
        stable += truth
        if nearest_end(columns, kd[k]) > 2e-3 * window[1]:
            assert inside(columns, kd[k]) == truth, (kp[k], kd[k], columns)
    assert 2 <= stable <= 38


CASCADE = TEXT.replace("type: pd", "type: ppi").replace("  kp: 2000.0 ", "  kp: 20.0 ").replace("  kd: 100.0 ", "  ki: 20.0\n  kv: 100.0 ")
TASKS = (
    TEXT.replace("type: pd", "type: ppi")
    .replace("space: joint", "space: task")
    .replace("  kp: 2000.0 ", "  # ")
    .replace("  kd: 100.0 ", "  # ")
)
TASKS = TASKS.replace("kp: [50, 90, 200], kd: [1, 5, 15]", "kp: [10, 10, 14], kv: [6, 8, 15], ki: [3, 4, 5]")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "name", "widest", "rate"),
    [(CASCADE, "left_knee", 12, None), (CASCADE, "right_hip_roll", 12, 2000), (TASKS, "com z", 150, None), (TASKS, "pelvis x", 150, 1000)],
)
def test_the_gains_of_cascades(text: str, name: str, widest: int, rate: int | None):
    """P/PI of a joint, of a task direction, and PD beside P/PI: kv·kp and kv at random, ki/kv held, against a count of all roots."""
    system = parse_robot(text.replace("feedback: motor", f"feedback: motor\n  sample_rate_hz: {rate}") if rate else text, "biped.yaml")
    channels = Channels(system)
    model = system.source.linearize("stand", "double")
    channel = channels.channel(View(joint=name))
    window = (widest * channel.point[0], widest * channel.point[1])
    state = State(system, "stand", "double", model)
    plane = PartRegion.of(state.loop, part_of(state, channel), window)
    draw, stable = np.random.default_rng(7), 0
    for kp, kd in (draw.uniform(0.02, 1, (30, 2)) * window).tolist():
        moved = channels.applied(system, View(joint=name, point=(kp, kd)))
        own: Any = channels.channel(View(joint=name, point=(kp, kd))).own
        file: Any = channel.own
        if hasattr(own, "kv"):
            assert (own.kp * own.kv, own.kv, own.ki * file.kv) == pytest.approx((kp, kd, file.ki * kd), rel=1e-6)  # 7 digits
        truth = is_stable(moved.loop(model))
        (columns,) = plane.columns(np.array([kp]))
        stable += truth
        if nearest_end(columns, kd) > 2e-3 * window[1]:
            assert inside(columns, kd) == truth, (kp, kd, columns)
    assert 2 <= stable <= 28


@pytest.mark.parametrize("sample_time", [None, 5e-4])
def test_of_a_single_joint_it_is_the_exact_region(sample_time: float | None):
    """n = 1: the exact region, which has another derivation of the counts, ends where the plane's columns end, to the picture's width."""
    joint = gr.ElasticJoint(motor_inertia=1.0, link_inertia=16.0, stiffness=1e4, damping=1.0)
    drive = gr.Drive(bandwidth=4000.0, damping_ratio=0.9, delay=2e-3)
    loop = gr.build_loop(joint.plant(), drive, gr.PD(1e4, 300.0), sample_time=sample_time)
    region = gr.pd_region(joint, drive, sample_time=sample_time)
    window = (3e4, 900.0)
    plane = PartRegion.of(loop, LoopPart.of_joint(loop, 0), window)
    kps = np.linspace(500.0, 2.9e4, 17)
    for exact, found in zip(region.columns(kps), plane.columns(kps), strict=True):
        assert found.shape == exact.shape
        assert np.allclose(found, exact, atol=2e-3 * window[1])


def test_the_return_ratio_with_others_closed():
    """From the determinants: 1 + ℓ is det(I + L) over the same without the part's gains."""
    system = parse_robot(TEXT, "biped.yaml")
    model = system.source.linearize("stand", "left")
    own = system.controller(model)
    size = model.size
    plane = PartRegion.of(system.loop(model), LoopPart(np.eye(size)[3], np.eye(size)[3], gr.PD(2000.0, 100.0)), (4000.0, 200.0))
    kp, kd = np.full(size, 2000.0), np.full(size, 100.0)
    places = np.linspace(5, len(plane.omega) - 5, 9).astype(int)
    omega = plane.omega[places]

    def determinant(p: float, d: float) -> np.ndarray:
        kp[3], kd[3] = p, d
        loop = system.loop(model, replace(own, kp=kp.copy(), kd=kd.copy()))
        return np.linalg.det(np.eye(size) + loop.response(omega))

    expected = determinant(3000.0, 140.0) / determinant(0.0, 0.0) - 1
    assert np.allclose(plane.ratio(3000.0, 140.0)[places], expected, rtol=1e-6)


USUAL = Requirements(gain_margin=2.0, phase_margin=np.radians(30), peak_sensitivity=2.0)


OWN = [(TEXT, "left_knee", USUAL.only(name)) for name in USUAL.asked] + [(SAMPLED, "left_ankle_pitch", USUAL)]


@pytest.mark.slow
@pytest.mark.parametrize(("text", "joint", "asked"), OWN, ids=lambda each: "+".join(getattr(each, "asked", ())) or None)
def test_random_gains_of_one_joint_keep_its_own_margins_where_the_plane_says_so(text: str, joint: str, asked: Requirements):
    """The truth: 1 + L = det(I + L_all) / det(I + L_all without this joint's gains), on a dense grid, read by the margins' definitions."""
    system = parse_robot(text, "biped.yaml")
    model = system.source.linearize("stand", "left")
    k, size = model.joint_names.index(joint), model.size
    own = system.controller(model)
    kp, kd = (np.broadcast_to(np.asarray(gain, dtype=float), size).copy() for gain in (own.kp, own.kd))
    unit, window = np.eye(size)[k], (8 * kp[k], 12 * kd[k])
    plane = PartRegion.of(system.loop(model), LoopPart(unit, unit, own.on_joint(k, size)), window)
    omega = np.geomspace(0.1, np.pi * 1999 if "sample_rate" in text else 2e4, 4000)
    draw, kept = np.random.default_rng(6), 0

    def determinant(p: float, d: float) -> np.ndarray:
        kp[k], kd[k] = p, d
        return np.linalg.det(np.eye(size) + system.loop(model, replace(own, kp=kp.copy(), kd=kd.copy())).response(omega))

    without = determinant(0.0, 0.0)
    for p, d in draw.uniform(0.02, 1, (10, 2)) * window:
        value = determinant(p, d) / without - 1
        stable = is_stable(system.loop(model, replace(own, kp=kp.copy(), kd=kd.copy())))
        axis = np.flatnonzero((value.imag[1:] > 0) != (value.imag[:-1] > 0))
        crossed = -value.real[axis][value.real[axis] < 0]
        circle = np.flatnonzero((np.abs(value[1:]) > 1) != (np.abs(value[:-1]) > 1))
        truths = {
            "gain_margin": not np.any((crossed > 0.5) & (crossed < 2)),
            "phase_margin": not np.any(np.abs(np.angle(-value[circle])) < np.radians(30)),
            "peak_sensitivity": float((1 / np.abs(1 + value)).max()) < 2,
        }
        truth = stable and all(truths[name] for name in asked.asked)
        (columns,) = required_columns(plane, asked, np.array([p]))
        kept += truth
        if nearest_end(columns, d) > 0.02 * window[1]:  # closer, between two samples of the picture
            assert inside(columns, d) == truth, (p, d, columns, truths)
    assert 1 <= kept <= 9
