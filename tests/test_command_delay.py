"""A delay of set-points alone: the run is the same run, later, and the record says what was asked for and when."""

from pathlib import Path

import numpy as np
import pytest
from pytest import approx

from gainroom.files.joint_yaml import parse_simulation
from gainroom.files.robot_yaml import load_robot_system
from gainroom.simulation.robot_simulation import RobotSimulation
from gainroom.simulation.run_record import joined
from gainroom.studies.simulation import simulate_study
from robot_files import ROBOT, write_arm

JOINT = """\
joint: {motor_inertia: 0.5, link_inertia: 1.0, stiffness: 8.0e3, damping: 4.0}
drive: {bandwidth: 4000.0, delay_ms: 1.0, command_delay_ms: LATE}
control: {type: KIND, feedback: motor, sample_rate_hz: 2000}
scenario: {duration: 1.0, reference: {type: cubic, by: 0.1, duration: 0.4}HARDWARE}
"""
LAWS = {"pd": "pd, kp: 400.0, kd: 30.0", "ppi": "ppi, kp: 10.0, kv: 30.0, ki: 40.0"}
HARDWARE = {"linear": "", "testbed": ", torque_limit: 20.0, friction: {motor: {coulomb: 0.2}}"}
TICK = 5e-4


def simulation(late: float, law: str = "pd", hardware: str = "linear"):
    return parse_simulation(
        JOINT.replace("LATE", str(late)).replace("KIND", LAWS[law]).replace("HARDWARE", HARDWARE[hardware]), "knee.yaml"
    )


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("hardware", HARDWARE)
def test_the_same_run_later(law: str, hardware: str):
    """Set-points that are 10 ms late move the joint 20 ticks later, to the last digits, and the loop itself is as it was."""
    outcomes = [simulate_study(simulation(late, law, hardware)) for late in (0.0, 10.0)]
    at_once, late = (one.run for one in outcomes)
    assert np.array_equal(late.reference, at_once.reference)
    for name in ("motor_position", "link_position", "target_torque"):
        first, second = getattr(at_once, name), getattr(late, name)
        assert second[20:] == approx(first[:-20], abs=1e-9 * np.abs(first).max()), name
        assert np.abs(second[:20] - second[0]).max() == 0, name  # at rest until the first set-point arrives
    assert outcomes[0].limit is not None
    assert outcomes[1].limit is not None
    assert outcomes[1].limit.gain == outcomes[0].limit.gain
    assert (
        outcomes[1].tracking.peak[0] > outcomes[0].tracking.peak[0] + 0.5 * 0.01 * np.abs(np.diff(at_once.reference, axis=0)).max() / TICK
    )
    assert outcomes[1].spec.moves_until == approx(outcomes[0].spec.moves_until + 0.01)


def test_half_a_tick_is_half_a_tick_of_the_reference():
    late = joined([*simulation(0.25).stream(1.0)])
    spec = simulation(0.0)
    shifted = spec.scenario.reference.position(late.time - TICK / 2)
    first = np.flatnonzero(late.target_torque[:, 0])[0]
    assert late.target_torque[first, 0] == approx(400 * shifted[first, 0] + 30 * shifted[first, 0] / TICK)


def test_a_run_that_is_continued_goes_on_from_the_same_rows():
    spec = simulation(3.0)
    whole, longer = joined([*spec.stream(1.0)]), spec.continued(1.0, 100, moving=True)
    rows = len(whole.time)
    for name in ("reference", "link_position"):
        assert np.array_equal(getattr(longer, name)[:rows], getattr(whole, name)), name


def test_a_torque_that_goes_with_set_points_is_late_too(tmp_path: Path):
    rows = ["time,target_torque", *(f"{k * TICK:.6f},{3.0 * (k >= 100)}" for k in range(1000))]
    (tmp_path / "log.csv").write_text("\n".join(rows) + "\n", "utf-8")
    path = tmp_path / "knee.yaml"
    runs = []
    for late in ("0", "5"):
        text = JOINT.replace("LATE", late).replace("KIND", LAWS["pd"]).replace("HARDWARE", "")
        path.write_text(text, "utf-8")
        spec = parse_simulation(text, str(path), tmp_path / "log.csv")
        runs.append(joined([*spec.stream(1.0)]))
    at_once, late = (run.link_position for run in runs)
    assert np.abs(at_once).max() > 1e-3
    assert late[10:] == approx(at_once[:-10], abs=1e-12)


def test_a_robots_set_points_are_late(tmp_path: Path):
    """The move of a whole robot in MuJoCo, 10 ms later. It settles by 1e-5 rad as it starts; one tick more or less would be 6e-4 rad."""
    scenario = "scenario: {duration: 0.6, move: {joint: elbow, by: 0.2, duration: 0.3}}\n"
    runs = []
    for late in ("0.0", "10.0"):
        text = ROBOT.replace("delay_ms: 2.0}", f"delay_ms: 2.0, command_delay_ms: {late}}}") + scenario
        spec = RobotSimulation.of(load_robot_system(write_arm(tmp_path, text)))
        runs.append(joined([*spec.stream(1.0)]))
    at_once, late = runs
    assert late.reference == approx(at_once.reference, abs=1e-15)  # start + what arrived + what had not yet: rounded once more
    assert np.ptp(at_once.link_position, axis=0).max() > 0.1
    assert late.link_position[20:] == approx(at_once.link_position[:-20], abs=5e-5)
