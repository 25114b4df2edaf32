"""The report page: whole, self-contained, honest at first glance, and safe against what a user typed."""

import json
import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from pytest import approx

import gainroom as gr
from gainroom.report.gain_map import GainPoint, _marks, gain_map
from gainroom.report.joint import joint_page
from gainroom.report.joint_tables import JointPresentation
from gainroom.report.joint_text import _change, sentence, warnings as warnings_of
from gainroom.report.map_lines import MapView, level_line
from gainroom.report.number_format import digits, one_degree
from gainroom.report.page import Card, Html, Lead, Section, figure, page, table
from gainroom.simulation.step_response import step_response

HOSTILE = "</script><script>alert(1)</script>'\"><img src=x onerror=alert(2)> & joint.yaml"
COMMAND = f"gainroom joint '{HOSTILE}' --report out.html"


def specification(kd: float = 70.0, sample_time: float | None = None, **joint: float) -> gr.System:
    """The paper's testbed: kd 70 is stable, kd 80 is not."""
    values = {"motor_inertia": 0.2, "link_inertia": 0.8, "stiffness": 1e4, "damping": 1.0} | joint
    return gr.System.of_joint(gr.ElasticJoint(**values), gr.Drive(4000.0, 0.9, 2.674e-3), gr.PD(1600.0, kd), "motor", sample_time)


@pytest.fixture(scope="module")
def stable() -> gr.JointStudy:
    return gr.study_joint(specification())


@pytest.fixture(scope="module")
def stable_page(stable) -> str:
    return joint_page(JointPresentation(stable), COMMAND)


@pytest.fixture(scope="module")
def unstable_page() -> str:
    return joint_page(JointPresentation(gr.study_joint(specification(kd=80.0))), COMMAND)


def without_library(html: str) -> str:
    """The page without the drawing library, which is one script of several megabytes."""
    scripts = re.findall(r"<script[^>]*>.*?</script>", html, re.S)
    largest = max(scripts, key=len)
    assert len(largest) > 1e6
    assert html.count(largest) == 1
    return html.replace(largest, "")


def headline(page: str) -> str:
    """All that the box on top says: the verdict, and what follows it in the weight of text."""
    return unescape(re.sub("</?span>", "", re.findall("<h1>(.*?)</h1>", page)[0]))


def figures(html: str) -> list[dict]:
    return [json.loads(text) for text in re.findall(r'<script type="application/json">(.*?)</script>', html, re.S)]


@pytest.mark.slow
def test_page_is_self_contained_and_small(stable_page):
    assert len(stable_page.encode()) < 2e6
    own = without_library(stable_page)
    assert not re.findall(r"<(?:link|img|iframe|object|embed|audio|video|source)\b", own)
    assert not re.findall(r"<[a-z][^>]*\s(?:src|href)\s*=", own)
    assert "@import" not in own
    assert "url(" not in own
    assert "https://" not in own
    assert "http://" not in own
    assert own.startswith("<!DOCTYPE html>")
    assert own.rstrip().endswith("</html>")


@pytest.mark.slow
def test_page_carries_answer_then_reason_in_order(stable, stable_page):
    own = unescape(without_library(stable_page))
    wanted = [
        sentence(stable).partition(". ")[0],
        "gain margin",
        "≥ 6 dB",
        "Gain map",
        "The link after a step of the reference, and under a load",
        "Open loop",
        "Nyquist",
        "Margins",
        "All crossings",
        "Inputs and assumptions",
        "Certification",
        "Command",
        COMMAND,
        gr.__version__,
    ]
    positions, start = [], own.index("<body")
    for part in wanted:
        start = own.index(part, start)
        positions.append(start)
    assert positions == sorted(positions)
    assert 3 <= own.count('<div class="card ') <= 5


@pytest.mark.slow
def test_unstable_says_so_first(unstable_page, stable_page):
    own = without_library(unstable_page)
    body = own[own.index("<body") :]
    assert body.startswith('<body class="bad">')
    assert 0 < body.index("UNSTABLE") < body.index("<h1>")
    assert body.index("<h1>Not safe: unstable") < body.index('class="cards"') < body.index('class="plot"')
    assert "✓ met" not in body  # margins of an unstable loop meet nothing
    calm = without_library(stable_page)
    assert 'class="bad"' not in calm
    assert "UNSTABLE" not in calm


def test_command_and_names_are_escaped(stable_page):
    own = without_library(stable_page)
    assert "<script>alert" not in own
    assert "<img" not in own
    shown = re.findall(r"<pre>(.*?)</pre>", own, re.S)
    assert unescape(shown[-1]) == COMMAND


def test_skeleton_escapes_every_plain_string():
    fig = {"data": [{"type": "scatter", "x": np.array([1.0, np.nan]), "name": HOSTILE}], "layout": {"title": {"text": HOSTILE}}}
    parts = [HOSTILE, figure(fig, HOSTILE, HOSTILE), table([HOSTILE], [[HOSTILE]], HOSTILE)]
    lead, card = Lead(HOSTILE, "bad", HOSTILE, [HOSTILE]), Card(*[HOSTILE] * 4, True, HOSTILE)
    html = page(HOSTILE, lead, [card], [Section(HOSTILE, parts)], HOSTILE, [HOSTILE])
    own = without_library(html)
    assert "<script>alert" not in own
    assert "<img" not in own
    (drawn,) = figures(html)
    assert drawn["data"][0]["x"] == [1.0, None]  # strict JSON: no NaN
    assert drawn["layout"]["title"]["text"] == HOSTILE


def test_library_is_left_out_where_nothing_is_drawn():
    html = page("title", Lead("sentence"), [], [Section("words", ["text", Html("<b>kept</b>")])], "gainroom")
    assert len(html) < 20_000
    assert "<b>kept</b>" in html


def test_gain_map_draws_the_exact_boundary(stable, stable_page):
    gain_map = figures(stable_page)[0]
    edges = [trace for trace in gain_map["data"] if "vibrates at" in str(trace.get("text"))]
    kp = [value for trace in edges for value in trace["x"] if value is not None]
    kd = [value for trace in edges for value in trace["y"] if value is not None]
    assert len(kp) > 50
    # On the boundary a slightly smaller factor and a slightly larger one disagree; six digits are drawn.
    inside, outside = stable.region.contains(np.array(kp), np.array(kd) - 1e-3), stable.region.contains(np.array(kp), np.array(kd) + 1e-3)
    assert np.all(inside != outside)
    marks = {trace["marker"]["symbol"]: (trace["x"][0], trace["y"][0]) for trace in gain_map["data"] if trace.get("mode") == "markers"}
    assert marks["circle"] == (1600.0, 70.0)
    assert marks["star"] == approx((stable.recommended.kp, stable.recommended.kd), rel=1e-5)
    assert marks["x"] == approx((stable.rule.kp, stable.rule.kd), rel=1e-5)


PICTURE = np.array([700.0, 480.0])  # [px]


def in_pixels(notes: list[dict], wide: tuple[float, float]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Middle and half size of labels: 7.5 per letter, a line of 18."""
    boxes = []
    for note in notes:
        x, y = np.array([note["x"], note["y"]]) / wide * PICTURE + [note.get("xshift", 0), note.get("yshift", 0)]
        half = 0.5 * np.array([7.5 * len(note["text"].replace("<b>", "").replace("</b>", "")), 18])
        middle = [
            x + {"left": 1, "right": -1}.get(note.get("xanchor"), 0) * half[0],
            y + {"bottom": 1, "top": -1}.get(note.get("yanchor"), 0) * half[1],
        ]
        boxes.append((np.array(middle), half))
    return boxes


@pytest.mark.parametrize("place", [(0.40, 0.26), (0.36, 0.25), (0.335, 0.252), (0.33, 0.22), (0.97, 0.25), (0.30, 0.25)])
def test_names_on_the_gain_map_cover_no_mark_and_no_name(place: tuple[float, float]):
    """Of gains nearly alike, in pixels: 7.5 per letter, a line of 18, marks of 16."""
    view, spots = MapView(10.0, 100.0, 10.0, 100.0), []
    for name, (x, y) in {"this file": place, "recommended": (0.33, 0.25), "10 Hz rule": (0.34, 0.30)}.items():
        spots.append(GainPoint(name, 10 * x, 100 * y, "circle", "#000000"))
    _, notes = _marks(spots, view, ("kp", "kd"))
    boxes = in_pixels(notes, (10.0, 100.0))
    assert len(boxes) == 3
    marks = [(np.array([spot.kp / 10, spot.kd / 100]) * PICTURE, np.array([8.0, 8.0])) for spot in spots]
    for k, (middle, half) in enumerate(boxes):
        assert np.all(middle - half > 0)
        assert np.all(middle + half < PICTURE)
        for other, width in (*marks, *boxes[:k]):
            assert np.any(np.abs(middle - other) >= half + width), (notes[k]["text"], middle, other)


def test_the_gain_map_has_lines_of_equal_dynamic_stiffness(stable, stable_page):
    """Each is where the joint's own record says so, and its text has the number."""
    gain_map = figures(stable_page)[0]
    lines = {trace["text"]: trace for trace in gain_map["data"] if str(trace.get("text")).startswith("dynamic stiffness")}
    assert len(lines) == 3
    found = []
    for text, line in lines.items():
        kp, kd = (np.array([value for value in line[axis] if value is not None]) for axis in ("x", "y"))
        inside = np.flatnonzero(stable.region.contains(kp, 1.02 * kd) & stable.region.contains(kp, 0.98 * kd))
        some = inside[:: max(1, len(inside) // 7)]
        stiffness = [gr.dynamic_stiffness(stable.system.loop(controller=gr.PD(kp[k], kd[k]))).stiffness[0] for k in some]
        found.append(float(np.median(stiffness)))
        assert np.array(stiffness) == approx(found[-1], rel=0.03)  # straight between lines 1 % of the picture apart, where stiffness bends
        assert float(re.sub(r"[^\d.]", "", text)) == approx(found[-1], rel=0.03)  # the label
    assert [one / found[0] for one in found] == approx([1.0, 0.8 / 0.95, 0.5 / 0.95], rel=0.02)


def test_no_label_of_the_gain_map_covers_a_mark_or_a_label(stable_page):
    """In the picture as it opens."""
    drawn = figures(stable_page)[0]
    wide = tuple(drawn["layout"][axis]["range"][1] for axis in ("xaxis", "yaxis"))
    boxes = in_pixels([note for note in drawn["layout"]["annotations"] if "xref" not in note], wide)
    assert len(boxes) > 8
    marks = [trace for trace in drawn["data"] if trace.get("mode") == "markers"]
    spots = [(np.array([mark["x"][0], mark["y"][0]]) / wide * PICTURE, np.array([8.0, 8.0])) for mark in marks]
    for k, (middle, half) in enumerate(boxes):
        for other, width in (*spots, *boxes[:k]):
            assert np.any(np.abs(middle - other) >= half + width), (middle, other)


def test_a_line_of_one_level_is_where_the_values_have_it():
    """Of a paraboloid: a circle, to the sagitta of a grid's cell, h²/8 times its bend."""
    x, y = np.linspace(-1.5, 1.5, 61), np.linspace(-1.2, 1.2, 49)
    line = level_line(x, y, x[None, :] ** 2 + y[:, None] ** 2, 1.0)
    assert np.isnan(line[2::3]).all()
    points = line[np.isfinite(line[:, 0])]
    assert np.hypot(*points.T) == approx(1.0, abs=0.05**2)
    angles = np.sort(np.arctan2(points[:, 1], points[:, 0]))
    assert np.diff(angles).max() < 0.1  # closed
    pieces = line.reshape(-1, 3, 2)[:, :2]
    assert np.hypot(*(pieces[:, 1] - pieces[:, 0]).T).max() < 0.05 * 1.5  # none runs across a cell's half


@pytest.mark.slow
def test_the_legend_of_the_gain_map_says_of_which_joint_its_areas_are(stable_page):
    """Of the nominal one, which matters where something is uncertain."""
    names = [trace["name"] for trace in figures(stable_page)[0]["data"] if trace["showlegend"]]
    assert names == ["stable", "every requirement met"]
    uncertain = replace(specification(), uncertainty=gr.Uncertainty(delay=(2e-3, 3e-3)))
    drawn = figures(joint_page(JointPresentation(gr.study_joint(uncertain)), "gainroom joint joint.yaml"))[0]
    assert [trace["name"] for trace in drawn["data"] if trace["showlegend"]] == [f"{name} (nominal joint only)" for name in names]


@pytest.mark.slow
@pytest.mark.parametrize(("kp", "zooms"), [(100.0, True), (5000.0, False)])
def test_the_gain_map_zooms_where_it_shows_a_part_of_the_stable_gains(kp: float, zooms: bool):
    study = gr.study_joint(specification(kd=10.0).with_controller(gr.PD(kp, 10.0)))
    layout = figures(str(gain_map(study)))[0]["layout"]
    shown, largest = layout["xaxis"]["range"][1], study.region.max_kp()
    assert (shown < largest) == zooms
    assert bool(layout["updatemenus"]) == zooms


@pytest.mark.slow
def test_gain_map_of_an_integral_controller_leaves_the_plain_pd_rule_out():
    spec = replace(specification().with_controller(gr.PPI(20.0, 10.0, 30.0)), uncertainty=gr.Uncertainty(delay=(2e-3, 3e-3)))
    html = joint_page(JointPresentation(gr.study_joint(spec)), "gainroom joint joint.yaml")
    own = unescape(without_library(html))
    drawn = figures(html)[0]
    symbols = {trace["marker"]["symbol"] for trace in drawn["data"] if trace.get("mode") == "markers"}
    assert symbols == {"circle", "star"}
    assert drawn["layout"]["xaxis"]["title"]["text"] == "kv·kp [N·m/rad]"
    for words in (
        "10 Hz rule (plain PD)",
        "for the nominal joint, not over the uncertainty",
        "recommended (worst case)",
        "recommended (nominal)",
    ):
        assert words in own


def test_a_loop_that_no_factor_stabilises_says_so():
    spec = replace(specification().with_controller(gr.PID(100.0, 1e6, 5.0)), requirements=gr.Requirements())
    study = gr.study_joint(spec)
    assert study.limit.gain == 0
    assert "no uniform gain reduction makes it stable" in without_library(joint_page(JointPresentation(study), "gainroom joint joint.yaml"))


def test_no_gains_for_an_integral_controller_names_the_ratio_that_is_held():
    spec = specification().with_controller(gr.PID(100.0, 20_000.0, 5.0))
    warnings = " ".join(warnings_of(gr.study_joint(spec)))
    assert "ki/kp, held constant, meet the requirements: lower ki" in warnings
    assert "uncertainty" not in warnings.partition("lower ki")[2].partition(" shorten")[0]


def test_what_binds_is_what_costs_most(stable):
    best = stable.recommended
    assert best.binding == max(best.costs, key=best.costs.__getitem__)
    assert best.held_back_by() == best.binding.replace("_", " ")
    alike = replace(best, dropped=lambda: dict.fromkeys(best.costs, best.value))
    assert alike.felt == {}
    assert alike.held_back_by() == "gain margin, phase margin and peak sensitivity together"
    slack = replace(alike, shortfalls=dict.fromkeys(best.shortfalls, -0.1))
    assert slack.binding == "link"  # no requirement is reached


@pytest.mark.slow
def test_what_a_requirement_costs_is_what_is_recommended_without_it():
    """However small the gains are that meet it; of gains in few digits stiffness and kp are known to 1 %."""
    spec = specification()
    place = {"feedback": spec.control.feedback, "sample_time": spec.control.sample_time}
    asked = gr.Requirements(gain_margin=2.0, phase_margin=np.pi / 6, peak_sensitivity=1.001)
    tiny = gr.recommend_pd(spec.source, spec.drives[0], asked, **place)
    without = gr.recommend_pd(spec.source, spec.drives[0], gr.Requirements(gain_margin=2.0, phase_margin=np.pi / 6), **place)
    assert without.kp > 1e4 * tiny.kp
    assert tiny.costs["peak_sensitivity"] == pytest.approx(without.value, rel=0.01)


def test_influences_that_lower_the_limit_are_called_less():
    assert [_change(rise) for rise in (1.25, -1.25, np.inf, -np.inf)] == ["1.25 dB more", "1.25 dB less", "no limit", "never stable"]


@pytest.mark.parametrize("interval", [3.0, (1.0,), (1.0, 2.0, 3.0), ("1", "2"), (None, 1.0), (2.0, 1.0), (np.nan, 1.0), (True, 2.0)])
def test_uncertainty_takes_two_numbers(interval):
    with pytest.raises(gr.GainroomError, match="two numbers"):
        gr.Uncertainty(delay=interval)


def test_bode_shows_the_four_cases(stable_page):
    names = {trace["name"] for trace in figures(stable_page)[2]["data"]}
    assert names == {"with elasticity and delay", "without elasticity", "without delay", "without both"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "spec",
    [
        specification(sample_time=5e-4),
        specification(stiffness=np.inf, damping=0.0),
        replace(specification(), drives=(gr.Drive(),), requirements=gr.Requirements()),
        replace(specification(), drives=(gr.Drive(4000.0),)),
        replace(specification(), requirements=gr.Requirements()),
        specification().with_controller(gr.PID(1600.0, 3000.0, 50.0, velocity_filter=gr.LowPass(2000.0))),
        replace(specification(), control=gr.Control("joint", gr.PPI(20.0, 50.0, 100.0), "link")),
        replace(specification(), uncertainty=gr.Uncertainty(delay=(2e-3, 3e-3))),
    ],
    ids=["sampled", "rigid", "no limit at all", "no delay", "nothing required", "PID", "P/PI on the link", "uncertain"],
)
def test_every_kind_of_joint_has_a_page(spec):
    study = gr.study_joint(spec)
    html = joint_page(JointPresentation(study), "gainroom joint joint.yaml --report joint.html")
    own = unescape(without_library(html))
    assert headline(own) == sentence(study)
    assert ("sampled at 2" in own) == (spec.control.sample_time is not None)
    assert len(figures(html)) == 4
    for drawn in figures(html):
        assert any(value is not None for trace in drawn["data"] for value in trace["x"])


def test_the_nyquist_plot_names_its_curves(stable, stable_page):
    """Every curve and mark in the legend; the disk by the margin that it is of."""
    (found,) = [one for one in figures(stable_page) if "Re L" in str(one["layout"].get("xaxis", {}).get("title"))]
    assert found["layout"]["showlegend"]
    names = [one["name"] for one in found["data"]]
    assert len(set(names)) == len(names) == 5
    assert f"disk of the disk margin {digits(stable.margins.disk_margin, '', 3)}" in names


def test_unstable_response_grows_at_the_rightmost_root():
    loop = specification(kd=80.0).loop()
    response = step_response(loop)
    root = gr.rightmost_roots(loop, count=1).roots[0]
    assert (response.growth, response.frequency) == (approx(root.real), approx(abs(root.imag)))
    half = len(response.time) // 2
    first, last = (np.abs(response.reference.motor[rows]).max() for rows in (slice(half // 2, half), slice(-half // 2, None)))
    assert last > 1.5 * first


def test_numbers_read_well():
    assert digits(16001.2, "N·m/rad") == "16\u202f000 N·m/rad"
    assert digits(26.7536, "°") == "26.75°"
    assert digits(-0.5) == "−0.5"
    assert digits(float("nan")) == "–"
    assert digits(float("inf"), "dB") == "∞"
    assert digits(2e-5, "kg·m²", 3) == "2·10⁻⁵ kg·m²"
    assert digits(None) == "–"
    assert one_degree(360 / np.pi, 4 * np.pi, 900 / np.pi) == "5 N·m, swinging at 2 Hz 2 N·m"
    assert one_degree(900 / np.pi, 0.0, 900 / np.pi) == "5 N·m"
    assert [one_degree(nothing, 1.0, 1.0) for nothing in (0.0, np.inf, np.nan)] == ["", "", ""]
