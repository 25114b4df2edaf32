"""Saving from the page: as often as one likes, by any page, and never over what somebody else has written."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from gainroom.app.bench import Bench, Opened, digest_of
from gainroom.app.joint_bench import JointBench
from gainroom.app.messages import View
from gainroom.app.robot_bench import RobotBench
from gainroom.errors import GainroomError
from gainroom.io.yaml_text import parse_yaml
from robot_files import ROBOT, write_arm
from test_cli import EXAMPLES

pytest.importorskip("uvicorn", reason="the extra gainroom[app] is not installed")
from gainroom.app.server import _Newest
from gainroom.app.session import Session


@dataclass
class Page:
    """What a session answers, without a socket."""

    bench: Bench

    def asked(self, gains: dict[str, Any], digest: str = "") -> dict[str, Any]:
        session = object.__new__(Session)
        session._bench, session._known = self.bench, {}
        ask = type("Ask", (), {"ask": "save", "view": View(gains=gains), "digest": digest})()
        ((name, part),) = session._parts(ask, "text", lambda: False)
        return {"part": name, **part}

    def saved(self, gains: dict[str, Any]) -> str:
        """The difference is looked at, then saved, as the page does it; what it is said to have been."""
        seen = self.asked(gains)
        done = self.asked(gains, seen["digest"])
        assert (done["part"], done["text"]) == ("saved", seen["text"])
        return done["text"]


@pytest.fixture(params=["joint", "robot"])
def opened(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Bench, Path]:
    if request.param == "robot":
        file = write_arm(tmp_path, ROBOT.partition("tasks:")[0])
        return RobotBench(Opened(file.read_text("utf-8"), str(file), tmp_path, file)), file
    file = tmp_path / "joint.yaml"
    file.write_text(EXAMPLES["fig9"], "utf-8")
    return JointBench(Opened(EXAMPLES["fig9"], str(file), tmp_path, file)), file


def gains_of(bench: Bench, factor: float) -> dict[str, Any]:
    """The view's gains, all kp times a factor; of a robot by the joint's name first."""

    def scaled(found: dict[str, Any]) -> dict[str, Any]:
        return {key: scaled(each) if isinstance(each, dict) else factor * each if key == "kp" else each for key, each in found.items()}

    return scaled(json.loads(json.dumps(bench.opening()["view"]["gains"])))


def kp_in(file: Path) -> Any:
    return parse_yaml(file.read_text("utf-8"), "file")["control"]["kp"]


def test_it_saves_again_and_again_and_back(opened: tuple[Bench, Path]):
    """Each difference is that to what stands there, and the values of the beginning are the text of the beginning."""
    bench, file = opened
    before, first = file.read_text("utf-8"), kp_in(file)
    page = Page(bench)
    for factor in (0.5, 0.25, 0.75):
        difference = page.saved(gains_of(bench, factor))
        assert kp_in(file) != first
        assert difference.count("\n+") == 2  # the heading, and one line
        assert page.asked(gains_of(bench, factor))["text"] == ""  # nothing is left to save
    assert page.saved(gains_of(bench, 1.0))
    assert file.read_text("utf-8") == before


def test_what_was_changed_elsewhere_is_not_overwritten(opened: tuple[Bench, Path]):
    """Neither before nor after a page has saved; put back, it may be saved again."""
    bench, file = opened
    page = Page(bench)
    for factor in (0.5, 0.25):
        ours = file.read_text("utf-8")
        file.write_text(ours + "# of somebody else\n", "utf-8")
        with pytest.raises(GainroomError, match="has changed since this page read or saved it"):
            page.saved(gains_of(bench, factor))
        assert file.read_text("utf-8") == ours + "# of somebody else\n"
        file.write_text(ours, "utf-8")
        page.saved(gains_of(bench, factor))


def test_a_page_that_is_loaded_again_opens_what_was_saved(opened: tuple[Bench, Path]):
    """And a page of before, which has not seen what the new one saved, is told to load again."""
    bench, _ = opened
    newest = _Newest(bench)
    assert newest.bench() is bench
    old = Page(bench)
    old.saved(gains_of(bench, 0.5))
    again = Page(newest.bench())
    assert again.bench is not bench
    assert newest.bench() is again.bench
    assert again.bench.opening()["view"]["gains"] == gains_of(bench, 0.5)
    assert again.asked(gains_of(again.bench, 1.0))["text"] == ""
    again.saved(gains_of(again.bench, 0.5))
    with pytest.raises(GainroomError, match="load the page again"):
        old.saved(gains_of(bench, 0.75))


def test_what_was_not_seen_is_not_saved(opened: tuple[Bench, Path]):
    bench, file = opened
    page, before = Page(bench), file.read_text("utf-8")
    with pytest.raises(GainroomError, match="have changed since the difference was shown"):
        page.asked(gains_of(bench, 0.5), digest_of("something else"))
    assert file.read_text("utf-8") == before


def test_copied_gains_have_the_limits_of_the_file(tmp_path: Path):
    """As the forms of export have them; a joint without a limit gets none."""
    import mujoco

    text = ROBOT.partition("tasks:")[0].replace("joints:\n", "joints:\n  elbow: {effort_limit: 30.0}\n", 1)
    assert "effort_limit" in text
    file = write_arm(tmp_path, text)
    bench = RobotBench(Opened(text, str(file), tmp_path, file))
    view = View()
    assert "u_clamp_max: 30.0, u_clamp_min: -30.0" in bench.copied(view, "ros2_control")
    links = '<body><joint name="{0}"/><geom size="0.1"/></body>'
    bodies = "".join(links.format(name) for name in ("shoulder", "elbow"))
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody>{bench.copied(view, 'mjcf')}</mujoco>")
    assert model.actuator_forcelimited.tolist() == [0, 1]
    assert model.actuator_forcerange[1].tolist() == [-30, 30]
