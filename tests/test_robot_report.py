"""A robot's page: whole, honest at first glance, its pictures true to geometry, loci and limits, and safe against what a user typed."""

import math
import re
import shutil
import subprocess
from dataclasses import replace
from html import escape, unescape
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pytest import approx

import gainroom as gr
from gainroom.analysis.margin_record import GainLimit, Margins
from gainroom.files.robot_yaml import parse_robot
from gainroom.report.number_format import digits
from gainroom.report.robot import MOST_PICTURES, robot_page
from gainroom.report.robot_headroom import MOST_STATES
from gainroom.report.robot_skeleton import LINE, common_view, drawn as drawing, labels
from gainroom.report.robot_tables import RobotPresentation
from gainroom.report.robot_text import sentence
from gainroom.studies.robot import RobotStudy, study_robot
from gainroom.system.requirements import REQUIREMENTS
from independent.quick_margins import quick_margins
from robot_files import changed
from robot_truths import hinge, link, write_robot
from test_report import figures, without_library

HOSTILE = "</script><script>alert(1)</script>'\"><img src=x onerror=alert(2)> & <b>leg"
COMMAND = f"gainroom robot '{HOSTILE}' --report out.html"
BIPED = """\
model: {package: gainroom, file: biped.urdf, base: floating}
joints: {default: {motor_inertia: 1.0, stiffness: 1.0e4, damping: 1.0}}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 2.0}
postures: {stand: {".*_hip_pitch": -0.3, ".*_knee": 0.6, ".*_ankle_pitch": -0.3}}
contacts: {double: [left_sole, right_sole], left: [left_sole], flight: []}
balance: joints
"""
UNCERTAIN = (
    BIPED.replace(", flight: []", "")
    + """\
control: {type: pd, feedback: motor, sample_rate_hz: 1000, kp: {default: 2000.0, ".*_knee": 3000.0}, kd: 150.0}
limits: {peak_sensitivity: 2.0}
uncertainty: {delay_ms: [2.0, 3.0], stiffness: 20%}
"""
)
JOINT_SPACE = "control: {type: pd, feedback: motor, kp: 2000.0, kd: 100.0}\n"
# theory: harmless on a rigid robot, unstable with elasticity and delay, least of all on one foot
TASK_SPACE = "control: {type: pd, space: task, feedback: motor}\ntasks: [{name: com, type: com, kp: 100, kd: 20}]\n"
THIGH = 0.35  # published; the robot's legs move in planes that the side view shows in true size
ARM = """\
model: {file: robot.urdf, base: fixed}
joints: {default: {motor_inertia: 0.5, stiffness: 5e3, damping: 2}}
drive: {bandwidth: 3000, delay_ms: 2}
postures: {bent: {"hip.*": 0.3, knee: -0.8}}
control: {type: pd, feedback: motor, kp: 400, kd: 20}
tasks: [{name: tip, type: position, frame: tip, kp: 200, kd: 20}]
"""


def arm(folder: Path, text: str = ARM, hip: str = "hip", recommend: bool = False) -> RobotStudy:
    """Two links in a plane."""
    links = link("base") + link("upper", 4.0, (0, 0, 0.25), (0.1, 0.1, 0.01)) + link("lower", 3.0, (0, 0, 0.2), (0.05, 0.05, 0.01))
    joints = hinge(escape(hip), "base", "upper") + hinge("knee", "upper", "lower", (0, 0, 0.5))
    write_robot(folder, links + link("tip"), joints + hinge("end", "lower", "tip", (0, 0, 0.4), kind="fixed"))
    return study_robot(parse_robot(text, "robot.yaml", folder), recommend=recommend)


@pytest.fixture(scope="module")
def biped() -> RobotStudy:
    return study_robot(parse_robot(BIPED + JOINT_SPACE, "biped.yaml"), recommend=False)


@pytest.fixture(scope="module")
def page(biped) -> str:
    return robot_page(RobotPresentation(biped), COMMAND)


@pytest.fixture(scope="module")
def unstable() -> RobotStudy:
    return study_robot(parse_robot(BIPED.replace(", flight: []", "") + TASK_SPACE, "biped.yaml"), recommend=False)


@pytest.fixture(scope="module")
def unstable_page(unstable) -> str:
    return robot_page(RobotPresentation(unstable), COMMAND)


@pytest.fixture(scope="module")
def small_arm(tmp_path_factory) -> RobotStudy:
    return arm(tmp_path_factory.mktemp("arm"), recommend=True)


def traces(figure: dict, kind: str) -> list[dict]:
    """The traces of a drawing: "joints", "patches", "bars"."""
    found = {
        "joints": lambda one: one.get("marker", {}).get("coloraxis") and one["type"] == "scatter",
        "patches": lambda one: one.get("fill") == "toself",
        "bars": lambda one: one["type"] == "bar",
    }
    return [one for one in figure["data"] if found[kind](one)]


def drawings(html: str) -> list[dict]:
    """Of vibrations at gain limits; before them stands the motion at the requirement that decides, where that is another."""
    html = html[html.index("<h2>Vibration by contact state") :] if re.search("<h2>What (fails|is tightest)", html) else html
    return [one for one in figures(html) if traces(one, "joints")]


def places(trace: dict) -> dict[str, tuple[float, float, float]]:
    """x, y and colour of every joint by name."""
    names = [text.partition(":")[0] for text in trace["text"]]
    return {name: values for name, *values in zip(names, trace["x"], trace["y"], trace["marker"]["color"], strict=True)}


def cells(html: str, heading: str) -> dict[str, list[str]]:
    """The rows of the table whose first column is called `heading`, by their first cell."""
    for table in re.findall(r"<table.*?</table>", html, re.S):
        if re.search(r'<th scope="col">(.*?)</th>', table).group(1) == heading:
            rows = (re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr>(?=<td)(.*?)</tr>", table))
            return {unescape(first): [unescape(cell) for cell in rest] for first, *rest in rows}
    raise AssertionError(heading)


@pytest.mark.slow
def test_page_is_self_contained_and_small(page):
    assert len(page.encode()) < 6e6
    own = without_library(page)
    assert not re.findall(r"<(?:link|img|iframe|object|embed|audio|video|source)\b", own)
    assert not re.findall(r"<[a-z][^>]*\s(?:src|href)\s*=", own)
    for outside in ("@import", "url(", "https://", "http://"):
        assert outside not in own


@pytest.mark.slow
def test_page_carries_answer_then_reason_in_order(page, biped):
    own = unescape(without_library(page))
    wanted = [
        sentence(biped).partition(". ")[0],
        "gain margin",
        "≥ 6 dB",
        "What fails: peak sensitivity Ms",
        "Gain headroom",
        "Vibration by contact state",
        "characteristic loci",
        "Cost of coupling",
        "Recommended gains",
        "Joints",
        "Inputs and assumptions",
        "Certification",
        "Command",
        COMMAND,
        gr.__version__,
    ]
    start = own.index("<body")
    for part in wanted:
        start = own.index(part, start)
    assert 3 <= own.count('<div class="card ') <= 5
    assert own.count("<figure>") == own.count("<figcaption>") + own.count("</tbody></table></div></figure>")  # pictures have captions


@pytest.mark.slow
def test_the_first_picture_is_of_what_fails(page, biped):
    """The state and loop with the largest Ms: found on a dense grid. Colours: what one joint's disturbance moves, S e_k."""
    first = next(one for one in figures(page) if traces(one, "joints"))
    motion = biped.decisive_motion
    omega = np.geomspace(0.5, 3000.0, 4000)
    peaks = []
    for state in biped.states:
        found = np.linalg.inv(np.eye(12) + state.loop.response(omega))
        own = np.abs(np.einsum("kii->ki", found))
        peaks.append((own.max(), omega[own.max(1).argmax()], state.model.joint_names[own.max(0).argmax()], state.title))
    worst, at, joint, title = max(peaks)
    assert (motion.joint, motion.state.title) == (joint, title)
    assert motion.limit.frequency == approx(at, rel=2e-3)
    assert biped.least(motion.state, "peak_sensitivity") == approx(worst, rel=1e-4)
    column = np.linalg.inv(np.eye(12) + motion.state.loop.response(np.array([motion.limit.frequency]))[0])
    parts = np.abs(column[:, motion.state.model.joint_names.index(joint)])
    shown = places(traces(first, "joints")[0])
    for name, part in zip(motion.state.model.joint_names, parts / parts.max(), strict=True):
        assert shown[name][2] == approx(part, rel=1e-5, abs=1e-9)
    assert f"What fails: peak sensitivity Ms {worst:.3g} in {title}" in unescape(page)


@pytest.mark.slow
def test_the_first_picture_is_of_the_worst_of_the_uncertainty():
    """Where the worst value is another resonance's than the nominal one: value, frequency and place of the same loop."""
    study = study_robot(parse_robot(UNCERTAIN, "biped.yaml"), recommend=False)
    motion, one = study.decisive_motion, REQUIREMENTS[study.decisive]
    assert motion is not None
    nominal = study.worst[study.decisive].margins
    assert one.value(motion.state.margins) == approx(study.least(study.worst[study.decisive], one.name), rel=1e-9)
    assert motion.limit.frequency == one.frequency(motion.state.margins) != approx(one.frequency(nominal), rel=0.5)
    assert motion.place == study.case_of(study.decisive) != ""


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="no browser")
@pytest.mark.parametrize(("width", "most"), [(1400, 5000), (420, 9000)])
def test_the_page_is_short_before_anything_is_opened(page, tmp_path, width, most):
    """Measured in a browser: the height at two widths, and that nothing is wider than a phone."""
    size = "[document.documentElement.scrollHeight, document.documentElement.scrollWidth].join(' ')"
    tell = f"<script>setTimeout(() => parent.postMessage({size}, '*'), 900)</script>"
    (tmp_path / "page.html").write_text(page.replace("</body>", f"{tell}</body>"), "utf-8")
    hear = "<script>addEventListener('message', (told) => { document.title = told.data })</script>"
    frame = f"<title></title>{hear}<iframe src='page.html' style='width:{width}px; height:1000px; border:0'></iframe>"
    (tmp_path / "frame.html").write_text(frame, "utf-8")  # a window has a least width
    call = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", f"--user-data-dir={tmp_path / 'profile'}"]
    call += ["--virtual-time-budget=8000", "--window-size=1500,1000", "--hide-scrollbars", "--dump-dom"]
    done = subprocess.run([*call, (tmp_path / "frame.html").as_uri()], capture_output=True, check=True)
    shown = done.stdout.decode()
    title = re.search(r"<title>(\d+) (\d+)</title>", shown)
    assert title is not None
    assert int(title[1]) < most
    assert int(title[2]) <= width


def test_details_are_closed_with_a_line_of_what_they_hold(page):
    own = without_library(page)
    closed = re.findall(r'<details class="section"><summary><h2>(.*?)</h2>(.*?)</summary>', own)
    assert {"Certification", "Joints", "Recommended gains", "Command"} <= {title for title, _ in closed}
    assert all(line.strip() for _, line in closed)
    opened = re.sub(r'<details class="section">.*?</details>\n', "", own, flags=re.S)
    assert opened.count('class="plot"') == 1  # what fails


def test_all_text_in_pictures_is_at_least_12_px(page, unstable_page):
    def sizes(value):
        if isinstance(value, dict):
            for key, item in value.items():
                if key in ("font", "textfont", "tickfont") and "size" in item:
                    yield item["size"]
                yield from sizes(item)
        elif isinstance(value, list):
            for item in value:
                yield from sizes(item)

    found = [size for html in (page, unstable_page) for figure in figures(html) for size in sizes(figure)]
    assert found
    assert min(found) >= 12


def test_drawing_is_in_proportion(page, biped):
    hero, *others = drawings(page)
    assert len(others) == len(biped.states)
    side, front = (places(trace) for trace in traces(hero, "joints"))
    for leg in ("left", "right"):
        hip, knee = np.array(side[f"{leg}_hip_pitch"][:2]), np.array(side[f"{leg}_knee"][:2])
        assert np.linalg.norm(hip - knee) == approx(THIGH, rel=1e-4)  # six digits are written
    # Depth: half scale at 30°, the far leg higher; the hips are 0.205 m apart.
    away = np.subtract(side["left_knee"][:2], side["right_knee"][:2])
    assert_allclose(away, 0.5 * 0.205 * np.array([math.cos(math.pi / 6), 0.5]), rtol=1e-4)
    across = np.subtract(front["left_knee"][:2], front["right_knee"][:2])
    assert_allclose(across, (0.205, 0.0), atol=1e-5)
    for figure in others:  # common axes
        assert figure["layout"]["xaxis"]["range"] == others[0]["layout"]["xaxis"]["range"]
        assert figure["layout"]["yaxis"]["range"] == others[0]["layout"]["yaxis"]["range"]
        assert figure["layout"]["yaxis"]["scaleanchor"] == "x"


def test_view_holds_both_sides_apart(biped):
    view = common_view(biped.states)
    points = np.vstack([state.model.body.skeleton(state.model.q).positions for state in biped.states])
    side, front = view.side(points), view.front(points)
    assert side[:, 0].max() < front[:, 0].min()
    for plane in (side, front):
        assert np.all(plane > view.low)
        assert np.all(plane < view.high)


def test_joints_are_coloured_by_their_part(page, biped):
    for figure, state in zip(drawings(page), (biped.tightest, *biped.states), strict=True):
        parts = dict(zip(state.model.joint_names, np.abs(state.limit.mode), strict=True))
        for trace in traces(figure, "joints"):
            found = places(trace)
            assert found.keys() == parts.keys()
            for name, (_, _, color) in found.items():
                assert color == approx(parts[name], rel=1e-5, abs=1e-9)
        assert figure["layout"]["coloraxis"]["cmin"] == 0
        assert figure["layout"]["coloraxis"]["cmax"] == 1
    double = places(traces(drawings(page)[1], "joints")[0])
    for joint in ("hip_pitch", "knee", "ankle_pitch"):  # the critical mode of a symmetric stance is symmetric, left against right
        assert double[f"left_{joint}"][2] == approx(double[f"right_{joint}"][2], rel=1e-4)
    (bars,) = traces(drawings(page)[0], "bars")
    assert bars["x"] == sorted(bars["x"], reverse=True)
    assert bars["x"][0] == 1


def test_colours_run_from_light_to_dark_for_all_eyes(page):
    scale = drawings(page)[0]["layout"]["coloraxis"]["colorscale"]
    light = [sum(w * int(color[k : k + 2], 16) for w, k in zip((0.2126, 0.7152, 0.0722), (1, 3, 5), strict=True)) for _, color in scale]
    assert light == sorted(light, reverse=True)


@pytest.mark.parametrize("height", [0.0, 0.5])
def test_a_stand_is_no_limb(tmp_path: Path, height: float):
    """From a fixed base up to the first joint a dashed line, in both views; limbs are solid, and none begins at the base below."""
    links = link("base") + link("upper", 4.0, (0, 0, 0.25), (0.1, 0.1, 0.01)) + link("lower", 3.0, (0, 0, 0.2), (0.05, 0.05, 0.01))
    write_robot(tmp_path, links, hinge("hip", "base", "upper", (0, 0, height)) + hinge("knee", "upper", "lower", (0, 0, 0.5)))
    state = study_robot(parse_robot(ARM[: ARM.index("tasks")], "robot.yaml", tmp_path), recommend=False).states[0]
    traces_, _ = drawing(state.model, state.limit, common_view([state]), 17)
    lines = [one for one in traces_ if one.get("mode") == "lines" and one.get("fill") is None and one["line"]["width"] != 3]
    stands = [one for one in lines if one["line"]["dash"] == "dash"]
    assert [sorted(one["y"][:2]) for one in stands] == [[0.0, height]] * (2 if height else 0)
    limbs = [one for one in lines if one not in stands]
    assert len(limbs) >= 2
    assert min(value for one in limbs for value in one["y"] if value is not None) >= height - 1e-9


def test_lines_to_names_of_joints_at_one_height_cross_no_disc(tmp_path: Path):
    """The outer one's name is level with it; the inner one's is a line lower, so that its line passes below."""
    names, links, joints = ("knee", "hip"), link("base"), ""
    for name, at in zip(names, (0.5, 0.25), strict=True):
        links += link(f"{name}_leg", 4.0, (0, 0, -0.25), (0.1, 0.1, 0.01))
        joints += hinge(name, "base", f"{name}_leg", (0, at, 0.0))
    write_robot(tmp_path, links, joints)
    text = ARM[: ARM.index("tasks")].replace('{"hip.*": 0.3, knee: -0.8}', "{}")
    state = study_robot(parse_robot(text, "robot.yaml", tmp_path), recommend=False).states[0]
    limit = replace(state.limit, mode=np.ones(2, dtype=complex), frequency=1.0)
    outer, inner = labels(state.model, limit, common_view([state]), 300.0)
    assert (outer["text"], inner["text"]) == names
    assert outer["ay"] == outer["y"] == inner["y"]
    assert inner["ay"] == approx(inner["y"] - LINE / 300.0)


def test_contacts_are_marked(page, biped):
    for figure, state in zip(drawings(page)[1:], biped.states, strict=True):
        assert len(traces(figure, "patches")) == 2 * len(state.model.contacts)  # two views
        words = " ".join(note["text"] for note in figure["layout"]["annotations"])
        assert ("no contact" in words) == (not state.model.contacts)


def test_heat_map_tells_what_is_left(page, biped):
    (heat,) = [one for figure in figures(page) for one in figure["data"] if one["type"] == "heatmap"]
    together = [digits(state.limit.gain, "", 3) for state in biped.states]
    assert heat["text"][0] == together
    state, joint = biped.states[1], 10  # the lifted foot's ankle, the lightest load
    factor = 10 ** heat["z"][1 + joint][1]
    assert heat["text"][1 + joint][1] == digits(factor, "", 3)

    def loop(scale: float) -> gr.Loop:
        kp, kd = np.full(12, 2000.0), np.full(12, 100.0)
        kp[joint], kd[joint] = scale * kp[joint], scale * kd[joint]
        return gr.build_loop(state.model, biped.system.drives, gr.PD(kp, kd), "motor")

    assert gr.is_stable(loop(0.999 * factor))
    assert not gr.is_stable(loop(1.001 * factor))


def test_one_is_the_neutral_colour(page):
    (axis,) = [figure["layout"]["coloraxis"] for figure in figures(page) if figure["data"][0]["type"] == "heatmap"]
    assert axis["cmin"] == -axis["cmax"]
    assert dict(axis["colorscale"])[0.5] == "#ffffff"
    assert "1: the limit" in axis["colorbar"]["ticktext"][axis["colorbar"]["tickvals"].index(0)]


def loci_figures(html: str) -> list[dict]:
    return [one for one in figures(html) if one["layout"]["xaxis"].get("title", {}).get("text") == "Re λ(L)"]


def test_loci_are_eigenvalues_of_the_loop(page, biped):
    found = loci_figures(page)
    assert len(found) == len(biped.states)
    for figure, state in zip(found, biped.states, strict=True):
        (strong,) = [one for one in figure["data"] if one.get("hoverinfo") == "text" and one["mode"] == "lines"]
        points = [(x, y, text) for x, y, text in zip(strong["x"], strong["y"], strong["text"], strict=True) if x is not None]
        assert len(points) > 30
        for x, y, text in points[::10]:
            omega = float(re.search(r"([\d.\u202f]+) rad/s", text).group(1).replace("\u202f", ""))
            around = omega * (1 + np.linspace(-5e-4, 5e-4, 41))  # ω is told to four digits
            values = np.linalg.eigvals(state.loop.response(around))
            # resonances are damped by B ω / 2 K > 0.5 %, 200 of these steps: in one a locus moves by at most as much of itself
            assert np.abs(values - complex(x, y)).min() < 5e-3 * max(1.0, math.hypot(x, y))
        (crossing,) = [one for one in figure["data"] if one["mode"] == "markers" and one["marker"]["symbol"] == "circle"]
        assert crossing["x"][0] == approx(-1 / state.limit.gain, rel=1e-5)
        assert crossing["y"] == [0]
        words = " ".join(note["text"] for note in figure["layout"]["annotations"])
        assert digits(state.limit.frequency, "rad/s", 3) in words
        assert figure["layout"]["xaxis"]["range"] == found[0]["layout"]["xaxis"]["range"]


def test_all_loci_are_drawn(page, biped):
    """The grey lines hold every eigenvalue in the window at any frequency."""
    figure, state = loci_figures(page)[1], biped.states[1]
    grey = next(one for one in figure["data"] if one["line"]["color"] == "#9a9a9a")
    drawn = np.array([complex(x, y) for x, y in zip(grey["x"], grey["y"], strict=True) if x is not None])
    (left, right), (bottom, top) = figure["layout"]["xaxis"]["range"], figure["layout"]["yaxis"]["range"]
    for omega in np.geomspace(10, 2000, 9):
        for value in np.linalg.eigvals(state.loop.response(omega)[0]):
            if left < value.real < right and bottom < value.imag < top:
                assert np.abs(drawn - value).min() < 0.03  # half the longest step between points, 0.012 + 0.005 of the window


def test_unstable_says_so_first(unstable_page, unstable, page):
    own = without_library(unstable_page)
    body = own[own.index("<body") :]
    assert not unstable.stable
    assert body.startswith('<body class="bad">')
    assert 0 < body.index("UNSTABLE") < body.index("<h1>")
    assert body.index("<h1>Not safe: unstable") < body.index('class="cards"') < body.index('class="plot"')
    assert "✓ met" not in body
    for figure, state in zip(drawings(unstable_page)[1:], unstable.states, strict=True):
        words = " ".join(note["text"] for note in figure["layout"]["annotations"])
        assert ("UNSTABLE" in words) == (not state.limit.stable)
        assert (figure["layout"]["plot_bgcolor"] == "white") == state.limit.stable
    calm = without_library(page)
    assert "UNSTABLE" not in calm
    assert 'class="bad"' not in calm


def test_unmet_requirements_are_told(page, biped):
    """Phase margin and peak sensitivity of the supporting leg fall short; the verdict is that of the states' own loops."""
    own = without_library(page)
    assert '<body class="bare">' in own
    kept = [quick_margins(state.loop) for state in biped.states]
    assert not all(biped.system.requirements.met_by(one) for one in kept)
    peak = max(one.peak_sensitivity for one in kept)
    assert f'<p class="value">{digits(peak, "", 3)}</p>' in own


def test_state_and_joint_tables_hold_the_study(page, biped):
    rows = cells(without_library(page), "state")
    assert [name.replace("\u00a0", " ") for name in rows] == [state.title for state in biped.states]
    for row, state in zip(rows.values(), biped.states, strict=True):
        assert row[:2] == ["yes", digits(state.limit.gain)]
        assert row[-2] == digits(state.margins.disk_margin, "", 3)
    joints = cells(without_library(page), "joint")
    assert list(joints) == list(biped.system.source.joint_names)
    for name, row in zip(joints, biped.tightest.joints, strict=True):
        assert joints[name][:5] == [
            digits(v) for v in (row.link_inertia, row.single_joint_limit, row.limit_others_closed, row.kp, row.kp_max)
        ]


@pytest.mark.parametrize("contacts", ["free: []", "free: [], touching: [{frame: tip, type: point, stiffness: 1e4, damping: 50}]"])
def test_postures_are_no_contact_states(tmp_path, contacts):
    """With few states all are drawn, however many postures there are."""
    text = ARM.replace("postures: {", "postures: {high: {knee: 0.5}, ") + f"contacts: {{{contacts}}}\n"
    study = arm(tmp_path, text)
    assert len(study.states) == 2 * contacts.count("[]") + 2 * contacts.count("touching")
    assert "not drawn" not in without_library(robot_page(RobotPresentation(study), COMMAND))


def test_recommended_gains_in_both_units(small_arm):
    html = robot_page(RobotPresentation(small_arm), COMMAND)
    own = without_library(html)
    joint, task = small_arm.recommended
    state = small_arm.states[0]
    load = state.model.motor_inertia + 1 / np.diagonal(np.linalg.inv(state.model.body.mass_matrix(state.model.q)))
    tables = re.findall(r"<table.*?</table>", own[own.index("Recommended gains</h2>") : own.index("Operational space</h2>")], re.S)
    plain, normalised, kept, tasks, _ = (re.findall(r"<td[^>]*>(.*?)</td>", table) for table in tables)
    best = joint.everywhere
    assert best is not None
    for k in range(2):
        assert plain[3 * k : 3 * k + 3] == [joint.names[k], digits(best.kp[k]), digits(best.kd[k])]
        assert normalised[3 * k + 1 : 3 * k + 3] == [digits(best.kp[k] / load[k]), digits(best.kd[k] / load[k])]
    assert len(plain) == len(normalised) == 2 * 3  # one contact state: its own set is the one for all states
    assert kept[0::6] == ["for all states"]
    assert "≥ 6 dB" in tables[2]
    assert task.names == ("tip x", "tip y", "tip z")
    assert tasks[3:6] == ["tip y", "–", "–"] or tasks[4] != "–"  # y is across the plane in which the arm moves
    directions = cells(own, "direction")
    assert "–" in directions["tip y"]


def test_coupling_marks_are_the_factors(unstable_page, unstable):
    by_state = next(one for one in figures(unstable_page) if one["layout"].get("showlegend") and len(one["layout"]["shapes"]) == 1)
    marks = {one["name"]: one for one in by_state["data"] if one["mode"] == "markers"}
    assert marks["all together"]["x"] == approx([state.limit.gain for state in unstable.states], rel=1e-5)
    left = 10 ** by_state["layout"]["xaxis"]["range"][0]
    for drawn, state in zip(marks["alone"]["x"], unstable.states, strict=True):
        alone = np.nanmin(state.limits_others_open)  # NaN: tasks put no gain on that joint
        assert alone > left
        assert drawn == approx(alone, rel=1e-5)
    assert "other loops closed" not in marks


def test_gains_that_nothing_limits(tmp_path):
    study = arm(tmp_path, ARM.replace("delay_ms: 2", "delay_ms: 0").replace("bandwidth: 3000", "bandwidth: .inf"))
    assert math.isinf(study.tightest.limit.gain)
    html = robot_page(RobotPresentation(study), COMMAND)
    own = without_library(html)
    assert "no vibration at any factor" in own
    assert "No locus crosses" in own
    for trace in traces(drawings(html)[0], "joints"):
        assert trace["marker"]["color"] == "white"
    assert not re.search(r">nan\b|\bnan<", own)


def test_gains_that_no_factor_saves(small_arm):
    (state,) = small_arm.states
    limit = GainLimit(False, 0.0, math.nan, math.nan, np.ones(2, dtype=complex), None)
    margins = Margins.unknown(limit)
    known = replace(small_arm.system, control=replace(small_arm.system.control, continuous=True))
    study = replace(small_arm, system=known, every=(changed(state, margins=margins),))
    html = robot_page(RobotPresentation(study), COMMAND)
    own = without_library(html)
    assert '<body class="bad">' in own
    assert "UNSTABLE at any lower gain" in own
    assert "no uniform gain reduction makes" in own
    assert not re.search(r">nan\b|\bnan<", own)


def test_what_a_user_typed_is_text(tmp_path):
    text = ARM.replace("bent:", f"{HOSTILE!r}:".replace("\\'", "''")).replace("name: tip", 'name: "<b>tip"')
    study = arm(tmp_path, text, hip="hip<script>alert(1)</script>&")
    html = robot_page(RobotPresentation(study), COMMAND)
    own = without_library(html)
    assert "<script>alert" not in own
    assert "<img" not in own
    for figure in figures(html):
        for words in re.findall(r"<(?!/?b>|/?extra>|br>)[^<>]*>", str(figure)):  # <extra> is plotly's own, about a curve's name
            pytest.fail(f"markup in a picture: {words}")


@pytest.mark.slow
def test_many_states_stay_readable(biped):
    """Two postures in nine contact states: the tightest are drawn, the tables have all."""
    named = ((state, {"posture": f"posture {k // 9}", "contact": f"contact {k % 9}"}) for k, state in enumerate(6 * biped.states))
    study = replace(biped, every=tuple(changed(state, **vars(state) | names) for state, names in named))
    html = robot_page(RobotPresentation(study), COMMAND)
    assert len(html.encode()) < 6e6
    assert len(drawings(html)) == 1 + MOST_PICTURES
    assert len(loci_figures(html)) == MOST_PICTURES
    heat = next(one for figure in figures(html) for one in figure["data"] if one["type"] == "heatmap")
    assert len(heat["x"]) == MOST_STATES
    assert len(cells(without_library(html), "state")) == len(study.states)
    assert "1 contact state with more headroom is not drawn" in without_library(html)


def test_a_requirement_that_is_not_met_is_explained(page, biped):
    """What a phase margin of several loops is, and what other gains would make of it: as the loops with those gains have it."""
    words = " ".join(re.sub(r"<[^>]*>", " ", unescape(without_library(page))).split())
    state = biped.unmet["phase_margin"]
    assert f"Phase margin of {state.model.size} loops: the smallest phase lag or lead" in words
    assert f"in {state.title}, at {state.margins.gain_crossover / (2 * np.pi):.3g} Hz" in words
    (told,) = re.findall(r"It would be ([\d.]+)° with all kd × 1.25 and ([\d.]+)° with all kp × 0.8, but ([\d.]+)° with all kd", words)
    drives, control = biped.system.drives, biped.system.control
    for (kp, kd), shown in zip(((1.0, 1.25), (0.8, 1.0), (1.0, 0.8)), told, strict=True):
        changed = gr.PD(kp * control.controller.kp, kd * control.controller.kd)
        truth = gr.joint_margins(gr.build_loop(state.model, drives, changed, control.feedback, control.sample_time)).phase_margin
        assert float(shown) == pytest.approx(np.degrees(truth), rel=5e-3)  # three digits, interpolated to a part in a thousand


def test_required_and_of_which_gains(page, unstable_page, small_arm):
    with_tasks = robot_page(RobotPresentation(small_arm), COMMAND)
    for html, words in (
        (page, "of the joints' gains closed together"),
        (with_tasks, "The tasks' own gains, closed in the joints' place, are required to be stable only"),
        (unstable_page, "of all tasks closed together"),
    ):
        text = " ".join(unescape(without_library(html)).split())
        assert "Required: gain margin ≥ 6 dB, phase margin ≥ 30°, Ms ≤ 2" in text
        assert words in text
