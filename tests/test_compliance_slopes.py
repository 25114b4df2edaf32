"""Peaks of the links' compliance and their slopes by every gain: against differences, fine grids, and one resonance by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest

import gainroom as gr
from draws import draw_plant
from gainroom.analysis.dynamic_stiffness import peaks, stiffness_of
from gainroom.design.compliance_slopes import DirectedCompliance
from gainroom.design.margin_slopes import moved

DRIVE = gr.Drive(4000.0, 0.9, 2e-3)


def of_joints(plant, feedback="motor", step=None, **filters):
    """Compliance of each joint of a plant with PD gains (3, n), and its loop with these gains."""
    size = plant.size

    def loop(gains):
        return gr.build_loop(plant, DRIVE, gr.PD(gains[0], gains[1], **filters), feedback=feedback, sample_time=step)

    return DirectedCompliance(loop(np.ones((3, size))), np.eye(size), np.eye(size), np.zeros(size, dtype=bool)), loop


def along_tasks(plant, rng, cascade, step):
    """Compliance along directions across the joints of a plant, some of them P/PI, and the controller of n joints with gains (3, m)."""
    from gainroom.robot.tasks import TaskPPI

    size, count = plant.size, len(cascade)
    jacobian = np.linalg.qr(rng.normal(size=(size, size)))[0][:count]
    torque = np.linalg.solve(plant.link_inverse_inertia + 0.1 * np.eye(size), jacobian.T)

    def controller(gains):
        kp, kd, ki = gains
        if not cascade.any():
            return gr.PD((torque * kp) @ jacobian, (torque * kd) @ jacobian)
        return TaskPPI(kp=np.where(cascade, kp, kp / kd), kv=kd, ki=ki, torque=torque, jacobian=jacobian)

    def loop(gains):
        return gr.build_loop(plant, DRIVE, controller(gains), sample_time=step)

    return DirectedCompliance(loop(np.ones((3, count))), torque, jacobian, cascade), loop


def assert_slopes_are_differences(links, gains, rng):
    """Central differences of ln |c| at frequencies between and at its peaks."""
    size, step = gains.shape[1], 1e-4
    omega = np.exp(rng.uniform(math.log(2.0), math.log(600.0), 20))
    direction = rng.integers(0, size, 20)
    slope = links.slopes(omega, direction, gains)
    cascade = links.cascade
    for place in np.ndindex(2, size):
        way = np.zeros((2, size))
        way[place] = step
        more, less = (np.log(np.abs(links.along(omega, moved(gains, sign * way, cascade))))[np.arange(20), direction] for sign in (1, -1))
        # the third derivative over six times the step squared: 1e-8 for slopes that change over a tenth of an e-fold
        np.testing.assert_allclose(slope[:, place[0], place[1]], (more - less) / (2 * step), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("feedback", ["motor", "link"])
@pytest.mark.parametrize("step", [None, 1e-3])
@pytest.mark.parametrize("kind", ["elastic", "rigid", "mixed", "heavy"])
def test_slopes_by_gains_of_joints(feedback, step, kind):
    rng = np.random.default_rng(5)
    for size in (1, 2, 5):
        plant = draw_plant(rng, size)
        if kind in ("rigid", "mixed"):
            rigid = np.full(size, True) if kind == "rigid" else np.arange(size) % 2 == 0
            plant = replace(plant, stiffness=np.where(rigid, np.inf, plant.stiffness), damping=np.where(rigid, 0.0, plant.damping))
        if kind == "heavy":
            pull = rng.normal(size=(size, size))
            plant = replace(plant, gravity_stiffness=5 * (pull + pull.T), link_viscous=rng.uniform(0, 2, size))
        links, _ = of_joints(plant, feedback, step, velocity_filter=gr.LowPass(800.0, 1))
        gains = np.array([rng.uniform(20, 90, size), rng.uniform(1, 4, size), np.zeros(size)])
        assert_slopes_are_differences(links, gains, rng)


@pytest.mark.parametrize("step", [None, 1e-3])
@pytest.mark.parametrize("cascade", [(False, False, False), (True, False, True), (True, True)])
def test_slopes_by_gains_of_tasks(step, cascade):
    rng = np.random.default_rng(6)
    plant = draw_plant(rng, 4)
    links, _ = along_tasks(plant, rng, np.array(cascade), step)
    count = len(cascade)
    mixed = np.array(cascade)
    gains = np.array([np.where(mixed, rng.uniform(3, 9, count), rng.uniform(20, 90, count)), rng.uniform(4, 9, count), 20.0 * mixed])
    assert_slopes_are_differences(links, gains, rng)


@pytest.mark.parametrize("feedback", ["motor", "link"])
def test_compliance_along_joints_is_that_of_the_loop(feedback):
    """Peaks of stable random machines against those that the loop's roots lead to."""
    rng = np.random.default_rng(7)
    for size in (2, 4):
        plant = draw_plant(rng, size)
        links, loop = of_joints(plant, feedback, 5e-4)
        gains = np.array([np.full(size, 30.0), np.full(size, 2.0), np.zeros(size)])
        while not gr.is_stable(loop(gains)):
            gains = gains * [[0.3], [0.6], [1.0]]
        found = links.peaks(gains)
        exact = stiffness_of(loop(gains), stable=True)
        np.testing.assert_allclose(found.softest(size)[0], exact.stiffness, rtol=1e-3)  # what two parabolas between samples 6 % apart leave


def test_peaks_of_a_task_space_that_is_the_joint_space():
    """Directions that are the joints, given as tasks: peaks and slopes of the joints."""
    rng = np.random.default_rng(8)
    plant = draw_plant(rng, 3)
    turn = np.eye(3)[[1, 2, 0]]
    links, loop = of_joints(plant, "motor", 5e-4)
    across = DirectedCompliance(loop(np.ones((3, 3))), turn.T, turn, np.zeros(3, dtype=bool))
    gains = np.array([[20.0, 30.0, 40.0], [1.0, 2.0, 3.0], [0.0, 0.0, 0.0]])
    omega, order = np.array([3.0, 30.0, 120.0]), [1, 2, 0]
    np.testing.assert_allclose(across.along(omega, gains[:, order]), links.along(omega, gains)[:, order], rtol=1e-10)
    own = links.slopes(omega, np.array([0, 1, 2]), gains)
    np.testing.assert_allclose(across.slopes(omega, np.array([2, 0, 1]), gains[:, order]), own[:, :, order], rtol=1e-9, atol=1e-12)


def test_only_what_a_load_moves_and_a_gain_holds_has_peaks():
    plant = gr.Plant(np.diag([1.0, 0.0, 2.0]), np.full(3, 0.1), np.full(3, 1e3), np.full(3, 1.0))
    links, _ = of_joints(plant)
    gains = np.array([[50.0, 50.0, 0.0], [3.0, 3.0, 3.0], [0.0, 0.0, 0.0]])
    assert links.held(gains).tolist() == [True, False, False]
    found = links.peaks(gains)
    assert set(found.direction.tolist()) == {0}
    assert np.isnan(found.softest(3)[0]).tolist() == [False, True, True]


def test_a_gearbox_limits_what_no_gain_moves():
    """Link on a soft gearbox of a motor 1000 times as heavy: its peak is that of the link on K and B alone, 1/(B ω) for light B."""
    joint = gr.ElasticJoint(motor_inertia=100.0, link_inertia=0.1, stiffness=1e3, damping=0.1)
    links, _ = of_joints(joint.plant())
    stiffness, _, limited = links.peaks(np.array([[2e4], [300.0], [0.0]])).softest(1)
    assert limited[0]
    assert stiffness[0] == pytest.approx(0.1 * math.sqrt(1e3 / 0.1), rel=0.01)  # the motor yields by its inertia's share
    light, _ = of_joints(replace(joint, motor_inertia=1.0).plant())
    assert not light.peaks(np.array([[200.0], [20.0], [0.0]])).softest(1)[2][0]


@pytest.mark.parametrize("damping", [1e-4, 1e-3, 1e-2, 0.1])
@pytest.mark.parametrize("where", [10.0, 10.13, 10.28])
def test_a_resonance_between_samples(damping, where):
    """1/(ω₀² − ω² + 2jζω₀ω), its largest value 1/(2ζ√(1 − ζ²)ω₀²) at ω₀√(1 − 2ζ²), from samples 6 % apart."""

    def response(omega):
        return (1 / (where**2 - omega**2 + 2j * damping * where * omega))[:, None]

    found = peaks(response, np.geomspace(1.0, 100.0, 80))
    k = int(np.argmax(found.height))
    assert found.omega[k] == pytest.approx(where * math.sqrt(1 - 2 * damping**2), rel=1e-5 * (1 + damping))
    assert found.height[k] == pytest.approx(1 / (2 * damping * math.sqrt(1 - damping**2) * where**2), rel=1e-9)
