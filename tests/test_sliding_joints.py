"""Joints that slide are told in m and N, hinges in rad and N m, wherever a person reads."""

import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from gainroom.cli import main
from gainroom.robot import load_model
from robot_truths import hinge, link, write_robot

ROBOT = """\
model: {file: robot.urdf, base: fixed}
joints: {default: {motor_inertia: 2.0, stiffness: 5e4, damping: 20}}
drive: {bandwidth: 3000, delay_ms: 2}
control: {type: pd, feedback: motor, kp: 900, kd: 120}
"""


def cart(folder: Path, second: str) -> Path:
    """A cart on a rail, and on it a second joint of the given kind."""
    links = link("base") + link("cart", 4.0, (0, 0, 0.1), (0.1, 0.1, 0.1)) + link("pole", 3.0, (0, 0, 0.2), (0.5, 0.5, 0.1))
    write_robot(folder, links, hinge("rail", "base", "cart", kind="prismatic") + hinge("pole", "cart", "pole", kind=second))
    (folder / "robot.yaml").write_text(ROBOT, "utf-8")
    (folder / "gains.yaml").write_text('".*": {kp: 900, kd: 120, motor_inertia: 2}', "utf-8")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("command", ["robot", "audit"])
@pytest.mark.parametrize("second", ["prismatic", "revolute"])
def test_units_in_terminal_and_page(tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, second: str):
    folder = cart(tmp_path, second)
    report = folder / "out.html"
    call = ["robot", str(folder / "robot.yaml")]
    if command == "audit":
        call = ["audit", str(folder / "robot.urdf"), "--delay-ms", "2", "--gains", str(folder / "gains.yaml")]
    call += ["--verbose"]
    assert main([*call, "--report", str(report)]) == 3  # no rate: nothing is decided
    terminal = " ".join(capsys.readouterr().out.split())
    page = " ".join(unescape(re.sub(r"<(script|style).*?</\1>", "", report.read_text("utf-8"), flags=re.S)).split())
    for text in (terminal, page):
        assert ("Prismatic joints: rail." in text) == (second == "revolute")
        for hinges, slides in (("N·m/rad", "N/m"), ("N·m·s/rad", "N·s/m"), ("kg·m²", "kg")):
            assert (f"[{slides}]" in text) == (second == "prismatic")
            assert (f"[{hinges}; prismatic {slides}]" in text) == (second == "revolute")
            assert f"[{hinges}]" not in text
    if second == "prismatic":
        assert "N·m" not in page


def test_which_joints_slide(tmp_path: Path):
    body = load_model(cart(tmp_path, "continuous") / "robot.urdf")
    np.testing.assert_array_equal(body.prismatic, [True, False])
    (tmp_path / "slide.xml").write_text(
        '<mujoco><worldbody><body><joint name="a" axis="1 1 0"/><geom size=".1" mass="1"/><body><joint name="b" type="slide" axis="1 0 1"/>'
        '<geom size=".1" mass="1"/></body></body></worldbody></mujoco>',
        "utf-8",
    )
    np.testing.assert_array_equal(load_model(tmp_path / "slide.xml").prismatic, [False, True])


def test_the_force_of_a_slide_is_told_in_newtons(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = cart(tmp_path, "revolute")
    text = ROBOT.replace("feedback: motor", "feedback: motor, sample_rate_hz: 1000")
    (folder / "robot.yaml").write_text(text + "scenario: {duration: 0.5, move: {joint: '.*', by: 0.01, duration: 0.3}}\n", "utf-8")
    assert main(["simulate", str(folder / "robot.yaml"), "--verbose"]) != 2
    rows = capsys.readouterr().out.partition("Joints with the largest torques")[2].partition("Vibration")[0].splitlines()
    (rail,), (pole,) = ([line for line in rows if line.startswith(f" {name} ")] for name in ("rail", "pole"))
    assert rail.endswith(" N")
    assert pole.endswith(" N·m")
