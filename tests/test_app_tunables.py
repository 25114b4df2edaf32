"""Numbers of a joint's controller beyond kp and kd that the page moves: filters, torque gains, observers."""

import json
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest

from app_pages import CERTIFIED, open_tab, serving
from gainroom.app.address import view_of
from gainroom.app.messages import View
from gainroom.errors import GainroomError
from gainroom.files.joint_yaml import parse_joint
from gainroom.io.strict_json import strict
from test_app_server import NUMBERS, answers, bench_of, command

pytest.importorskip("uvicorn", reason="the extra gainroom[app] is not installed")

JOINT = """joint: {{rotor_inertia: 1.0e-4, gear_ratio: 100, link_inertia: 16.0, stiffness: 1.0e4, damping: 1.0}}
drive: {{bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: {delay}}}
control:
  # as measured on the bench
  {control}
  sample_rate_hz: 1000
limits: {{}}
"""
PD = "type: pd\n  kp: 3400\n  kd: 540\n  feedback: motor"
SOFT = "type: pd\n  kp: 1800\n  kd: 120\n  feedback: motor"
BIQUAD = "biquads: [{{zero_frequency: {}, zero_damping: 0.2, pole_frequency: 60, pole_damping: {}}}]"
FILTERS = f"{SOFT}\n  velocity_filter: {{{{bandwidth_hz: {{}}}}}}\n  notches: [{{{{frequency: {{}}, width: 0.5, depth: 0.1}}}}]"
TORQUE = "type: torque_feedback\n  kp: {}\n  kd: 300\n  ktau: {}\n  kstau: {}\n  feedback: {{kp: motor, kd: motor, ktau: torque}}"
OBSERVER = "type: dob\n  kp: 1800\n  kd: 150\n  nominal_inertia: {}\n  bandwidth: {}\n  feedback: motor"
IN_HERTZ = "type: dob\n  kp: 1800\n  kd: 150\n  nominal_inertia: 130\n  bandwidth_hz: {}\n  feedback: motor"
LAW = "type: lti\n  motor: {{zeros: [0.99], poles: [0.7], gain: 60000}}\n  gain: {}"
PID = "type: pid\n  kp: 3400\n  ki: {}\n  kd: 300\n  feedback: motor"
CASES: dict[str, tuple[str, tuple[Any, ...], tuple[Any, ...], dict[str, float]]] = {
    "biquad": (f"{PD}\n  {BIQUAD}", (110, 0.04), (100.5, 0.06), {"biquads.0.zero_frequency": 100.5, "biquads.0.pole_damping": 0.06}),
    "filters": (FILTERS, (300, 700), (220.5, 650), {"velocity_filter.bandwidth_hz": 220.5, "notches.0.frequency": 650}),
    "torque_feedback": (TORQUE, (3000, 0.3, 0.0), (2500, -0.2, -0.01), {"kp": 2500, "ktau": -0.2, "kstau": -0.01}),
    "dob": (OBSERVER, (130, 6.5), (90, 9), {"nominal_inertia": 90, "bandwidth": 9}),
    "dob in Hz": (IN_HERTZ, (1.0,), (1.4,), {"bandwidth_hz": 1.4}),
    "lti": (LAW, (1.0,), (0.7,), {"gain": 0.7}),
    "pid": (PID, (900,), (4000,), {"ki": 4000}),
}
"""Control section, its values in the file, values that are typed, and the view that moves the same numbers there."""


def joint(control: str, values: tuple[Any, ...], delay: float = 2.0) -> str:
    return JOINT.format(control=control.format(*values), delay=delay)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_a_number_that_is_moved_is_a_number_that_is_typed(tmp_path: Path, case: str):
    """The file is typed anew for the command line; to the last bit, as it is the same computation."""
    control, file, moved, gains = CASES[case]
    bench, view = bench_of(joint(control, file)), View(gains={name: float(value) for name, value in gains.items()})
    said, before = command(tmp_path, joint(control, moved)), command(tmp_path, joint(control, file))
    quick = json.loads(json.dumps(strict(dict([next(bench.quick(view, None, ""))]))))["verdict"]
    assert {name: quick["numbers"][name] for name in NUMBERS} == {name: said[name] for name in NUMBERS}
    assert said["gain_margin_db"] != before["gain_margin_db"]
    assert bench.text(view) == joint(control, moved)
    assert bench.text(View.model_validate(bench.opening()["view"])) == joint(control, file)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["biquad", "torque_feedback", "dob", "lti"])
def test_every_part_of_the_page_is_answered(case: str):
    control, file, _, gains = CASES[case]
    bench = bench_of(joint(control, file).replace("limits: {}", "limits: {peak_sensitivity: 2}"))
    view = View(gains={name: float(value) for name, value in gains.items()})
    assert {name for name, _ in bench.curves(view, None, "", True)} == {"map", "before", "step"}
    parts = answers(bench, view)
    assert parts.keys() == {"verdict", "bode", "map", "use"}
    assert (parts["verdict"]["point"] is None) == (case != "biquad")
    assert bool(bench.opening()["structures"][""]["map_of"]) == (case != "biquad")


def test_the_observers_delay_follows_the_drives():
    """A file that leaves it out has the whole ticks of the delay and one more: of 2 ms three, of 4 ms five."""
    control, file, *_ = CASES["dob"]
    bench = bench_of(joint(control, file))
    view = View(delay_ms=4.0, gains={"bandwidth": 9.0})
    assert "delay_ticks" not in bench.opening()["view"]["gains"]
    text = bench.text(view)
    assert text == joint(control, (130, 9), 4)
    assert [parse_joint(one, "x").control.controller.delay_ticks for one in (bench.opened.text, text)] == [3, 5]
    moved, opened = (next(one.quick(each, None, ""))[1]["numbers"] for one, each in ((bench, view), (bench_of(text), View())))
    assert {name: moved[name] for name in NUMBERS} == {name: opened[name] for name in NUMBERS}


@pytest.mark.parametrize(
    ("gains", "message"),
    [({"kp": -1.0}, "gains: kp must be a number >= 0"), ({"biquads.1.zero_damping": 1.0}, "is not a gain of this controller"),
     ({"biquads.0.zero_frequency": 4000.0}, "below half the sample rate"), ({"kp": {"x": 1.0}}, "gains: kp must be a number")],
)  # fmt: skip
def test_what_cannot_be_moved_there_is_refused_in_one_line(gains: dict[str, Any], message: str):
    control, file, *_ = CASES["biquad"]
    with pytest.raises(GainroomError, match=message) as error:
        list(bench_of(joint(control, file)).quick(View(gains=gains), None, ""))
    assert "\n" not in str(error.value)


def test_copied_lines_take_the_place_of_the_files():
    control, file, moved, gains = CASES["filters"]
    bench = bench_of(joint(control, file))
    lines = bench.copied(View(gains={**gains, "kd": 100.0}), "yaml").splitlines()
    assert lines[1:3] == ["kp: 1800", "kd: 100"]
    taken = parse_joint(JOINT.format(control="\n  ".join(["type: pd", "feedback: motor", *lines[1:]]), delay=2.0), "x")
    assert taken == parse_joint(joint(control, moved).replace("kd: 120", "kd: 100"), "x")


def test_an_address_holds_them():
    assert view_of("ktau=-0.2&biquads.0.zero_damping=0.1").gains == {"ktau": -0.2, "biquads.0.zero_damping": 0.1}


@pytest.mark.parametrize("key", ["pd", "pid", "pd+biquad", "torque_feedback", "dob"])
def test_another_structure_starts_where_the_pd_stands(tmp_path: Path, key: str):
    """The PD is typed for the command line. Round-off, but of the slow observer: 0.2 % of kp/kd turns phases by some 1e-3 rad."""
    bench = bench_of(joint(SOFT, ()))
    view = View(structure=key, gains={"kp": 1700.0, "kd": 110.0})
    said = command(tmp_path, joint(SOFT.replace("1800", "1700").replace("120", "110"), ()))
    numbers = json.loads(json.dumps(strict(dict([next(bench.quick(view, None, ""))]))))["verdict"]["numbers"]
    margins = ("gain_margin_db", "phase_margin_deg", "peak_sensitivity", "delay_margin_ms")
    assert [numbers[name] for name in margins] == pytest.approx([said[name] for name in margins], rel=1e-3 if key == "dob" else 1e-9)
    written = command(tmp_path, bench.text(view))  # the file that would be saved
    assert [written[name] for name in margins] == [numbers[name] for name in margins]
    assert bench.text(view).split("control:")[0] == joint(SOFT, ()).split("control:")[0]
    lines = bench.copied(view, "yaml").splitlines()[1:]
    pasted = JOINT.split("control:")[0].format(delay=2.0) + "control:\n  " + "\n  ".join(lines) + "\nlimits: {}\n"
    assert parse_joint(pasted, "x") == parse_joint(bench.text(view), "x")
    assert view_of(f"structure={quote(key)}&kp=1700&kd=110") == view


def test_what_is_new_in_a_structure_acts_once_it_is_moved(tmp_path: Path):
    bench = bench_of(joint(SOFT, ()))
    view = View(structure="torque_feedback", gains={"ktau": -0.2})
    typed = TORQUE.format(1800, -0.2, 0.0).replace("kd: 300", "kd: 120")
    said = command(tmp_path, JOINT.format(control=typed, delay=2.0))
    numbers = next(bench.quick(view, None, ""))[1]["numbers"]
    assert numbers["peak_sensitivity"] == said["peak_sensitivity"]
    assert bench.plant(view) != bench.plant(View(structure="torque_feedback"))


@pytest.mark.parametrize(
    ("case", "key", "message"),
    [("lti", "pd", "takes the place of pd, pid, torque_feedback, dob alone"), ("pid", "observer", "must be one of pd, pid, pd.biquad")],
)
def test_a_structure_that_a_file_cannot_have_is_refused_in_one_line(case: str, key: str, message: str):
    control, file, *_ = CASES[case]
    with pytest.raises(GainroomError, match=message) as error:
        bench_of(joint(control, file)).text(View(structure=key))
    assert "\n" not in str(error.value)


def test_a_file_without_a_rate_says_why_it_has_no_observer():
    text = joint(SOFT, ()).replace("  sample_rate_hz: 1000\n", "")
    offered = bench_of(text).opening()["structures"]
    assert [key for key, each in offered.items() if "refused" in each] == ["split", "dob"]
    assert "control.sample_rate_hz is missing" in offered["dob"]["refused"]


@pytest.mark.slow
def test_a_structure_is_chosen_and_undone(browser: Any, tmp_path: Path):
    (tmp_path / "joint.yaml").write_text(joint(SOFT, ()), "utf-8")
    with serving(tmp_path / "joint.yaml") as served:
        tab = open_tab(browser, served.address)
        tab.settle(CERTIFIED)
        before = tab.text("#sentence")
        tab.page.locator("#structure").select_option("pd+biquad")
        tab.settle(CERTIFIED)
        assert tab.text("#sentence") == before  # zeros where the poles are
        tab.page.locator("[id='slide-biquads.0.pole_frequency']").press("ArrowLeft")
        tab.page.locator("[id='slide-biquads.0.pole_damping']").press("ArrowLeft")
        tab.settle(CERTIFIED)
        assert tab.text("#sentence") != before
        assert "structure=pd%2Bbiquad" in tab.page.url
        again = open_tab(browser, tab.page.url)
        assert again.view()["gains"] == tab.view()["gains"]
        again.page.context.close()
        tab.page.locator("#structure").select_option("dob")
        tab.settle(CERTIFIED)
        assert tab.page.locator("#dot").get_attribute("visibility") == "hidden"
        assert "a plain PD" in tab.text("#map figcaption")
        while tab.page.locator("#undo").is_enabled():
            tab.page.locator("#undo").click()
        tab.settle(CERTIFIED)
        assert tab.text("#sentence") == before
        assert tab.view()["gains"] == {"kp": 1800, "kd": 120}
        assert tab.page.locator("#dot").get_attribute("visibility") == "visible"
        assert tab.page.locator("#structure").input_value() == ""
        assert not tab.said


@pytest.mark.slow
@pytest.mark.parametrize("case", ["biquad", "torque_feedback"])
def test_sliders_move_them_and_undo_puts_them_back(browser: Any, tmp_path: Path, case: str):
    control, file, *_ = CASES[case]
    (tmp_path / "joint.yaml").write_text(joint(control, file), "utf-8")
    name, value = {"biquad": ("biquads.0.pole_damping", 0.04), "torque_feedback": ("ktau", 0.3)}[case]
    with serving(tmp_path / "joint.yaml") as served:
        tab = open_tab(browser, served.address)
        tab.settle(CERTIFIED)
        before = tab.text("#sentence")
        slider = tab.page.locator(f"[id='slide-{name}']")
        assert float(tab.page.locator(f"[id='gain-{name}']").input_value()) == value
        for _ in range(15):
            slider.press("ArrowRight")
        tab.settle(CERTIFIED)
        moved = tab.view()["gains"][name]
        assert moved > value
        # 15 steps of 0.005 decades, or of a thousandth of the slider from -1 to 1
        assert moved == pytest.approx(value * 10**0.075 if case == "biquad" else value + 0.03, rel=1e-3)
        assert tab.text("#sentence") != before
        assert f"{name}={moved:g}" in tab.page.url
        assert ("a plain PD" in tab.text("#map figcaption")) == (case != "biquad")
        while tab.page.locator("#undo").is_enabled():
            tab.page.locator("#undo").click()
        tab.settle(CERTIFIED)
        assert tab.view()["gains"][name] == value
        assert tab.text("#sentence") == before
        assert not tab.said
