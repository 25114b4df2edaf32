"""The page without a file: any of the shipped examples, chosen on it; and values that are typed beside their sliders."""

import contextlib
import json
import re
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest

from app_pages import CERTIFIED, PATIENCE, Served, Tab, open_tab, serving, tab_in
from gainroom.cli import main
from gainroom.cli.app import examples
from gainroom.cli.example import example_texts
from test_app_access import client, exceptions, get

pytest.importorskip("pinocchio")
uvicorn = pytest.importorskip("uvicorn", reason="the extra gainroom[app] is not installed")

TEXTS = example_texts()
EVIL = "<script>window.broken=1</script>"


@pytest.fixture(scope="module")
def bare() -> Iterator[Served]:
    """`gainroom app`."""
    with serving(None) as found:
        yield found


def sentence_of(capsys: pytest.CaptureFixture[str], folder: Path, command: str, text: str) -> str:
    (folder / "typed.yaml").write_text(text, "utf-8")
    main([command, str(folder / "typed.yaml"), "--json"])
    return json.loads(capsys.readouterr().out)["sentence"]


def choose(tab: Tab, name: str) -> None:
    """As a person does."""
    with tab.page.expect_navigation():
        tab.page.locator("#example").select_option(name)
    tab.settle()


@pytest.mark.slow
def test_any_example_is_chosen_and_its_numbers_are_the_command_lines(browser: Any, bare: Served, capsys, tmp_path: Path):
    tab = open_tab(browser, bare.address)
    assert tab.page.locator("#example option").all_inner_texts() == list(TEXTS)
    assert tab.page.locator("#example").input_value() == "testbed"
    tab.page.locator("#delay_ms-typed").fill("4")  # of this one alone
    choose(tab, "talos-knee")
    tab.settle(CERTIFIED)
    assert tab.view()["delay_ms"] == 2.0
    assert tab.page.locator("#example").input_value() == "talos-knee"
    assert tab.text("#sentence") == sentence_of(capsys, tmp_path, "joint", TEXTS["talos-knee"])
    assert tab.page.locator("#save").is_hidden()
    choose(tab, "biped")
    tab.page.locator("#heat button").first.wait_for()
    assert not tab.said


@pytest.mark.slow
def test_the_knee_as_stiff_as_it_may_be_at_four_milliseconds(browser: Any, capsys, tmp_path: Path):
    """A first user's job: from `gainroom example talos-knee` to gains that the command line calls safe, by hand and by Save."""
    main(["example", "talos-knee"])
    file = tmp_path / "talos-knee.yaml"
    file.write_text(capsys.readouterr().out, "utf-8")
    with serving(file) as own:
        tab = open_tab(browser, own.address)
        tab.settle(CERTIFIED)
        assert tab.text("#sentence").startswith("Not safe: stable, but 3 requirements fail")
        tab.page.locator("#delay_ms").fill("4")
        tab.settle(CERTIFIED)
        tab.page.get_by_role("button", name="Use recommended").click()
        tab.settle(CERTIFIED)
        assert tab.text("#sentence").startswith("Safe")
        cards = tab.page.locator("#rows .row")
        assert not [text for text in cards.all_inner_texts() if "★" in text]  # they have been taken
        assert len({card.bounding_box()["y"] for card in cards.all()}) == 1
        tab.page.get_by_role("button", name="Copy gains").click()
        tab.page.get_by_role("button", name="YAML").click()
        tab.page.get_by_text("Copied as yaml").wait_for()
        comment, *gains = tab.page.evaluate("navigator.clipboard.readText()").splitlines()
        assert comment == "# for talos-knee.yaml with delay_ms 4 (opened with 2)"
        lines = " ".join(gains).split()
        tab.page.get_by_role("button", name="Save").click()
        tab.page.locator("#confirm").click()
        tab.page.get_by_text("Saved").wait_for()
        said = tab.text("#sentence")
        assert not tab.said
    text = TEXTS["talos-knee"].replace("delay_ticks: 4 ", "delay_ticks: 8 ").replace("[4, 6]", "[4, 8]")  # of 0.5 ms
    for gain, value in (lines[:2], lines[2:4]):
        text = re.sub(rf"(?m)^  {gain} \S+", f"  {gain} {value}", text)
    typed = tmp_path / "typed.yaml"
    typed.write_text(text, "utf-8")
    for each in (typed, file):
        assert main(["joint", str(each), "--json", "--strict"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert (found["unmet"], found["sentence"]) == ([], said)  # in the worst of the stated ranges, as far as it was examined


@pytest.mark.slow
def test_a_card_leads_to_where_its_margin_is_worst(browser: Any, bare: Served):
    """To the state and the joint of which the verdict speaks, in the posture as it is posed."""
    tab = open_tab(browser, bare.address + "?example=biped")
    tab.settle(CERTIFIED)
    tab.page.locator("summary").click()
    tab.page.locator("#angle-right_knee").fill("0.7")
    tab.settle(CERTIFIED)
    place = re.search(r"worst in (\w+)/(\w+): .*phase margin [^;]* at (\w+),", tab.text("#sentence"))
    assert place is not None
    tab.page.locator("[data-name=phase_margin]").focus()
    tab.page.keyboard.press("Enter")
    tab.settle(CERTIFIED)
    view = tab.view()
    assert (view["posture"], view["contact"], view["joint"]) == place.groups()
    assert tab.page.evaluate("() => document.activeElement.dataset.name") == "phase_margin"  # the answers took no focus away
    assert view["angles"] == {"right_knee": 0.7}
    assert tab.page.evaluate("() => gainroom.body.feet.length") == 1  # on the ground in this contact state, of two before
    assert not tab.said


@pytest.mark.slow
def test_two_tabs_on_different_examples(browser: Any, bare: Served):
    """The address holds which, with the view: a copy of the tab is the same."""
    tab = open_tab(browser, bare.address + "?example=fig9")
    other = tab_in(tab.page.context, bare.address + "?example=talos-knee")
    tab.drag((0.4, 0.3))
    other.drag((0.3, 0.5))
    for each in (tab, other):
        each.settle(CERTIFIED)
        copy = tab_in(tab.page.context, each.page.url)
        copy.settle(CERTIFIED)
        each.settle(CERTIFIED)  # again: a page that lost its server meanwhile has asked anew
        assert (copy.text("#sentence"), copy.view()) == (each.text("#sentence"), each.view())
        assert copy.page.title() == each.page.title()
        assert not each.said + copy.said
    assert (tab.page.title(), other.page.title()) == ("fig9.yaml – gainroom", "talos-knee.yaml – gainroom")


@pytest.mark.parametrize("name", ["nobody", EVIL, "../fig9", "fig9.yaml", "fig9&example=nobody", "x" * 3000])
def test_a_name_that_is_no_example(bare: Served, name: str):
    query = "?example=" + quote(name, safe="&=")
    status, _, text = get(bare.address + query)
    assert status == 404
    assert text == f"no such example; there are: {', '.join(TEXTS)}\n"  # and no word of what was asked for
    assert get(bare.address + "mesh/0" + query)[0] == 404
    with pytest.raises(exceptions.InvalidStatus, match="403"):
        client.connect(
            bare.address.replace("http", "ws") + "ws" + query, origin=bare.address.rstrip("/"), open_timeout=PATIENCE, proxy=None
        )


@pytest.mark.slow
def test_a_file_has_no_examples_beside_it(browser: Any, served: Served):
    assert get(served.address + "?example=fig9")[0] == 404
    assert open_tab(browser, served.address).page.locator("#example").count() == 0


@contextlib.contextmanager
def with_token(token: str) -> Iterator[str]:
    """The application as it is served elsewhere than here, here: its address without the token."""
    from gainroom.app.server import application, listening

    listener = listening("127.0.0.1", 0)
    port = listener.getsockname()[1]
    shipped = examples()
    config = uvicorn.Config(application(shipped["testbed"](), port, token, shipped), ws="wsproto", lifespan="off", log_level="error")
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    try:
        yield f"http://127.0.0.1:{port}/"
    finally:
        server.should_exit = True
        thread.join()
        listener.close()


@pytest.mark.slow
def test_the_token_stays_when_another_example_is_chosen(browser: Any):
    with with_token("secret") as address:
        assert get(address + "?example=fig9")[0] == 403
        assert get(address + "?example=nobody")[0] == 403  # not even which there are
        tab = open_tab(browser, address + "?token=secret")
        choose(tab, "fig9")
        assert "token=secret" in tab.page.url
        tab.settle(CERTIFIED)
        assert not tab.said
        tab.page.context.close()


def put(tab: Tab, name: str, text: str) -> None:
    """A typed value, and Enter."""
    tab.page.locator(f"#{name}-typed").click()
    tab.page.keyboard.press("Control+a")
    tab.page.keyboard.type(text)
    tab.page.keyboard.press("Enter")


@pytest.mark.slow
def test_typed_values(browser: Any, bare: Served, capsys, tmp_path: Path):
    """No delay, and more than the slider shows, are the command line's; what is no such number is put back and said."""
    tab = open_tab(browser, bare.address + "?example=fig9")
    slider, typed = tab.page.locator("#delay_ms"), tab.page.locator("#delay_ms-typed")
    for text in ("0", "50", "2.345"):
        put(tab, "delay_ms", text)
        tab.settle(CERTIFIED)
        assert tab.view()["delay_ms"] == float(text)
        assert float(slider.input_value()) == pytest.approx(float(text), abs=0.006)  # its own steps
        said = sentence_of(capsys, tmp_path, "joint", TEXTS["fig9"].replace("delay_ms: 2.0", f"delay_ms: {float(text)!r}"))
        assert tab.text("#sentence") == said
    put(tab, "delay_ms", "1e9")
    tab.page.get_by_text("delay_ms: 1000000000 must be <= 10000 ms").wait_for()  # as the command line says it
    put(tab, "delay_ms", "4")
    tab.settle(CERTIFIED)
    for text in ("-3", "", "--", "1e999"):
        put(tab, "delay_ms", text)
        tab.page.get_by_text("delay: a number from 0").wait_for()
        assert typed.input_value() == "4"
        assert tab.view()["delay_ms"] == 4.0
    for text in ("0", "-1"):
        put(tab, "stiffness", text)
        tab.page.get_by_text("stiffness: a number above 0").wait_for()
        assert tab.view()["stiffness"] == 10000.0
    tab.page.get_by_role("button", name="Undo").click()
    assert tab.view()["delay_ms"] == 1e9  # what was put back was no step
    tab.page.get_by_role("button", name="Undo").click()
    tab.settle(CERTIFIED)
    assert tab.view()["delay_ms"] == 2.345
    assert not tab.said
