"""While answers come in: what is shown belongs to what is asked for, claims no more than is known, and moves nothing."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from app_pages import CERTIFIED, Served, Tab, open_tab, serving
from gainroom.analysis.stability import is_stable
from gainroom.app.bench import Opened
from gainroom.app.joint_bench import JointBench
from gainroom.app.messages import View
from gainroom.cli.example import example_texts

pytest.importorskip("uvicorn", reason="the extra gainroom[app] is not installed")

TEXTS = example_texts()
HOLD = """() => { const take = gainroom.socket.onmessage; window.held = [];
    gainroom.socket.onmessage = (event) => (JSON.parse(event.data).lane === 'full' ? held.push(event) : take(event));
    window.release = () => { gainroom.socket.onmessage = take; held.forEach((event) => take(event)); }; }"""
"""Certified answers are held back until `release()`."""
ENDED = "() => held.some((event) => JSON.parse(event.data).part === 'done')"
MEASURE = """() => { window.tall = new Set(); const head = document.querySelector('header'), main = document.querySelector('main');
    const seen = new ResizeObserver(() => tall.add(`${head.offsetHeight} ${main.offsetTop}`));
    for (const each of document.querySelectorAll('header, header > *, #controls')) seen.observe(each); }"""
"""Every height that the header has from now on, and where what is below it begins."""
OUTSIDE = """() => [...document.querySelectorAll('#controls *, header *, figure, p')]
    .filter((each) => each.getBoundingClientRect().right > innerWidth + 0.5).map((each) => each.id || each.textContent)"""
LISTEN = """() => { window.said = []; for (const place of [document.querySelector('#sentence'), document.querySelector('#brief')])
    new MutationObserver(() => said.push([gainroom.certified, place.textContent]))
        .observe(place, { childList: true, subtree: true, characterData: true }); }"""
FRAMES = """() => { window.frames_asked = 0; const ask = window.requestAnimationFrame;
    window.requestAnimationFrame = (then) => { frames_asked += 1; return ask(then); }; }"""
TELL = """(done) => gainroom.socket.onmessage({ data: JSON.stringify(
    { part: 'progress', lane: 'search', key: gainroom.key, done, total: 100 }) })"""


@pytest.fixture(scope="module")
def knee(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """One joint with ranges."""
    file = tmp_path_factory.mktemp("app") / "talos-knee.yaml"
    file.write_text(TEXTS["talos-knee"], "utf-8")
    with serving(file) as found:
        yield found


@pytest.fixture(scope="module")
def biped(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A robot of several states, at a rate, with a range."""
    pytest.importorskip("pinocchio")
    file = tmp_path_factory.mktemp("app") / "biped.yaml"
    file.write_text(of_two_states(), "utf-8")
    with serving(file) as found:
        yield found


def of_two_states(kp: float = 2000.0, kd: float = 100.0) -> str:
    text = TEXTS["biped"].replace("kp: 2000.0 ", f"kp: {kp!r} ").replace("kd: 100.0 ", f"kd: {kd!r} ")
    text = text.replace("  right: [right_sole]\n  flight: []\n", "")
    crouch = next(line for line in text.splitlines(keepends=True) if line.startswith("  crouch:"))
    return text.replace(crouch, "") + "uncertainty: {delay_ms: [2.0, 2.5]}\n"


def starred(tab: Tab) -> list[str]:
    """The cards with what the recommended gains have."""
    return [text for text in tab.page.locator(".row").all_inner_texts() if "★" in text]


@pytest.mark.slow
def test_a_star_of_other_values_is_neither_taken_nor_shown_as_theirs(browser: Any, knee: Served):
    tab = open_tab(browser, knee.address)
    tab.settle(CERTIFIED)
    page, snap = tab.page, tab.page.locator("#snap")
    assert len(starred(tab)) >= 3
    page.evaluate(HOLD)
    before = tab.view()["gains"]
    at_once = """() => { const slider = document.querySelector('#delay_ms'); slider.value = 4; slider.dispatchEvent(new Event('input'));
        const found = [document.querySelector('#snap').disabled, document.querySelector('[data-mark=star]').getAttribute('opacity')];
        slider.dispatchEvent(new Event('change')); return found; }"""
    assert page.evaluate(at_once) == [True, "0.25"]
    tab.settle()
    assert snap.is_disabled()
    assert snap.inner_text() == "★ computing …"
    assert not starred(tab)
    lines = "() => new Set([...document.querySelectorAll('[data-area=line]')].map((line) => line.getAttribute('stroke-opacity')))"
    assert page.evaluate(f"() => [...({lines})()]") == ["0.2"]
    page.locator("#dot").focus()
    page.keyboard.press("s")
    assert tab.view()["gains"] == before
    page.evaluate("() => release()")
    tab.settle(CERTIFIED)
    assert snap.is_enabled()
    assert page.locator("[data-mark=star]").get_attribute("opacity") == "1"
    assert page.evaluate(f"() => [...({lines})()]") == ["1"]
    snap.click()
    tab.settle(CERTIFIED)
    assert tab.text("#sentence").startswith("Safe: every requirement is met")
    best = dict(JointBench(Opened(TEXTS["talos-knee"], "talos-knee.yaml", Path())).full(View(delay_ms=4.0), None, lambda *_: None))["use"]
    assert tab.view()["gains"] == best["gains"]
    page.locator("#delay_ms").fill("2")  # other gains are recommended there, and the cards say what they have
    tab.settle(CERTIFIED)
    assert len(starred(tab)) >= 3
    assert not tab.said


@pytest.mark.slow
def test_ranges_are_stated_where_they_are_set(browser: Any, knee: Served):
    """As the file has them, 4 to 6 ticks of 0.5 ms, and as they are widened."""
    tab = open_tab(browser, knee.address)
    tab.settle(CERTIFIED)
    said = dict(zip(("delay_ms", "stiffness", "link_inertia"), tab.page.locator("#controls small").all_inner_texts(), strict=False))
    assert said["delay_ms"] == "range 2 … 3 ms"
    assert said["stiffness"] == "range 8\u202f000 … 12\u202f000 N·m/rad"
    assert said["link_inertia"] == "range 1 … 60 kg·m²"
    tab.page.locator("#delay_ms").fill("4")
    tab.page.get_by_text("range 2 … 4 ms").wait_for()
    tab.settle(CERTIFIED)
    assert "The worst case of the stated ranges allows less; verdict and ★ are of the worst case" in tab.text("#map .legend")
    unstable = tab.page.locator("#map svg").get_by_text("unstable")
    assert unstable.count() == 1
    tab.page.locator("#snap").click()
    tab.settle(CERTIFIED)
    tab.page.get_by_role("button", name="Fit").click()
    tab.settle(CERTIFIED)
    kp, kd = tab.page.evaluate("() => JSON.parse(JSON.stringify(gainroom.found.point)).map((each) => 1.55 * each)")
    bench = JointBench(Opened(TEXTS["talos-knee"], "talos-knee.yaml", Path()))
    corner = dict(bench.quick(View(gains={"kp": kp, "kd": kd}, delay_ms=4.0), None, ""))["verdict"]
    assert (unstable.count() == 0) == corner["stable"]


def comes_to_rest(tab: Tab) -> bool:
    """Whether no frame is asked for within half a second, once the last answers are drawn."""
    before = -1
    for _ in range(40):
        asked = tab.page.evaluate("() => frames_asked")
        if asked == before:
            return True
        before = asked
        tab.page.wait_for_timeout(500)
    return False


def robot_rests_and_moves(tab: Tab) -> None:
    """Held it is drawn where something about it changes, and no frame is asked for until then."""
    tab.page.get_by_role("img", name="The robot in its critical mode").scroll_into_view_if_needed()
    tab.page.evaluate(FRAMES)
    assert comes_to_rest(tab)
    asked = tab.page.evaluate("() => frames_asked")
    tab.page.get_by_role("button", name="Move", exact=True).click()
    tab.page.wait_for_function(f"() => frames_asked > {asked} + 5")
    tab.page.get_by_role("button", name="Hold", exact=True).click()
    assert comes_to_rest(tab)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["knee", "biped"])
def test_nothing_moves_while_answers_come_and_nothing_is_beside_the_page(browser: Any, kind: str, request: pytest.FixtureRequest):
    tab = open_tab(browser, request.getfixturevalue(kind).address)
    tab.page.evaluate(MEASURE)
    tab.settle(CERTIFIED)
    if kind == "biped":
        assert tab.page.locator("#controls small").all_inner_texts()[0] == "range 2 … 2.5 ms"
    tab.drag((0.4, 0.3), (0.5, 0.9), (0.6, 0.1))
    tab.settle(CERTIFIED)
    tab.page.locator("#delay_ms").fill("4")
    tab.settle(CERTIFIED)
    assert len(tab.page.evaluate("() => [...tall]")) == 1
    assert tab.page.evaluate(OUTSIDE) == []
    if kind == "biped":
        robot_rests_and_moves(tab)
    tab.page.set_viewport_size({"width": 420, "height": 860})
    tab.page.wait_for_function("() => document.querySelector('#map svg').viewBox.baseVal.width < 420")
    assert tab.page.evaluate("() => document.documentElement.scrollWidth") <= 420
    assert not tab.said


@pytest.mark.slow
def test_the_first_words_claim_no_more_than_is_known(browser: Any, biped: Served):
    """One of two states is not known to be more than that one, on the phone's line, too."""
    tab = open_tab(browser, biped.address)
    tab.settle(CERTIFIED)
    final = tab.text("#sentence")
    tab.page.evaluate(LISTEN)
    tab.page.locator("#gain-kd").fill("101")
    tab.page.keyboard.press("Tab")
    tab.settle(CERTIFIED)
    assert not final.startswith("In this state")
    early = [text for known, text in tab.page.evaluate("() => said") if not known]
    assert any("requirement" in text for text in early)  # the first state's full verdict was among them
    assert all(text.startswith(("In this state: ", "Not safe")) for text in early)
    tab.page.evaluate(HOLD)
    tab.page.locator("#contact").select_option("left")  # the same gains: what is known of all states stays
    tab.page.wait_for_function(ENDED)
    bases = tab.page.evaluate(
        "() => held.map((event) => JSON.parse(event.data)).filter((part) => part.part === 'verdict').map((part) => part.basis)"
    )
    assert bases == ["certified"]
    assert not tab.said


@pytest.mark.slow
def test_an_unstable_state_is_said_as_soon_as_it_is_known():
    """Before the others are examined, which it says, too; whether a state is stable is told by the roots of its loop."""
    pytest.importorskip("pinocchio")
    from gainroom.app.robot_bench import RobotBench

    bench = RobotBench(Opened(TEXTS["biped"], "biped.yaml", Path()))
    seen = set()
    for factor in (1.0, 3.5, 9.0):
        names = bench.opening()["channels"]
        view = View.model_validate(
            {"delay_ms": 3.0, "contact": "double", "gains": {name: {"kp": 2000 * factor, "kd": 100 * factor} for name in names}}
        )
        system = bench.system(view)
        stable = [is_stable(system.loop(system.source.linearize(*place))) for place in system.source.states]
        seen.add(len(set(stable)))
        *early, last = [part for name, part in bench.full(view, None, lambda *_: None) if name == "verdict"]
        assert [part["basis"] for part in early] == ["state"] * len(early)
        assert last["basis"] == "certified"
        assert last["stable"] == all(stable)
        for part in early:
            assert part["tone"] != "good"
            assert part["sentence"].startswith("In this state: " if part["stable"] else "Not safe: unstable in ")
        assert len(early) >= 1
        assert last["sentence"].startswith("Not safe: unstable in ") != all(stable)
        if not all(stable):
            assert any(not part["stable"] for part in early)
    assert seen == {1, 2}  # among them gains that are stable in some states alone, the one that is looked at among those


@pytest.mark.slow
def test_a_run_on_the_drawing_is_called_one(browser: Any, biped: Served):
    """In title and caption, until the critical mode is back; and no root of other gains is told."""
    tab = open_tab(browser, biped.address)
    tab.settle(CERTIFIED)
    tab.page.wait_for_function("() => gainroom.body.part && gainroom.body.root && gainroom.body.root.key === gainroom.body.part.key")
    title, note = tab.page.locator("#side figcaption"), tab.page.locator("#mode")
    assert title.inner_text().startswith("Critical mode")
    assert note.inner_text().startswith("Vibration at the gain limit")
    assert "These gains: " in note.inner_text()
    tab.page.evaluate("""() => { const { body } = gainroom, still = body.part.rest.map((row) => row.map(() => 0));
        body.play({ ms: [0, 10], start: body.part.rest, moved: [still, still] }); }""")
    assert title.inner_text().startswith("Simulated run")
    assert note.inner_text().startswith("The simulated run")
    tab.page.locator(".film").get_by_role("button", name="Critical mode").click()
    assert title.inner_text().startswith("Critical mode")
    tab.page.evaluate("() => gainroom.body.takeRoot({ ...gainroom.body.root, key: -1 })")
    assert note.inner_text().startswith("Vibration at the gain limit")
    assert "These gains: " not in note.inner_text()
    assert not tab.said


@pytest.mark.slow
def test_a_menu_closes_and_a_search_never_goes_back(browser: Any, knee: Served):
    tab = open_tab(browser, knee.address)
    tab.settle(CERTIFIED)
    copy, forms = tab.page.get_by_role("button", name="Copy gains"), tab.page.locator("#forms")
    for close in (
        lambda: tab.page.locator("#side figcaption").click(),
        lambda: tab.page.locator("#stiffness-typed").click(),
        lambda: tab.page.keyboard.press("Escape"),
    ):
        copy.click()
        assert forms.is_visible()
        close()
        assert forms.is_hidden()
        assert copy.get_attribute("aria-expanded") == "false"
    shown = []
    for done in (50, 5, 71, 13):
        tab.page.evaluate(TELL, done)
        shown.append(tab.text("#snap"))
    assert shown == [f"Stop the search ({share} %)" for share in (50, 50, 71, 71)]
    assert not tab.said
