"""Sway of a floating base on its contacts, apart from vibration: found by its mode, judged by who is said to damp it."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("pinocchio")

from gainroom.analysis.margins import margins
from gainroom.analysis.margins_outside import margins_outside
from gainroom.analysis.stability import rightmost_roots
from gainroom.cli import main
from gainroom.cli.example import example_texts
from gainroom.files.robot_yaml import load_robot_system
from gainroom.robot.sway import NEAR, SlowMode, SlowMotion, bands
from gainroom.studies.analysis import analyze
from gainroom.studies.verdict import STATUS
from gainroom.system.feedback import Feedback
from robot_truths import hinge, link

MASS, HEIGHT, OWN = 40.0, 0.8, 1.2
"""Of the torso above its ankle [kg], [m], [kg m²]."""
ROTOR = 0.3
LOAD = OWN + MASS * HEIGHT**2 + ROTOR
"""[kg m²] that the ankle turns where the foot stands: torso about the ankle, and the motor."""
KP, KD, DELAY, TICK = 400.0, 8.0, 2e-3, 1e-3
FIXED = {"file": "robot.urdf", "base": "fixed"}
ARM = 0.02 + 1.0 * 0.3**2 + ROTOR
"""[kg m²] that the shoulder turns while the torso, a thousand times as heavy to turn, stays."""


def standing(folder: Path, arm: dict[str, float] | None = None, root: str = "torso", **top: Any) -> Path:
    """A torso on one ankle and a foot, from above: root torso; with a short light arm at the ankle's height where `arm` has its gains.

    At the ankle's height the arm does not turn with the torso's fall but for its own turning, so that the two modes stay apart.
    """
    bodies = link("torso", MASS, (0.0, 0.0, 0.0), (OWN, OWN, 0.3)) + link("foot", 1e-3, (0.0, 0.0, 0.0), (1e-6, 1e-6, 1e-6))
    joints = hinge("ankle", "torso", "foot", at=(0.0, 0.0, -HEIGHT))
    if arm is not None:
        bodies += link("arm", 1.0, (0.0, 0.0, -0.3), (0.02, 0.02, 0.001))
        joints += hinge("shoulder", "torso", "arm", at=(0.0, 0.0, -HEIGHT))
    (folder / "robot.urdf").write_text(f'<robot name="standing">{bodies}{joints}</robot>', "utf-8")
    kp, kd = {"ankle": KP}, {"ankle": KD}
    if arm is not None:
        kp["shoulder"], kd["shoulder"] = arm["kp"], arm["kd"]
    described = {
        "model": {"file": "robot.urdf", "base": "floating", "gravity_stiffness": False},
        "joints": {"default": {"motor_inertia": ROTOR, "stiffness": "rigid"}},
        "drive": {"bandwidth": math.inf, "delay_ms": 1e3 * DELAY},
        "contacts": {"ground": ["foot"]},
        "control": {"type": "pd", "space": "joint", "feedback": "motor", "kp": kp, "kd": kd, "sample_rate_hz": 1 / TICK},
        **top,
    }
    file = folder / "robot.yaml"
    file.write_text(yaml.safe_dump({key: value for key, value in described.items() if value is not None}), "utf-8")
    return file


def call_of(folder: Path, kp: float, kd: float, *gearbox: str) -> list[str | Path]:
    """An audit of the torso's model on its foot, with these gains of the ankle, at 2 ms and 1 kHz."""
    standing(folder)
    gains = folder / "gains.yaml"
    gains.write_text(yaml.safe_dump({"ankle": {"kp": kp, "kd": kd, "motor_inertia": ROTOR}}), "utf-8")
    call = ["audit", folder / "robot.urdf", "--gains", gains, "--delay-ms", "2", "--rate-hz", "1000", *gearbox]
    return [*call, "--base", "floating", "--contact", "foot"]


def answered(capsys: pytest.CaptureFixture[str], *words: str | Path) -> tuple[int, dict[str, Any]]:
    status = main([*map(str, words), "--json"])
    return status, json.loads(capsys.readouterr().out)


def found(facts: dict[str, Any], code: str) -> dict[str, Any] | None:
    return next((one for one in facts["findings"] if one["code"] == code), None)


def test_the_mode_of_a_torso_on_its_ankle(tmp_path: Path):
    """By hand: ω² = kp/J, and all of the motion is the base's but for the motor's."""
    system = load_robot_system(standing(tmp_path))
    (state,) = analyze(system).states
    (mode,) = SlowMotion.of(state.model).modes(state.controller, Feedback.of("motor"))
    assert mode.frequency == pytest.approx(math.sqrt(KP / LOAD), rel=1e-4)  # the foot's 1e-3 kg and 1e-6 kg m² beside the torso's
    assert mode.of_base == pytest.approx(1 - ROTOR / LOAD, rel=1e-3)
    assert state.sway is not None
    # J s² + (kd s + kp) e^{−sτ}, τ the delay and half a tick of hold: 2ζω = kd/J − ω²τ
    ratio = (KD / LOAD - KP / LOAD * (DELAY + TICK / 2)) / (2 * math.sqrt(KP / LOAD))
    assert state.sway.damping_ratio == pytest.approx(ratio, rel=0.01)  # terms of (ωT)² beside 1, and of ζ²
    assert state.sway.frequency == pytest.approx(math.sqrt(KP / LOAD), rel=0.01)


@pytest.mark.parametrize(("changes", "sways"), [({}, True), ({"contacts": None}, False), ({"model": FIXED}, False)])
def test_a_base_sways_on_its_contacts_alone(changes: dict, sways: bool, tmp_path: Path):
    """Neither in flight, where the same two bodies swing against each other, nor fixed, where the foot swings."""
    system = load_robot_system(standing(tmp_path, **({"contacts": {"free": []}} | changes if changes else {})))
    (state,) = analyze(system).states
    assert (state.sway is not None) is sways


def test_a_gearbox_is_in_series_with_its_gain(tmp_path: Path):
    """Of slow motion: 1/K₀ = 1/kp + 1/K, here K = kp, so that the frequency is that of half the gain."""
    joints = {"default": {"motor_inertia": ROTOR, "stiffness": KP, "damping": 0.1}}
    (state,) = analyze(load_robot_system(standing(tmp_path, joints=joints))).states
    (mode,) = SlowMotion.of(state.model).modes(state.controller, Feedback.of("motor"))
    assert mode.frequency == pytest.approx(math.sqrt(KP / 2 / LOAD), rel=2e-3)  # the motor, J_m of LOAD, moves half as far
    (linked,) = SlowMotion.of(state.model).modes(state.controller, Feedback.of("link"))
    assert linked.frequency == pytest.approx(math.sqrt(KP / LOAD), rel=1e-4)


def test_what_delay_has_a_part_in_is_no_sway(tmp_path: Path):
    """At 15 ms and a tick the lag takes 0.06 rad at 3.8 rad/s: the mode is damped less by that."""
    (state,) = analyze(load_robot_system(standing(tmp_path, drive={"bandwidth": math.inf, "delay_ms": 15.0}))).states
    assert len(SlowMotion.of(state.model).modes(state.controller, Feedback.of("motor"))) == 1
    assert state.sway is None


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.3, 1.0])
def test_the_root_of_each_states_sway_is_one_of_the_loops_rightmost(factor: float, tmp_path: Path):
    """Against the polished roots of a collocated state space, an independent way to them."""
    file = tmp_path / "biped.yaml"
    file.write_text(example_texts()["biped"], "utf-8")
    for state in analyze(load_robot_system(file).scaled(factor)).states:
        if not state.contact.startswith("flight"):
            assert state.sway is not None
            root = state.sway.frequency * complex(-state.sway.damping_ratio, math.sqrt(1 - state.sway.damping_ratio**2))
            apart = np.abs(rightmost_roots(state.loop, count=24).roots - root)
            assert apart.min() < 1e-6 * abs(root)  # both are polished to 1e-9
        else:
            assert state.sway is None


@pytest.mark.slow
def test_margins_outside_no_band_are_all_margins_and_outside_one_those_of_a_grid(tmp_path: Path):
    file = tmp_path / "biped.yaml"
    file.write_text(example_texts()["biped"], "utf-8")
    for state in analyze(load_robot_system(file)).states[::3]:
        whole = margins(state.loop)
        same = margins_outside(state.loop, whole, np.zeros((0, 2)))
        assert same.phase_margin == pytest.approx(abs(whole.phase_margin), rel=1e-9)
        assert same.peak_sensitivity == pytest.approx(whole.peak_sensitivity, rel=1e-9)
        band = np.array([[2.0, 40.0]])
        left = margins_outside(state.loop, whole, band)
        omega = np.geomspace(0.05, math.pi / 5e-4, 60_001)
        response = state.loop.response(omega)
        own = np.abs(np.diagonal(np.linalg.inv(np.eye(response.shape[1]) + response), axis1=1, axis2=2))
        tops = (own[1:-1] > own[:-2]) & (own[1:-1] > own[2:])  # the flank of a peak in the band is none
        away = (omega < band[0, 0]) | (omega > band[0, 1])
        peak = own[1:-1][tops & away[1:-1, None]].max()
        assert left.peak_sensitivity == pytest.approx(peak, rel=1e-3)  # a grid of 1.0002 in ω is that near to a peak
        omega, response = omega[away], response[away]
        loci = np.linalg.eigvals(response)
        lag = np.abs(np.angle(-loci))
        near = np.abs(np.log(np.abs(loci))) < 1e-3  # on the unit circle but for a grid's step
        assert left.phase_margin == pytest.approx(lag[near].min(), abs=3e-3)


def test_bands_end_where_another_mode_is_nearer():
    modes = [SlowMode(one, share, np.ones(1), np.ones(1)) for one, share in ((1.0, 0.1), (2.0, 0.9), (2.5, 0.1), (9.0, 0.8), (9.0, 0.1))]
    first, second = bands(modes, [one for one in modes if one.sways])
    assert first == pytest.approx([math.sqrt(2.0), math.sqrt(5.0)])
    assert second[0] == second[1] == 9.0  # a mode of another kind at the same frequency: nothing is left out
    assert bands(modes[1:2], modes[1:2])[0] == pytest.approx([2 / NEAR, 2 * NEAR])


@pytest.mark.slow
def test_who_damps_sway_decides_in_every_command(tmp_path: Path, capsys):
    """A damping ratio of 0.02 is a phase margin of some 2°: not enough for joints, and nothing to do with vibration."""
    levels = {None: "undecided", "joints": "unsafe", "controller": "safe"}
    for balance, level in levels.items():
        file = standing(tmp_path, balance=balance, scenario={"duration": 0.2})
        status, facts = answered(capsys, "robot", file)
        assert (facts["verdict"], status) == (level, STATUS[level])
        sway = found(facts, "sway")
        assert sway is not None
        assert (sway["level"], sway["joints"]) == (level, ["ankle"])
        assert sway["remedy"] == ("balance" if balance is None else "")
        assert (found(facts, "phase_margin") is None) is (balance == "controller")
        for other in (("simulate", file), ("sweep", file, "--grid", "ankle=0:0.000000001:2")):
            other_status, swept = answered(capsys, *other)
            assert (swept["verdict"], other_status) == (level, STATUS[level]), other
            assert found(swept, "sway") is not None


def test_the_audit_of_a_model_asks_and_takes_the_answer(tmp_path: Path, capsys):
    call = call_of(tmp_path, KP, KD, "--stiffness", "inf")
    status, facts = answered(capsys, *call)
    assert (status, facts["verdict"]) == (3, "undecided")
    assert facts["to_use"] is None  # lower gains would sway as well
    sway = found(facts, "sway")
    assert sway is not None
    assert sway["remedy"] == "--balance"
    assert answered(capsys, *call, "--balance", "joints")[1]["verdict"] == "unsafe"
    written = tmp_path / "written.yaml"
    status, facts = answered(capsys, *call, "--balance", "controller", "--write-robot", written)
    assert (status, facts["verdict"]) == (0, "safe")
    status, again = answered(capsys, "robot", written)
    assert (status, again["verdict"]) == (0, "safe")
    answer = tmp_path / "answer.json"
    answer.write_text(json.dumps(facts), "utf-8")
    bare = [*call[:3], answer, *call[4:]]
    assert answered(capsys, *bare)[1]["verdict"] == "safe"  # it goes along with the gains
    assert answered(capsys, *bare, "--balance", "joints")[1]["verdict"] == "unsafe"  # what is typed goes first
    for form, held in (("yaml", True), ("mjlab", False)):
        status, told = answered(capsys, "export", answer, "--to", form, "--model", tmp_path / "robot.urdf")
        assert status == 0
        assert any("who damps sway" in note and "--balance controller" in note for note in told["notes"]) is not held
    assert main([*map(str, call), "--balance", "nobody"]) == 2
    assert "--balance nobody: must be joints or controller" in capsys.readouterr().err


@pytest.mark.slow
def test_gearboxes_of_a_range_leave_sway_to_whom_it_belongs(tmp_path: Path, capsys):
    """A harmonic drive of 21 kN m/rad and more beside kp 400 hardly moves the mode: what it is judged by is who damps it, in every look."""
    call = call_of(tmp_path, KP, KD, "--gearbox", "harmonic")
    for more, level in ((), "undecided"), (("--balance", "joints"), "unsafe"), (("--balance", "controller"), "safe"):
        assert answered(capsys, *call, *more)[1]["verdict"] == level


def test_an_arm_that_swings_as_slowly_is_no_sway(tmp_path: Path, capsys):
    """Of its own frequency, with the torso well damped: nobody above the joints damps that."""
    kp = 0.5 * KP / LOAD * ARM  # 0.7 of the torso's frequency
    file = standing(tmp_path, arm={"kp": kp, "kd": 0.02 * math.sqrt(kp * ARM)}, balance="controller")
    status, facts = answered(capsys, "robot", file)
    assert (status, facts["verdict"]) == (1, "unsafe")
    missed = found(facts, "phase_margin")
    assert missed is not None
    assert missed["joints"][0] == "shoulder"
    assert missed["frequency_rad_s"] == pytest.approx(math.sqrt(kp / ARM), rel=0.05)  # what the torso gives way shifts it by J_a/J


def test_a_vibration_stays_one_whoever_damps_sway(tmp_path: Path, capsys):
    """kd so high that the delay takes the margin: by hand ω_c ≈ kd/J, a phase of π/2 − ω_c (T + Ts)."""
    kd = 0.5 * LOAD / (DELAY + TICK)  # ω_c (T + Ts) = 0.5: phase 61°, |S| up to about 1.9; twice the gain leaves 33°
    control = {"type": "pd", "feedback": "motor", "kp": KP, "kd": 2.2 * kd, "sample_rate_hz": 1 / TICK}
    for balance in (None, "joints", "controller"):
        status, facts = answered(capsys, "robot", standing(tmp_path, balance=balance, control=control))
        assert (status, facts["verdict"]) == (1, "unsafe")
        assert found(facts, "sway") is None


@pytest.mark.slow
def test_gains_that_the_weight_topples_are_not_called_safe_where_nothing_is_said_of_it(tmp_path: Path, capsys):
    """By hand: the weight turns the torso over its ankle with m g h = 314 N m/rad, which kp 200 does not hold and kp 400 does."""
    model = {"file": "robot.urdf", "base": "floating"}
    for kp, gravity, balance, level in (
        (200.0, None, None, "undecided"),
        (200.0, False, None, "safe"),
        (200.0, True, None, "unsafe"),
        (200.0, None, "controller", "safe"),
        (200.0, None, "joints", "undecided"),
        (400.0, None, None, "safe"),
    ):
        control = {"type": "pd", "feedback": "motor", "kp": kp, "kd": 100.0, "sample_rate_hz": 1 / TICK}
        said = model if gravity is None else model | {"gravity_stiffness": gravity}
        file = standing(tmp_path, balance=balance, control=control, model=said)
        for command in (("robot", file), ("sweep", file, "--grid", "ankle=0:0.000000001:2")):
            status, facts = answered(capsys, *command)
            assert (facts["verdict"], status) == (level, STATUS[level]), (kp, gravity, balance, command[0])
        assert (found(facts, "topples_with_weight") is not None) == (level == "undecided")
    call = call_of(tmp_path, 200.0, 50.0, "--stiffness", "inf")
    assert answered(capsys, *call)[1]["verdict"] == "undecided"
    assert answered(capsys, *call, "--balance", "controller")[1]["verdict"] == "safe"


FOLDED = math.pi / 2
"""[rad] of the waist: the trunk then lies level, and the weight is half as high over the ankle."""


@pytest.mark.slow
@pytest.mark.parametrize("grid", [f"waist=0:{FOLDED}:3", f"waist={-FOLDED}:0:3"])
def test_a_sweep_finds_the_posture_in_which_the_weight_topples_wherever_it_stands(grid: str, tmp_path: Path, capsys):
    """By hand, of a trunk on a waist half way up: m g h over the ankle is 314 N m/rad upright and 157 folded; kp 230 holds the latter."""
    bodies = link("pelvis", 0.1, (0.0, 0.0, 0.0), (0.01, 0.01, 0.01)) + link("trunk", MASS, (0.0, 0.0, HEIGHT / 2), (OWN, OWN, 0.3))
    joints = hinge("ankle", "pelvis", "foot", at=(0.0, 0.0, -HEIGHT / 2)) + hinge("waist", "pelvis", "trunk")
    foot = link("foot", 1e-3, (0.0, 0.0, 0.0), (1e-6, 1e-6, 1e-6))
    control = {"type": "pd", "feedback": "motor", "kp": {"ankle": 230.0, "waist": 400.0}, "kd": {"ankle": 120.0, "waist": 60.0}}
    more = {
        "model": {"file": "robot.urdf", "base": "floating"},
        "control": control | {"sample_rate_hz": 1 / TICK},
        "postures": {"folded": {"waist": FOLDED}, "upright": {"waist": 0.0}},
    }
    file = standing(tmp_path, **more)
    (tmp_path / "robot.urdf").write_text(f'<robot name="standing">{bodies}{foot}{joints}</robot>', "utf-8")
    for command in (("robot", file), ("sweep", file, "--grid", grid, "--posture", "upright")):
        status, facts = answered(capsys, *command)
        assert (facts["verdict"], status) == ("undecided", 3), facts["sentence"]
        toppling = found(facts, "topples_with_weight")
        assert toppling is not None
        assert "folded" not in toppling["state"]
    folded = yaml.safe_load(file.read_text("utf-8"))
    del folded["postures"]["upright"]
    file.write_text(yaml.safe_dump(folded), "utf-8")
    assert answered(capsys, "robot", file)[1]["verdict"] == "safe"
