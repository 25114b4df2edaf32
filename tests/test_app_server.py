"""The page's server: what it answers, in which order, and that its numbers are the command line's."""

import asyncio
import contextlib
import io
import json
import random
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from app_pages import PATIENCE
from gainroom.app.bench import Opened
from gainroom.app.joint_bench import JointBench
from gainroom.app.lanes import Lane
from gainroom.app.messages import LONGEST, View, read_message
from gainroom.app.session import Session
from gainroom.cli import main
from gainroom.errors import GainroomError
from gainroom.files.edited_text import edited
from gainroom.files.joint_yaml import parse_joint
from gainroom.io.strict_json import strict
from test_cli import EXAMPLES

pytest.importorskip("uvicorn", reason="the extra gainroom[app] is not installed")

TYPED = """joint: {{rotor_inertia: 1.0e-4, gear_ratio: 100, link_inertia: {load!r}, stiffness: {stiffness!r}, damping: 1.0}}
drive: {{bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: {delay!r}}}
control: {{type: pd, kp: {kp!r}, kd: {kd!r}, feedback: motor{rate}}}
limits: {limits}
"""
USUAL = "{gain_margin_db: 6.0, phase_margin_deg: 30.0, peak_sensitivity: 2.0}"


def bench_of(text: str, name: str = "joint.yaml") -> JointBench:
    return JointBench(Opened(text, name, Path()))


def answers(bench: JointBench, view: View) -> dict[str, dict[str, Any]]:
    """The last of each part, as the page gets them."""
    parts = [*bench.quick(view, None, ""), *bench.full(view, None, lambda *_: None)]
    return json.loads(json.dumps(strict(dict(parts))))


def command(folder: Path, text: str) -> dict[str, Any]:
    (folder / "typed.yaml").write_text(text, "utf-8")
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        main(["joint", str(folder / "typed.yaml"), "--json"])
    return json.loads(out.getvalue())


def random_views(count: int, seed: int) -> Iterator[tuple[View, dict[str, Any]]]:
    """Views around Fig. 9's joint, stable and not, and what one would type for them."""
    draw = random.Random(seed)
    for _ in range(count):
        kp, kd = round(10 ** draw.uniform(2.5, 4.6), 2), round(10 ** draw.uniform(1.2, 2.9), 3)
        delay, stiffness = round(draw.uniform(0.2, 6.0), 3), round(10 ** draw.uniform(3.3, 4.7), 1)
        load, rate = round(10 ** draw.uniform(-0.3, 2), 3), draw.choice([0, 1000, 2000])
        view = View(gains={"kp": kp, "kd": kd}, delay_ms=delay, stiffness=stiffness, link_inertia=load, sample_rate_hz=rate)
        sampled = f", sample_rate_hz: {rate}" if rate else ""
        yield view, {"kp": kp, "kd": kd, "delay": delay, "stiffness": stiffness, "load": load, "rate": sampled}


def typed(limits: str, **values: Any) -> str:
    start = {"kp": 1e4, "kd": 300.0, "delay": 2.0, "stiffness": 1e4, "load": 16.0, "rate": ""}
    return TYPED.format(limits=limits, **{**start, **values})


NUMBERS = (
    "gain_margin_db", "lower_gain_margin_db", "phase_margin_deg", "delay_margin_ms", "peak_sensitivity", "disk_margin",
    "phase_crossover_rad_s", "gain_crossover_rad_s",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("count", "limits"), [(50, "{}"), pytest.param(200, "{}", marks=pytest.mark.population), (4, USUAL)])
def test_every_number_is_the_command_lines(tmp_path: Path, count: int, limits: str):
    """The file is typed anew for the command line, so an edit that went wrong shows. Equal to the last bit: it is the same computation."""
    bench = bench_of(typed(limits))
    stable = 0
    for view, values in random_views(count, 3):
        said = command(tmp_path, typed(limits, **values))
        parts = answers(bench, view) if limits == USUAL else json.loads(json.dumps(strict(dict([next(bench.quick(view, None, ""))]))))
        verdict = parts["verdict"]
        stable += said["stable"]
        assert {name: verdict["numbers"][name] for name in NUMBERS} == {name: said[name] for name in NUMBERS}
        assert {name: verdict["worst"][name] for name in NUMBERS} == {name: said["worst"][name] for name in NUMBERS}
        assert verdict["sentence"] == said["sentence"]
        assert (verdict["stable"], verdict["stable_in_range"], verdict["met"], verdict["unmet"]) == (
            said["stable"], said["stable_in_range"], said["requirements_met"], said["unmet"],
        )  # fmt: skip
        best = said["recommended"]
        assert limits != USUAL or parts["use"]["point"] == (None if best is None else [best["plane"]["kp"], best["plane"]["kd"]])
    assert 0.2 * count < stable < 0.95 * count or count < 10


@pytest.mark.slow
def test_over_ranges_it_says_what_the_command_line_says(tmp_path: Path):
    """Nominal while dragging, and marked so; then the worst case."""
    text = EXAMPLES["fig9"] + "uncertainty: {stiffness: 20%, delay_ms: [2.0, 2.3]}\n"
    bench, view = bench_of(text), View(gains={"kp": 9000.0, "kd": 250.0})
    first = next(part for name, part in bench.quick(view, None, "") if name == "verdict")
    assert first["basis"] == "nominal"
    said = command(tmp_path, text.replace("kp: 1.0e4", "kp: 9000").replace("kd: 300.0", "kd: 250"))
    verdict = answers(bench, view)["verdict"]
    assert verdict["basis"] == "certified"
    assert verdict["sentence"] == said["sentence"]
    assert verdict["worst"]["phase_margin_deg"] == said["worst"]["phase_margin_deg"]


def test_a_value_outside_its_range_widens_it():
    """Never less than the file states: 4 ms (8 ticks) beside [4, 6] ticks is judged over [4, 8]."""
    text = bench_of(EXAMPLES["talos-knee"]).text(View(delay_ms=4.0))
    assert "delay_ticks: 8 " in text
    assert "delay_ticks: [4, 8]" in text
    low, high = parse_joint(text, "x").uncertainty.delay
    assert (float(low), float(high)) == pytest.approx((2e-3, 4e-3))


def test_other_rates_keep_the_delay_of_a_file_in_ticks():
    system = parse_joint(bench_of(EXAMPLES["talos-knee"]).text(View(sample_rate_hz=4000.0)), "x")
    assert system.delay == pytest.approx(2e-3)
    assert system.control.sample_time == 1 / 4000


def test_a_rate_that_is_chosen_takes_the_place_of_a_continuous_clock():
    """And taken away again it leaves the file as it was."""
    bench = bench_of(EXAMPLES["fig9"])
    assert [bench_of(EXAMPLES[name]).opening()["asks_rate"] for name in ("fig9", "testbed", "testbed-sampled")] == [False, False, True]
    chosen = parse_joint(bench.text(View(sample_rate_hz=2000.0)), "x").control
    assert (chosen.sample_time, chosen.continuous) == (1 / 2000, False)
    assert bench.text(View(sample_rate_hz=0.0)) == EXAMPLES["fig9"]


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_an_untouched_view_leaves_the_file_as_it_is(name: str):
    bench = bench_of(EXAMPLES[name])
    assert bench.text(View.model_validate(bench.opening()["view"])) == EXAMPLES[name]


def test_points_of_the_map_are_gains_of_every_controller():
    """In the P/PI cascade's plane kp is kv·kp: the text's gains must lie at the point that was dragged to."""
    text = TYPED.replace("type: pd, kp: {kp!r}, kd: {kd!r}", "type: ppi, kp: 33.0, kv: 300.0, ki: 500.0").format(
        load=16.0, stiffness=1e4, delay=2.0, rate="", limits="{}"
    )
    bench = bench_of(text)
    system = parse_joint(bench.text(View(point=(6000.0, 200.0))), "x")
    controller = system.control.controller
    assert (controller.kp * controller.kv, controller.kv) == pytest.approx((6000.0, 200.0))
    assert controller.ki / controller.kv == pytest.approx(500 / 300)  # held


def test_edited_text_changes_values_alone():
    text = "a: {x: 1, y: [2, 3]}  # why\nb:\n  c: old   # kept\n  # behind\nd:\n  e: {f: 1}\n"
    found = edited(
        text, "t", {("a", "y"): [5.0, 6.5], ("b", "c"): 7.25, ("b", "new"): None, ("a", "z"): 1e-5, ("d", "e"): {"g h": 2.0}, ("k",): 3.0}
    )
    assert found == "a: {z: 1e-05, x: 1, y: [5, 6.5]}  # why\nb:\n  c: 7.25   # kept\n  new: null\n  # behind\nd:\n  e: {'g h': 2}\nk: 3\n"
    with pytest.raises(GainroomError, match="must be a section"):
        edited("a: 1\n", "t", {("a", "b"): 1.0})


def test_copied_gains_are_read_back(tmp_path: Path):
    from gainroom.files.gain_files import gains_of, parse_file

    bench, view = bench_of(EXAMPLES["fig9"]), View(gains={"kp": 5000.0, "kd": 200.0})
    found = gains_of(parse_file(bench.copied(view, "ros2_control"), Path("x.yaml")), ("joint",))
    assert (float(found.kp[0]), float(found.kd[0])) == (5000.0, 200.0)
    assert '<position joint="joint" kp="5000.0" kv="200.0"/>' in bench.copied(view, "mjcf")
    assert "UNSTABLE" in bench.copied(View(gains={"kp": 5000.0, "kd": 900.0}), "mjcf")
    assert bench.copied(view, "yaml") == "# for joint.yaml\nkp: 5000\nkd: 200\n"
    elsewhere = bench.copied(view.model_copy(update={"delay_ms": 4.0, "sample_rate_hz": 2000.0}), "yaml")
    assert elsewhere.startswith("# for joint.yaml with delay_ms 4 (opened with 2) and sample_rate_hz 2000 (opened with 0)\nkp: 5000\n")


def test_saving_refuses_what_was_not_seen_and_what_changed_meanwhile(tmp_path: Path):
    file = tmp_path / "joint.yaml"
    file.write_text(EXAMPLES["fig9"], "utf-8")
    opened = Opened(EXAMPLES["fig9"], str(file), tmp_path, file)
    with pytest.raises(GainroomError, match="have changed since the difference"):
        opened.save("joint: {}\n", "0" * 64)
    file.write_text(EXAMPLES["testbed"], "utf-8")
    from gainroom.app.bench import digest_of

    with pytest.raises(GainroomError, match="has changed since this page read or saved it"):
        opened.save("joint: {}\n", digest_of("joint: {}\n"))
    assert file.read_text("utf-8") == EXAMPLES["testbed"]


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "null", "{", '{"ask": "look"}', '{"ask": "rm", "key": 1}', '{"ask": "look", "key": -1}', '{"ask": "look", "key": 1.5}',
        '{"ask": "look", "key": 1, "view": {"delay_ms": NaN}}', '{"ask": "look", "key": 1, "view": {"delay_ms": -1}}',
        '{"ask": "look", "key": 1, "view": {"gains": {"kp": "1"}}}', '{"ask": "look", "key": 1, "more": 1}',
        '{"ask": "look", "key": 1, "view": {"delay_ms": 1e999}}', '{"ask": "copy", "key": 1, "form": "../../etc/passwd"}',
        '{"ask": "look", "key": 1, "window": [0, 1]}', "[" * 20_000,
        '{"ask": "look", "key": 1, "view": {"gains": ' + '{"a":' * 900 + "1" + "}" * 900 + "}}",
        " " * (LONGEST + 1),
    ],
)  # fmt: skip
def test_malformed_messages_are_refused_in_one_line(text: str):
    with pytest.raises(GainroomError) as error:
        read_message(text)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 400


def test_of_several_questions_the_latest_is_answered():
    lane, started, go, done = Lane("test"), threading.Event(), threading.Event(), threading.Event()
    found: list[str] = []

    def first(stale: Any) -> None:
        started.set()
        go.wait(PATIENCE)
        found.append(f"first, stale: {stale()}")

    lane.put("a", first)
    assert started.wait(PATIENCE)
    lane.put("a", lambda stale: found.append("never"))
    lane.put("a", lambda stale: found.append(f"last, stale: {stale()}"))
    lane.put("b", lambda stale: done.set())
    go.set()
    assert done.wait(PATIENCE)
    assert found == ["first, stale: True", "last, stale: False"]


def test_a_patient_job_waits_for_no_other():
    """What rests behind one patient job is the next patient one alone; whatever else comes goes at once, and before it."""
    lane, done, found = Lane("test"), threading.Event(), []
    started, go = threading.Event(), threading.Event()

    def first(stale: Any) -> None:
        started.set()
        go.wait(PATIENCE)
        found.append("first")

    lane.put("a", first, patient=True)
    assert started.wait(PATIENCE)
    lane.put("a", lambda stale: found.append("never"), patient=True)
    lane.put("a", lambda stale: found.append("last"))  # of the same owner: the gesture has ended
    lane.put("b", lambda stale: done.set(), patient=True)
    go.set()
    assert done.wait(PATIENCE)
    assert found == ["first", "last"]


def test_what_is_sent_is_sent_at_once():
    """No part waits for the receipt of the one before, which the other side delays by 40 ms (Nagle's algorithm is off)."""
    from gainroom.app.server import listening

    async def option() -> int:
        found: asyncio.Future[int] = asyncio.get_running_loop().create_future()

        def accepted(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            found.set_result(writer.get_extra_info("socket").getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            writer.close()

        async with await asyncio.start_server(accepted, sock=listening("127.0.0.1", 0)) as server:
            _, writer = await asyncio.open_connection(*server.sockets[0].getsockname()[:2])
            try:
                return await found
            finally:
                writer.close()

    assert asyncio.run(option()) != 0


@pytest.mark.parametrize(("parts", "stale", "sent"), [
    (["step", "map"], False, ["step", "map", "done"]), (["step", "map"], True, ["step"]), (["map", "step"], True, []),
])  # fmt: skip
def test_of_late_curves_one_is_shown(parts: list[str], stale: bool, sent: list[str]):
    """In a quick drag each would be overtaken before it is there; a map of other values would be wrong, a step is a moment old."""
    bench = SimpleNamespace(curves=lambda *_: ((name, {"plant": ""}) for name in parts))
    found: list[str] = []

    async def job() -> None:
        session = Session(cast(Any, None), cast(Any, bench), {})
        session._put = lambda text: found.append(json.loads(text)["part"])
        await asyncio.to_thread(session._job, read_message('{"ask": "look", "key": 1}'), "curves", lambda: stale)
        await asyncio.sleep(0)  # what was sent from the thread

    asyncio.run(job())
    assert found == sent


def test_a_run_is_that_of_simulate_and_ends_where_it_is_cancelled():
    from gainroom.app.bench import Cancelled
    from gainroom.files.joint_yaml import parse_simulation
    from gainroom.studies.simulation import simulate_study

    bench = bench_of(EXAMPLES["testbed-simulated"])
    told: list[int] = []
    (name, part), *_ = bench.shaken(View(), lambda done, total, what: told.append(done))
    outcome = simulate_study(parse_simulation(EXAMPLES["testbed-simulated"], "x.yaml"))
    assert name == "run"
    measured = outcome.run.measured
    assert max(part["motion"][0]["values"]) == pytest.approx(float(measured.max() - measured[0, 0]), rel=0.02)
    assert len(told) > 1

    def stop(done: int, total: int, what: str) -> None:
        if done:
            raise Cancelled

    with pytest.raises(Cancelled):
        list(bench.shaken(View(), stop))


@pytest.mark.slow
def test_the_report_of_a_view(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """`--export` with a view is the report of the file with those values."""
    (tmp_path / "joint.yaml").write_text(EXAMPLES["fig9"], "utf-8")
    (tmp_path / "typed.yaml").write_text(
        EXAMPLES["fig9"].replace("kp: 1.0e4", "kp: 5000.0").replace("delay_ms: 2.0", "delay_ms: 3.0"), "utf-8"
    )
    view = "#kp=5000&kd=300&delay_ms=3"
    assert main(["app", str(tmp_path / "joint.yaml"), "--export", str(tmp_path / "view.html"), "--view", view]) == 0
    main(["joint", str(tmp_path / "typed.yaml"), "--report", str(tmp_path / "typed.html")])
    capsys.readouterr()

    def numbers(name: str) -> str:
        text = (tmp_path / name).read_text("utf-8")
        return text[: text.index("Command")].replace("typed.yaml", "joint.yaml")

    assert numbers("view.html") == numbers("typed.html")
    assert main(["app", str(tmp_path / "joint.yaml"), "--export", str(tmp_path / "view.html"), "--view", "kp=much"]) == 2
    assert "must be a number" in capsys.readouterr().err
