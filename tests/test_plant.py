"""The plant against the Z-formula and the textbook's block form, and its limits."""

from dataclasses import replace
from math import inf, sqrt

import numpy as np
import pytest

import gainroom as gr
from draws import draw_joint, draw_plant
from gainroom.analysis.loop_samples import joint_loops
from refusals import assert_refused

S_POINTS = np.array([1j * w for w in (0.3, 5.0, 80.0, 400.0, 3000.0)] + [3.0 + 40j, -2.0 + 90j])


def from_mechanism(plant: gr.Plant, s: complex) -> tuple[np.ndarray, np.ndarray]:
    """(P_M, P_L) of the second-order form, (n, n) each."""
    form = plant.mechanism()
    states = np.linalg.solve(s * s * form.mass + s * form.damping + form.stiffness, form.force.astype(complex))
    return form.motor_position @ states, form.link_position @ states


def z_formula(plant: gr.Plant, s: complex) -> tuple[np.ndarray, np.ndarray]:
    """P_M = (1/s²) Z (I + J_m Z)⁻¹ and P_L = (1/s²) W (I + J_m Z)⁻¹ with Z = W + s² diag(1/k), without friction and gravity."""
    w, motor = plant.link_inverse_inertia, np.diag(plant.motor_inertia)
    with np.errstate(invalid="ignore"):
        compliance = np.where(plant.elastic, 1 / (plant.stiffness + s * plant.damping), 0.0)
    admittance = w + s * s * np.diag(compliance)
    inner = np.linalg.inv(np.eye(plant.size) + motor @ admittance)
    return admittance @ inner / s**2, w @ inner / s**2


def torque_balance(plant: gr.Plant, s: complex) -> tuple[np.ndarray, np.ndarray]:
    """(P_M, P_L) from the equations of motion in the joint torques τ_J, which also rigid joints have; singular W is no case of its own.

    q = H τ_J with (s² I + W (D_l s + G)) q = W τ_J;  θ = q + τ_J/k;  (J_m s² + D_m s) θ + τ_J = τ_m
    """
    w, eye = plant.link_inverse_inertia, np.eye(plant.size)
    gravity = np.zeros_like(w) if plant.gravity_stiffness is None else plant.gravity_stiffness
    links = np.linalg.solve(s * s * eye + w @ (s * np.diag(plant.link_viscous) + gravity), w.astype(complex))
    with np.errstate(invalid="ignore"):
        compliance = np.where(plant.elastic, 1 / (plant.stiffness + s * plant.damping), 0.0)
    motors = links + np.diag(compliance)
    torque = np.linalg.inv(np.diag(plant.motor_inertia * s * s + plant.motor_viscous * s) @ motors + eye)
    return motors @ torque, links @ torque


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.abs(found - expected).max() / np.abs(expected).max())


def rounding(plant: gr.Plant, s: complex) -> float:
    """A few ulp times the condition number of the mechanism's equations; that of the formulas is smaller."""
    form = plant.mechanism()
    return 30 * np.finfo(float).eps * np.linalg.cond(s * s * form.mass + s * form.damping + form.stiffness)


@pytest.mark.parametrize(
    ("size", "rank", "rigid"), [(1, None, 0), (1, None, 1), (3, None, 0), (3, None, 2), (6, 4, 0), (6, 4, 2), (12, 6, 5), (4, 2, 4)]
)
def test_z_formula(size, rank, rigid):
    rng = np.random.default_rng([1, size, rigid])
    plant = replace(draw_plant(rng, size, rank, rigid), motor_viscous=np.zeros(size), link_viscous=np.zeros(size))
    for s in S_POINTS:
        responses = [plant.response(s, side)[0] for side in ("motor", "link")]
        for found, response, expected in zip(from_mechanism(plant, s), responses, z_formula(plant, s), strict=True):
            assert relative(found, expected) < rounding(plant, s)
            assert relative(response, expected) < rounding(plant, s)


@pytest.mark.parametrize(("size", "rank", "rigid"), [(1, None, 0), (1, None, 1), (3, None, 1), (6, 4, 2), (12, 6, 3)])
def test_friction_and_gravity(size, rank, rigid):
    plant = draw_plant(np.random.default_rng([2, size, rigid]), size, rank, rigid, gravity=True)
    for s in S_POINTS:
        for found, expected in zip(from_mechanism(plant, s), torque_balance(plant, s), strict=True):
            assert relative(found, expected) < rounding(plant, s)


@pytest.mark.parametrize(("size", "rank"), [(2, 1), (6, 4), (12, 6)])
def test_gravity_on_a_closed_chain_settles_at_its_static_balance(size, rank):
    """Torques hold the weight G on the motions R that the contacts leave, and wind up gearboxes: R (Rᵀ G R)⁻¹ Rᵀ + 1/K as s → 0."""
    rng = np.random.default_rng([20, size])
    free, half = rng.normal(size=(size, rank)), rng.normal(size=(size, size))
    weight, stiffness = 300 * (half @ half.T + np.eye(size)), rng.uniform(4e3, 2e4, size)
    plant = gr.Plant(free @ free.T, np.full(size, 0.5), stiffness, np.full(size, 2.0), gravity_stiffness=weight)
    still = free @ np.linalg.solve(free.T @ weight @ free, free.T) + np.diag(1 / stiffness)
    for s in (1e-4j, 1e-6j, 1e-9j):
        # by s² and s B/K² off rest, and by the round-off of W's factor
        assert relative(plant.response([s], "motor")[0], still) < 1e-6


def test_textbook_block_form():
    """M_q q̈ = K(θ − q) + …, J_m θ̈ = τ − K(θ − q) − …, with the link inertia matrix M_q = W⁻¹ (Spong 1987)."""
    plant = draw_plant(np.random.default_rng(3), 5, gravity=True)
    mass = np.linalg.inv(plant.link_inverse_inertia)
    spring, damper = np.diag(plant.stiffness), np.diag(plant.damping)
    for s in S_POINTS:
        k = spring + s * damper
        links = mass * s * s + np.diag(plant.link_viscous) * s + plant.gravity_stiffness + k
        motors = np.diag(plant.motor_inertia) * s * s + np.diag(plant.motor_viscous) * s + k
        block = np.block([[links, -k], [-k, motors]])
        positions = np.linalg.solve(block, np.vstack([np.zeros((5, 5)), np.eye(5)]))
        both_sides = rounding(plant, s) + 30 * np.finfo(float).eps * np.linalg.cond(block)
        motor_side, link_side = from_mechanism(plant, s)
        assert relative(motor_side, positions[5:]) < both_sides
        assert relative(link_side, positions[:5]) < both_sides


def test_one_joint_is_equation_two():
    """P_M = (J_L s² + B s + K)/(s² (J_M J_L s² + (J_M + J_L)(B s + K)))."""
    joint = gr.ElasticJoint(0.2, 0.8, 1e4, 1.5)
    for s in S_POINTS:
        spring = 1.5 * s + 1e4
        below = s * s * (0.16 * s * s + spring)
        motor_side, link_side = from_mechanism(joint.plant(), s)
        assert motor_side[0, 0] == pytest.approx((0.8 * s * s + spring) / below, rel=rounding(joint.plant(), s))
        assert link_side[0, 0] == pytest.approx(spring / below, rel=rounding(joint.plant(), s))


def test_resonances():
    joint = gr.ElasticJoint(1.0, 16.0, 1e4, 0.0)
    assert joint.antiresonance == pytest.approx(25.0, rel=1e-15)
    assert joint.resonance == pytest.approx(sqrt(1e4 * 17 / 16), rel=1e-15)
    motor_side, _ = from_mechanism(joint.plant(), 1j * joint.antiresonance)
    assert abs(motor_side[0, 0]) < 1e-15  # at rest; elsewhere of order 1/(J ω²) = 1e-4
    rigid = gr.ElasticJoint(1.0, 16.0)
    assert (rigid.resonance, rigid.antiresonance) == (inf, inf)
    assert gr.ElasticJoint(1.0, inf, 1e4).antiresonance == 0.0
    assert gr.ElasticJoint(1.0, inf, 1e4).resonance == pytest.approx(100.0, rel=1e-15)


def test_from_motor_reflects_the_rotor():
    joint = gr.ElasticJoint.from_motor(rotor_inertia=1e-4, gear_ratio=100, link_inertia=16.0, stiffness=1e4, damping=1.0)
    assert joint == gr.ElasticJoint(1e-4 * 100**2, 16.0, 1e4, 1.0)


def test_stiff_tends_to_rigid():
    """1/k enters Z next to W, as s²/k to 1/J_L: 1e-12·(400²)·J_L here."""
    rigid, stiff = gr.ElasticJoint(0.2, 0.8).plant(), gr.ElasticJoint(0.2, 0.8, 1e12).plant()
    for s in S_POINTS[:4]:
        for found, expected in zip(from_mechanism(stiff, s), from_mechanism(rigid, s), strict=True):
            assert relative(found, expected) < 2 * abs(s * s) * 0.8 / 1e12 + rounding(stiff, s)


def test_heavy_link_tends_to_locked():
    locked, heavy = gr.ElasticJoint(0.2, inf, 1e4, 1.0).plant(), gr.ElasticJoint(0.2, 1e12, 1e4, 1.0).plant()
    for s in S_POINTS[1:]:
        expected = 1 / (0.2 * s * s + 1.0 * s + 1e4)
        assert from_mechanism(locked, s)[0][0, 0] == pytest.approx(expected, rel=rounding(locked, s))
        assert from_mechanism(heavy, s)[0][0, 0] == pytest.approx(expected, rel=1e-7)  # K/(J_L s²) ≤ 4e-10, times K/(J_M s²) ≤ 2e3


@pytest.mark.parametrize("seed", range(5))
def test_reciprocity(seed):
    """Without gravity's asymmetry the motor admittance is symmetric (Betti)."""
    plant = draw_plant(np.random.default_rng([4, seed]), 5, 3, 2)
    for s in S_POINTS:
        motor_side, _ = from_mechanism(plant, s)
        assert np.abs(motor_side - motor_side.T).max() < rounding(plant, s) * np.abs(motor_side).max()


def test_the_order_of_joints_does_not_matter():
    rng = np.random.default_rng(5)
    plant, order = draw_plant(rng, 6, 4, 2), rng.permutation(6)
    mixed = gr.Plant(
        plant.link_inverse_inertia[np.ix_(order, order)],
        *(getattr(plant, name)[order] for name in ("motor_inertia", "stiffness", "damping", "motor_viscous", "link_viscous")),
    )
    for s in S_POINTS:
        for found, expected in zip(from_mechanism(mixed, s), from_mechanism(plant, s), strict=True):
            assert relative(found, expected[np.ix_(order, order)]) < rounding(plant, s)


def test_scalars_stand_for_every_joint():
    plant = gr.Plant(np.eye(3), 0.5, 1e4, 1.0)
    assert plant.motor_inertia.tolist() == [0.5] * 3
    assert plant.stiffness.tolist() == [1e4] * 3
    assert plant.joint_names == ("joint1", "joint2", "joint3")
    assert plant.size == 3


def test_plain_joint_has_positive_inertia_mechanism():
    for seed in range(20):
        form = draw_joint(np.random.default_rng([6, seed])).plant().mechanism()
        assert np.linalg.eigvalsh(form.mass)[0] > 0
        assert np.linalg.eigvalsh(form.damping)[0] > -1e-12 * np.abs(form.damping).max()  # rank one and rounding
        assert np.linalg.eigvalsh(form.stiffness)[0] > -1e-12 * np.abs(form.stiffness).max()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"motor_inertia": -1.0}, ["motor_inertia", "-1", "kg·m²", "> 0"]),
        ({"motor_inertia": 0.0}, ["motor_inertia", "0", "> 0"]),
        ({"link_inertia": 0.0}, ["link_inertia", "0", "> 0 or inf"]),
        ({"link_inertia": float("nan")}, ["link_inertia", "nan", "> 0"]),
        ({"stiffness": -5.0}, ["stiffness", "-5", "N·m/rad", "> 0"]),
        ({"stiffness": 0.0}, ["stiffness", "0", "> 0"]),
        ({"stiffness": None}, ["stiffness", "None", "> 0"]),
        ({"damping": -0.1}, ["damping", "-0.1", ">= 0"]),
        ({"damping": inf}, ["damping", "inf", ">= 0"]),
        ({"motor_viscous": -1.0}, ["motor_viscous", "-1", ">= 0"]),
        ({"link_viscous": -1.0}, ["link_viscous", "-1", ">= 0"]),
        ({"motor_inertia": "1.0"}, ["motor_inertia", "'1.0'", "number"]),
        ({"motor_inertia": True}, ["motor_inertia", "True", "number"]),
        ({"motor_inertia": [1.0]}, ["motor_inertia", "[1.0]", "number"]),
        ({"motor_inertia": 1j}, ["motor_inertia", "1j", "number"]),
    ],
)
def test_joint_errors(arguments, words):
    good = {"motor_inertia": 1.0, "link_inertia": 1.0, "stiffness": 1e4, "damping": 1.0, "name": "l_knee"}
    with pytest.raises(gr.GainroomError) as caught:
        gr.ElasticJoint(**{**good, **arguments})
    for word in ["l_knee", *words]:
        assert word in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("rotor", [-1e-4, 0.0])
def test_from_motor_errors(rotor):
    with pytest.raises(gr.GainroomError, match=r"rotor_inertia .* must be a number > 0"):
        gr.ElasticJoint.from_motor(rotor, 100, 1.0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"link_inverse_inertia": np.ones((2, 3))}, ["link_inverse_inertia", "(2, 3)", "square"]),
        ({"link_inverse_inertia": np.zeros((0, 0))}, ["link_inverse_inertia", "(0, 0)"]),
        ({"link_inverse_inertia": np.array([[1.0, 0.5], [0.0, 1.0]])}, ["link_inverse_inertia", "symmetric"]),
        ({"link_inverse_inertia": np.diag([1.0, -1.0])}, ["link_inverse_inertia", "negative eigenvalue"]),
        ({"link_inverse_inertia": np.diag([1.0, np.nan])}, ["link_inverse_inertia", "finite"]),
        ({"link_inverse_inertia": np.diag([np.nan] * 40)}, ["link_inverse_inertia", "finite"]),
        ({"motor_inertia": np.ones(3)}, ["motor_inertia", "(3,)", "2 numbers"]),
        ({"motor_inertia": np.array([1.0, 0.0])}, ["joint2", "motor_inertia", "0", "> 0"]),
        ({"motor_inertia": np.array([0.0, 0.0]), "stiffness": np.array([np.inf, 1e4])}, ["joint2", "motor_inertia", "elastic"]),
        ({"joint_names": ("hip",)}, ["1 joint_names", "2 joints"]),
        ({"stiffness": np.array([1e4, -1.0])}, ["joint2", "stiffness", "-1", "> 0"]),
        ({"gravity_stiffness": np.eye(3)}, ["gravity_stiffness", "(3, 3)", "(2, 2)"]),
    ],
)
def test_plant_errors(arguments, words):
    good = {"link_inverse_inertia": np.eye(2), "motor_inertia": np.ones(2), "stiffness": np.full(2, 1e4)}
    assert_refused(lambda: gr.Plant(**{**good, **arguments}), words)


def soft_plant() -> gr.Plant:
    """Two joints on a base that rests on three springs: W, W_c and W_cc from one positive definite matrix."""
    root = np.random.default_rng(8).normal(size=(5, 6))
    whole = root @ root.T / 5
    soft = gr.Compliance(whole[:2, 2:], whole[2:, 2:], np.array([3e4, 5e4, 800.0]), np.array([40.0, 10.0, 2.0]))
    return gr.Plant(whole[:2, :2], np.array([0.3, 0.8]), 1e4, 1.0, link_viscous=0.4, compliance=soft)


def test_springs_to_the_ground_are_the_equations_of_motion():
    """P_M from the second-order form, written out, against the response that eliminates the springs."""
    plant = soft_plant()
    for side, part in (("motor", 0), ("link", 1)):
        for point, found in zip(S_POINTS, plant.response(S_POINTS, side), strict=True):
            expected = from_mechanism(plant, point)[part]
            assert found == pytest.approx(expected, abs=1e-10 * np.abs(expected).max())


def test_stiff_springs_are_a_constraint():
    """K_c → ∞: W − W_c W_cc⁻¹ W_cᵀ, the projection of a rigid contact."""
    plant = soft_plant()
    soft = plant.compliance
    stiff = replace(plant, compliance=replace(soft, stiffness=1e14 * np.ones(3), damping=np.zeros(3)))
    projected = plant.link_inverse_inertia - soft.coupling @ np.linalg.solve(soft.inverse_inertia, soft.coupling.T)
    rigid = replace(plant, link_inverse_inertia=projected, compliance=None)
    s = 1j * np.array([3.0, 70.0, 400.0])
    # the springs give way by s²/(K_c W_cc), 1e-8 at most here
    assert stiff.response(s, "motor") == pytest.approx(rigid.response(s, "motor"), rel=1e-7)


@pytest.mark.parametrize("feedback", ["motor", "link"])
def test_one_joint_on_springs_is_not_taken_for_a_free_one(feedback):
    """The scalar loop of n = 1 against the plant's own response."""
    two = soft_plant()
    soft = two.compliance
    plant = gr.Plant(two.link_inverse_inertia[:1, :1], 0.3, 1e4, 1.0, compliance=replace(soft, coupling=soft.coupling[:1]))
    omega = np.array([3.0, 40.0, 300.0, 2000.0])
    loop = gr.build_loop(plant, gr.Drive(), gr.PD(1.0, 0.0), feedback=feedback)
    # zeros and poles come from eigenvalues: a few digits fewer than the response itself
    assert loop.response(omega) == pytest.approx(plant.response(1j * omega, feedback)[:, 0, 0], rel=1e-6)


@pytest.mark.parametrize("omega", [1e-9, 1e-6, 1e-3, 1.0, 1e3])
def test_what_a_contact_s_spring_holds_keeps_its_digits_at_rest(omega: float):
    """Joint 0 rests on a spring, joint 1 is free: (s² (M + J) + k(s) e eᵀ)⁻¹, whose row of the held joint is 1/ω² times less."""
    mass, motors, stiffness, damping = np.array([[2.0, 0.7], [0.7, 1.5]]), np.array([0.3, 0.1]), 5e5, 30.0
    links = np.linalg.inv(mass)
    soft = gr.Compliance(links[:, :1], links[:1, :1], np.array([stiffness]), np.array([damping]))
    plant = gr.Plant(links, motors, compliance=soft)
    whole, s = mass + np.diag(motors), 1j * omega
    held = 1 / (stiffness + s * damping + s**2 * (whole[0, 0] - whole[0, 1] ** 2 / whole[1, 1]))
    found = plant.response(s, "motor")[0]
    assert found[0, 0] == pytest.approx(held, rel=1e-12)
    looked = joint_loops(gr.build_loop(plant, gr.Drive(), gr.PD(np.ones(2), np.zeros(2))))
    assert looked.response(np.array([omega])).reshape(2, 2)[0, 0] == pytest.approx(held, rel=1e-12)
