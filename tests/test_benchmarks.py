"""The peers of the benchmarks are set up right: on a problem without what they do not model, they find the truth."""

from pathlib import Path

import numpy as np
import pytest
from pytest import approx

import gainroom as gr
from benchmarks import habits, identification, sysid_peer
from benchmarks.table import markdown, print_table
from gainroom.simulation import Scenario, Testbed, simulate
from identified import multisine, soft_loop

ROOT, TICK = Path(__file__).parents[1], 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("weight", [0.0, 3.0])
def test_sysid_finds_a_joint_without_friction_and_noise(weight: float):
    """From 30 % off, in windows over all of the log; the current loop is slow beside the tick, so that the torque is known in between."""
    if not sysid_peer.is_installed():  # not where tests are collected, as it loads a lot
        pytest.skip("mujoco.sysid is not installed")
    joint = gr.ElasticJoint(0.2, 0.8, 3000.0, 1.0)
    rng, time = np.random.default_rng(1), np.arange(1500) * TICK
    torque = 15 * multisine(rng, time, np.geomspace(3, 50, 60))
    bed = Testbed(soft_loop(joint, gr.Drive(400.0, 0.8, 2e-3), 1.0, 0.7, TICK), gravity=weight, substep=TICK / 4)
    run = simulate(bed, Scenario(np.full((len(time), 1), 0.3), time[-1], feedforward=torque[:, None]))
    angles = np.hstack([run.motor_position, run.link_position])
    rates = sysid_peer.true_rates(angles, run.actual_torque[:, 0], joint.motor_inertia, TICK)
    given = sysid_peer.Given(TICK, sysid_peer.over_ticks(run.actual_torque[:, 0]), angles[:, 0], angles, rates, weight)
    truth = {"motor_inertia": 0.2, "link_inertia": 0.8, "stiffness": 3000.0, "damping": 1.0}
    found = sysid_peer.fit(given, [(0.05, 15), (0.1, 15)], {name: identification.OFF[name] * value for name, value in truth.items()})
    for name in ("motor_inertia", "link_inertia", "stiffness"):
        assert found[name][0] == approx(truth[name], rel=1e-3)  # what a torque that is read once a tick tells
    assert found["resonance"][0] == approx(joint.resonance, rel=1e-3)
    assert found["damping"][0] == approx(1.0, rel=1e-2)


def test_without_sysid_the_benchmark_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setattr(identification, "is_installed", lambda: False)
    print_table(identification.run(seed=0))
    assert "pip install 'mujoco[sysid]'" in capsys.readouterr().out


@pytest.mark.slow
def test_the_readme_has_what_people_do_instead_as_it_is_measured():
    rows = [line for line in markdown(habits.run(seed=2017)).splitlines() if line.startswith("|")]
    assert len(rows) == 6
    assert "\n".join(rows) in (ROOT / "README.md").read_text("utf-8")
