"""The page in a browser: what a person does with mouse, keys and links, and what they then see."""

import json
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from app_pages import CERTIFIED, PATIENCE, Served, Tab, open_tab, serve, serving, tab_in
from faults import lasting_port
from gainroom.cli import main
from test_cli import EXAMPLES

pytest.importorskip("uvicorn", reason="the extra gainroom[app] is not installed")


@pytest.fixture
def tab(browser: Any, served: Served) -> Iterator[Tab]:
    found = open_tab(browser, served.address)
    yield found
    assert not found.said
    strange = [url for url in found.asked if not re.match(rf"(http|ws)://127\.0\.0\.1:{served.address.rsplit(':', 1)[1]}", url)]
    assert not strange, "a request off the machine"
    found.page.context.close()


def said_by_command(capsys: pytest.CaptureFixture[str], text: str, folder: Path) -> dict[str, Any]:
    (folder / "typed.yaml").write_text(text, "utf-8")
    main(["joint", str(folder / "typed.yaml"), "--json"])
    return json.loads(capsys.readouterr().out)


def with_gains(kp: float, kd: float, delay: float = 2.0) -> str:
    text = EXAMPLES["fig9"].replace("kp: 1.0e4", f"kp: {kp!r}").replace("kd: 300.0", f"kd: {kd!r}")
    return text.replace("delay_ms: 2.0", f"delay_ms: {delay!r}")


@pytest.mark.slow
def test_it_opens_with_the_verdict_of_the_command_line(tab: Tab, capsys, tmp_path: Path):
    tab.settle(CERTIFIED)
    said = said_by_command(capsys, EXAMPLES["fig9"], tmp_path)
    assert tab.text("#sentence") == said["sentence"]
    assert tab.text("[data-name=phase_margin] b") == f"{said['phase_margin_deg']:.3g}° ✗"
    assert "Certified" in tab.text("#basis")
    assert tab.page.locator("[data-area=stable]").count() == 1
    assert tab.page.locator("[data-area=required]").count() == 1


@pytest.mark.slow
def test_a_quick_verdict_behind_the_certified_one_changes_no_word(tab: Tab):
    """They come from two threads: on a busy machine the quick one may be the slower."""
    tab.settle(CERTIFIED)
    said = tab.text("#sentence"), tab.text("#basis")
    late = {"part": "verdict", "lane": "quick", "basis": "quick", "tone": "warn", "sentence": "late", "rows": []}
    take = "(part) => gainroom.socket.onmessage({ data: JSON.stringify({ ...part, key: gainroom.key }) })"
    tab.page.evaluate(take, late)
    assert (tab.text("#sentence"), tab.text("#basis")) == said
    assert tab.page.evaluate(CERTIFIED)


@pytest.mark.slow
def test_dragged_gains_are_judged_as_the_command_line_judges_them(tab: Tab, capsys, tmp_path: Path):
    tab.drag((0.6, 0.3), (0.45, 0.8))
    tab.settle(CERTIFIED)
    gains = tab.view()["gains"]
    assert gains != {"kp": 1e4, "kd": 300.0}
    said = said_by_command(capsys, with_gains(gains["kp"], gains["kd"]), tmp_path)
    assert tab.text("#sentence") == said["sentence"]
    assert tab.text("[data-name=gain_margin] b").split()[0] == f"{said['gain_margin_db']:.3g}"


@pytest.mark.slow
def test_far_up_it_says_unstable(tab: Tab):
    tab.drag((0.5, 0.97))
    tab.settle(CERTIFIED)
    assert tab.text("#sentence").startswith("Not safe: unstable.")
    assert "bad" in (tab.page.locator("#verdict").get_attribute("class") or "")
    tab.page.get_by_text("do not run these gains").wait_for()


@pytest.mark.slow
def test_keys_move_the_dot_and_undo_brings_it_back(tab: Tab):
    page = tab.page
    page.locator("#dot").focus()
    page.keyboard.press("ArrowUp")
    page.keyboard.press("Shift+ArrowRight")
    tab.settle()
    moved = tab.view()["gains"]
    assert moved["kp"] > 1e4
    assert moved["kd"] > 300
    page.keyboard.press("Control+z")
    page.keyboard.press("Control+z")
    tab.settle()
    assert tab.view()["gains"] == {"kp": 1e4, "kd": 300.0}
    assert page.locator("#undo").is_disabled()


@pytest.mark.slow
def test_the_delay_slider_shrinks_the_region(tab: Tab, capsys, tmp_path: Path):
    def top() -> float:
        return tab.page.evaluate("() => document.querySelector('[data-area=stable]').getBBox().height")

    before = top()
    tab.page.locator("#delay_ms").fill("4")
    tab.settle(CERTIFIED)
    tab.page.wait_for_function("before => document.querySelector('[data-area=stable]').getBBox().height < 0.7 * before", arg=before)
    said = said_by_command(capsys, with_gains(1e4, 300.0, 4.0), tmp_path)
    assert tab.text("#sentence") == said["sentence"]


@pytest.mark.slow
def test_as_stiff_as_it_may_be_at_four_milliseconds_and_taken_away(tab: Tab, capsys, tmp_path: Path):
    """What the page is for, from the first look to the clipboard."""
    tab.page.locator("#delay_ms").fill("4")
    tab.settle(CERTIFIED)
    tab.page.get_by_role("button", name="Use recommended").click()
    tab.settle(CERTIFIED)
    assert tab.text("#sentence").startswith("Safe")
    tab.page.get_by_role("button", name="Copy gains").click()
    tab.page.get_by_role("button", name="YAML").click()
    tab.page.get_by_text("Copied as yaml").wait_for()
    first, *lines = tab.page.evaluate("navigator.clipboard.readText()").split("\n")
    assert first == "# for fig9.yaml with delay_ms 4 (opened with 2)"
    kp, kd = (float(line.split(": ")[1]) for line in lines[:2])
    said = said_by_command(capsys, with_gains(1e4, 300.0, 4.0), tmp_path)
    assert (kp, kd) == pytest.approx((said["recommended"]["kp"], said["recommended"]["kd"]), rel=1e-6)
    assert said_by_command(capsys, with_gains(kp, kd, 4.0), tmp_path)["requirements_met"] is True


@pytest.mark.slow
def test_the_address_holds_the_view(tab: Tab, served: Served):
    tab.drag((0.4, 0.3))
    tab.page.locator("#delay_ms").fill("3.5")
    tab.page.locator("#sample_rate_hz-typed").fill("4000")
    tab.page.keyboard.press("Tab")
    tab.settle(CERTIFIED)
    other = tab_in(tab.page.context, tab.page.url)
    other.settle(CERTIFIED)
    assert other.view() == tab.view()
    assert other.text("#sentence") == tab.text("#sentence")
    assert not other.said


@pytest.mark.slow
def test_two_tabs_do_not_disturb_each_other(tab: Tab, served: Served):
    other = tab_in(tab.page.context, served.address)
    tab.drag((0.3, 0.2))
    other.drag((0.7, 0.6))
    for each in (tab, other):
        each.settle(CERTIFIED)
    assert tab.view()["gains"]["kp"] < other.view()["gains"]["kp"]
    assert tab.text("#sentence") != other.text("#sentence")


@pytest.mark.slow
def test_saving_shows_the_difference_first(browser: Any, tmp_path: Path):
    file = tmp_path / "joint.yaml"
    file.write_text(EXAMPLES["testbed"], "utf-8")
    with serving(file) as own:
        tab = open_tab(browser, own.address)
        tab.page.locator("#gain-kd").fill("40")
        tab.page.keyboard.press("Tab")
        tab.settle()
        tab.page.get_by_role("button", name="Save").click()
        tab.page.locator("#dialog[open]").wait_for()
        assert "+  kd: 40" in tab.text("#dialog pre")
        assert file.read_text("utf-8") == EXAMPLES["testbed"]
        tab.page.locator("#confirm").click()
        tab.page.get_by_text("Saved").wait_for()
        assert file.read_text("utf-8") == EXAMPLES["testbed"].replace("kd: 70.0 ", "kd: 40 ")
        assert not tab.said


@pytest.mark.slow
def test_a_server_that_comes_back_finds_the_page_as_it_was(browser: Any, tmp_path: Path):
    file = tmp_path / "joint.yaml"
    file.write_text(EXAMPLES["fig9"], "utf-8")
    port = lasting_port()
    first = serve(file, port)
    tab = open_tab(browser, first.address)
    tab.drag((0.4, 0.3))
    tab.settle(CERTIFIED)
    before, view = tab.text("#sentence"), tab.view()
    first.process.send_signal(signal.SIGINT)
    assert first.process.wait(PATIENCE) == 130
    assert "Traceback" not in (first.process.stderr.read() if first.process.stderr else "")
    tab.page.locator("#offline").wait_for(state="visible")
    assert "Not current" in tab.text("#basis")
    second = serve(file, port)
    try:
        tab.page.locator("#offline").wait_for(state="hidden")
        tab.settle(CERTIFIED)
        assert tab.view() == view
        assert tab.text("#sentence") == before
    finally:
        second.process.kill()
        second.process.wait()


@pytest.mark.slow
def test_on_a_phone_everything_is_within_its_width(browser: Any, served: Served):
    tab = open_tab(browser, served.address, 420, 800)
    tab.settle(CERTIFIED)
    assert tab.page.evaluate("() => document.documentElement.scrollWidth") <= 420
    tab.drag((0.5, 0.5))
    tab.settle()
    assert tab.view()["gains"] != {"kp": 1e4, "kd": 300.0}
    assert not tab.said


@pytest.mark.slow
def test_on_a_phone_one_line_of_verdict_stays(browser: Any, served: Served):
    """The word and what the cards say, at the top of the screen wherever the page is scrolled to."""
    context = browser.new_context(viewport={"width": 420, "height": 860}, is_mobile=True, has_touch=True, reduced_motion="reduce")
    tab = tab_in(context, served.address)
    tab.settle(CERTIFIED)
    values = [tab.text(f"[data-name={name}] b") for name in ("gain_margin", "phase_margin", "peak_sensitivity")]
    assert tab.text("#brief") == f"Not safe · {values[0]} · {values[1]} · Ms {values[2]}"
    tab.page.locator("#step").scroll_into_view_if_needed()
    line, sentence = (tab.page.locator(name).bounding_box() for name in ("#brief", "#sentence"))
    assert line["y"] == 0
    assert line["height"] < 860 / 20
    assert sentence["y"] + sentence["height"] < 0
    assert not tab.said
    context.close()


@pytest.mark.slow
def test_gains_beyond_the_map_widen_it(tab: Tab):
    tab.page.locator("#gain-kd").fill("2000")
    tab.page.keyboard.press("Tab")
    tab.settle(CERTIFIED)
    tab.page.wait_for_function("() => Number(document.querySelector('#dot').getAttribute('transform').match(/[\\d.]+/g)[1]) > 50")
    assert tab.view()["gains"]["kd"] == 2000.0


@pytest.mark.slow
def test_the_slider_of_the_sample_rate_ends_in_continuous_time(tab: Tab):
    """Rates have two digits; the last step is no rate, which an empty number with the sign of infinity shows, and typing 0 is the same."""
    slider, typed = tab.page.locator("#sample_rate_hz"), tab.page.locator("#sample_rate_hz-typed")
    assert tab.view()["sample_rate_hz"] == 0
    assert (slider.get_attribute("aria-valuetext"), typed.get_attribute("placeholder"), typed.input_value()) == ("continuous time", "∞", "")
    slider.press("ArrowLeft")
    tab.settle(CERTIFIED)
    assert tab.view()["sample_rate_hz"] == 9900
    assert slider.get_attribute("aria-valuetext") == "9\u202f900 Hz"
    slider.press("End")
    tab.settle(CERTIFIED)
    assert tab.view()["sample_rate_hz"] == 0
    for rate in ("1250", "0"):
        typed.fill(rate)
        tab.page.keyboard.press("Tab")
        tab.settle(CERTIFIED)
        assert tab.view()["sample_rate_hz"] == float(rate)


@pytest.mark.slow
def test_the_keyboard_alone_reaches_everything(tab: Tab):
    tab.settle(CERTIFIED)
    wanted = {"snap", "copy", "save", "gain-kp", "delay_ms", "stiffness", "link_inertia", "sample_rate_hz", "dot"}
    seen = set()
    for _ in range(30):
        tab.page.keyboard.press("Tab")
        seen.add(tab.page.evaluate("() => document.activeElement.id"))
    assert wanted <= seen
    tab.page.locator("#dot").focus()  # in a number, s is typed
    tab.page.keyboard.press("s")
    tab.settle(CERTIFIED)
    assert tab.text("#sentence").startswith("Safe")


@pytest.mark.slow
def test_a_run_is_simulated_and_can_be_stopped(tab: Tab):
    tab.page.get_by_role("button", name="Shake it").click()
    tab.page.get_by_text("control.sample_rate_hz is missing").wait_for()  # a run goes tick by tick
    tab.page.locator("#sample_rate_hz-typed").fill("2000")
    tab.page.keyboard.press("Tab")
    tab.settle(CERTIFIED)
    tab.page.get_by_role("button", name="Shake it").click()
    tab.page.locator("#run canvas").first.wait_for()
    assert "vibrat" in tab.text("#run .said") or "settles" in tab.text("#run .said") or "Stable" in tab.text("#run .said")
    tab.page.get_by_role("button", name="Shake it").wait_for()
