"""States in which the gains move nothing, and directions that nothing moves: told as what they are, beside the others as if alone."""

import json
import math
import re
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from pytest import approx

import gainroom as gr
from gainroom.analysis.disk_margin import disk_margin_of
from gainroom.analysis.margin_record import GainLimit, Margins
from gainroom.cli import main
from gainroom.design.robot_gains import recommend_robot
from gainroom.files.audit_options import AuditOptions, audited as described
from gainroom.files.robot_yaml import parse_robot
from gainroom.report.audit_text import audit_sentence, audit_warnings
from gainroom.report.robot import robot_page
from gainroom.report.robot_tables import RobotPresentation
from gainroom.report.robot_text import sentence, warnings
from gainroom.studies.audit import Audit, audit
from gainroom.studies.robot import RobotStudy, study_robot
from gainroom.studies.state import limiting_joints, state_of
from independent.quick_margins import quick_margins
from refusals import assert_refused
from robot_files import changed, write_arm
from robot_truths import GRAVITY, hinge, link, write_robot

LEG = """\
model: {file: robot.urdf, base: floating}
joints: {default: {motor_inertia: 0.5, stiffness: 5e3, damping: 2}}
drive: {bandwidth: 3000, delay_ms: 2}
postures: {bent: {hip: 0.4, knee: -0.8, ankle: 0.4}}
contacts: {flight: [], stand: [foot]}
control: {type: pd, space: task, feedback: motor}
tasks: [{name: com, type: com, kp: [100, 100, 60], kd: [10, 10, 5]}]
"""
JOINTS = "control: {type: pd, feedback: motor, kp: 300, kd: 20}"
HELD = """\
model: {file: robot.urdf, base: fixed}
joints: {default: {motor_inertia: 0.5}}
drive: {bandwidth: 3000, delay_ms: 2}
postures: {bent: {hip: 0.4, knee: -0.8, ankle: 0.4}}
contacts: {free: [], held: [foot]}
control: {type: pd, feedback: motor, kp: 300, kd: 20}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A trunk on a leg that moves in a plane."""
    path = tmp_path_factory.mktemp("leg")
    links = (
        link("base")
        + link("trunk", 20.0, (0, 0, 0.2), (0.5, 0.5, 0.2))
        + link("thigh", 4.0, (0, 0, -0.2), (0.1, 0.1, 0.01))
        + link("shank", 3.0, (0, 0, -0.2), (0.05, 0.05, 0.01))
        + link("foot", 1.0, (0.05, 0, -0.05), (0.01, 0.01, 0.01))
    )
    joints = (
        hinge("seat", "base", "trunk", kind="fixed")
        + hinge("hip", "trunk", "thigh")
        + hinge("knee", "thigh", "shank", (0, 0, -0.4))
        + hinge("ankle", "shank", "foot", (0, 0, -0.4))
    )
    write_robot(path, links, joints)
    (path / "leg.yaml").write_text(LEG, "utf-8")
    return path


def studied(folder: Path, text: str, recommend: bool = False) -> RobotStudy:
    return study_robot(parse_robot(text, "f", folder), recommend=recommend)


@pytest.fixture(scope="module")
def leg(folder: Path) -> RobotStudy:
    return studied(folder, LEG, recommend=True)


@pytest.fixture(scope="module")
def without(folder: Path) -> RobotStudy:
    """The same without the state in which nothing moves."""
    return studied(folder, LEG.replace("flight: [], ", ""), recommend=True)


@pytest.mark.slow
def test_a_state_in_which_nothing_moves_is_apart(leg: RobotStudy, without: RobotStudy):
    (state,), (alone,), (still,) = leg.states, without.states, leg.immobile
    assert (still.title, still.reason) == ("bent/flight", "the tasks act on no motion")
    assert (state.limit.gain, state.limit.frequency, state.margins.disk_margin) == (
        alone.limit.gain,
        alone.limit.frequency,
        alone.margins.disk_margin,
    )
    assert state.joints == alone.joints
    assert leg.stable == without.stable
    assert not without.immobile
    assert sentence(leg).endswith("In bent/flight the tasks act on no motion.")
    (warning,) = [text for text in warnings(leg) if "bent/flight" in text]
    for word in ("no verdict and no limit", "posture task"):
        assert word in warning


@pytest.mark.slow
def test_gains_are_told_only_where_they_move_something(leg: RobotStudy, without: RobotStudy):
    joint, task = leg.recommended
    assert joint.per_contact["flight"] is not None  # the joints do move there
    assert joint.per_contact["flight"].moves
    flight, stand, everywhere = task.per_contact["flight"], task.per_contact["stand"], task.everywhere
    assert flight is not None
    assert not flight.moves
    assert np.isnan([*flight.kp, *flight.kd, flight.margins.gain_margin]).all()
    assert math.isnan(task.cost["flight"])
    alone = without.recommended[1].everywhere
    assert stand is not None
    assert everywhere is not None
    assert alone is not None
    assert_array_equal(everywhere.kp, alone.kp)
    assert np.isnan(everywhere.kp).tolist() == [False, True, False]  # the leg moves in the plane of x and z
    assert everywhere.binding == "bent/stand"
    assert everywhere.cases == 1


@pytest.fixture
def at_once(leg: RobotStudy, monkeypatch: pytest.MonkeyPatch):
    """The command has studied the leg already."""
    monkeypatch.setattr("gainroom.studies.robot.study_robot", lambda spec, progress: leg)


@pytest.mark.slow
@pytest.mark.usefixtures("at_once")
def test_json_keeps_its_keys(folder: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["robot", str(folder / "leg.yaml"), "--json", "--exit-zero"]) == 0
    facts = json.loads(capsys.readouterr().out)
    flight, stand = facts["states"]
    assert (flight["contact"], stand["contact"]) == ("flight", "stand")
    assert flight.keys() == stand.keys()
    assert (flight["moves"], stand["moves"]) == (False, True)
    for key in ("stable", "gain_limit", "limit_frequency_rad_s", "disk_margin"):
        assert flight[key] is None
        assert stand[key] is not None
    for name in ("joints", "tasks"):
        assert [row.keys() for row in flight[name]] == [row.keys() for row in stand[name]]
    assert [row["moves"] for row in flight["tasks"]] == [False] * 3
    assert [row["moves"] for row in stand["tasks"]] == [True, False, True]
    sets = {one["contact"]: one for one in facts["recommended"][1]["sets"]}
    assert sets["flight"]["kp"] == sets["flight"]["kd"] == [None] * 3
    assert sets["flight"]["moves"] is False
    assert sets["everywhere"]["kp"][1] is None
    assert sets["everywhere"]["kp"][0] > 0


@pytest.mark.slow
@pytest.mark.usefixtures("at_once")
def test_terminal_and_page_say_it_in_words(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    report = tmp_path / "out.html"
    assert main(["robot", str(folder / "leg.yaml"), "--verbose", "--report", str(report), "--exit-zero"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert max(map(len, out.splitlines())) <= max(80, len(f"Report: {report}"))
    words = " ".join(out.split())
    for text in (
        "No gains for com y: nothing can move there",
        "Nothing moves in contact flight",
    ):
        assert text in words
    assert re.search(r"bent/flight( –)+ nothing moves", words)
    page = report.read_text("utf-8")
    for text in ("<td>bent/flight</td><td>–</td>", "nothing moves there: gains have no effect", "no loop is closed"):
        assert text in page


@pytest.mark.slow
def test_joint_control_with_idle_tasks(folder: Path):
    """The joints are judged in every state, the tasks in those where they move something."""
    study = studied(folder, LEG.replace(LEG.splitlines()[5], JOINTS))
    assert not study.immobile
    assert [state.tasks is not None and state.tasks.moves for state in study.states] == [False, True]
    assert "The tasks act on no motion in bent/flight" in robot_page(RobotPresentation(study), "again")


def test_contacts_that_hold_every_joint(folder: Path):
    study = studied(folder, HELD, recommend=True)
    assert ([state.contact for state in study.states], [state.contact for state in study.immobile]) == (["free"], ["held"])
    assert sentence(study).endswith("In bent/held no joint that has gains can move.")
    (gains,) = study.recommended
    assert {name: one is not None and one.moves for name, one in gains.per_contact.items()} == {"free": True, "held": False}
    assert gains.everywhere is not None
    assert np.isfinite(gains.everywhere.kp).all()


def test_nothing_moves_anywhere(folder: Path):
    text = LEG.replace("flight: [], stand: [foot]", "flight: []")
    assert_refused(lambda: studied(folder, text), ["f: the tasks act on no motion in any posture and contact state"])


def test_a_direction_without_gains_has_no_limit(folder: Path):
    """Control along z alone: the same limit whether x is in the task without gains, or its gains do nothing."""
    (state,) = studied(folder, LEG.replace("[100, 100, 60]", "[0, 100, 60]").replace("[10, 10, 5]", "[0, 10, 5]")).states
    assert state.tasks is not None
    x, y, z = state.tasks.rows
    assert (x.moves, y.moves, z.moves) == (True, False, True)
    assert math.isnan(x.gain_limit)
    assert math.isnan(x.limit_others_closed)
    assert z.gain_limit == approx(state.limit.gain, rel=1e-9)
    assert z.limit_others_closed == approx(state.limit.gain, rel=1e-6)  # sampled and polished on another curve


@pytest.mark.slow
def test_the_verdict_holds_for_the_stated_ranges(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    """A delay that may be a thousandth longer than the delay margin allows is one too many; a thousandth less is none."""
    text = LEG.replace(LEG.splitlines()[5], JOINTS)
    monkeypatch.setattr("gainroom.studies.robot._recommended", lambda system: [])  # gains to use are of no concern
    room = min(1e3 * state.margins.delay_margin for state in studied(folder, text).states)
    path = folder / "uncertain.yaml"
    for share, stable in ((0.999, True), (1.001, False)):
        path.write_text(text + f"uncertainty: {{delay_ms: [1.5, {2 + share * room!r}]}}\n", "utf-8")
        assert main(["robot", str(path), "--json"]) == 1  # within a thousandth of the delay margin no 30° of phase are left
        told = json.loads(capsys.readouterr().out)
        assert told["stable"]
        assert told["stable_in_range"] == stable
        assert (told["unstable_at"] is None) == stable
        assert ("not everywhere in the uncertainty ranges" in told["sentence"]) != stable
    page = robot_page(RobotPresentation(studied(folder, path.read_text("utf-8"))), "gainroom robot uncertain.yaml")
    assert "UNSTABLE within the uncertainty ranges, in bent/" in page


@pytest.mark.slow
def test_gains_that_keep_all_that_is_required_are_not_called_too_stiff(folder: Path):
    """The file's own gains, here some that were recommended, made to fit no other shape: what is recommended is no softer than they."""
    text = LEG.replace(LEG.splitlines()[5], JOINTS) + "limits: {gain_margin_db: 6, phase_margin_deg: 30, peak_sensitivity: 2}\n"
    first = recommend_robot(parse_robot(text, "f", folder)).everywhere
    assert first is not None
    names = ("hip", "knee", "ankle")
    own = {
        gain: "{" + ", ".join(f"{name}: {value!r}" for name, value in zip(names, values.tolist(), strict=True)) + "}"
        for gain, values in (("kp", first.kp), ("kd", first.kd))
    }
    again = text.replace(JOINTS, re.sub(r"kp: [^,}]+, kd: [^,}]+", f"kp: {own['kp']}, kd: {own['kd']}", JOINTS))
    spec = parse_robot(again, "f", folder)
    study = study_robot(spec, recommend=False)
    assert not study.unmet  # what was promised holds when it is looked at again
    recommended = recommend_robot(spec).everywhere
    assert recommended is not None
    np.testing.assert_array_equal(recommended.kp, first.kp)


def test_a_joint_that_the_file_leaves_slack_is_given_gains(folder: Path):
    """Stiff on two joints and nothing on the third: no shape to compare others with by their mean."""
    text = LEG.replace(LEG.splitlines()[5], JOINTS.replace("kp: 300", "kp: {hip: 3000, knee: 3000, ankle: 0}")).replace("flight: [], ", "")
    gains = recommend_robot(parse_robot(text, "f", folder)).everywhere
    assert gains is not None
    assert np.all(gains.kp > 0)


@pytest.mark.slow
def test_the_one_safe_set_never_costs_less_than_nothing(folder: Path):
    """What is safe in all states is safe in each, though every search stops within 2 %."""
    contacts = "flight: [], stand: [foot], toe: [{frame: foot, type: point}], knee: [shank]"
    text = (
        LEG.replace("flight: [], stand: [foot]", contacts).replace(LEG.splitlines()[5], JOINTS)
        + "limits: {gain_margin_db: 6, phase_margin_deg: 30}\n"
    )
    gains = recommend_robot(parse_robot(text, "f", folder))
    assert min(gains.cost.values()) >= 1
    assert max(gains.cost.values()) > 1.05  # or nothing was tried
    for one in gains.per_contact.values():
        assert one is not None
        assert one.margins.least_gain_margin >= 10 ** (6 / 20)


@pytest.mark.slow
def test_cascade_gains_are_those_that_were_checked(folder: Path):
    """Put back into the tasks, recommended P/PI gains keep what is said of them."""
    text = LEG.replace("type: pd", "type: ppi").replace("kp: [100, 100, 60], kd: [10, 10, 5]", "kp: 10, kv: [10, 10, 4], ki: 5")
    text = text.replace("flight: [], ", "")
    study = studied(folder, text, recommend=True)
    (state,), spec = study.states, study.system
    found = study.recommended[1].everywhere
    assert found is not None
    assert found.ki is not None
    tasks = spec.source.tasks(state.model)
    gains = {name: np.nan_to_num(getattr(found, name)) for name in ("kp", "kd", "ki")}
    kept = quick_margins(spec.loop(state.model, spec.filtered(replace(tasks, **gains).controller())))
    # the same loop twice, once as directions in the core, once as matrices by LAPACK: each polishes to eleven digits
    for own, other in ((kept.limit.gain, found.margins.limit.gain), (kept.phase_margin, found.margins.phase_margin)):
        assert other == pytest.approx(own, rel=1e-9)
    assert found.margins.least_phase_margin == pytest.approx(kept.least_phase_margin, rel=1e-9)
    assert found.margins.least_gain_margin == pytest.approx(kept.least_gain_margin, rel=1e-9)
    assert found.margins.peak_sensitivity == pytest.approx(kept.peak_sensitivity, rel=1e-6)  # both by parabolas between other samples


ARM = """\
model: {file: robot.urdf, base: fixed}
joints: {default: {motor_inertia: 0.5, stiffness: 2e5}}
drive: {bandwidth: 3000, delay_ms: 2}
postures: {bent: {hip: 0.3, knee: -0.8}}
control: {type: pd, feedback: link, kp: 1, kd: 0.4}
tasks: [{name: trunk, type: posture, kp: 200, kd: 20}]
"""


def test_a_limit_that_cannot_be_followed_leaves_the_verdict(folder: Path):
    """Undamped springs, small gains: the verdict is that of the roots, whether or not a limit is found beside it."""
    (state,) = studied(folder, ARM.replace("joints: {", "joints: {locked: [ankle], ")).states
    assert state.limit.stable == (gr.rightmost_roots(state.loop, 8).roots.real < 0).all()


@pytest.mark.slow
def test_what_is_not_known_is_said(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    def lost(loop: gr.Loop) -> None:
        raise gr.GainroomError("the loci could not be followed")

    alone = LEG.replace("flight: [], ", "")
    for text in (alone, alone.replace("delay_ms: 2", "delay_ms: 200")):
        (folder / "lost.yaml").write_text(text, "utf-8")
        monkeypatch.undo()
        word = "Stable" if studied(folder, text).stable else "Unstable"
        for name in ("joint_margins", "gain_limit"):
            monkeypatch.setattr(f"gainroom.studies.loop_numbers.{name}", lost)
        study = studied(folder, text)
        (state,) = study.states
        assert state.limit.stable == (word == "Stable") == (text == alone)
        assert math.isnan(state.limit.gain)
        at_rate = (
            "Not decided: the loop's rate is not given, and any rate costs margin (control.sample_rate_hz); the gain margin is not known"
        )
        assert sentence(study).startswith(at_rate if word == "Stable" else "Not safe: unstable")
        assert ("in a loop at 2 kHz these gains would be unstable" in sentence(study)) is (word == "Stable")
        assert sentence(study).endswith("In bent/stand only the verdict is known, not the gain limit.")
        assert any("counted from the roots" in warning for warning in warnings(study))
        page = robot_page(RobotPresentation(study), "again")
        assert not re.search(r">nan\b|\bnan<|>∞ ×", page[page.index("<body") :])
        monkeypatch.setattr("gainroom.studies.robot.study_robot", lambda spec, progress, study=study: study)
        status = 3 if word == "Stable" else 1
        assert main(["robot", str(folder / "lost.yaml"), "--json"]) == status
        (told,) = json.loads(capsys.readouterr().out)["states"]
        assert (told["stable"], told["gain_limit"], told["limit_certified"]) == (word == "Stable", None, False)
        assert main(["robot", str(folder / "lost.yaml")]) == status
        assert "nan" not in capsys.readouterr().out


def test_disk_margin_is_that_of_the_motors_torques(folder: Path):
    """A stack that moves everything: the margin of D P, each torque with a factor of its own; opened at the positions it is another."""
    stack = "tasks: [{name: com, type: com, kp: [10, 1, 10], kd: [0.5, 1, 5]}, {name: rest, type: posture, kp: 0.5, kd: 1}]"
    text = (
        LEG.replace("base: floating", "base: fixed").replace(LEG.splitlines()[-1], stack).replace("flight: [], stand: [foot]", "free: []")
    )
    (state,) = studied(folder, text).states
    loop = state.loop
    assert loop.parts is not None
    control = loop.parts.controller

    def at_torques(omega: np.ndarray) -> np.ndarray:
        s = 1j * omega
        return control.matrix(s, s, loop.size, None) @ loop.actuated_at(1j * omega)

    omega = np.geomspace(1e-2, 1e4, 400)
    assert state.margins.disk_certified
    assert state.margins.disk_margin == approx(
        disk_margin_of(at_torques, omega).margin, rel=2e-3
    )  # certified and sampled, each to a thousandth
    assert state.margins.disk_margin != approx(disk_margin_of(loop.response, omega).margin, rel=0.02)


@pytest.mark.slow
def test_gravity_counts_on_two_feet_in_continuous_time():
    """Both feet held: W is singular. With the weight the legs topple sooner than without, and every number is known."""
    text = (
        (files("gainroom") / "files" / "examples" / "biped.yaml")
        .read_text("utf-8")
        .replace("base: floating}", "base: floating, gravity_stiffness: true}")
    )
    spec = parse_robot(text, "robot.yaml")
    for posture in ("stand", "crouch"):
        state = state_of(spec, posture, "double")
        assert state.limit.stable
        assert state.limit.certificate is not None
        assert state.limit.certificate.holds
        assert 0 < state.limit.lower_gain < 1
        assert math.isfinite(state.margins.gain_margin)
        sampled = replace(spec, control=replace(spec.control, sample_time=5e-4))
        held = state_of(sampled, posture, "double")
        assert state.limit.lower_gain == approx(held.limit.lower_gain, rel=1e-3)  # of statics, which no sampling changes


def test_gains_that_are_too_soft_for_gravity_say_how_stiff_they_have_to_be(tmp_path: Path):
    """A rigid pendulum that stands is held where kp > m g l."""
    links = link("base") + link("upper", 4.0, (0, 0, 1.0), (0.1, 0.1, 0.01))
    write_robot(tmp_path, links, hinge("hip", "base", "upper", (0, 0, 1.0)))
    text = """
model: {file: robot.urdf, base: fixed, gravity_stiffness: true}
joints: {default: {motor_inertia: 0.1, stiffness: rigid}}
drive: {bandwidth: .inf, delay_ms: 1.0}
postures: {up: {}}
contacts: {none: []}
control: {type: pd, feedback: motor, sample_rate_hz: 1000, kp: KP, kd: 2.0}
"""
    held = 4.0 * GRAVITY * 1.0  # statics, which no rate and no delay changes
    for kp, factor in ((0.1 * held, 10.0), (0.6 * held, 1 / 0.6), (2 * held, None)):
        study = study_robot(parse_robot(text.replace("KP", repr(kp)), "robot.yaml", tmp_path), recommend=False)
        (state,) = study.states
        assert state.stable == (factor is None)
        if factor is None:
            assert state.toppled_below is None
        else:
            assert state.toppled_below == approx(factor, rel=1e-6)  # the weight is differenced
            assert "too soft to hold the robot against gravity, which in up/none takes more than" in sentence(study)


def test_what_each_state_keeps(folder: Path, leg: RobotStudy, at_once: None, capsys: pytest.CaptureFixture[str]):
    (state,) = leg.states
    quick = quick_margins(state.loop)  # other searches on the same loci
    for one, _ in leg.system.requirements.asked_for:
        bounded = one.value
        assert bounded(state.margins) == approx(bounded(quick), rel=1e-9)
    assert main(["robot", str(folder / "leg.yaml"), "--json", "--exit-zero"]) == 0
    told = json.loads(capsys.readouterr().out)["states"][1]
    assert 10 ** (told["kept"]["gain_margin_db"] / 20) == approx(state.margins.least_gain_margin)
    assert told["kept"]["phase_margin_deg"] == approx(math.degrees(state.margins.least_phase_margin))
    assert told["kept"]["peak_sensitivity"] == state.margins.peak_sensitivity
    assert told["disk_margin_certified"] is state.margins.disk_certified


@pytest.mark.slow
@pytest.mark.parametrize(("certified", "shown"), [(True, " 0.25 "), (False, " ~0.25 ")])
def test_a_disk_margin_that_is_not_certified_says_so(
    folder: Path, leg: RobotStudy, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], certified: bool, shown: str
):
    (state,) = leg.states
    study = replace(leg, every=(changed(state, margins=replace(state.margins, disk_margin=0.25, disk_certified=certified)),))
    monkeypatch.setattr("gainroom.studies.robot.study_robot", lambda spec, progress: study)
    main(["robot", str(folder / "leg.yaml"), "--verbose"])
    assert shown in capsys.readouterr().out
    page = robot_page(RobotPresentation(study), "again")
    assert f"<td>{shown.strip()}</td>" in page
    assert f"proved between frequencies, too, in {'all' if certified else '0 of 1'} stable states" in page


@pytest.mark.parametrize("first", [True, False])
def test_what_one_state_does_not_tell_is_not_met(leg: RobotStudy, first: bool):
    """Whatever the order of states: all that is required is missed where nothing but the verdict is known."""
    (state,) = leg.states
    unknown = changed(state, margins=Margins.unknown(GainLimit.unknown(state.model.size)))
    study = replace(leg, every=(unknown, state) if first else (state, unknown))
    assert study.stable
    assert study.unmet == dict.fromkeys(study.system.requirements.asked, unknown)


def test_legs_that_round_off_tells_apart_keep_the_models_order():
    mode = np.array([0.3, 1 - 1e-13, 0.7j, -1.0, 0.7 + 1e-12])
    limit = GainLimit(True, 2.0, 0.0, 100.0, mode, None)
    assert limiting_joints(limit, ("a", "b", "c", "d", "e")) == ("b", "d", "c", "e")


def audited(folder: Path, *contacts: str) -> Audit:
    (folder / "gains.yaml").write_text('".*": {kp: 300, kd: 20}', "utf-8")
    options = AuditOptions(2.0, motor_inertia=0.5, base="fixed", contacts=contacts)
    return audit(described(str(folder / "robot.urdf"), folder / "gains.yaml", options).system)


def test_audit_says_where_contacts_hold_every_joint(folder: Path, capsys: pytest.CaptureFixture[str]):
    free, held = audited(folder), audited(folder, "thigh", "shank", "foot")
    assert [(state.posture, state.contact) for state in held.immobile] == [("zero", "contact")]
    assert repr((held.safe, held.joints, held.delay_limit)) == repr((free.safe, free.joints, free.delay_limit))  # NaN where it is known
    assert any("contact: no joint that has gains can move" in warning for warning in audit_warnings(held))
    call = ["audit", str(folder / "robot.urdf"), "--gains", str(folder / "gains.yaml"), "--delay-ms", "2", "--base", "fixed"]
    call += [
        "--motor-inertia",
        "0.5",
        "--rate-hz",
        "2000",
        "--gearbox",
        "direct",
        "--contact",
        "thigh",
        "--contact",
        "shank",
        "--contact",
        "foot",
    ]
    assert main([*call, "--json"]) == 0
    first, second = json.loads(capsys.readouterr().out)["states"]
    assert first.keys() == second.keys()
    assert (first["moves"], second["moves"], second["stable"]) == (True, False, None)
    assert main(call) == 0
    assert "contact: no joint that has gains can move" in " ".join(capsys.readouterr().out.split())
    assert main([*call, "--verbose"]) == 0
    assert "contact – – – nothing moves –" in " ".join(capsys.readouterr().out.split())


def test_audit_without_a_limit_is_not_safe(folder: Path, monkeypatch: pytest.MonkeyPatch):
    def lost(loop: gr.Loop) -> None:
        raise gr.GainroomError("the loci could not be followed")

    monkeypatch.setattr("gainroom.studies.loop_numbers.margins", lost)
    result = audited(folder)
    assert result.tightest.limit.stable
    assert not result.safe
    assert "the gain margin is not known" in audit_sentence(result)
    assert result.verdict.level == "undecided"


@pytest.mark.parametrize("resonance", [300.0, 600.0, 900.0, 1500.0, 2000.0, 3000.0])
@pytest.mark.parametrize("delay", [0.0, 2e-3])
def test_lag_decides_about_an_undamped_spring_under_link_side_feedback(resonance: float, delay: float):
    """At small gains the pole at jω_r moves by minus the residue of L = K D e^{−sT}/(J_m J_l s² (s² + ω_r²)): by hand, no current loop."""
    motor, load, kp, kd = 0.5, 0.8, 9.0, 0.4
    stiffness = resonance**2 / (1 / motor + 1 / load)
    joint = gr.ElasticJoint(motor, load, stiffness, 0.0)
    loop = gr.build_loop(joint, gr.Drive(delay=delay), gr.PD(kp, kd), feedback="link")
    s = 1j * resonance
    residue = stiffness * (kp + kd * s) * np.exp(-s * delay) / (motor * load * s**2 * 2 * s)
    assert gr.is_stable(loop) == (residue.real > 0)
    assert delay or residue.real < 0


def test_requirements_within_ranges_are_not_called_met(tmp_path: Path):
    """Of a robot with an uncertainty margins are known at the corners alone: met there is not proved to be met everywhere."""
    text = write_arm(tmp_path).read_text("utf-8")
    soft = re.sub(r"kp: [^,}]+", "kp: 20", re.sub(r"kd: [^,}]+", "kd: 8", text))
    exact = study_robot(parse_robot(soft, "arm", tmp_path), recommend=False)
    uncertain = study_robot(parse_robot(soft + "uncertainty: {delay_ms: [1.9, 2.1]}\n", "arm", tmp_path), recommend=False)
    assert exact.requirements_met is True
    assert uncertain.requirements_met is None
    beyond = changed(uncertain.every[0], worst_case=replace(uncertain.every[0].worst_case, unstable_at="a corner"))
    assert replace(uncertain, every=(beyond,)).requirements_met is False
