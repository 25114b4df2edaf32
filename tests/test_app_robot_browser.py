"""A robot's page in a browser: states, joints, gains of tasks and cascades, payload, search."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app_pages import CERTIFIED, Served, open_tab, serving
from gainroom.app.messages import View
from gainroom.files.robot_yaml import parse_robot
from test_app_robot import CASCADES, LAWS, TYPED, bench_of, command, of_tasks

pytest.importorskip("pinocchio")
pytest.importorskip("uvicorn", reason="the extra gainroom[app] is not installed")


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    file = tmp_path_factory.mktemp("app") / "robot.yaml"
    file.write_text(
        TYPED.format(delay=2.0, gains="kp: 2000.0, kd: 100.0", rate="").replace(
            "{left: [left_sole]}", "{left: [left_sole], both: [left_sole, right_sole]}"
        ),
        "utf-8",
    )
    with serving(file) as found:
        yield found


@pytest.mark.slow
def test_states_are_chosen_in_the_heat_map_and_joints_posed(browser: Any, served: Served):
    tab = open_tab(browser, served.address)
    tab.settle(CERTIFIED)
    first = tab.text("#sentence")
    tab.page.get_by_role("button", name="left_knee, stand / both").click()
    tab.settle(CERTIFIED)
    view = tab.view()
    assert (view["joint"], view["contact"]) == ("left_knee", "both")
    assert tab.page.locator("#joint").input_value() == "left_knee"
    assert tab.page.locator("[data-area=stable]").count() == 1
    assert tab.text("#sentence") == first  # of all states
    tab.drag((0.6, 0.9))
    tab.settle(CERTIFIED)
    assert tab.view()["gains"]["left_knee"] != {"kp": 2000.0, "kd": 100.0}
    assert tab.text("#sentence").startswith("Not safe: unstable")
    tab.page.get_by_text("Posture: where").click()
    tab.page.locator("#angle-right_knee").fill("1.3")
    tab.settle(CERTIFIED)
    assert tab.view()["angles"] == {"right_knee": 1.3}
    other = open_tab(browser, tab.page.url)
    other.settle(CERTIFIED)
    assert other.view() == tab.view()
    for _ in range(3):
        tab.page.get_by_role("button", name="Undo").click()
    tab.settle(CERTIFIED)
    assert tab.view()["angles"] == {}
    assert not tab.said


@pytest.mark.slow
def test_names_out_of_a_file_stay_text(browser: Any, tmp_path: Path):
    """A joint, posture and contact whose names would be script if they were ever put into markup."""
    evil = "<img src=x onerror=window.broken=1>"
    model = Path(__file__).parents[1] / "examples" / "robot.xml"
    (tmp_path / "robot.xml").write_text(model.read_text("utf-8").replace('"knee"', f'"{evil.replace("<", "&lt;")}"'), "utf-8")
    (tmp_path / "robot.yaml").write_text(
        f"model: {{file: robot.xml}}\njoints: {{default: {{motor_inertia: 0.1, stiffness: 1.0e+4}}}}\n"
        f"drive: {{bandwidth: 4000, delay_ms: 2}}\npostures: {{'{evil}': {{}}}}\n"
        f"contacts: {{'{evil}': []}}\ncontrol: {{type: pd, space: joint, feedback: motor, kp: 50, kd: 3}}\nlimits: {{}}\n",
        "utf-8",
    )
    with serving(tmp_path / "robot.yaml") as own:
        tab = open_tab(browser, own.address)
        tab.settle(CERTIFIED)
        assert tab.page.evaluate("() => window.broken") is None
        assert evil in tab.text("#states")
        tab.page.locator("#joint").select_option(evil)
        tab.settle(CERTIFIED)
        assert not tab.said


@pytest.mark.slow
def test_a_cascade_is_dragged_undone_copied_and_saved(browser: Any, tmp_path: Path):
    file, text = tmp_path / "robot.yaml", TYPED.replace("type: pd", "type: ppi").replace("[left_sole]}", "[left_sole], flight: []}")
    file.write_text(text.format(delay=2.0, gains=LAWS["ppi"][0], rate=""), "utf-8")
    with serving(file) as own:
        tab = open_tab(browser, own.address)
        tab.page.locator("#joint").select_option("right_knee")
        tab.settle(CERTIFIED)
        tab.page.locator("[data-area=every]").first.wait_for()  # two states
        tab.drag((0.4, 0.3))
        tab.settle(CERTIFIED)
        gains = tab.view()["gains"]["right_knee"]
        assert gains["ki"] / gains["kv"] == pytest.approx(0.2, rel=1e-6)  # held, to seven digits
        assert float(tab.page.locator("#gain-kv").input_value()) == gains["kv"]
        tab.page.locator("#gain-ki").fill("30")
        tab.page.locator("#gain-ki").press("Tab")
        tab.settle(CERTIFIED)
        assert tab.view()["gains"]["right_knee"] == {**gains, "ki": 30.0}
        tab.page.get_by_role("button", name="Copy gains").click()
        assert tab.page.locator("#forms button").all_inner_texts() == ["YAML"]
        tab.page.get_by_role("button", name="YAML").click()
        tab.page.get_by_text("Copied").wait_for()
        assert "right_knee: 30" in tab.page.evaluate("navigator.clipboard.readText()")
        other = open_tab(browser, tab.page.url)
        other.settle(CERTIFIED)
        assert other.view() == tab.view()
        tab.page.get_by_role("button", name="Undo").click()
        tab.settle(CERTIFIED)
        assert tab.view()["gains"]["right_knee"] == gains
        tab.page.get_by_role("button", name="Save").click()
        tab.page.locator("#dialog[open]").wait_for()
        tab.page.locator("#confirm").click()
        tab.page.get_by_text("Saved").wait_for()
        assert not tab.said
    k = parse_robot(file.read_text("utf-8"), "read.yaml").source.joint_names.index("right_knee")
    saved = parse_robot(file.read_text("utf-8"), "read.yaml").control.controller
    assert {name: float(np.broadcast_to(getattr(saved, name), 12)[k]) for name in ("kp", "kv", "ki")} == gains


SAID = """() => { window.said = []; new MutationObserver(() => said.push(document.querySelector('#map .legend').textContent))
    .observe(document.querySelector('#map .legend'), { childList: true, subtree: true }); }"""


@pytest.mark.slow
def test_a_payload_is_slid_and_a_search_stopped(browser: Any, tmp_path: Path):
    """What is shown with a payload is what the file with it says; a search ends at a press, and where it would be of another robot."""
    (tmp_path / "robot.yaml").write_text(of_tasks("pd kp: [50, 90, 200], kd: [5, 8, 15]"), "utf-8")
    with serving(tmp_path / "robot.yaml") as own:
        tab = open_tab(browser, own.address)
        tab.settle(CERTIFIED)
        tab.page.locator("#payload_at").select_option("right_foot")
        tab.page.locator("#payload-typed").fill("6")
        tab.page.locator("#payload-typed").press("Enter")
        tab.settle(CERTIFIED)
        view = tab.view()
        assert (view["payload"], view["payload_at"]) == (6.0, "right_foot")
        other = open_tab(browser, tab.page.url)
        assert other.view() == view
        typed = bench_of(of_tasks("pd kp: [50, 90, 200], kd: [5, 8, 15]")).text(View(payload=6.0, payload_at="right_foot"))
        assert "mass: 6" in typed
        assert tab.text("#sentence") == command(tmp_path, typed)["sentence"]
        find, stop = (tab.page.get_by_role("button", name=name) for name in ("Find gains", "Stop the search"))
        find.click()
        stop.click()
        find.click()
        stop.wait_for()
        tab.page.evaluate(SAID)
        tab.page.locator("#delay_ms").fill("1.8")
        tab.page.get_by_text("the search has ended, as other values than gains have changed").wait_for()
        find.wait_for()
        tab.settle(CERTIFIED)
        tab.page.wait_for_function("() => said.some((text) => text.includes('Being computed: where every requirement is met'))")
        tab.page.wait_for_function("() => !document.querySelector('#map .legend').textContent.includes('Being computed')")
        assert tab.text("#map .legend").startswith("Areas: sampled, not certified; what is certified of ● is said in the verdict.")
        assert tab.text("#basis").startswith("Certified in every state by root counts")
        find.click()
        stop.wait_for()
        tab.drag((0.4, 0.3))  # gains alone: the search goes on, and the verdict does not wait for it
        tab.settle(CERTIFIED)
        assert not tab.said + other.said


@pytest.mark.slow
def test_the_step_of_a_task_direction_has_its_unit(browser: Any, tmp_path: Path):
    text = CASCADES.replace("  left: [left_sole]\n  right: [right_sole]\n  flight: []\n", "")  # one state to certify behind it
    (tmp_path / "robot.yaml").write_text(text.partition("limits:")[0] + "limits: {}\n", "utf-8")
    with serving(tmp_path / "robot.yaml") as own:
        tab = open_tab(browser, own.address)
        for name, unit in (("com z", "1 m/s²"), ("pelvis x", "1 rad/s²")):
            tab.page.locator("#joint").select_option(name)
            tab.page.get_by_text(f"Position under a load: what would move the links by {unit}").wait_for()
        assert [field.get_attribute("id") for field in tab.page.locator("#gains input").all()] == ["gain-kp", "gain-kd"]  # of a PD task
        assert not tab.said


@pytest.mark.slow
def test_recommended_gains_of_tasks_are_found_and_taken(browser: Any, tmp_path: Path):
    continuous = of_tasks("pd kp: [50, 90, 200], kd: [5, 8, 15]").replace("delay_ms: 1.5", "delay_ms: 1.5, clock: continuous")
    (tmp_path / "robot.yaml").write_text(continuous, "utf-8")  # without a clock gains just within the limits miss them at every usual rate
    with serving(tmp_path / "robot.yaml") as own:
        tab = open_tab(browser, own.address)
        tab.settle(CERTIFIED)
        tab.page.get_by_role("button", name="Find gains").click()
        tab.page.get_by_role("button", name="Use recommended").click()
        tab.settle(CERTIFIED)
        assert "every requirement is met" in tab.text("#sentence")
        assert "root counts" in tab.text("#basis")
        tab.page.get_by_text("★ recommended (meets every requirement in every state; limits certified)").wait_for()
        assert tab.text("#snap") == "★ Recommended"  # and not offered again
        assert tab.page.locator("#snap").is_disabled()
        tab.page.get_by_role("button", name="Undo").click()
        tab.settle(CERTIFIED)
        assert tab.page.get_by_role("button", name="Use recommended").is_enabled()
        assert tab.view()["gains"]["com x"] == {"kp": 50.0, "kd": 5.0}
        assert not tab.said
