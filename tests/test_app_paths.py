"""The page on a joint whose kd runs in the drive: it opens, is dragged, and says at rest what `gainroom joint` says."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gainroom as gr
from app_pages import CERTIFIED, open_tab, serving
from gainroom.app.bench import Opened
from gainroom.app.joint_bench import JointBench
from gainroom.app.messages import View
from gainroom.app.path_parts import plane, step
from gainroom.cli import main
from gainroom.errors import GainroomError
from gainroom.files.joint_yaml import parse_joint
from gainroom.simulation.step_response import step_response
from gainroom.system.delay_reserve import response_of_paths

TEXT = """\
joint: {{motor_inertia: 1.0, link_inertia: 16.0, stiffness: 1.0e4, damping: 1.0}}
drive: {{bandwidth: 4000, damping_ratio: 0.9, delay_ms: 2.0}}
control: {{type: pd, kp: {kp}, kd: {kd}, feedback: motor, sample_rate_hz: 2000{path}}}
limits: {{peak_sensitivity: 2, phase_margin_deg: 30}}
"""
DRIVE = ", kd_path: {delay_ms: 0.1, sample_rate_hz: 20000}"
AS_THE_HOST = ", kd_path: {delay_ms: 2, sample_rate_hz: 2000}"


def text(kp: float = 5000, kd: float = 300, path: str = DRIVE) -> str:
    return TEXT.format(kp=kp, kd=kd, path=path)


def bench(kp: float = 5000, kd: float = 300, path: str = DRIVE) -> JointBench:
    return JointBench(Opened(text(kp, kd, path), "joint.yaml", Path()))


def silent(done: int, total: int, what: str) -> None:
    """Progress that nobody sees."""


def test_it_is_dragged_by_stability_alone():
    """Beside the ends that `margins` finds by following eigenvalues: just inside stable, just outside not."""
    own = bench()
    assert own.opening()["point"] == (5000.0, 300.0)
    paths = gr.margins(parse_joint(text(), "joint.yaml", two_paths=True).loop()).paths
    assert paths is not None
    gains: dict[Any, Any]
    for gains, stable in (
        ({"kp": 5000 * paths.others * 0.99}, True),
        ({"kp": 5000 * paths.others * 1.01}, False),
        ({"kd": 300 * paths.kd * 0.99}, True),
        ({"kd": 300 * paths.kd * 1.01}, False),
        ({"kd": 300 * paths.lower_kd * 1.01}, True),
        ({"kd": 300 * paths.lower_kd * 0.99}, False),
    ):
        parts = dict(own.quick(View(gains=gains), None, ""))
        assert parts.keys() == {"verdict", "bode"}
        assert parts["verdict"]["stable"] is stable
        assert parts["verdict"]["tone"] == ("bare" if stable else "bad")
        assert parts["verdict"]["rows"] == []


def test_the_plane_is_cut_where_stability_ends():
    """On the line of the file's kp the outline crosses kd where `margins` loses the loop, to the last halving: 1/24/2^8 of the window."""
    system = parse_joint(text(), "joint.yaml", two_paths=True)
    paths = gr.margins(system.loop()).paths
    assert paths is not None
    window = (10000.0, 2 * 300 * paths.kd)
    kps, kds = (np.array(column, dtype=float) for column in plane(system, window)["stable"][0])
    upper, lower = (part[np.argsort(part[:, 0])] for part in np.array_split(np.column_stack([kps, kds])[:-1], 2)[::-1])
    share = 1e-3 + 14 / 28 * (1 - 1e-3)  # the middle line of 29
    system = system.with_controller(gr.PD(share * window[0], 300.0))
    paths = gr.margins(system.loop()).paths
    assert paths is not None
    found = [np.interp(share * window[0], *line.T) for line in (lower, upper)]
    assert sorted(found) == pytest.approx(sorted([300 * paths.lower_kd, 300 * paths.kd]), abs=window[1] / 24 / 2**8 + 1e-4 * window[1])


@pytest.mark.slow
def test_at_rest_it_says_what_joint_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Gains that were dragged, written and judged by the command line: sentence, requirements, and what is missed."""
    own, view = bench(), View(gains={"kp": 3000.0, "kd": 30.0})
    path = tmp_path / "joint.yaml"
    path.write_text(own.text(view), "utf-8")
    assert own.text(view) == text(3000, 30)
    main(["joint", str(path), "--json"])
    said = json.loads(capsys.readouterr().out)
    parts = dict(own.full(view, None, silent))
    assert parts.keys() == {"verdict", "use"}
    verdict = parts["verdict"]
    assert verdict["sentence"] == said["sentence"]
    assert verdict["unmet"] == said["unmet"] != []
    assert verdict["met"] is said["requirements_met"] is False
    rows = {row["name"]: row for row in verdict["rows"]}
    assert rows["peak_sensitivity"]["met"] is False
    assert rows["peak_sensitivity"]["required"] == "≤ 2"
    assert float(rows["peak_sensitivity"]["worst"]) == pytest.approx(said["worst"]["peak_sensitivity"]["value"], rel=5e-3)  # three digits
    assert "covers" not in verdict
    assert parts["use"]["gains"] is None
    with pytest.raises(GainroomError, match="no page where kd closes on a path of its own"):
        own.page(view)


@pytest.mark.slow
def test_it_says_what_is_certified_over_ranges():
    """Nominal margins come first; of the ranges nothing is proved between corners and samples."""
    own = JointBench(Opened(text(path=DRIVE) + "uncertainty: {stiffness: 5%}\n", "joint.yaml", Path()))
    verdicts = [part for kind, part in own.full(View(), None, silent) if kind == "verdict"]
    assert [part["basis"] for part in verdicts] == ["nominal", "certified"]
    assert "corners and samples" in verdicts[-1]["covers"]


def test_pictures_are_those_of_one_path_where_both_are_alike():
    """kd at the host's rate and delay: the step is that of the PD, and far below half the rate so is the open loop."""
    (alike, one) = (parse_joint(text(path=path), "joint.yaml", two_paths=True) for path in (AS_THE_HOST, ""))
    drawn, exact = step(alike), step_response(one.loop())
    time = 1e-3 * np.array(drawn["ms"], dtype=float)
    for name, side in (("reference", exact.reference), ("disturbance", exact.load)):
        scale = 1.0 if name == "reference" else float(drawn["added"].split()[0]) * 1e3
        for key, curve in ((name, side.link), (f"{name}_motor", side.motor)):
            shown = time < exact.time[-1]
            moved = np.array(drawn[key], dtype=float)[shown]
            # the testbed steps in parts of a tick, and the picture has 5 digits
            assert moved == pytest.approx(scale * np.interp(time[shown], exact.time, curve), abs=2e-3 * scale * np.abs(curve).max())
    omega = np.geomspace(1.0, 0.05 * np.pi / 5e-4, 40)
    assert response_of_paths(alike.loop(), omega) == pytest.approx(one.loop().response(omega), rel=5e-3)  # aliases: (0.05)² of the plant


@pytest.mark.slow
def test_it_opens_and_is_dragged_in_a_browser(browser: Any, tmp_path: Path):
    """The dot to twice kp: stable while it moves, judged where it rests; then the drive is left for the host, where these gains shake."""
    (tmp_path / "joint.yaml").write_text(text(), "utf-8")
    with serving(tmp_path / "joint.yaml") as served:
        tab = open_tab(browser, served.address)
        tab.settle(CERTIFIED)
        first = tab.text("#sentence")
        assert first.startswith("Safe")
        assert "without aliases" in tab.text("#bode figcaption")
        assert "without aliases" in tab.text("#side figcaption")
        tab.drag((0.8, 0.6))
        tab.settle(CERTIFIED)
        assert tab.view()["gains"]["kp"] > 5000
        assert tab.text("#sentence") != first
        assert tab.page.locator("#snap").is_disabled()
        tab.page.locator("#structure").select_option("pd")
        tab.settle(CERTIFIED)
        assert "without aliases" not in tab.text("#bode figcaption")
        assert tab.text("#sentence").startswith(("Unstable", "UNSTABLE", "Not safe"))
        assert not tab.said


def test_kd_in_the_drive_is_chosen_from_a_pd_and_left_again():
    """The drive's own loop is that of section compare, where the file has one."""
    own = bench(1600, 64, "")
    view = View(structure="split")
    assert "kd_path: {delay_ms: 0.1, sample_rate_hz: 20000}" in own.text(view)
    assert own.system(view).control.kd_path == gr.GainPath(1e-4, 5e-5)
    offered: dict[str, Any] = own.opening()["structures"]
    assert offered["split"]["bode_of"]
    assert not offered[""]["bode_of"]
    given = text(1600, 64, "") + "compare: {drive_path: {delay_ms: 0.2, sample_rate_hz: 10000}}\n"
    other = JointBench(Opened(given, "joint.yaml", Path()))
    assert other.system(view).control.kd_path == gr.GainPath(2e-4, 1e-4)
    back = bench()
    assert back.system(View(structure="pd")).control.kd_path is None
    assert back.text(View(structure="split")).count("kd_path") == 1
