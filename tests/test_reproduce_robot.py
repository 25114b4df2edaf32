"""Table I and claims 2 to 4 by other routes: equations of motion solved whole, dense grids, inertias summed link by link."""

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from gainroom.paper import Row, claim2, claim3, claim4, table1
from gainroom.paper.biped import COM_KD, COM_KP, MOVE, NAMES, START, biped, com_tasks, on_both_feet, standing, standing_so
from gainroom.paper.joints import DAMPING, DRIVE, MOTOR_INERTIA, STIFFNESS
from robot_truths import accelerations

OMEGA = np.geomspace(20.0, 3000.0, 12000)  # [rad/s] neighbours 4e-4 apart: crossings are interpolated to about 1e-6
KP, KD = 1e4, 300.0  # Fig. 9's gains


def drive(delay: float = DRIVE.delay) -> np.ndarray:
    """C(jω) e^{−jωT} over OMEGA."""
    s = 1j * OMEGA
    return DRIVE.bandwidth**2 / (s**2 + 2 * DRIVE.damping_ratio * DRIVE.bandwidth * s + DRIVE.bandwidth**2) * np.exp(-s * delay)


def smallest_scale(values: np.ndarray) -> float:
    """The smallest factor that puts one of the eigenvalues (ω, k) on −1, by linear interpolation between grid points."""
    scales = []
    for column in np.atleast_2d(values.T):
        crosses = np.flatnonzero((np.diff(np.sign(column.imag)) != 0) & (column.real[1:] < 0) & (column.real[:-1] < 0))
        a, b = column[crosses], column[crosses + 1]
        share = a.imag / (a.imag - b.imag)
        scales += (-1 / (a + share * (b - a)).real).tolist()
    return min(scales)


def joint_loop(load: float, delay: float, kp: float = KP, kd: float = KD) -> np.ndarray:
    """The loop of one joint over OMEGA: eq. (2) as it is printed, times controller and drive."""
    s, jm = 1j * OMEGA, MOTOR_INERTIA
    elastic = (load * s**2 + DAMPING * s + STIFFNESS) / (jm * load / (jm + load) * s**2 + DAMPING * s + STIFFNESS)
    return elastic / ((jm + load) * s**2) * (kp + s * kd) * drive(delay)


def row_of(rows, key: str) -> Row:
    (row,) = [row for row in rows() if row.id == key]
    return row


# --- Table I


def test_postures_of_the_motion_are_what_they_are_said_to_be():
    body = biped().source.body
    for pitch in (table1.LEAN.pitch, 0.0):
        postures = table1.motion(pitch)
        assert len(postures) == table1.STEPS
        for q, share in zip(postures, np.linspace(0, 1, table1.STEPS), strict=True):
            assert_allclose(body.com(q), START + share * 0.06, atol=1e-9)
            assert not body.beyond_limits(q)
            for side, sign in (("left", 1), ("right", -1)):
                axes, place = body.frame_placement(q, f"{side}_sole")
                assert_allclose(axes, np.eye(3), atol=1e-9)
                assert_allclose(place, (0, sign * 0.1025, 0), atol=1e-9)
            c, s = math.cos(pitch), math.sin(pitch)
            assert_allclose(body.frame_placement(q, "pelvis")[0], [[c, 0, s], [0, 1, 0], [-s, 0, c]], atol=1e-9)
        knees = [body.angles(q)[NAMES.index("left_knee")] for q in postures]
        assert min(knees) > 0.2  # never near straight, where gains would grow without bound


def joint_gains_the_long_way(model, jacobian, kp, kd, rotors=True):
    """Kpq, Kvq without projectors or priorities.

    The links on their contacts are solved whole (robot_truths): W' and the task's acceleration T per joint torque. Of all torques
    with T Γ = a, Γ is the one of least Γᵀ W' Γ, and of those the smallest (Gauss' principle: nothing moves that the task does not
    need); joint errors reach the task as the motion that the contacts leave has them, Eᵀ with W' E = Tᵀ.
    """
    inertia = model.inertia.copy()
    if rotors:
        inertia[6:, 6:] += np.diag(model.motor_inertia)
    whole = accelerations(inertia, model.contact_jacobian, np.eye(12))
    compliance, moved = whole[6:], jacobian @ whole
    size = len(jacobian)
    system = np.block([[compliance, moved.T], [moved, np.zeros((size, size))]])
    torque = np.linalg.lstsq(system, np.vstack([np.zeros((12, size)), np.eye(size)]), rcond=1e-10)[0][:12]
    error = np.linalg.lstsq(compliance, moved.T, rcond=1e-10)[0].T
    return torque @ np.diag(kp) @ error, torque @ np.diag(kd) @ error


def test_table1_from_equations_solved_whole():
    largest = {"kp": np.zeros(12), "kv": np.zeros(12)}
    for q in table1.motion(table1.LEAN.pitch):
        model = standing_so(q)
        assert np.all(model.motor_inertia == MOTOR_INERTIA)
        kpq, kvq = joint_gains_the_long_way(model, model.body.com_jacobian(q), COM_KP, COM_KD)
        for gain, matrix in (("kp", kpq), ("kv", kvq)):
            largest[gain] = np.maximum(largest[gain], np.diag(matrix))
    found = table1.gains(table1.LEAN)
    for gain in ("kp", "kv"):
        # two least-squares solutions through condition numbers of about 1e5
        assert_allclose(found[gain], largest[gain], rtol=1e-7)
    rows = {row.id: row for row in table1.rows()}
    for k, name in enumerate(NAMES):
        side, _, joint = name.partition("_")
        for gain, values in largest.items():
            row = rows[f"table1.{side}.{joint}.{gain}"]
            assert row.computed == pytest.approx(values[k], rel=1e-7)
            assert row.agrees == (abs(row.computed / float(row.printed) - 1) <= 0.25)


def test_table1_without_rotors_and_with_the_pelvis_from_equations_solved_whole():
    q = table1.motion(0.0)[4]
    model = standing_so(q)
    rotation = model.body.frame_placement(q, "pelvis")[0] @ model.body.frame_jacobian(q, "pelvis")[3:]
    both = np.vstack([model.body.com_jacobian(q), rotation])
    for rotors in (True, False):
        for jacobian, pelvis in ((both[:3], False), (both, True)):
            kp, kd = np.arange(1.0, len(jacobian) + 1), np.arange(2.0, len(jacobian) + 2)
            expected = joint_gains_the_long_way(model, jacobian, kp, kd, rotors)
            found = com_tasks(model, rotors, pelvis).joint_gains(kp, kd)
            for one, other in zip(found, expected, strict=True):
                assert_allclose(one, other, atol=1e-8 * np.abs(other).max())


def test_the_largest_gains_do_not_hide_between_the_samples():
    body = biped().source.body
    largest, near = np.zeros(12), None
    for share in np.linspace(0, 1, 41):
        near = on_both_feet(body, START + share * MOVE, table1.LEAN.pitch, near)
        largest = np.maximum(largest, np.diag(com_tasks(standing_so(near)).joint_gains(COM_KP, COM_KD)[0]))
    # at an inner maximum a sample is at most 1/16 of the motion away: second order
    assert_allclose(table1.gains(table1.LEAN)["kp"], largest, rtol=0.01)


def test_the_hip_yaw_comes_from_the_lean_and_the_sideways_direction():
    yaw = NAMES.index("left_hip_yaw")
    ends = {}
    for account in (table1.LEVEL, table1.LEAN):
        for place in (0, -1):
            tasks = com_tasks(standing_so(table1.motion(account.pitch)[place]))
            ends[account.key, place] = tasks.torque[yaw] * tasks.jacobian[:, yaw]
        # the start is symmetric: fore, aft, up and down do not turn the hips; round-off
        assert np.abs(ends[account.key, 0][[0, 2]]).max() < 1e-12
    leaning = ends["leaning_pelvis", -1]
    assert leaning[1] > 50 * np.abs(leaning[[0, 2]]).max()
    assert leaning[1] > 50 * ends["level_pelvis", -1][1]


def test_the_tolerance_is_no_wider_than_what_is_left_open():
    for account in (table1.LOWER, table1.NO_ROTORS):
        assert table1.unsettled(account) > table1.TOLERANCE - 0.01
    lower = table1.motion(table1.LEAN.pitch, 0.005)
    for q, other in zip(lower, table1.motion(table1.LEAN.pitch), strict=True):
        assert_allclose(biped().source.body.com(other) - biped().source.body.com(q), (0, 0, 0.005), atol=1e-9)


def test_the_inferred_pelvis_gains_are_the_best_fit():
    def off(kp, kd):
        account = table1.Account("try", "", 0.0, pelvis_kp=kp, pelvis_kd=kd)
        return table1.typical_factor(account)

    kp, kd = table1.PELVIS_TASK.pelvis_kp, table1.PELVIS_TASK.pelvis_kd
    assert len(kp) == len(kd) == 3
    best = off(kp, kd)
    for axis in range(3):
        for factor in (0.8, 1.25):
            scaled = np.where(np.arange(3) == axis, factor, 1.0)
            for changed in (off(tuple(kp * scaled), kd), off(kp, tuple(kd * scaled))):
                assert changed > best - 1e-3  # they are rounded to two or three digits


def test_the_documentation_names_what_was_inferred():
    text = " ".join((Path(__file__).parents[1] / "docs" / "reproduction.md").read_text("utf-8").split())
    x, _, z = START
    assert f"a pelvis that leans back {-table1.LEAN.pitch:g} rad, a start {-x:g} m behind the ankles and {z:g} m above the soles" in text
    assert table1.LEAN.rotors


# --- Claim 2


@pytest.mark.parametrize("delay", claim2.DELAYS)
def test_claim2_limits_on_a_dense_grid(delay: float):
    gains, _ = claim2.limits(delay)
    heaviest, against = smallest_scale(joint_loop(claim2.RATIOS[-1] * MOTOR_INERTIA, delay)[:, None]), claim2.change(delay)
    for k in range(0, len(claim2.RATIOS), 7):
        expected = smallest_scale(joint_loop(claim2.RATIOS[k] * MOTOR_INERTIA, delay)[:, None])
        assert gains[k] == pytest.approx(expected, rel=1e-4)  # light loads have a resonance of some grid steps' width
        assert against[k] == pytest.approx(20 * math.log10(expected / heaviest), abs=2e-3)


@pytest.mark.slow
def test_claim2_spreads_on_a_dense_grid():
    def spread(loads, delay=DRIVE.delay):
        limits = [20 * math.log10(smallest_scale(joint_loop(load, delay)[:, None])) for load in loads]
        return max(limits) - min(limits)

    for delay in claim2.DELAYS:
        key = f"claim2.heavy_load_{1e3 * delay:g}_ms.gain_limit_spread_db"
        # the module's own grid is coarser: a peak between its samples is missed by less than a twentieth
        assert row_of(claim2.rows, key).computed == pytest.approx(spread(np.geomspace(0.1, 100, 200), delay), rel=0.05, abs=1e-3)
    light = row_of(claim2.rows, "claim2.light_load.gain_limit_spread_db").computed
    assert light == pytest.approx(spread(np.geomspace(0.01, 0.1, 200)), rel=0.1)  # a kink: its tip lies between samples
    for contact in ("double", "left"):
        loads = 1 / np.diag(standing(contact).link_inverse_inertia)
        assert row_of(claim2.biped_rows, f"claim2.biped_{contact}.gain_limit_spread_db").computed == pytest.approx(spread(loads), abs=1e-3)


# --- Claim 3


def carried(q, axis_point, links):
    """Inertia [kg m²] about the y and the x axis through a point of the links on these joints (0: the pelvis), moving as one."""
    import pinocchio as pin

    body = biped().source.body
    data = body.model.createData()
    pin.forwardKinematics(body.model, data, q)
    total = np.zeros(2)
    for index in links:
        inertia, place = body.model.inertias[index], data.oMi[index]
        offset = place.act(inertia.lever) - axis_point
        own = place.rotation @ inertia.inertia @ place.rotation.T
        spread = own + inertia.mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
        total += spread[1, 1], spread[0, 0]
    return total


def test_claim3_loads_of_the_ankles_summed_link_by_link():
    body, q = biped().source.body, standing("double").q
    names = list(body.model.names)
    everything = range(1, len(names))
    left_foot, right_foot = names.index("left_ankle_roll"), names.index("right_ankle_roll")
    ankle = body.frame_placement(q, "left_foot")[1]
    pitch, roll = carried(q, ankle, [k for k in everything if k != left_foot])
    # ankle pitch turns ankle roll's axis with it, at zero angle no matter; the link between the two stays or goes with its joint
    between = names.index("left_ankle_pitch")
    pitch_axis, _ = carried(q, ankle, [k for k in everything if k not in (left_foot, between)])
    single_pitch = claim3.supporting("left", "ankle_pitch").load
    single_roll = claim3.supporting("left", "ankle_roll").load
    assert single_pitch == pytest.approx(pitch_axis, rel=1e-9)
    assert single_roll == pytest.approx(roll, rel=1e-9)
    assert pitch > single_pitch
    still = (left_foot, right_foot, between, names.index("right_ankle_pitch"))
    shared, _ = carried(q, ankle, [k for k in everything if k not in still])
    assert claim3.supporting("double", "ankle_pitch").load == pytest.approx(shared / 2, rel=1e-9)


def test_claim3_sideways_sway_is_a_parallelogram():
    """Pelvis, trunk and hip yaw links shift without turning; both legs turn about their ankles."""
    body, q = biped().source.body, standing("double").q
    names = list(body.model.names)
    energy = 0.0
    for side in ("left", "right"):
        ankle = body.frame_placement(q, f"{side}_foot")[1]
        leg = [names.index(f"{side}_{joint}") for joint in ("hip_roll", "hip_pitch", "knee", "ankle_pitch")]
        energy += carried(q, ankle, leg)[1]
    hip = body.frame_placement(q, "left_hip_roll_link")[1] - body.frame_placement(q, "left_foot")[1]
    shifted = sum(body.model.inertias[k].mass for k in (1, names.index("left_hip_yaw"), names.index("right_hip_yaw")))
    energy += shifted * (hip[1] ** 2 + hip[2] ** 2)
    assert claim3.supporting("double", "ankle_roll").load == pytest.approx(energy / 2, rel=1e-9)


def test_claim3_limits_on_a_dense_grid():
    for contact, joint in claim3.SWAY:
        edge = claim3.supporting(contact, joint)
        kd = KD * smallest_scale(joint_loop(edge.load, DRIVE.delay)[:, None])
        row = row_of(claim3.rows, f"claim3.{contact}.{joint}.kv_limit_per_s")
        assert row.computed == pytest.approx(kd / (MOTOR_INERTIA + edge.load), rel=1e-6)
    s = 1j * OMEGA
    alone = (KP + s * KD) * drive() / (MOTOR_INERTIA * s**2)
    assert claim3.motor_alone() == pytest.approx(KD * smallest_scale(alone[:, None]), rel=1e-6)


@pytest.mark.parametrize("contact", ["double", "left"])
def test_claim3_centre_of_mass_by_direction_on_a_dense_grid(contact: str):
    model, s = standing(contact), 1j * OMEGA
    tasks = com_tasks(model)
    moved = tasks.jacobian @ model.response(s, "motor") @ tasks.torque
    for axis, found in enumerate(claim3.com_limits(contact)):
        loop = moved[:, axis, axis] * (COM_KP[axis] + s * COM_KD[axis]) * drive()
        assert found == pytest.approx(COM_KD[axis] * smallest_scale(loop[:, None]), rel=1e-6)


# --- Claim 4


def tracked(values: np.ndarray) -> np.ndarray:
    """Eigenvalues (ω, k) in the order of their size, which keeps loci of different size apart."""
    return np.take_along_axis(values, np.argsort(np.abs(values), axis=1), axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("contact", ["double", "left"])
@pytest.mark.parametrize("gains", list(claim4.GAIN_SETS))
def test_claim4_limits_on_a_dense_grid(contact: str, gains: str):
    kp, kd = claim4.GAIN_SETS[gains]
    near = (OMEGA > 200) & (OMEGA < 1500)  # all of them vibrate near 630 rad/s
    s = 1j * OMEGA[near]
    found = claim4.standing_limits(contact, gains)
    model = standing(contact)
    tasks = com_tasks(model)
    response = model.response(s, "motor") * drive()[near, None, None]
    in_task_space = tasks.jacobian @ response @ tasks.torque * (kp + s[:, None] * kd)[:, None, :]
    assert found.full == pytest.approx(smallest_scale(tracked(np.linalg.eigvals(in_task_space))), rel=1e-5)
    kpq, kvq = (np.diag(matrix) for matrix in tasks.joint_gains(kp, kd))
    diagonal = np.linalg.eigvals(response * (kpq + s[:, None] * kvq)[:, None, :])
    # mirrored joints have near-equal eigenvalues that change places in the order of size
    assert found.diagonal == pytest.approx(smallest_scale(tracked(diagonal)), rel=1e-3)
    loads = 1 / np.diag(model.link_inverse_inertia)
    singles = [smallest_scale(joint_loop(load, DRIVE.delay, p, d)[:, None]) for load, p, d in zip(loads, kpq, kvq, strict=True) if d > 1e-6]
    assert found.single == pytest.approx(min(singles), rel=1e-5)
    rigid = np.linalg.eigvals(
        tasks.jacobian
        @ standing(contact, rigid=True).response(1j * OMEGA, "motor")
        @ tasks.torque
        * ((kp + 1j * OMEGA[:, None] * kd) * drive()[:, None])[:, None, :]
    )
    assert found.rigid == pytest.approx(smallest_scale(tracked(rigid)), rel=1e-3)


def test_claim4_says_what_its_figures_say():
    double, single = (claim4.standing_limits(contact, "table1_gains") for contact in ("double", "left"))
    assert double.coupling > 2 > 1.2 > single.coupling > 1
    hard = [claim4.standing_limits(contact, "com_100_20") for contact in ("double", "left")]
    assert all(limits.full < 1 < limits.rigid for limits in hard)
    table = claim4.table1_limits()
    assert row_of(claim4.rows, "claim4.table1.coupling_factor").computed == pytest.approx(table.diagonal / table.full)
    assert table.full > 1  # the robot stood still with these gains
