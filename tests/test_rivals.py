"""What a joint leaves of the torque, and which other model explains it: logs in closed form, made backwards from the twist.

A twist that is chosen gives the spring's torque, that the link's acceleration, and the torque τ = J_M q̈ + spring is what moves it so. No
integrator has a step here, and whatever law the spring has is exact.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest

import gainroom as gr
from gainroom.identification.frequency_response import frequency_response
from gainroom.identification.joint import JointFit, identify_joint
from gainroom.identification.motion import motion_of
from gainroom.identification.prediction import Between, Noise, Signals
from gainroom.identification.record import Record
from gainroom.identification.rivals import rivals_of, rivals_text
from gainroom.identification.torque_balance import Balance, Spectra, through_drive, torque_balance

TICK, COUNT = 1e-3, 6000
TIME = TICK * np.arange(COUNT)
MOTOR, LINK, STIFFNESS, DAMPING = 0.05, 0.12, 900.0, 0.3
OMEGA = 2 * np.pi * np.fft.rfftfreq(COUNT, TICK)
SWING = 0.01  # [rad] of the twist
QUIET = Noise(0.0, 0.0, 0.0, np.array([1e-9]))


def integrated(acceleration: np.ndarray) -> np.ndarray:
    """(m,) the position without drift, of a periodic record."""
    spectrum = np.fft.rfft(acceleration)
    spectrum[1:] /= -(OMEGA[1:] ** 2)
    spectrum[0] = 0.0
    return np.fft.irfft(spectrum, COUNT)


def derived(values: np.ndarray, times: int) -> np.ndarray:
    return np.fft.irfft(np.fft.rfft(values) * (1j * OMEGA) ** times, COUNT)


def twist(seed: int) -> np.ndarray:
    """A multisine of 3 to 45 Hz, whole periods, from rest to rest."""
    lines = np.unique(np.rint(np.geomspace(3, 45, 60) * COUNT * TICK).astype(int))
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(lines))
    values = (np.sin(2 * np.pi * np.outer(TIME, lines / COUNT / TICK) + phases) / np.sqrt(lines)).sum(axis=1)
    ends = 0.5 - 0.5 * np.cos(np.pi * np.arange(600) / 600)
    values[:600] *= ends
    values[-600:] *= ends[::-1]
    return SWING * values / values.std()


def log(spring: Callable[[np.ndarray], np.ndarray], link: np.ndarray | float = LINK, seed: int = 0, noise: float = 0.005):
    """Torque with noise of a share, and the motor's position with an encoder's steps of 10 µrad, (m,) each."""
    bent = twist(seed)
    pull = spring(bent) + DAMPING * derived(bent, 1)
    pull = pull - pull.mean()
    position = integrated(pull / link) + bent
    torque = MOTOR * derived(position, 2) + pull
    rng = np.random.default_rng(seed + 100)
    return torque + noise * torque.std() * rng.standard_normal(COUNT), 1e-5 * np.round(position / 1e-5)


def spectra(torque: np.ndarray, position: np.ndarray, sampled: bool = True) -> Spectra:
    joint = gr.ElasticJoint(MOTOR, LINK, STIFFNESS, DAMPING)
    positions = position[:, None]
    signals = Signals(torque, sampled, positions, motion_of(positions, False, TICK, joint), TICK)
    return Spectra(signals, frequency_response(torque, position, TICK))


def linear(bent: np.ndarray) -> np.ndarray:
    return STIFFNESS * bent


@pytest.mark.slow
@pytest.mark.parametrize(("gap", "seed"), [(4e-3, 0), (8e-3, 1), (15e-3, 2)])
def test_a_gap_is_called_backlash(gap: float, seed: int):
    """To a fifth: the steepest corners of the torque are above the frequencies that are looked at."""
    torque, position = log(lambda bent: STIFFNESS * (bent - np.clip(bent, -gap, gap)), seed=seed)
    first = rivals_of(spectra(torque, position), torque, None)[0]
    assert first.name == "backlash"
    assert first.values["gap"] == pytest.approx(gap, rel=0.2)
    assert "backlash of about ±" in rivals_text([first])


@pytest.mark.slow
@pytest.mark.parametrize("growth", [0.5, 2.0, 4.0])
def test_a_torque_that_grows_faster_than_the_twist_is_called_stiffening(growth: float):
    """Slope at the largest twist over that at none, 3 h θ², to a fifth: twists below the excited frequencies are not seen."""
    torque, position = log(lambda bent: STIFFNESS * bent * (1 + growth / 3 * (bent / (2.5 * SWING)) ** 2))
    first = rivals_of(spectra(torque, position), torque, None)[0]
    assert first.name == "stiffening"
    slope = first.values["growth"] * (2.5 * SWING / first.values["twist"]) ** 2
    assert slope == pytest.approx(growth, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(("moment", "ratio"), [(3.0, 1.25), (2.0, 2.0), (4.2, 0.5)])
def test_a_load_that_changes_is_told_with_its_moment(moment: float, ratio: float):
    torque, position = log(linear, LINK * np.where(moment > TIME, 1.0, ratio))
    first = rivals_of(spectra(torque, position), torque, None, 10.0)[0]
    assert first.name == "load change"
    assert first.values["moment"] == pytest.approx(10.0 + moment, abs=0.1)
    assert first.values["ratio"] == pytest.approx(ratio, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.3, 0.5, 0.7])
def test_a_second_mode_is_told_with_its_resonances(share: float):
    """A third mass: the free joint's resonances are eigenvalues of M⁻¹K."""
    masses = np.diag([MOTOR, (1 - share) * LINK, share * LINK])
    springs = STIFFNESS * np.array([[1.0, -1, 0], [-1, 2.2, -1.2], [0, -1.2, 1.2]])
    modes = np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(masses, springs)).real)[1:])
    torque = twist(0) / SWING
    s = 1j * OMEGA[1:, None, None]
    compliance = np.linalg.inv(masses * s**2 + springs * (1 + 2e-4 * s))[:, 0, 0]
    position = np.fft.irfft(np.append(0.0, compliance) * np.fft.rfft(torque), COUNT)
    torque = torque + 0.005 * np.random.default_rng(5).standard_normal(COUNT)
    position = position + 1e-6 * position.std() * np.random.default_rng(6).standard_normal(COUNT)
    first = rivals_of(spectra(torque, position), torque, None)[0]
    assert first.name == "second mode"
    assert [first.values["first"], first.values["second"]] == pytest.approx(modes.tolist(), rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("sides", [(-1.0, 1.0), (-math.inf, 0.7), (-0.5, math.inf)])
def test_a_command_beyond_a_limit_that_is_not_logged_is_told(sides: tuple[float, float]):
    """The command is the torque as it was, but where that was at the limit, above it by as much again as smooth torques rise."""
    drive = gr.Drive(3000.0, 0.9, 2e-3)
    command = twist(3) / SWING
    made = through_drive(np.clip(command, *sides), drive, TICK)
    s = 1j * OMEGA[1:]
    coupling = DAMPING * s + STIFFNESS
    response = (LINK * s**2 + coupling) / (s**2 * (MOTOR * LINK * s**2 + (MOTOR + LINK) * coupling))
    position = np.fft.irfft(np.append(0.0, response) * np.fft.rfft(made), COUNT)
    seen = spectra(command, position, sampled=False)
    first = rivals_of(seen, through_drive(command, drive, TICK), lambda torque: through_drive(torque, drive, TICK))[0]
    assert first.name == "torque limit"
    assert first.values["torque"] == pytest.approx(min(abs(side) for side in sides), rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_two_masses_and_a_spring_have_no_rival_and_leave_no_torque(seed: int):
    torque, position = log(linear, seed=seed)
    seen = spectra(torque, position)
    balance = torque_balance(seen, gr.ElasticJoint(MOTOR, LINK, STIFFNESS, DAMPING), gr.Drive(), Between(), QUIET, np.zeros(2))
    assert balance.most < 3e-3  # noise of 0.5 % over all frequencies, the most of it where there is least torque
    assert not [rival for rival in rivals_of(seen, torque, None) if rival.name != "second mode"]


def test_what_is_left_is_the_share_that_the_model_misses():
    """A rigid joint's inertia 10 % too small leaves a tenth of the torque, a hundredth of its power, in every band."""
    bent = twist(0)
    torque = 0.2 * derived(bent, 2)
    balance = torque_balance(spectra(torque, bent), gr.ElasticJoint(0.09, 0.09), gr.Drive(), Between(), QUIET, np.zeros(2))
    assert balance.left[balance.power > 0.01] == pytest.approx(0.01, rel=0.15)  # friction's columns take a little of it


def test_nothing_is_said_where_nothing_explains_more():
    assert rivals_text([]) == ""


def told(torque: np.ndarray, position: np.ndarray, **more: np.ndarray) -> JointFit:
    """What `identify joint` finds."""
    return identify_joint(Record(TIME, {"actual_torque": torque, "motor_position": position} | more, TICK))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spring", "link", "words"),
    [
        (lambda bent: STIFFNESS * (bent - np.clip(bent, -0.007, 0.007)), LINK, "backlash of about ±"),
        (linear, LINK * np.where(TIME < 3.1, 1.0, 1.2), "a load that changes at 3.1"),
        (lambda bent: STIFFNESS * bent * (1 + 0.06 * (bent / SWING) ** 2), LINK, "a gear that stiffens"),
    ],
    ids=["backlash", "load", "stiffening"],
)
def test_a_wrong_joint_is_not_adequate_and_its_cause_is_named(spring, link, words):
    """Or it is refused, with the same words."""
    try:
        found = told(*log(spring, link))
        said, adequate = " ".join(found.warnings), found.adequate
    except gr.GainroomError as error:
        said, adequate = str(error), False
    assert not adequate
    assert words in said


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_right_joint_is_adequate(seed: int):
    found = told(*log(linear, seed=seed))
    assert found.adequate
    assert not found.rivals
    for name, value in {"motor_inertia": MOTOR, "link_inertia": LINK, "stiffness": STIFFNESS}.items():
        assert found.parameters[name].low < value < found.parameters[name].high


DRIVE = gr.Drive(3000.0, 0.9, 2e-3)
COMMAND = twist(3) / SWING
HOT = np.linspace(1.5, 0.8, COUNT)


def slowed(command: np.ndarray) -> np.ndarray:
    """By at most 0.08 N·m a row."""
    made = command.copy()
    for row in range(1, COUNT):
        made[row] = made[row - 1] + np.clip(command[row] - made[row - 1], -0.08, 0.08)
    return made


@pytest.mark.slow
@pytest.mark.parametrize(
    "limited",
    [
        lambda command: np.clip(command, -1.0, 1.0),
        lambda command: np.minimum(command, 0.7),
        lambda command: np.clip(command, -HOT, HOT),
        slowed,
        lambda command: np.where(np.abs(command) < 0.4, 0.0, command),
        lambda command: 0.8 * command,
    ],
    ids=["limit", "one side", "as it gets hot", "rate", "dead zone", "torque constant"],
)
def test_the_torque_that_the_joint_got_is_fitted_where_it_is_not_the_command(limited):
    """Inertias and stiffness to 1 %, in their intervals; from the command they would be a tenth off at least."""
    made = through_drive(limited(COMMAND), DRIVE, TICK)
    s = 1j * OMEGA[1:]
    coupling = DAMPING * s + STIFFNESS
    response = (LINK * s**2 + coupling) / (s**2 * (MOTOR * LINK * s**2 + (MOTOR + LINK) * coupling))
    position = np.fft.irfft(np.append(0.0, response) * np.fft.rfft(made), COUNT)
    rng = np.random.default_rng(8)
    torque = made + 0.005 * rng.standard_normal(COUNT)
    found = told(torque, position + 2e-6 * rng.standard_normal(COUNT), target_torque=COMMAND)
    assert found.torque == "actual_torque"
    assert [text for text in found.warnings if "the joint is fitted to" in text]
    for name, value in {"motor_inertia": MOTOR, "link_inertia": LINK, "stiffness": STIFFNESS}.items():
        assert found.parameters[name].value == pytest.approx(value, rel=0.01)


@pytest.mark.parametrize("others", [0.0, 1e-3, 0.02, 0.6])
def test_a_loop_that_rings_does_not_hide_the_other_bands(others: float):
    """Two bands may have all of the power: a band counts from a hundredth of three times what is in the others, of all of it at most."""
    power = np.append([(1 - others) / 2] * 2, others * np.array([0.5, 0.4, 0.099, 0.001]))
    left = np.array([1e-4, 2e-4, 0.3, 0.2, 0.4, 50.0])
    balance = Balance(np.ones((6, 2)), left, power, np.zeros(6))
    assert balance.most == pytest.approx(0.4 if others else 2e-4)  # the last has a tenth of a percent of the others: noise
