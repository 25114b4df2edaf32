"""The C++ header of a tracked robot: a program that has nothing else of the robot gives the limits that Python gives."""

from collections.abc import Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

import gainroom as gr
from gainroom.robot.contact import Contact
from native_programs import SANITIZED, compiled, output
from test_gain_tracker import WHEELS, WHEELS_YAML
from test_posture_table import HOSTILE

BIPED = str(files("gainroom") / "files" / "examples" / "biped.yaml")
EXAMPLE = Path(__file__).parents[1] / "examples" / "posture_loop.cpp"
TICK = 5e-4
PROGRAM = """
#include <cstdio>
#include <cstdlib>

// Lines of the number of a contact state and a posture; of each what is said of it. First whether the tracker settled.
int main() {
    const gainroom::TrackedRobot tracked = my_robot();
    gainroom::GainTracker tracker(tracked);
    std::printf("%d\\n", int(tracker.settle()));
    std::vector<double> q(tracked.posture.size());
    char word[64];
    while (std::scanf("%63s", word) == 1) {
        const std::size_t contact = std::strtoul(word, nullptr, 10);
        for (double& value : q) {
            if (std::scanf("%63s", word) != 1) return 1;
            value = std::strtod(word, nullptr);
        }
        const gainroom::Limit found = tracker.update(q.data(), contact);
        const int certified = found.certified, flag = int(found.flag);
        std::printf("%a %a %d %ld %a %d\\n", found.gain, found.frequency, certified, found.age, found.safe_gain, flag);
    }
}
"""
FAST = ("-O3", "-march=native", "-ffp-contract=fast")
FLAGS = ("", "posture", "contact", "too few constraints")


def with_control(robot, **changes):
    """A robot whose system has another control."""
    return replace(robot, system=replace(robot.system, control=replace(robot.system.control, **changes)))


def legs(_: Path):
    return gr.load_robot(BIPED)


def rigid_legs(folder: Path):
    """Rigid joints and ideal current loops: numbers that are infinite."""
    (folder / "rigid.yaml").write_text(
        Path(BIPED).read_text().replace("stiffness: 1.0e4", "stiffness: .inf").replace("bandwidth: 4000.0", "bandwidth: .inf")
    )
    return with_control(gr.load_robot(str(folder / "rigid.yaml")), sample_time=TICK)


def tasks(_: Path):
    """Of the biped, with gains of its centre of mass that are stable in every posture."""
    robot = gr.load_robot(BIPED)
    robot = replace(robot, stack=(replace(robot.stack[0], kp=100.0, kd=20.0), *robot.stack[1:]))
    return with_control(robot, sample_time=TICK, space="task", controller=None)


def wheels(folder: Path):
    """A fixed base, joints that turn on."""
    (folder / "wheels.urdf").write_text(WHEELS, "utf-8")
    (folder / "robot.yaml").write_text(WHEELS_YAML, "utf-8")
    return gr.load_robot(str(folder / "robot.yaml"))


def program(folder: Path, header: str, name: str = "tracked_robot", options: Sequence[str] = SANITIZED) -> Path:
    (folder / f"{name}.cpp").write_text(header + PROGRAM)
    return compiled(folder / f"{name}.cpp", *options)


def header_of(tracker: gr.GainTracker, folder: Path) -> str:
    tracker.to_header(folder / "robot.hpp", "my", date="2026-11-28")
    return in_main(folder / "robot.hpp")


def in_main(header: Path) -> str:
    """Its text inside a program, which is compiled once for as long as that stays the same."""
    return header.read_text("ascii").replace("#pragma once\n", "", 1)


def line(contact: int, q) -> str:
    return " ".join([str(contact), *(float(value).hex() for value in q)])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "options"), [(legs, SANITIZED), (legs, FAST), (rigid_legs, SANITIZED), (tasks, SANITIZED), (tasks, FAST), (wheels, SANITIZED)]
)
def test_the_header_tracks_what_python_tracks(make, options, tmp_path: Path):
    """In motion, with contact switches. Python's first limits come from Pinocchio's matrices, the header's from its own tree: their last
    digits differ, and after them those of the crossings, which Newton's method finds to 1e-11 or so.

    With all that this processor can do gcc 12 took half of a floating base's momentum for 0 (pose.hpp).
    """
    robot = make(tmp_path)
    tracker, ticks = gr.GainTracker(robot), range(1500)
    names = [tracker.contacts[tick // 333 % len(tracker.contacts)] for tick in ticks]
    postures = [moved(robot, tick) for tick in ticks]
    lines = [line(list(robot.contacts).index(name), q) for name, q in zip(names, postures, strict=True)]
    built = program(tmp_path, header_of(tracker, tmp_path), options=options)
    settled, *said = output(built, given="\n".join(lines)).splitlines()
    assert settled == "1"
    both = 0
    for words, q, name in zip(said, postures, names, strict=True):
        now, (gain, frequency, certified, age, safe, flag) = tracker.update(q, name), words.split()
        assert FLAGS[int(flag)] == now.flag == ""
        if now.certified and certified == "1":
            both += 1
            numbers = [float.fromhex(word) for word in (gain, frequency, safe)]
            assert numbers == pytest.approx([now.gain, now.frequency, now.safe_gain], rel=1e-9)
            assert int(age) == now.age_ticks == 0
    assert both > 0.95 * len(ticks)


def moved(robot, tick: int):
    """Every joint swings about the first posture, each at its own rate."""
    body, angles = robot.body, dict(next(iter(robot.postures.values())).angles)
    own = np.arange(body.size)
    swing = 0.2 * np.sin(1e-3 * (2.0 + 0.3 * own) * tick + own)
    return body.configuration({name: angles.get(name, 0.0) + angle for name, angle in zip(body.joint_names, swing, strict=True)})


@pytest.mark.slow
def test_what_is_no_posture_or_contact_is_flagged(tmp_path: Path):
    """Numbers that are none, unknown contact states, and one in which a floating base cannot stand: flags as in Python, nothing raised."""
    robot = gr.load_robot(BIPED)
    robot = replace(robot, contacts={"toe": (Contact("left_sole", "point"),), **robot.contacts})
    tracker = gr.GainTracker(robot)
    names = list(robot.contacts)
    q = robot.body.configuration(dict(robot.postures["stand"].angles))
    given = [("double", q), ("double", q * np.nan), ("up", q), ("toe", q), ("left", 2 * q), ("left", q)]
    lines = [line(names.index(name) if name in names else 99, posture) for name, posture in given]
    text = header_of(tracker, tmp_path)
    built = program(tmp_path, text)
    settled, *said = output(built, given="\n".join(lines)).splitlines()
    assert settled == "1"
    expected = [tracker.update(posture, name) for name, posture in given]
    assert [FLAGS[int(words.split()[5])] for words in said] == [one.flag for one in expected]
    assert [one.flag for one in expected] == ["", "posture", "contact", "too few constraints", "posture", ""]
    safe = [float.fromhex(words.split()[4]) for words in said]
    assert safe == pytest.approx([one.safe_gain for one in expected], rel=1e-9)
    system = replace(robot.system, source=robot)
    limits = {name: gr.gain_limit(system.loop(robot.linearize("stand", name))).gain for name in ("toe", "left")}
    assert expected[3].safe_gain <= 0.9 * limits["toe"] < limits["left"]


EDITED = """
#include <cstdio>
#include <functional>
#include <limits>

// What settle() says of robots that are not as they were written, then the tick after it.
int main() {
    using Robot = gainroom::TrackedRobot;
    constexpr double none = std::numeric_limits<double>::quiet_NaN(), infinite = std::numeric_limits<double>::infinity();
    const std::vector<std::function<void(Robot&)>> edits = {
        [](Robot&) {},
        [](Robot& robot) { robot.contacts[1].limit *= 1 + 1e-5; },
        [](Robot& robot) { robot.contacts[1].limit = infinite; },
        [](Robot& robot) { robot.contacts[1].limit = none; },
        [](Robot& robot) { robot.contacts[1].limit = 0.0; },
        [](Robot& robot) { robot.contacts.clear(); },
        [](Robot& robot) { for (auto& one : robot.contacts) one.tracked = false; },
        [](Robot& robot) { robot.contacts[1].held[0].frame.link = 60; },
        [](Robot& robot) { robot.posture.pop_back(); },
        [](Robot& robot) { robot.posture.clear(); },
        [](Robot& robot) { robot.joints.pop_back(); },
        [](Robot& robot) { robot.joint_names.clear(); },
        [](Robot& robot) { robot.sample_time = none; },
        [](Robot& robot) { robot.sample_time = -1e-3; },
        [](Robot& robot) { robot.gain_margin = 0.0; },
        [](Robot& robot) { robot.stack.sizes.push_back(3); },
        [](Robot& robot) { robot.tasks.push_back({gainroom::Reading::center, {0, {}}}); },
        [](Robot& robot) { robot.gain_margin = infinite; },
        [](Robot& robot) { robot.tree = {true, {}, {}, {{1.0, {}, {}}}, {}}; },
        [](Robot& robot) { robot.tree = {true, {}, {{1000, {}, {0, 0, 1}, false, false}}, {{1.0, {}, {}}, {1.0, {}, {}}}, {}}; },
        [](Robot& robot) { robot.tree = {true, {}, {{0, {}, {0, 0, 1}, false, false}}, {{1.0, {}, {}}}, {}}; },
        [](Robot& robot) {  // sizes whose sum is right
            robot.tasks.assign(2, {gainroom::Reading::center, {0, {}}});
            robot.stack.sizes = {4, 2};
            robot.stack.kp.assign(6, 1.0), robot.stack.kd.assign(6, 1.0);
        },
    };
    const std::vector<double> q = my_robot().posture;
    for (const auto& edit : edits) {
        Robot robot = my_robot();
        edit(robot);
        gainroom::GainTracker tracker(robot);
        const bool settled = tracker.settle();
        const gainroom::Limit limit = tracker.update(q.data(), 1);
        const char* where = tracker.unsettled();
        std::printf("%d %d %a %d %s\\n", int(settled), int(limit.certified), limit.safe_gain, int(limit.flag), where ? where : "-");
    }
}
"""


@pytest.mark.slow
def test_what_is_not_as_it_was_written_is_never_settled(tmp_path: Path):
    """And its ticks tell nothing but that."""
    source = tmp_path / "edited_robot.cpp"
    source.write_text(header_of(gr.GainTracker(gr.load_robot(BIPED)), tmp_path) + EDITED)
    first, other, *rest = [words.split() for words in output(compiled(source, *SANITIZED)).splitlines()]
    assert (first[:2], first[3:]) == (["1", "1"], ["0", "-"])
    assert other == ["0", "0", "0x0p+0", "4", "left"]
    assert len(rest) == 20
    assert all(words == ["0", "0", "0x0p+0", "4", "-"] for words in rest)


@pytest.mark.slow
def test_the_example_follows_a_walk(tmp_path: Path):
    robot = gr.load_robot(BIPED)
    gr.GainTracker(robot, replace(robot.system.control, sample_time=1e-3)).to_header(tmp_path / "biped.hpp", "biped")
    source = EXAMPLE.read_text().replace('#include "biped.hpp"', in_main(tmp_path / "biped.hpp"))
    (tmp_path / EXAMPLE.name).write_text(source)
    said = output(compiled(tmp_path / EXAMPLE.name)).splitlines()
    assert len(said) == 8
    assert all(" certified" in one and one.endswith("factor on the gains 1.000") for one in said)  # limits of some 4, for 6 dB


@pytest.mark.slow
def test_names_stay_inside_their_strings(tmp_path: Path):
    """Contact states of any name; what the program has of them is what Python has, byte for byte."""
    robot = gr.load_robot(BIPED)
    names = [name for name in HOSTILE if "\0" not in name]
    tracker = gr.GainTracker(replace(robot, contacts=dict.fromkeys(names, robot.contacts["double"])))
    main = "\n".join(f'    if (tracked.contact("{_octal(name)}") != {k}) return {k + 1};' for k, name in enumerate(names))
    source = header_of(tracker, tmp_path) + f"int main() {{\n    const auto tracked = my_robot();\n{main}\n    return 0;\n}}\n"
    assert "int x = 1" not in source
    (tmp_path / "names_of_robot.cpp").write_text(source)
    assert output(compiled(tmp_path / "names_of_robot.cpp")) == ""


def _octal(name: str) -> str:
    return "".join(f"\\{byte:03o}" for byte in name.encode())


def test_the_file_is_whole_or_not_there(tmp_path: Path):
    target = tmp_path / "robot.hpp"
    target.write_text("before")
    (tmp_path / "robots").mkdir()
    tracker = gr.GainTracker(wheels(tmp_path / "robots"))
    for name in ("1x", "a b", "", "a-b", None, "_x", "x" * 41):
        with pytest.raises(gr.GainroomError, match=r"C\+\+ header: name .* must be a letter"):
            tracker.to_header(target, name)
    with pytest.raises(gr.GainroomError, match="cannot be written"):
        tracker.to_header(tmp_path / "nowhere" / "robot.hpp", "my")
    assert target.read_text() == "before"
    tracker.to_header(target, "VALUES")
    assert "inline gainroom::TrackedRobot VALUES_robot() {" in target.read_text()
