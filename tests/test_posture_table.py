"""Gains by posture and contact: limits at the grid's points, what holds between them, and the C header against Python."""

import os
import shutil
import subprocess
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

import gainroom as gr
from gainroom.design.realtime.c_header import string
from gainroom.robot.linearize import linearize

BIPED = files("gainroom") / "files" / "examples" / "biped.yaml"
KNEES = gr.Feature("knees", {"left_knee": 1.0, "right_knee": 1.0, "left_hip_pitch": -0.5, "right_hip_pitch": -0.5}, 0.0, 1.2, 4)
SWAY = gr.Feature("sway", {"left_hip_roll": 1.0, "right_hip_roll": 1.0}, -0.2, 0.2, 3)
PROGRAM = """\
#include <stdio.h>
#include "table.h"
int main(void) {
    double angles[GAIN_TABLE_JOINTS];
    gain_table_gains gains;
    char name[64];
    while (scanf("%63s", name) == 1) {
        for (int j = 0; j < GAIN_TABLE_JOINTS; j++)
            if (scanf("%la", &angles[j]) != 1) return 1;
        const int status = gain_table_lookup(angles, gain_table_contact(name), &gains);
        printf("%d %d %d %a", status, gains.status, gains.certified, gains.factor);
        for (int j = 0; j < GAIN_TABLE_JOINTS; j++) printf(" %a %a", gains.kp[j], gains.kd[j]);
        printf("\\n");
    }
    for (int j = 0; j < GAIN_TABLE_JOINTS; j++) printf("%s\\n", gain_table_joints[j]);
    printf("%s\\n%s\\n%s\\n", gain_table_model, gain_table_date, gain_table_features[0]);
    return 0;
}
"""


@pytest.fixture(scope="module")
def biped(tmp_path_factory: pytest.TempPathFactory):
    """In continuous time."""
    path = tmp_path_factory.mktemp("table") / "biped.yaml"
    path.write_text(BIPED.read_text("utf-8").replace("sample_rate_hz: 2000", "#"), "utf-8")
    return gr.load_robot(path)


@pytest.fixture(scope="module")
def table(biped) -> gr.PostureTable:
    own = {name: ([2000.0 + 100 * k] * 12, [100.0 + 5 * k] * 12) for k, name in enumerate(("double", "left", "flight"))}
    return gr.PostureTable.computed(biped, (KNEES, SWAY), gr.GainTable.of(own), samples=25, highest=4.0)


def limit(biped, table: gr.PostureTable, angles, contact: str) -> float:
    """By another way to the loop: linearize with the configuration itself."""
    q = biped.body.configuration(dict(zip(table.joints, angles, strict=True)))
    own = table.own[table.contacts.index(contact)]
    return gr.gain_limit(
        gr.build_loop(linearize(biped.body, biped.actuators, q, biped.contacts[contact]), biped.system.drives, gr.PD(*own))
    ).gain


def angles_at(table: gr.PostureTable, knees: float, sway: float):
    """The posture by the definition of its features."""
    found = dict(zip(table.joints, table.base, strict=True))
    for feature, value in ((KNEES, knees), (SWAY, sway)):
        for name, weight in feature.joints.items():
            found[name] += weight * value
    return np.array([found[name] for name in table.joints])


@pytest.mark.slow
def test_points_of_the_grid_are_the_loops_limits(biped, table):
    for contact, k, m in (("double", 0, 0), ("left", 3, 1), ("flight", 2, 2)):
        knees, sway = 0.4 * k, -0.2 + 0.2 * m
        expected = limit(biped, table, angles_at(table, knees, sway), contact)
        assert table.limits[table.contacts.index(contact), k, m] == pytest.approx(expected, rel=1e-9)
    assert table.certified.all()


def test_postures_between_hold_the_margin(biped, table):
    """Fresh random postures, joints beside the features included: never less than the gain margin, whatever the corners were."""
    rng = np.random.default_rng(77)
    for number in range(60):
        contact = table.contacts[number % 3]
        angles = angles_at(table, rng.uniform(0.1, 1.1), rng.uniform(-0.15, 0.15)) + rng.uniform(-0.04, 0.04, 12)
        gains = table.lookup(angles, contact)
        assert gains.status in (0, 1)
        assert gains.factor * table.margin <= limit(biped, table, angles, contact) * (1 + 1e-9)
        assert gains.kp == pytest.approx(gains.factor * table.own[number % 3, 0])


def test_the_least_corner_counts(table):
    """Of made-up limits: inside a cell, on its edges and in the corners of the grid."""
    made = replace(
        table, limits=np.arange(table.limits.size, dtype=float).reshape(table.limits.shape) + 1.0, between=0.5, margin=2.0, highest=1e3
    )
    cases = {(0.2, -0.1): 1.0, (0.6, 0.1): 5.0, (0.0, -0.2): 1.0, (1.2, 0.2): 8.0, (0.5, 0.05): 5.0}
    for at, least in cases.items():
        assert made.lookup(angles_at(table, *at), "double").factor == pytest.approx(0.25 * least)
        assert made.lookup(angles_at(table, *at), "left").factor == pytest.approx(0.25 * (least + 12))
    assert not replace(made, certified=np.arange(36).reshape(3, 4, 3) != 5).lookup(angles_at(table, 0.6, 0.1), "double").certified


def test_what_is_not_in_the_table_has_the_lowest_gains(table):
    inside = angles_at(table, 0.6, 0.0)
    lowest = min(table.highest, table.outside * table.limits[1].min() / table.margin)
    assert table.outside <= table.between
    cases = [(angles_at(table, 1.3, 0.0), 1), (angles_at(table, 0.6, -0.3), 1), (inside + 0.2 * (np.arange(12) == 5), 1)]
    cases += [(np.where(np.arange(12) == 3, bad, inside), 2) for bad in (np.nan, np.inf, -np.inf)]
    cases += [(inside[:-1], 2), ("?", 2)]
    for angles, status in cases:
        found = table.lookup(angles, "left")
        assert (found.status, found.certified, found.factor) == (status, False, lowest)
    for name in ("up", "", None):
        found = table.lookup(inside, name)
        assert (found.status, found.certified) == (3, False)
        assert found.kp == pytest.approx(table.everywhere_factor * table.everywhere[0])
        assert (found.kp <= table.highest * table.own[:, 0].min(axis=0)).all()


@pytest.mark.slow
def test_postures_outside_are_told_and_their_gains_are_low_but_for_a_few(biped, table):
    """Of postures like the 75 looked at a share of more than x lies lower with a probability of (1 − x)^75: 0.1 % for 26 of 300."""
    rng, high, seen = np.random.default_rng(3), 0, []
    for number in range(300):
        contact = table.contacts[number % 3]
        angles = angles_at(table, rng.uniform(-1.2, 2.4), rng.uniform(-0.6, 0.6)) + rng.uniform(-0.3, 0.3, 12)
        gains = table.lookup(angles, contact)
        seen.append((gains.status, gains.certified))
        high += gains.factor * table.margin > limit(biped, table, angles, contact) * (1 + 1e-9)
    assert set(seen) == {(1, False)}
    assert (table.looked_outside, table.never) == (75, 0)
    assert high <= 26


def test_postures_outside_where_no_factor_is_safe_are_counted(biped, monkeypatch):
    from gainroom.design.realtime import posture_table

    def limit_of(self, contact, gains, values, offset=0.0):
        if values[0] > KNEES.high:
            raise gr.GainroomError("no factor")
        return 2.0, True

    monkeypatch.setattr(posture_table._PostureLimits, "limit", limit_of)
    made = gr.PostureTable.computed(biped, (KNEES, SWAY), samples=30)
    assert made.never > 0
    assert made.looked_outside + made.never == 30 * len(made.contacts)
    assert made.outside == 1.0


@pytest.mark.parametrize("option", ["-ffast-math", "-ffinite-math-only"])
def test_the_header_refuses_to_take_all_numbers_for_finite(table, tmp_path: Path, option: str):
    table.to_header(tmp_path / "table.h")
    (tmp_path / "main.c").write_text(PROGRAM)
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    done = subprocess.run(["cc", option, "-fsyntax-only", str(tmp_path / "main.c")], capture_output=True, text=True, check=False)
    assert done.returncode
    assert "compile it without" in done.stderr


def ran(folder: Path, header: str, lines: str, *, cpp: bool = False) -> list[str]:
    (folder / "table.h").write_text(header)
    (folder / "main.c").write_text(PROGRAM)
    compiler = os.environ.get("CXX") or shutil.which("c++") or "build/native/c++" if cpp else "cc"  # the core's own, and C's
    if shutil.which(compiler) is None:
        pytest.skip("no compiler")
    language = ["-x", "c++", "-std=c++17"] if cpp else ["-std=c99"]
    options = ["-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]
    command = [compiler, *language, *options, str(folder / "main.c"), "-o", str(folder / "program")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert not done.returncode, done.stderr
    return subprocess.run([str(folder / "program")], input=lines, capture_output=True, text=True, check=True).stdout.splitlines()


@pytest.mark.parametrize("cpp", [False, True], ids=["C99", "C++17"])
def test_the_header_gives_what_python_gives(table, tmp_path: Path, cpp: bool):
    """Bit for bit, in the table and outside, at random, on edges, for no numbers and for unknown contacts."""
    rng = np.random.default_rng(5)
    made = replace(table, limits=rng.uniform(1.0, 9.0, table.limits.shape), certified=rng.random(table.limits.shape) > 0.2)
    postures = [angles_at(table, rng.uniform(-0.1, 1.3), rng.uniform(-0.25, 0.25)) + rng.uniform(-0.02, 0.02, 12) for _ in range(300)]
    postures += [angles_at(table, 0.4 * k, -0.2 + 0.2 * m) for k in range(4) for m in range(3)]
    postures += [np.where(np.arange(12) == 3, bad, postures[0]) for bad in (np.nan, np.inf, -np.inf, 1e300)]
    names = [("double", "left", "flight", "up")[k % 4] for k in range(len(postures))]
    lines = "\n".join(f"{name} {' '.join(float(x).hex() for x in angles)}" for name, angles in zip(names, postures, strict=True))
    made.to_header(tmp_path / "table.h", date="2026-11-23")
    said = ran(tmp_path, (tmp_path / "table.h").read_text(), lines, cpp=cpp)
    seen = set()
    for line, name, angles in zip(said, names, postures, strict=False):
        words, gains = line.split(), made.lookup(angles, name)
        assert [int(word) for word in words[:3]] == [gains.status, gains.status, gains.certified]
        assert float.fromhex(words[3]) == gains.factor
        assert [float.fromhex(word) for word in words[4:]] == np.column_stack([gains.kp, gains.kd]).ravel().tolist()
        seen.add((gains.status, gains.certified))
    assert seen == {(0, True), (0, False), (1, False), (2, False), (3, False)}
    assert said[len(postures) :] == [*table.joints, table.model, "2026-11-23", "knees"]


HOSTILE = [
    '"; } int x = 1; //',
    "*/ #error",
    "a\nb",
    "\\",
    "??/",
    "\\\n",
    "%s",
    "NAME_x GUARD DATA JOINTS",
    "übel",
    "\0",
    "#include <x>",
    "",
]


def test_names_stay_inside_their_strings(table, tmp_path: Path):
    """The header compiles, and gives every name back byte for byte."""
    odd = replace(table, joints=tuple(HOSTILE), model='*/ "model" /*', features=(replace(KNEES, name="*/\n#error"), SWAY))
    header = tmp_path / "odd.h"
    odd.to_header(header, date='*/ "now"')
    text = header.read_text("ascii")
    assert text.count("#error") == 1  # its own
    assert "int x = 1" not in text
    assert text.count("*/") == text.count("/*")
    bytes_of = ["".join(f"\\{byte:03o}" for byte in name.encode()) + "\\0" for name in HOSTILE]
    program = "\n".join(
        f'    if (memcmp(gain_table_joints[{k}], "{each}", {each.count(chr(92))})) return {k + 1};' for k, each in enumerate(bytes_of)
    )
    (tmp_path / "names.c").write_text(f'#include <string.h>\n#include "odd.h"\nint main(void) {{\n{program}\n    return 0;\n}}\n')
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    subprocess.run(["cc", "-std=c99", "-Wall", "-Werror", str(tmp_path / "names.c"), "-o", str(tmp_path / "names")], check=True)
    subprocess.run([str(tmp_path / "names")], check=True)


def test_a_string_ends_where_it_ends():
    assert string('a"1') == '"a\\0421"'
    assert string("a\nb?") == '"a\\012b\\077"'


def test_the_file_is_whole_or_not_there(table, tmp_path: Path):
    target = tmp_path / "table.h"
    target.write_text("before")
    for name in ("1x", "a b", "", "a-b", 'x"', "é", "x" * 41, None, "_x"):
        with pytest.raises(gr.GainroomError, match="letter"):
            table.to_header(target, name)
    with pytest.raises(gr.GainroomError, match="cannot be written"):
        table.to_header(tmp_path / "nowhere" / "table.h")
    assert target.read_text() == "before"
    table.to_header(target, "legs2")
    assert "legs2_lookup" in target.read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["table.h"]


WRONG = {
    "0 features": {"features": ()},
    "is not one of": {"features": (replace(KNEES, joints={"left_kne": 1.0}),)},
    "must not be 0": {"features": (replace(KNEES, joints={"left_knee": 0.0}),)},
    "belongs to another": {"features": (KNEES, replace(KNEES, name="again"))},
    "must be below": {"features": (replace(KNEES, low=1.2),)},
    ">= 2": {"features": (replace(KNEES, points=1),)},
    "at most": {"features": (replace(KNEES, points=200_000),)},
    "name joints": {"features": (replace(KNEES, joints={}),)},
    "one kp and kd per joint": {"gains": gr.PID(1000.0, 1.0, 100.0)},
    "up'": {"gains": gr.GainTable.of({"up": ([1.0] * 12, [1.0] * 12)})},
    "the robot has 12": {"gains": gr.GainTable.of({"left": ([1.0], [1.0])})},
    "samples": {"samples": 0},
    "aside": {"aside": -1.0},
    "highest": {"highest": 0.0},
}


@pytest.mark.parametrize("words", WRONG)
def test_what_makes_no_table_is_refused(biped, words: str):
    given = dict(WRONG[words])
    with pytest.raises(gr.GainroomError, match=words):
        gr.PostureTable.computed(biped, given.pop("features", (KNEES,)), **given)
