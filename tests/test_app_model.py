"""`gainroom app MODEL`: the page opens on the robot that `gainroom audit MODEL --write-robot` writes, with its numbers."""

import io
import json
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from app_pages import CERTIFIED, open_tab, serving, tab_in
from gainroom.app.bench import Opened
from gainroom.app.messages import View
from gainroom.app.robot_bench import RobotBench
from gainroom.cli import main

pytest.importorskip("pinocchio")
pytest.importorskip("mujoco")
pytest.importorskip("uvicorn", reason="the extra gainroom[app] is not installed")

LEG = """<mujoco model="leg"><compiler angle="radian"/><worldbody>
<body name="thigh" pos="0 0 1"><joint name="hip" axis="0 1 0" range="-1.8 0.8" armature="0.025"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.05" mass="4"/>
<body name="shank" pos="0 0 -0.4"><joint name="knee" axis="0 1 0" range="0 2.3" armature="0.025"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.04" mass="3"/></body></body></worldbody>
<actuator><position name="hip" joint="hip" kp="98.7" kv="6.28"/><position name="knee" joint="knee" kp="98.7" kv="6.28"/></actuator>
<keyframe><key name="squat" qpos="-0.6 1.2"/></keyframe></mujoco>"""
SCENE = """<mujoco><include file="leg.xml"/><keyframe><key name="kneel" qpos="-0.2 2.0"/></keyframe></mujoco>"""
OPTIONS = ("--delay-ms", "4", "--stiffness", "2000", "--damping", "2", "--rate-hz", "1000")

DRAWN = "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))"
CORNERS = ("0.2 0 0", "-0.1 0.2 0", "-0.1 -0.2 0", "0 0 0.9")
FACET = "facet normal 0 0 0\nouter loop\nvertex {}\nvertex {}\nvertex {}\nendloop\nendfacet\n"
FACETS = "".join(FACET.format(*(CORNERS[k] for k in face)) for face in ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)))
TETRAHEDRON = f"solid part\n{FACETS}endsolid part\n"
INERTIA = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
MESHES = f"""<robot name="r"><link name="base">{INERTIA}</link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 3"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<link name="arm">{INERTIA}<visual><geometry><mesh filename="part.stl"/></geometry></visual></link></robot>"""
ROBOT = """model: {file: robot.urdf}
joints: {default: {motor_inertia: 0.1, stiffness: 1000, damping: 1}}
drive: {bandwidth: 4000, delay_ms: 2}
control: {type: pd, space: joint, feedback: motor, kp: 40, kd: 2}
limits: {gain_margin_db: 6}
"""


@pytest.fixture
def leg(tmp_path: Path) -> Path:
    (tmp_path / "leg.xml").write_text(LEG, "utf-8")
    (tmp_path / "scene.xml").write_text(SCENE, "utf-8")
    return tmp_path / "leg.xml"


def said(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    main([*words, "--json"])
    return json.loads(capsys.readouterr().out)


def bench_at(path: Path) -> RobotBench:
    return RobotBench(Opened(path.read_text("utf-8"), str(path), path.parent, path))


@pytest.mark.slow
def test_it_opens_the_robot_that_audit_writes(leg: Path, capsys):
    """The same file, byte for byte; what the page then certifies is what audit says of the same call."""
    written, opened = leg.parent / "written.yaml", leg.parent / "opened.yaml"
    audited = said(capsys, "audit", str(leg), *OPTIONS, "--posture", "squat", "--write-robot", str(written))
    call = ["app", str(leg), *OPTIONS, "--posture", "squat", "--write-robot", str(opened), "--export", str(leg.parent / "page.html")]
    assert main(call) == 0
    assert opened.read_text("utf-8") == written.read_text("utf-8")
    shown = [part for name, part in bench_at(opened).full(View(), None, lambda *_: None) if name == "verdict"][-1]
    assert [state["gain_limit"] for state in shown["states"]] == [state["gain_limit"] for state in audited["states"]]
    assert "gainroom app" in (leg.parent / "page.html").read_text("utf-8")


def test_keyframes_of_the_model_and_of_its_scene_are_presets(leg: Path):
    main(["app", str(leg), *OPTIONS, "--write-robot", str(leg.parent / "r.yaml"), "--export", str(leg.parent / "page.html")])
    frames = bench_at(leg.parent / "r.yaml").opening()["keyframes"]
    assert frames == {"squat": {"hip": -0.6, "knee": 1.2}, "kneel": {"hip": -0.2, "knee": 2.0}}


@pytest.mark.slow
def test_a_keyframe_is_taken_in_the_browser(browser: Any, leg: Path):
    with serving(leg, *OPTIONS) as own:
        tab = open_tab(browser, own.address)
        tab.settle(CERTIFIED)
        assert tab.page.locator("#save").is_hidden()  # a model holds no such gains
        tab.page.locator("#posture").select_option(label="squat")
        tab.settle(CERTIFIED)
        assert tab.view()["angles"] == {"hip": -0.6, "knee": 1.2}
        assert tab.page.locator("#posture").input_value() == "keyframe squat"
        tab.page.locator("#posture").select_option("zero")
        tab.settle(CERTIFIED)
        assert tab.view()["angles"] == {}
        assert not tab.said


REFUSED = (
    (("leg.xml",), "leg.xml: is a robot's model; its delay is needed, too: gainroom app leg.xml --delay-ms 2"),
    (("--delay-ms", "2"), "--delay-ms 2: is of a model; name a URDF or MJCF before it"),
    (("leg.xml", "--stiffness", "0"), "--stiffness: is of a model, a URDF or MJCF, and needs --delay-ms"),
    (("joint.yaml", "--margin-db", "6"), "--margin-db: is of a model, a URDF or MJCF, and needs --delay-ms"),
    (("leg.xml", "--delay-ms", "2", "--write-robot", "leg.xml"), "leg.xml: the robot.yaml would overwrite the input"),
    (("robot.yaml", "--delay-ms", "2"), "robot.yaml: must be a URDF or MJCF; it describes a whole robot: gainroom robot robot.yaml"),
    (
        ("leg.xml", "--delay-ms", "4", "--rate-hz", "500", "--gains-run", "split", "--drive-rate-hz", "20000", "--drive-delay-ms", "0.05"),
        "--gains-run split: the page has one rate and delay for all gains; gainroom audit judges two",
    ),
)


@pytest.mark.parametrize(("words", "message"), REFUSED)
def test_calls_that_mean_nothing_are_refused(words: tuple[str, ...], message: str, leg: Path, capsys, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(leg.parent)
    Path("robot.yaml").write_text("model: {file: leg.xml}\n", "utf-8")
    assert main(["app", *words, "--no-browser", "--export", "page.html"]) == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert not Path("page.html").exists()


@pytest.mark.slow
def test_gains_are_found_and_the_view_exported(browser: Any, leg: Path):
    """What a search finds meets every requirement, and the page that is taken away says so without a server."""
    with serving(leg, *OPTIONS) as own:
        tab = open_tab(browser, own.address)
        tab.settle(CERTIFIED)
        assert tab.text("#sentence").startswith("Not safe: unstable")
        tab.page.get_by_role("button", name="Find gains").click()
        tab.page.get_by_role("button", name="Use recommended").wait_for()
        tab.page.locator("[data-mark=star]").wait_for()
        tab.page.get_by_role("button", name="Use recommended").click()
        tab.settle(CERTIFIED)
        assert "every requirement is met" in tab.text("#sentence")
        assert "they follow" not in tab.text("#map .legend")  # of one state there are no others
        with tab.page.expect_download() as waiting:
            tab.page.get_by_role("button", name="Export page").click()
        taken = browser.new_context(offline=True).new_page()
        waiting.value.save_as(leg.parent / "taken.html")
        taken.goto(f"file://{leg.parent}/taken.html")
        assert tab.text("#sentence") in " ".join(taken.locator("body").inner_text().split())
        assert not tab.said


def colours(canvas: Any) -> int:
    return len(Image.open(io.BytesIO(canvas.screenshot())).convert("RGB").getcolors(1 << 24))


@pytest.mark.slow
def test_the_robot_is_drawn_and_can_be_held(browser: Any, leg: Path):
    with serving(leg, *OPTIONS) as own:
        tab = open_tab(browser, own.address, moving=True)
        tab.settle(CERTIFIED)
        tab.page.get_by_text("Vibration at the gain limit").wait_for()
        canvas = tab.page.locator("#side canvas")
        for _ in range(1000):
            if colours(canvas) > 20:  # shaded limbs on an empty ground
                break
            tab.page.wait_for_function(DRAWN)
        assert colours(canvas) > 20
        tab.page.get_by_role("button", name="Hold").click()
        tab.page.get_by_role("button", name="Move").wait_for()
        assert not tab.said


@pytest.mark.slow
def test_a_robot_whose_meshes_come_late_is_in_view(browser: Any, tmp_path: Path):
    """All of it, with white around: the camera follows what comes."""
    (tmp_path / "part.stl").write_text(TETRAHEDRON, "utf-8")
    (tmp_path / "robot.urdf").write_text(MESHES, "utf-8")
    (tmp_path / "robot.yaml").write_text(ROBOT, "utf-8")
    with serving(tmp_path / "robot.yaml") as own:
        context, held = browser.new_context(viewport={"width": 1400, "height": 1000}, reduced_motion="reduce"), []
        context.route("**/mesh/*", lambda route: held.append(route))
        tab = tab_in(context, own.address)
        tab.settle(CERTIFIED)
        assert held
        for route in held:
            route.continue_()
        canvas = tab.page.locator("#side canvas")
        for _ in range(1000):
            if colours(canvas) > 5:
                break
            tab.page.wait_for_function(DRAWN)
        picture = Image.open(io.BytesIO(canvas.screenshot())).convert("RGB")
        wide, high = picture.size
        assert len(picture.getcolors(1 << 24)) > 5
        for edge in ((0, 0, wide, 2), (0, high - 2, wide, high), (0, 0, 2, high), (wide - 2, 0, wide, high)):
            assert picture.crop(edge).getcolors() == [((edge[2] - edge[0]) * (edge[3] - edge[1]), (255, 255, 255))]
        assert not tab.said
        context.close()


@pytest.mark.slow
def test_a_run_is_played_on_the_robot_and_can_be_stopped(browser: Any, leg: Path):
    with serving(leg, *OPTIONS) as own:
        tab = open_tab(browser, own.address, moving=True)
        tab.page.locator("#delay_ms").fill("1")
        tab.settle(CERTIFIED)
        tab.page.get_by_role("button", name="Shake it").click()
        tab.page.get_by_role("button", name="Stop").click()
        tab.page.get_by_role("button", name="Shake it").wait_for()
        tab.page.get_by_role("button", name="Hold").click()  # a run then stands at its first moment
        tab.page.get_by_role("button", name="Shake it").click()
        slider = tab.page.locator("#film")
        slider.wait_for()
        slider.fill("20")
        tab.page.wait_for_function("() => Number.parseFloat(document.querySelector('.film output').textContent) > 0")
        larger = tab.page.get_by_role("button", name="Motion drawn")
        if larger.count():  # the run is small enough
            larger.click()
            assert larger.inner_text() == "Motion drawn as it is"
        tab.page.get_by_role("button", name="Critical mode").click()
        slider.wait_for(state="detached")
        assert not tab.said
