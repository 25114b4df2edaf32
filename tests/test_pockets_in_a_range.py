"""Ranges of what is uncertain whose ends are good and whose middle is not: a resonance that is damped by short and by long delays alone."""

import json
from pathlib import Path

import numpy as np
import pytest

import gainroom as gr
from gainroom.cli import main
from gainroom.files.robot_yaml import parse_robot
from gainroom.studies.robot import study_robot
from gainroom.system.system import System
from robot_truths import hinge, link, write_robot

SHORTEST, LONGEST = 2.5e-3, 18e-3
ROBOT = """\
model: {{file: robot.urdf, base: fixed}}
joints: {{default: {{motor_inertia: 0.05, stiffness: 5e3, damping: {damping}}}}}
drive: {{bandwidth: 3000, delay_ms: 17}}
postures: {{bent: {{hip: 0.3, knee: -0.8}}}}
control: {{type: pd, feedback: motor, kp: {{hip: 5, knee: 2}}, kd: {{hip: 1, knee: 0.4}}}}
uncertainty: {{delay_ms: [2.5, 18]}}
limits: {{gain_margin_db: 6}}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two links in a plane."""
    path = tmp_path_factory.mktemp("arm")
    links = link("base") + link("upper", 4.0, (0, 0, 0.25), (0.1, 0.1, 0.01)) + link("lower", 3.0, (0, 0, 0.2), (0.05, 0.05, 0.01))
    write_robot(path, links, hinge("hip", "base", "upper") + hinge("knee", "upper", "lower", (0, 0, 0.5)))
    return path


def growth(system: System, delay: float) -> float:
    """Of the rightmost root, found by spectral discretisation and Newton."""
    return float(gr.rightmost_roots(system.with_values(delay=delay).loop()).roots[0].real)


@pytest.mark.slow
@pytest.mark.parametrize("damping", [0.05, 0.5, 0.9], ids=["wide", "medium", "narrow"])
def test_a_range_that_is_unstable_in_its_middle_is_not_called_safe(
    folder: Path, damping: float, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    text = ROBOT.format(damping=damping)
    system = parse_robot(text, "f", folder)
    assert growth(system, SHORTEST) < 0
    assert growth(system, LONGEST) < 0
    assert max(growth(system, delay) for delay in np.linspace(SHORTEST, LONGEST, 60)) > 0
    (folder / "robot.yaml").write_text(text, "utf-8")
    monkeypatch.chdir(folder)
    assert main(["robot", "robot.yaml", "--json", "--report", "robot.html"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["stable"]
    assert told["stable_in_range"] is False
    assert told["requirements_met"] is False
    assert "✓" not in (folder / "robot.html").read_text("utf-8").partition("Vibration at the limit")[0]  # no margin counts as met
    assert growth(system, 1e-3 * float(told["unstable_at"].partition("delay ")[2].partition(" ms")[0])) > 0


@pytest.mark.slow
def test_recommended_gains_hold_within_the_range(folder: Path):
    """At delays that the search has not seen: vibration starts where it says at the earliest."""
    system = parse_robot(ROBOT.format(damping=2.0), "f", folder)
    study = study_robot(system)
    assert study.to_use is not None
    _, found = study.to_use
    own = system.with_controller(gr.PD(found.kp, found.kd))
    least = min(gr.gain_limit(own.with_values(delay=delay).loop()).gain for delay in np.linspace(SHORTEST, LONGEST, 40))
    assert found.margins.limit.gain >= 10 ** (6 / 20)
    assert least > 0.98 * found.margins.limit.gain  # between the places that were looked at, where nothing is proved


@pytest.mark.slow
def test_a_state_in_which_nothing_moves_has_no_part_in_it(folder: Path):
    """A flat contact holds both links, on which the encoders are: recommended gains are those without that state."""
    text = ROBOT.format(damping=2.0).replace("[2.5, 18]", "[1, 2]").replace("17", "1.5").replace("feedback: motor", "feedback: link")
    alone, both = (study_robot(parse_robot(text + more, "f", folder)) for more in ("", "contacts: {free: [], held: [lower]}\n"))
    assert [state.contact for state in both.immobile] == ["held"]
    assert alone.to_use is not None
    assert both.to_use is not None
    assert both.to_use[1].kp.tolist() == alone.to_use[1].kp.tolist()
    assert both.to_use[1].kd.tolist() == alone.to_use[1].kd.tolist()
