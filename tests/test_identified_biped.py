"""From logs to gains on the biped: recommended over the identified intervals, they never make it vibrate, whatever is true in them."""

from dataclasses import replace

import numpy as np
import pytest

import gainroom as gr
from gainroom.design.gain_sets import GainSet
from gainroom.design.robot_gains import recommend_robot
from gainroom.files.robot_yaml import parse_robot
from gainroom.simulation.robot_simulation import RobotSimulation
from gainroom.studies.simulation import simulate_study
from gainroom.system.system import System
from identified import SEED
from identified_biped import KINDS, ROBOT, bench, drawn, robot_of
from independent.quick_margins import quick_margins

DRAWS, LOOP_ERROR = 200, 0.05


def gains_of(robot: System) -> GainSet:
    found = recommend_robot(robot).everywhere
    assert found is not None
    return found


def margins_at(system: System, found: GainSet) -> tuple[bool, float]:
    """Stable, by the roots; and by how much of itself the requirement is missed that is missed most, with the robot's weight."""
    model = system.source.linearize("stand", "double", weight=not found.without_weight)
    loop = system.loop(model, gr.PD(found.kp, found.kd))
    return gr.is_stable(loop), system.requirements.shortfall(quick_margins(loop))


def vibrates(system: System, found: GainSet, gain: float = 1.0) -> bool:
    """Standing for a second in MuJoCo, on the ground."""
    return simulate_study(RobotSimulation.of(system.with_controller(gr.PD(found.kp, found.kd))), gain).vibrates


@pytest.mark.slow
def test_share_of_the_draws(tmp_path):
    """One kind of joint for all twelve; damping and inertia are taken as exact, which leaves a quarter of the corners."""
    kinds = [bench(0, 0, tmp_path, 5.0)]
    robot = robot_of(kinds)
    robot = replace(robot, uncertainty=robot.uncertainty.without("damping").without("motor_inertia"))
    found, rng = gains_of(robot), np.random.default_rng([SEED, 10])
    for index in range(4):
        stable, missed = margins_at(drawn(rng, robot, kinds, bool(index % 2)), found)
        assert stable
        assert missed < LOOP_ERROR
    assert not vibrates(drawn(rng, robot, kinds, True), found)
    assert vibrates(robot, found, 4.0)  # well beyond the gain margin of 2: the simulation would show it


@pytest.mark.population
@pytest.mark.timeout(3600)
def test_200_draws_from_within_the_intervals(tmp_path, capsys):
    """Six kinds; half of the draws at ends of all intervals, each kind by itself."""
    kinds = [bench(1, kind, tmp_path) for kind in range(len(KINDS))]
    robot = robot_of(kinds)
    found, rng = gains_of(robot), np.random.default_rng([SEED, 11])
    missed, quiet = [], 0
    for index in range(DRAWS):
        system = drawn(rng, robot, kinds, bool(index % 2))
        stable, short = margins_at(system, found)
        assert stable, index
        missed.append(short)
        quiet += not vibrates(system, found)
    with capsys.disabled():
        print(f"\n{DRAWS} draws stable, {quiet} quiet in MuJoCo; ", end="")
        print(f"requirements missed by {max(missed):.4f} at most, in {np.sum(np.array(missed) > 0)}")
    assert quiet == DRAWS
    assert max(missed) < LOOP_ERROR


@pytest.mark.population
@pytest.mark.timeout(3600)
def test_joints_that_differ_among_themselves_miss_little():
    """Inertias known to 20 %, every joint at an end of its own; the cases of the search have all joints at the same end."""
    robot = parse_robot(ROBOT.replace("scenario:", "uncertainty: {motor_inertia: 20%}\nscenario:"), "biped")
    found, rng = gains_of(robot), np.random.default_rng([SEED, 12])
    low, high = robot.uncertainty.values((0.0,))["motor_inertia"], robot.uncertainty.values((1.0,))["motor_inertia"]
    for _ in range(60):
        stable, missed = margins_at(robot.with_values(motor_inertia=np.where(rng.integers(0, 2, len(low)), low, high)), found)
        assert stable
        assert missed < 0.01  # of a requirement
