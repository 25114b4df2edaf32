"""Dynamic stiffness of the links: against equations of motion solved whole, exact sampling, fine grids and published designs."""

import math

import numpy as np
import pytest
from scipy.linalg import block_diag, expm

import gainroom as gr
from gainroom.analysis import dynamic_stiffness as module
from gainroom.analysis.link_compliance import LinkCompliance
from gainroom.robot.linearize import linearize
from robot_truths import actuators, biped_posture, feet

WIDE = (4000.0, 0.9)  # bandwidth [rad/s] and damping ratio of the current loops

ELBOW = {"motor_inertia": 0.448, "link_inertia": 0.35, "stiffness": 900.0, "damping": 0.0}
FIG9 = {"motor_inertia": 1.0, "link_inertia": 16.0, "stiffness": 1e4, "damping": 1.0}
TESTBED = {"motor_inertia": 0.2, "link_inertia": 0.8, "stiffness": 1e4, "damping": 1.0}


def one_joint(joint, delay, rate, kp, kd, feedback="motor"):
    drive = gr.Drive(*WIDE, delay=delay)
    step = 1 / rate if rate else None
    return gr.build_loop(gr.ElasticJoint(**joint), drive, gr.PD(kp=kp, kd=kd), feedback=feedback, sample_time=step)


def torque_per_position(s, kp, kd, delay, step):
    """What a PD puts on a motor per measured position (k,): current loop, delay, hold and backward difference."""
    bandwidth, damping = WIDE
    current = bandwidth**2 / (s * s + 2 * damping * bandwidth * s + bandwidth**2)
    if step is None:
        return (kp + kd * s) * current * np.exp(-s * delay)
    hold = (1 - np.exp(-s * step)) / (s * step)
    return (kp + kd * (1 - np.exp(-s * step)) / step) * hold * current * np.exp(-s * delay)


def held(s, step):
    return 1.0 if step is None else np.abs((1 - np.exp(-s * step)) / (s * step))


@pytest.mark.parametrize(
    ("joint", "delay", "rate", "kp", "kd", "milliradians", "damping"),
    [
        (ELBOW, 3e-3, 1000, 2544, 49.9, 8.49, 0.09),
        (ELBOW, 3e-3, 1000, 628, 37.9, 2.70, 0.36),
        (ELBOW, 5e-3, 1000, 1115, 28.5, 5.30, 0.20),
        (ELBOW, 5e-3, 1000, 585, 37.4, 2.83, 0.37),
        (FIG9, 2e-3, 2000, 4896, 207, 0.81, 0.19),
        (FIG9, 2e-3, 2000, 2758, 219, 0.68, 0.36),
        (TESTBED, 2.5e-3, None, 1056, 22.1, 2.00, 0.13),
        (TESTBED, 2.5e-3, None, 883, 26.0, 1.76, 0.16),
    ],
)
def test_designs_computed_elsewhere(joint, delay, rate, kp, kd, milliradians, damping):
    """Peak compliance [mrad/(N m)] and least damping ratio of two designs each, worked out by another program that takes hold and
    difference as one sample of delay; its gains have three digits, which move a sharp peak by up to 2 %."""
    found = gr.dynamic_stiffness(one_joint(joint, delay, rate, kp, kd))
    assert 1e3 / found.stiffness[0] == pytest.approx(milliradians, rel=0.02)
    assert found.damping_ratio == pytest.approx(damping, abs=0.012)


def machine(rng, size):
    """Random machine of `size` joints, as links' inertia matrix (n, n) and a Plant of it, with gravity and friction of the links."""
    root = rng.normal(size=(size, size))
    inertia = root @ root.T + size * 0.1 * np.eye(size)
    pull = rng.normal(size=(size, size)) * 5
    gravity = pull + pull.T
    plant = gr.Plant(
        link_inverse_inertia=np.linalg.inv(inertia),
        motor_inertia=rng.uniform(0.05, 2.0, size),
        stiffness=rng.uniform(500.0, 2e4, size),
        damping=rng.uniform(0.0, 5.0, size),
        motor_viscous=rng.uniform(0.0, 2.0, size),
        link_viscous=rng.uniform(0.0, 2.0, size),
        gravity_stiffness=gravity,
    )
    return inertia, plant


@pytest.mark.parametrize("feedback", ["motor", "link"])
@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("step", [None, 1e-3])
def test_response_of_equations_of_motion(feedback, coupled, step):
    """C of link_compliance against the equations of motors and links, 2n unknowns, solved with the links' inertia matrix itself."""
    rng = np.random.default_rng(7)
    for size in (1, 2, 4):
        inertia, plant = machine(rng, size)
        delay = 2e-3
        if coupled:
            kp, kd = (part @ part.T + scale * np.eye(size) for part, scale in ((rng.normal(size=(size, size)), 300.0),) * 2)
            kd = kd / 20
        else:
            kp, kd = np.diag(rng.uniform(200, 900, size)), np.diag(rng.uniform(5, 20, size))
        given = (kp, kd) if coupled or size == 1 else (np.diag(kp), np.diag(kd))
        given = (float(kp[0, 0]), float(kd[0, 0])) if size == 1 else given
        loop = gr.build_loop(plant, gr.Drive(*WIDE, delay=delay), gr.PD(*given), feedback=feedback, sample_time=step)
        links = LinkCompliance.of(loop)
        omega = np.geomspace(0.01, 3000.0, 60)
        s = 1j * omega
        found = links.at(s, links.feedback(s, loop.parts.controller))
        for at, c in zip(s, found, strict=True):
            fed = kp * torque_per_position(at, 1.0, 0.0, delay, step) + kd * torque_per_position(at, 0.0, 1.0, delay, step)
            k = np.diag(plant.stiffness + at * plant.damping)
            motors = np.diag(plant.motor_inertia * at**2 + plant.motor_viscous * at) + k
            links_side = inertia * at**2 + np.diag(plant.link_viscous * at) + plant.gravity_stiffness + k
            at_motors, at_links = (fed, 0 * fed) if feedback == "motor" else (0 * fed, fed)
            whole = np.block([[motors + at_motors, -k + at_links], [-k, links_side]])
            right = np.linalg.solve(whole, np.vstack([np.zeros((size, size)), np.eye(size)]))[size:] * held(at, step)
            assert np.abs(c - right).max() <= 1e-8 * np.abs(right).max()  # solutions by two orders of elimination, conditions of 1e6
        if size == 1:
            alone = links.of_one(s, links.feedback(s, loop.parts.controller)[:, 0, 0])
            assert alone == pytest.approx(found[:, 0, 0], rel=1e-9)


@pytest.mark.parametrize("soles", [("left_sole", "right_sole"), ("left_sole",), ()])
def test_a_biped_without_its_inverse(body, soles):
    """C of a floating base on its contacts, against base, joints, motors and contact forces as one system, whose W is never formed."""
    model = linearize(body, actuators(12), biped_posture(body), feet(*soles))
    size, step, delay = model.size, 5e-4, 2e-3
    rng = np.random.default_rng(1)
    kp, kd = rng.uniform(2000, 8000, size), rng.uniform(100, 250, size)
    loop = gr.build_loop(model, gr.Drive(*WIDE, delay=delay), gr.PD(kp, kd), sample_time=step)
    links = LinkCompliance.of(loop)
    inertia, joints = model.inertia, model.selection
    contacts = 1e5 * model.contact_jacobian  # in the size of the other rows: forces in units of 1e5 N
    count, held_by = len(inertia), len(contacts)
    for omega in np.geomspace(0.5, 3000.0, 25):
        at = 1j * omega
        fed = np.diag(kp * torque_per_position(at, 1.0, 0.0, delay, step) + kd * torque_per_position(at, 0.0, 1.0, delay, step))
        k = np.diag(model.stiffness + at * model.damping)
        whole = np.zeros((count + size + held_by,) * 2, complex)
        whole[:count, :count] = inertia * at**2 + joints.T @ k @ joints
        whole[:count, count : count + size], whole[:count, count + size :] = -joints.T @ k, -contacts.T
        whole[count : count + size, :count] = -k @ joints
        whole[count : count + size, count : count + size] = np.diag(model.motor_inertia * at**2) + fed + k
        whole[count + size :, :count] = contacts
        load = np.vstack([joints.T, np.zeros((size + held_by, size))])
        right = joints @ np.linalg.lstsq(whole, load, rcond=None)[0][:count] * held(at, step)
        found = links.at(np.array([at]), links.feedback(np.array([at]), loop.parts.controller))[0]
        assert np.abs(found - right).max() <= 1e-7 * np.abs(right).max()  # contacts as constraints: conditions of 1e9


def exactly_sampled(joint, ticks, step, kp, kd, omega):
    """|q/τ_L| (k,) of one joint sampled exactly: torque and load held, the current loop and the joint by a matrix exponential."""
    bandwidth, damping = WIDE
    a = np.zeros((6, 6))  # current loop (2), motor and link position and speed
    a[0, 1], a[1, :2] = 1.0, (-(bandwidth**2), -2 * damping * bandwidth)
    k, b, motor, link = joint["stiffness"], joint["damping"], joint["motor_inertia"], joint["link_inertia"]
    a[2, 4] = a[3, 5] = 1.0
    a[4] = np.array([1, 0, -k, k, -b, b]) / motor
    a[5] = np.array([0, 0, k, -k, b, -b]) / link
    inputs = np.zeros((6, 2))
    inputs[1, 0], inputs[5, 1] = bandwidth**2, 1 / link
    step_of = expm(np.block([[a, inputs], [np.zeros((2, 8))]]) * step)
    flow, pushed = step_of[:6, :6], step_of[:6, 6:]
    z = np.exp(1j * omega * step)
    found = []
    for one in z:
        law = (kp + kd * (1 - 1 / one) / step) * one**-ticks
        closed = flow - pushed[:, :1] @ (law * np.eye(6)[2:3])
        found.append(np.linalg.solve(one * np.eye(6) - closed, pushed[:, 1])[3])
    return np.abs(np.array(found))


def test_exact_sampling():
    """Peaks of the fundamental against exactly sampled joints: what the module says of its alias terms, 1.2e-4 where ω T_s is below 1."""
    rng = np.random.default_rng(5)
    seen = 0
    while seen < 12:
        joint = {
            "motor_inertia": rng.uniform(0.1, 1.0),
            "link_inertia": 1.0,
            "stiffness": 10 ** rng.uniform(2.5, 4.5),
            "damping": rng.uniform(0, 2),
        }
        step, ticks = rng.choice([1e-3, 2e-3]), int(rng.integers(1, 5))
        mode = math.sqrt(joint["stiffness"])
        kp, kd = rng.uniform(0.1, 1.0) * joint["stiffness"], rng.uniform(0.1, 0.5) * mode
        found = gr.dynamic_stiffness(one_joint(joint, ticks * step, 1 / step, kp, kd))
        if math.isnan(found.stiffness[0]):
            continue
        seen += 1
        near = found.omega[0] * np.linspace(0.97, 1.03, 41) if found.omega[0] else np.geomspace(1e-3, 1.0, 5)
        assert exactly_sampled(joint, ticks, step, kp, kd, near).max() == pytest.approx(1 / found.stiffness[0], rel=3e-4)


@pytest.mark.slow
def test_peaks_on_random_joints_against_fine_grids():
    """Peaks of 200 random stable joints against 60,000 frequencies each: never below a sample, and above the highest by no more than
    what the grid's spacing can miss of a peak of that damping, (spacing/2ζ)²."""
    rng = np.random.default_rng(11)
    omega = np.geomspace(1e-2, 1e4, 60_000)
    spacing = omega[1] / omega[0] - 1
    seen = 0
    while seen < 200:
        link, ratio = 1.0, 10 ** rng.uniform(-1, 1.5)
        joint = {"motor_inertia": link / ratio, "link_inertia": link}
        mode = 2 * math.pi * 10 ** rng.uniform(0.5, 2)
        joint |= {"stiffness": mode**2 / (1 + ratio), "damping": 2 * rng.uniform(0.002, 0.05) * mode / (1 + ratio)}
        delay, step = rng.uniform(5e-4, 1e-2), rng.choice([None, 1e-3])
        crossing = rng.uniform(0.05, 0.4) / delay
        kp, kd = (joint["motor_inertia"] + 0.1) * crossing**2, (joint["motor_inertia"] + 0.1) * crossing
        loop = one_joint(joint, delay, None if step is None else 1 / step, kp, kd)
        if not gr.is_stable(loop):
            continue
        seen += 1
        found = gr.dynamic_stiffness(loop)
        s = 1j * (omega if step is None else omega[omega < math.pi / step])
        spring = joint["stiffness"] + s * joint["damping"]
        motor = joint["motor_inertia"] * s * s + torque_per_position(s, kp, kd, delay, step) + spring
        grid = np.abs(motor / (motor * (link * s * s + spring) - spring**2)) * held(s, step)
        missed = (spacing / 2 / found.damping_ratio) ** 2
        # a peak is sampled until it is within 1e-3 of its parabola, whose own error is the square of that
        assert grid.max() * (1 - 1e-6) <= 1 / found.stiffness[0] <= grid.max() * (1 + missed + 1e-6)


def test_peaks_of_coupled_machines_against_fine_grids():
    rng = np.random.default_rng(13)
    omega = np.geomspace(1e-2, 3e3, 20_000)
    for size in (2, 3):
        _, plant = machine(rng, size)
        plant = gr.Plant(plant.link_inverse_inertia, plant.motor_inertia, plant.stiffness, plant.damping)
        loop = gr.build_loop(plant, gr.Drive(*WIDE, delay=1e-3), gr.PD(np.full(size, 150.0), np.full(size, 6.0)))
        found = gr.dynamic_stiffness(loop)
        links = LinkCompliance.of(loop)
        samples = np.abs(np.diagonal(links.at(1j * omega, links.feedback(1j * omega, loop.parts.controller)), axis1=1, axis2=2))
        assert 1 / found.stiffness == pytest.approx(samples.max(axis=0), rel=1e-4)  # spacing 6e-4 and damping ratios above 0.03
        assert np.all(1 / found.stiffness >= samples.max(axis=0) * (1 - 1e-9))


def test_static_stiffness_is_that_of_two_springs_in_series():
    found = gr.dynamic_stiffness(one_joint(TESTBED, 1e-4, None, 50.0, 30.0))
    assert found.static[0] == pytest.approx(1 / (1 / 50 + 1 / 1e4), rel=1e-5)  # read at a thousandth of the slowest root
    assert found.omega[0] == 0
    assert found.stiffness[0] == pytest.approx(found.static[0], rel=1e-5)


def test_integral_action_leaves_the_gearbox_alone_at_rest():
    joint = gr.ElasticJoint(**TESTBED)
    loop = gr.build_loop(joint, gr.Drive(*WIDE, delay=1e-3), gr.PID(kp=300.0, ki=300.0, kd=20.0))
    assert gr.dynamic_stiffness(loop).static[0] == pytest.approx(
        1e4, rel=0.2
    )  # K, which ki/s exceeds a hundredfold at the lowest frequency


def test_edges():
    """Unstable: unknown. Nothing holds the joint: 0. A link that nothing moves: no end."""
    assert math.isnan(gr.dynamic_stiffness(one_joint(TESTBED, 2.5e-3, None, 1e4, 300.0)).stiffness[0])
    loose = gr.dynamic_stiffness(one_joint(TESTBED, 2.5e-3, None, 0.0, 10.0))
    assert loose.stiffness[0] == 0 == loose.static[0]
    locked = gr.build_loop(gr.ElasticJoint(0.2, math.inf, 1e4, 1.0), gr.Drive(), gr.PD(100.0, 10.0))
    assert gr.dynamic_stiffness(locked).stiffness[0] == math.inf
    with pytest.raises(gr.GainroomError, match="has no link"):
        gr.dynamic_stiffness(gr.loop_from(lambda s: 1 / (s + 1)))


def test_kd_on_the_drive():
    """With equal rates and delays of both paths the loop is that of one path; with kd closed early, the link is damped more."""
    joint, drive, gains = gr.ElasticJoint(**FIG9), gr.Drive(*WIDE, delay=2e-3), gr.PD(2758.0, 219.0)
    one = gr.dynamic_stiffness(gr.build_loop(joint, drive, gains, sample_time=5e-4))
    same = gr.dynamic_stiffness(gr.build_loop(joint, drive, gains, sample_time=5e-4, kd_path=gr.GainPath(2e-3, 5e-4)))
    early = gr.dynamic_stiffness(gr.build_loop(joint, drive, gains, sample_time=5e-4, kd_path=gr.GainPath(1e-4, 5e-5)))
    assert same.stiffness == pytest.approx(one.stiffness, rel=1e-9)
    assert same.damping_ratio == pytest.approx(one.damping_ratio, rel=1e-6)
    assert early.damping_ratio > one.damping_ratio


def test_least_damping_of_coupled_machines_by_eigenvalues():
    """Least damping ratio of a sampled machine against eigenvalues of its matrices, put together here: whole ticks of delay as states."""
    rng = np.random.default_rng(3)
    size, step, ticks = 2, 1e-3, 2
    inertia, plant = machine(rng, size)
    plant = gr.Plant(plant.link_inverse_inertia, plant.motor_inertia, plant.stiffness, plant.damping)
    kp, kd = np.full(size, 150.0), np.full(size, 6.0)
    found = gr.dynamic_stiffness(gr.build_loop(plant, gr.Drive(delay=ticks * step), gr.PD(kp, kd), sample_time=step))
    k, b = np.diag(plant.stiffness), np.diag(plant.damping)
    inverse = block_diag(np.diag(1 / plant.motor_inertia), np.linalg.inv(inertia))
    springs, dampers = np.block([[k, -k], [-k, k]]), np.block([[b, -b], [-b, b]])
    a = np.block([[np.zeros((4, 4)), np.eye(4)], [-inverse @ springs, -inverse @ dampers]])
    push = np.vstack([np.zeros((4, size)), inverse[:, :size]])
    whole = expm(np.block([[a, push], [np.zeros((size, 8 + size))]]) * step)
    # states: plant (8), last motor positions (2), torques on their way (2, 2)
    closed = np.zeros((14, 14))
    closed[:8, :8], closed[:8, 10:12] = whole[:8, :8], whole[:8, 8:]
    closed[8:10, :2] = np.eye(2)
    closed[10:12, 12:14] = np.eye(2)
    closed[12:14, :2], closed[12:14, 8:10] = -np.diag(kp + kd / step), np.diag(kd / step)
    s = np.log(np.linalg.eigvals(closed).astype(complex)) / step
    most = 1.5 * math.sqrt(np.linalg.eigvals(inverse @ springs).real.max())
    s = s[(s.imag > 0) & (s.imag < 0.999 * math.pi / step) & (np.abs(s) <= most)]
    assert found.damping_ratio == pytest.approx((-s.real / np.abs(s)).min(), rel=1e-6)


def test_at_the_resonance_of_an_undamped_motor_on_its_spring_the_link_of_a_link_side_encoder_does_not_move():
    """1 + J_m s²/K is 0 to the last digit at ω = 2 rad/s, and the compliance with it."""
    joint, drive = gr.ElasticJoint(motor_inertia=1.0, link_inertia=3.0, stiffness=4.0), gr.Drive(delay=1e-3)
    links = LinkCompliance.of(gr.build_loop(joint, drive, gr.PD(0.5, 0.1), feedback="link"))
    s = np.array([2j])
    fed = links.feedback(s, gr.PD(0.5, 0.1))
    for found in (links.of_one(s, fed[:, 0, 0])[0], links.at(s, fed)[0, 0, 0]):
        assert abs(found) < 1e-10


def test_roots_at_rest_are_no_vibration(monkeypatch):
    """Two roots at 0, of a motion that drifts, are a pair of any damping ratio for an eigenvalue problem, 1e-8 of the largest."""
    joint = gr.ElasticJoint(motor_inertia=0.2, link_inertia=0.8, stiffness=1e4, damping=1.0)
    loop = gr.build_loop(joint, gr.Drive(4000.0, 0.9, 2e-3), gr.PD(50.0, 5.0), sample_time=1e-3)
    monkeypatch.setattr(module, "roots_within", lambda loop, most: np.array([3e-6 + 2e-6j, -10.0 + 258.0j]))
    assert module.vibrations(loop).tolist() == [-10.0 + 258.0j]
