"""A robot on the page: its numbers are the command line's, and a view is a file that says the same."""

import contextlib
import io
import json
import math
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gainroom.analysis.stability import is_stable
from gainroom.app.address import view_of
from gainroom.app.bench import Cancelled, Opened
from gainroom.app.channels import Channels
from gainroom.app.messages import View
from gainroom.app.robot_bench import RobotBench
from gainroom.app.robot_curves import part_of
from gainroom.cli import main
from gainroom.cli.example import example_texts
from gainroom.errors import GainroomError
from gainroom.files.robot_yaml import parse_robot
from gainroom.io.strict_json import strict
from test_part_region_every_state import keeps

pytest.importorskip("pinocchio")
pytest.importorskip("uvicorn", reason="the extra gainroom[app] is not installed")

TEXT = example_texts()["biped"]
TYPED = """model: {{package: gainroom, file: biped.urdf, base: floating}}
joints: {{default: {{rotor_inertia: 1.0e-4, gear_ratio: 100, stiffness: 1.0e4, damping: 1.0}}}}
drive: {{bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: {delay!r}}}
postures: {{stand: {{".*_hip_pitch": -0.3, ".*_knee": 0.6, ".*_ankle_pitch": -0.3}}}}
contacts: {{left: [left_sole]}}
control: {{type: pd, space: joint, feedback: motor, {gains}{rate}}}
limits: {{}}
"""


def bench_of(text: str) -> RobotBench:
    return RobotBench(Opened(text, "biped.yaml", Path()))


def command(folder: Path, text: str) -> dict[str, Any]:
    (folder / "robot.yaml").write_text(text, "utf-8")
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        main(["robot", str(folder / "robot.yaml"), "--json"])
    return json.loads(out.getvalue())


def full(bench: RobotBench, view: View) -> list[tuple[str, dict[str, Any]]]:
    return [(name, json.loads(json.dumps(strict(part)))) for name, part in bench.full(view, None, lambda *_: None)]


LAWS = {
    "pd": ("kp: 2000.0, kd: 100.0", {"kp": (500, 9000), "kd": (20, 500)}),
    "ppi": ("kp: 20.0, kv: 100.0, ki: 20.0", {"kp": (3, 30), "kv": (20, 500), "ki": (0, 60)}),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "count"),
    [("pd", 3), ("ppi", 3), pytest.param("pd", 25, marks=pytest.mark.population), pytest.param("ppi", 25, marks=pytest.mark.population)],
)
def test_every_number_is_the_command_lines(tmp_path: Path, law: str, count: int):
    """Gains, delay and rate at random; the file is typed anew. What is said while dragging agrees with it, too."""
    start, ends = LAWS[law]
    typed = TYPED.replace("type: pd", f"type: {law}")
    bench = bench_of(typed.format(delay=2.0, gains=start, rate=""))
    names = bench.opening()["channels"]
    draw = random.Random(8)
    for _ in range(count):
        gains = {name: {key: round(draw.uniform(*end), 2) for key, end in ends.items()} for name in names}
        delay, rate = round(draw.uniform(0.5, 4), 2), draw.choice([0, 2000])
        view = View.model_validate({"gains": gains, "delay_ms": delay, "sample_rate_hz": rate})
        columns = ", ".join(f"{key}: {{{', '.join(f'{name}: {pair[key]!r}' for name, pair in gains.items())}}}" for key in ends)
        said = command(tmp_path, typed.format(delay=delay, gains=columns, rate=f", sample_rate_hz: {rate}" if rate else ""))
        parts = full(bench, view)
        verdict = [part for name, part in parts if name == "verdict"][-1]
        assert verdict["states"] == said["states"]
        assert verdict["sentence"] == said["sentence"]
        assert verdict["stable"] == said["stable"]
        heat = dict(parts)["heat"]
        assert heat["together"] == [said["states"][0]["gain_limit"]]
        assert heat["closed"][0] == [joint["limit_others_closed"] for joint in said["states"][0]["joints"]]
        quick = dict([*bench.quick(view, None, ""), *bench.curves(view, None, "", False)])
        assert quick["verdict"]["stable"] == said["stable"]
        assert quick["verdict"]["tone"] != "good"
        assert quick["mode"]["gain"] == pytest.approx(said["states"][0]["gain_limit"], rel=1e-9)


@pytest.mark.slow
def test_the_page_opens_on_the_joint_that_vibrates_first(tmp_path: Path):
    """In the file's first state; what `gainroom robot` calls its limiting joint."""
    text = TEXT.partition("limits:")[0] + "limits: {}\n"  # no gains to be recommended
    said = command(tmp_path, text)["states"][0]
    view = bench_of(text).opening()["view"]
    assert (view["posture"], view["contact"]) == (said["posture"], said["contact"])
    assert view["joint"] == said["limiting_joints"][0]


LIMITS = "limits: {gain_margin_db: 6.0, phase_margin_deg: 25.0, peak_sensitivity: 2.5}"
VIEWS = (
    {"gains": {"left_knee": {"kp": 3100.5, "kd": 120.25}}, "delay_ms": 3.0},
    {"stiffness": 0.5, "posture": "crouch", "contact": "left", "sample_rate_hz": 2000},
    {"angles": {"right_knee": 1.1, "left_hip_yaw": -0.2}, "point": (2500.0, 90.0), "joint": "left_hip_roll"},
    {"payload": 12.5, "payload_at": "left_foot", "contact": "right", "angles": {"right_knee": 0.9}},
    {"payload": 30.0, "stiffness": 2.0},
)


@pytest.mark.parametrize("values", VIEWS)
def test_the_edited_file_describes_what_is_shown(values: dict[str, Any]):
    """Read back as the command line reads it, its loop is the shown one."""
    bench, view = bench_of(TEXT), View.model_validate(values)
    shown, read = bench.system(view), parse_robot(bench.text(view), "read.yaml")
    posture, contact = view.posture or "stand", view.contact or "double"
    omega = np.geomspace(1, 2000, 12)
    mine, theirs = (system.loop(system.source.linearize(posture, contact)).response(omega) for system in (shown, read))
    assert np.allclose(mine, theirs, rtol=1e-9, atol=1e-12)
    before = bench.system(View())
    assert not np.allclose(before.loop(before.source.linearize(posture, contact)).response(omega), mine, rtol=1e-3)


def test_a_payload_of_the_file_is_taken_off_and_moved():
    """What the robot weighs in all, and where: in the view as in the file that it makes; untouched the file stays as it is."""
    text = TEXT.replace("file: biped.urdf, ", "file: biped.urdf, payload: {frame: left_foot, mass: 4.0}, ")
    bench, bare = bench_of(text), bench_of(TEXT).system(View()).source.body.total_mass
    shown = bench.opening()["view"]
    assert (shown["payload"], shown["payload_at"]) == (4.0, "left_foot")
    assert bench.text(View.model_validate(strict(shown))) == text
    for view, load in ((View(), 4.0), (View(payload=0.0), 0.0), (View(payload_at="pelvis"), 4.0), (View(payload=7.0), 7.0)):
        for system in (bench.system(view), parse_robot(bench.text(view), "read.yaml")):
            bodies = [posture.body for posture in system.source.postures.values()]
            assert {round(body.total_mass, 9) for body in bodies} == {round(bare + load, 9)}
            assert bodies[0].payload.get(view.payload_at or "left_foot", 0.0) == load
    assert bench_of(TEXT).text(View(payload_at="pelvis", payload=0.0)) == TEXT
    with pytest.raises(GainroomError, match="no frame 'nobody'"):
        list(bench.quick(View(payload=1.0, payload_at="nobody"), None, ""))


@pytest.mark.slow
def test_copies_state_the_worst_of_all_states(tmp_path: Path):
    """Whichever state is shown: the least gain limit that `gainroom robot` prints, and where; unstable in one, not to be run."""
    bench = bench_of(TEXT.partition("limits:")[0] + "limits: {}\n")
    states = command(tmp_path, bench.opened.text)["states"]
    worst = min(states, key=lambda state: state["gain_limit"])
    assert worst["gain_limit"] < 0.99 * max(state["gain_limit"] for state in states)
    for form in ("mjcf", "ros2_control"):
        for contact in ("double", worst["contact"]):
            text = " ".join(bench.copied(View(contact=contact), form).split())
            assert f"starts at {worst['gain_limit']:.3g} × these gains" in text
            assert f"the worst of {len(states)} states" in text
            assert any(
                f"in {state['posture']}/{state['contact']}," in text
                for state in states
                if state["gain_limit"] < 1.001 * worst["gain_limit"]
            )
    factor = math.sqrt(worst["gain_limit"] * states[0]["gain_limit"])  # stable in the first state, and not everywhere
    gains = {name: {key: factor * value for key, value in own.items()} for name, own in bench.opening()["view"]["gains"].items()}
    view = View.model_validate({"gains": gains})
    assert is_stable(bench.state(view).loop)
    assert "UNSTABLE in " in bench.copied(view, "mjcf")


@pytest.mark.slow
def test_what_is_computed_of_every_state_says_what_follows_and_can_be_ended():
    bench, view = bench_of(TYPED.format(delay=2.0, gains="kp: 2000.0, kd: 100.0", rate="").replace("limits: {}", LIMITS)), View()
    maps = [part for name, part in bench.curves(view, None, "", True) if name == "map"]
    assert maps == []  # of one state there are no others
    bench = bench_of(of_tasks("pd kp: [50, 90, 200], kd: [5, 8, 15]"))
    maps = [part for name, part in bench.curves(view, None, "", True) if name == "map"]
    assert [part["next"] for part in maps] == ["safe", "whole", ""]
    assert [part.get("last", False) for part in maps] == [False, False, True]
    first = [part for name, part in bench.curves(view, None, "", False) if name == "map"]
    assert [(part["next"], part["last"]) for part in first] == [("", False)]  # in the middle of a gesture
    for most in (0, 2, 5):
        count = iter(range(100_000))

        def told(*_: object, count: Iterator[int] = count, most: int = most) -> None:
            if next(count) == most:
                raise Cancelled

        with pytest.raises(Cancelled):
            list(bench.curves(view, None, "", True, told))


@pytest.mark.slow
def test_task_gains_are_edited_in_their_lists():
    bench = bench_of(TASKS)
    view = View.model_validate({"gains": {"com z": {"kp": 210.0, "kd": 14.0}}})
    read, shown = parse_robot(bench.text(view), "x"), bench.system(view)
    assert read.source.stack[0].kp == pytest.approx((50, 90, 210))
    omega = np.geomspace(1, 2000, 9)
    loops = [system.loop(system.source.linearize("stand", "left")).response(omega) for system in (read, shown)]
    assert np.allclose(*loops, rtol=1e-9, atol=1e-12)
    parts = [*bench.quick(View(joint="com z"), None, ""), *bench.curves(View(joint="com z"), None, "", True)]
    assert [name for name, _ in parts] == ["verdict", "verdict", "bode", "map", "mode", "before", "step", "map", "map", "map", "root"]


def laplace_inverse(value_at: Any, time: float) -> float:
    """f(t) of F(s) by the damped Fourier series (Dubner and Abate 1968); its error is e^{−16} and the tail of the series."""
    span = 8.0 * time
    shift = 16 / (2 * span)
    s = shift + 1j * np.pi / span * np.arange(1 << 13)
    terms = (value_at(s) * np.exp(1j * s.imag * time)).real
    return float(np.exp(shift * time) / span * (terms.sum() - terms[0] / 2))


TASKS = TEXT.replace("space: joint", "space: task").replace("  kp: 2000.0 ", "  # ").replace("  kd: 100.0 ", "  # ")
CASCADES = TASKS.replace("type: pd", "type: ppi").replace(
    "kp: [50, 90, 200], kd: [1, 5, 15]", "kp: [10, 10, 14], kv: [6, 8, 15], ki: [3, 4, 5]"
)
SLOW_ANKLES = TEXT.replace("drive:\n", '  ".*_ankle_.*": {delay_ms: 3.1}\ndrive:\n')


def steps_of(bench: RobotBench, view: View) -> dict[str, Any]:
    """What is drawn up to the steps; the maps of every state, which come behind them, are not computed."""
    parts: dict[str, Any] = {}
    for name, part in bench.curves(view, None, "", True):
        parts[name] = part
        if name == "step":
            break
    return parts


STEPS = [
    (TEXT, "left_knee", 0),
    (SLOW_ANKLES, "left_knee", 0),
    (SLOW_ANKLES, "left_ankle_pitch", 0),
    (TEXT, "left_knee", 1000),
    (TASKS, "com z", 0),
    (CASCADES, "com z", 0),
    (CASCADES, "pelvis x", 2000),
]


@pytest.mark.slow
@pytest.mark.parametrize(("text", "name", "rate"), STEPS)
def test_a_step_is_the_inverse_transform_of_the_closed_loop(text: str, name: str, rate: int):
    """x = rᵀ (I + G D)⁻¹ G l c_p, with D of all gains, put together from responses and not from states; sampled: on the ticks.

    c_p is what c makes of a position: velocity gains act on no reference.
    """
    bench, view = bench_of(text), View(joint=name, sample_rate_hz=rate, contact="double")
    shown = steps_of(bench, view)["step"]
    state, channel = bench.state(view), Channels(bench.system(view)).channel(view)
    part, loop = part_of(state, channel), state.loop
    assert loop.parts is not None
    controller, control = loop.parts.controller, loop.sample_time
    own: Any = channel.own

    def by_position(v: np.ndarray) -> Any:
        """P/PI: kp (kv + ki/v), Fig. 13, sampled by backward Euler; PD: kp."""
        return own.kp * (own.kv + own.ki * (1 / v + (control or 0.0))) if hasattr(own, "kv") else own.kp

    def closed(s: np.ndarray) -> np.ndarray:
        v = loop.variable(s)
        actuated = loop.actuated_at(s)
        sensitivity = np.linalg.inv(np.eye(loop.size) + actuated @ controller.matrix(s, v, loop.size, control))
        return np.einsum("i,kij,kjl,l->k", part.right, sensitivity, actuated, part.left) * by_position(v)

    for k in (len(shown["ms"]) // 8, len(shown["ms"]) // 3, len(shown["ms"]) // 2):
        time = shown["ms"][k] / 1e3
        if rate:  # on a circle outside of the unit one, within which the sum of the running response is that of its samples
            count = 1 << math.ceil(math.log2(4 * time * rate))
            outside = 20 / count  # what is folded back: e^{−20}
            z = np.exp(outside + 2j * np.pi * np.fft.rfftfreq(count))
            found = np.fft.irfft(closed(np.log(z) * rate) / (1 - 1 / z), count) * np.exp(outside * np.arange(count))
            truth = found[round(time * rate)]
        else:
            truth = laplace_inverse(lambda s: closed(s) / s, time)
        assert shown["reference_motor"][k] == pytest.approx(truth, abs=2e-3)  # the series' tail, and the halved step's own error
    changed = steps_of(bench, view.model_copy(update={"gains": {name: {"kp": 2.0}}}))
    assert changed["before"]["reference"] != changed["step"]["reference"]


@pytest.mark.slow
def test_recommended_gains_of_a_cascade_are_gains_that_it_has():
    """They are found as PD; typed into a P/PI file as kp = kp/kd, kv = kd, ki = 0 they are the same loop."""
    laws = {}
    for law, (gains, _) in LAWS.items():
        text = TYPED.replace("type: pd", f"type: {law}").replace("limits: {{}}", "limits: {{gain_margin_db: 6.0, phase_margin_deg: 30.0}}")
        bench = bench_of(text.format(delay=2.0, gains=gains, rate=""))
        laws[law] = bench, dict(bench.recommended(View(), lambda *_: None))["use"]
    (bench, use), (other, pd) = laws["ppi"], laws["pd"]
    assert set(use["gains"]["left_knee"]) == {"kp", "kv", "ki"}
    view = View.model_validate({"gains": use["gains"]})
    read = parse_robot(bench.text(view), "read.yaml")
    shown, model = bench.state(view).loop, read.source.linearize()
    omega = np.geomspace(1, 2000, 12)
    assert np.allclose(read.loop(model).response(omega), shown.response(omega), rtol=1e-9)
    meant = other.state(View.model_validate({"gains": pd["gains"]})).loop
    assert np.allclose(meant.response(omega), shown.response(omega), rtol=1e-5, atol=1e-9)  # seven digits of each gain
    assert [line.split(":")[0] for line in use["lines"] if not line.startswith(" ")] == ["kp", "kv", "ki"]


def of_tasks(com: str) -> str:
    """A file of tasks, on one foot and on both."""
    text = TYPED.format(delay=1.5, gains="", rate="").replace("space: joint", "space: task").replace("type: pd", f"type: {com[:3].strip()}")
    text = text.replace("{left: [left_sole]}", "{left: [left_sole], both: [left_sole, right_sole]}")
    tasks = f"[{{name: com, type: com, {com[3:]}}}, {{name: pelvis, type: orientation, frame: pelvis, kp: 100, kd: 20}}]"
    return text.replace("limits: {}", f"tasks: {tasks}\n{LIMITS}")


@pytest.mark.slow
@pytest.mark.parametrize(
    "com", ["pd kp: [50, 90, 200], kd: [5, 8, 15]", "ppikp: [10, 10, 14], kv: [6, 8, 15], ki: [3, 4, 5]"], ids=["pd", "ppi"]
)
def test_recommended_gains_of_tasks_stay_the_recommended_ones(com: str):
    """Once they are taken they are found, starred and good, which Nyquist's criterion on a dense grid says, too, of every state."""
    bench = bench_of(of_tasks(com))
    first = dict(bench.recommended(View(), lambda *_: None))["use"]
    taken = View.model_validate({"gains": first["gains"]})
    parts = bench.full(taken, None, lambda *_: None)
    verdict, use = (last for name, last in dict(parts).items() if name in ("verdict", "use"))
    assert (use["points"], use["find"]) == (first["points"], False)
    assert use["star"] == "meets every requirement in every state; limits certified"
    assert verdict["met"] is True
    assert verdict["uncertified"] == []
    system = bench.system(taken)
    omega, angle = np.geomspace(0.02, 6000, 5000), np.radians(25.0) * (1 - 1e-6)
    factors = np.append(np.exp(1j * np.linspace(-angle, angle, 12)), np.geomspace(0.502, 1.99, 12))  # within 6 dB
    for place in system.source.states:
        loop = system.loop(system.source.linearize(*place))
        response = loop.response(omega)
        single = np.diagonal(np.linalg.inv(np.eye(loop.size) + response), axis1=1, axis2=2)
        assert is_stable(loop)
        assert keeps(np.linalg.eigvals(response), factors), place
        assert all(keeps(1 / single[:, [j]] - 1, factors) for j in range(loop.size)), place
        assert np.abs(single).max() < 2.5 * (1 + 1e-6)


@pytest.mark.slow
def test_the_pictures_of_a_run_are_its_postures():
    """Of a robot that a step moves: the skeleton of the first picture is the posture's, and bones keep their length."""
    text = TYPED.format(delay=1.0, gains="kp: 2000.0, kd: 100.0", rate=", sample_rate_hz: 1000")
    bench = bench_of(text)
    chosen = View(joint="right_hip_yaw")  # which moves little, and is among the curves all the same
    parts = dict(bench.shaken(chosen, lambda *_: None))
    assert "right_hip_yaw" in [curve["name"] for curve in parts["run"]["motion"]]
    assert "right_hip_yaw" not in [curve["name"] for curve in dict(bench.shaken(View(), lambda *_: None))["run"]["motion"]]
    film = parts["film"]
    poses = (np.array(film["start"][0]) + np.array([moved[0] for moved in film["moved"]])).reshape(len(film["ms"]), -1, 3)
    assert not np.any(film["moved"][0][0])
    rest = dict(bench.curves(View(), None, "", False))["mode"]
    start = np.reshape(rest["rest"][0], (-1, 3))
    assert np.allclose(poses[0], start, atol=2e-2)  # sunk into its contacts by its weight
    parents = np.array(rest["nodes"]["parents"])
    bones = np.flatnonzero(parents >= 0)
    length = np.linalg.norm(poses[:, bones] - poses[:, parents[bones]], axis=2)
    assert np.allclose(length, length[0], atol=1e-3)  # four digits each
    assert parts["film"]["ms"][-1] == pytest.approx(parts["run"]["ms"][-1], abs=20)


def test_an_untouched_view_leaves_the_file_as_it_is():
    bench = bench_of(TEXT)
    assert bench.text(View.model_validate(strict(bench.opening()["view"]))) == TEXT


def test_gains_in_an_address():
    """By name, and kp,kd as addresses of earlier versions have them."""
    view = view_of("#gain.left_knee=kp:9,kv:30,ki:60&gain.right_knee=2000,90&at.left_knee=0.5&payload=5&payload_at=pelvis")
    assert (view.payload, view.payload_at) == (5.0, "pelvis")
    assert view.gains == {"left_knee": {"kp": 9.0, "kv": 30.0, "ki": 60.0}, "right_knee": {"kp": 2000.0, "kd": 90.0}}
    with pytest.raises(GainroomError, match="must be a number"):
        view_of("gain.left_knee=kp:much")


STRANGE = (
    {"joint": "<script>"},
    {"posture": "../x"},
    {"angles": {"nobody": 1.0}},
    {"gains": {"nobody": {"kp": 1.0}}},
    {"contact": "moon"},
    {"gains": {"left_knee": 3.0}},
    {"gains": {"left_knee": {"kv": 3.0}}},
)


@pytest.mark.parametrize("values", STRANGE)
def test_names_that_the_robot_does_not_have_are_refused(values: dict[str, Any]):
    bench = bench_of(TEXT)
    with pytest.raises(GainroomError):
        list(bench.quick(View.model_validate(values), None, ""))
