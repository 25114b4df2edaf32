"""joint.yaml: what is read is what was meant, and everything else is named in one line."""

import math
import re
from importlib import import_module
from typing import Literal, get_origin

import pytest
import yaml
from pytest import approx

from gainroom.cli.example import joint_examples
from gainroom.errors import GainroomError
from gainroom.files.joint_yaml import JointFile, parse_joint
from gainroom.io.validation import Section, validate
from gainroom.io.yaml_text import MAX_DEPTH, MAX_NODES, parse_yaml
from gainroom.studies.analysis import analyze
from gainroom.system.filters import Biquad

FULL = """\
joint: {rotor_inertia: 1.0e-4, gear_ratio: 100, link_inertia: 16.0, stiffness: 1e4, damping: 1,
        motor_viscous: 0.2, link_viscous: 0.3}
drive: {bandwidth: 4000.0, damping_ratio: 0.8, delay_ticks: 4.5}
control:
  type: pd
  kp: 1.0e4
  kd: 300.0
  feedback: motor
  sample_rate_hz: 2000
  velocity_filter: {bandwidth_hz: 100, order: 2, damping_ratio: 0.7}
  notches: [{frequency: 300.0, width: 0.4, depth: 0.2}, {frequency_hz: 80}]
  biquads: [{zero_frequency_hz: 25, zero_damping: 0.1, pole_frequency: 350.0, pole_damping: 0.6}]
limits: {gain_margin_db: 6.0, phase_margin_deg: 30.0, peak_sensitivity: 2.0}
uncertainty: {delay_ticks: [4, 6], stiffness: 20%, link_inertia: [0.8, 16.0], motor_inertia: 10 %, damping: [0, 2]}
"""


def edited(*edits: tuple[str, str]) -> str:
    text = FULL
    for old, new in edits:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def refusal(*edits: tuple[str, str]) -> str:
    with pytest.raises(GainroomError) as caught:
        parse_joint(edited(*edits), "knee.yaml")
    assert all(message.startswith("knee.yaml: ") and "\n" not in message for message in caught.value.problems)
    return caught.value.problems[0].removeprefix("knee.yaml: ")


def test_every_key_arrives_in_si():
    spec = parse_joint(FULL, "knee.yaml")
    assert spec.source.motor_inertia == approx(1.0)
    assert (spec.source.link_inertia, spec.source.stiffness, spec.source.damping) == (16.0, 1e4, 1.0)
    assert (spec.source.motor_viscous, spec.source.link_viscous) == (0.2, 0.3)
    assert (spec.drives[0].bandwidth, spec.drives[0].damping_ratio) == (4000.0, 0.8)
    assert spec.drives[0].delay == approx(4.5 / 2000)
    assert spec.control.sample_time == 1 / 2000
    assert (float(spec.control.controller.kp), float(spec.control.controller.kd), str(spec.control.feedback)) == (1e4, 300.0, "motor")
    assert spec.control.controller.velocity_filter.bandwidth == approx(2 * math.pi * 100)
    assert (spec.control.controller.velocity_filter.order, spec.control.controller.velocity_filter.damping_ratio) == (2, 0.7)
    assert [notch.frequency for notch in spec.control.controller.notches] == approx([300.0, 2 * math.pi * 80])
    assert spec.control.controller.biquads == (Biquad(2 * math.pi * 25, 0.1, 350.0, 0.6),)
    assert (spec.control.controller.notches[0].width, spec.control.controller.notches[0].depth) == (0.4, 0.2)
    assert 20 * math.log10(spec.requirements.gain_margin) == approx(6.0)
    assert math.degrees(spec.requirements.phase_margin) == approx(30.0)
    assert spec.requirements.peak_sensitivity == 2.0
    assert spec.uncertainty.delay == approx((0.002, 0.003))
    assert spec.uncertainty.stiffness == approx((8000.0, 12000.0))
    assert spec.uncertainty.link_inertia == (0.8, 16.0)
    assert spec.uncertainty.motor_inertia == approx((0.9, 1.1))
    assert spec.uncertainty.damping == (0.0, 2.0)


@pytest.mark.parametrize("text", [FULL, *joint_examples().values()])
def test_a_file_written_back_means_the_same(text: str):
    file = validate(JointFile, parse_yaml(text, "knee.yaml"), "knee.yaml")
    written = yaml.safe_dump(file.model_dump(exclude_none=True))
    again = validate(JointFile, parse_yaml(written, "again.yaml"), "again.yaml")
    assert again == file
    assert repr(again.spec()) == repr(file.spec())


@pytest.mark.parametrize("rigid", [".inf", "rigid"])
def test_limits_are_the_same_formulas(rigid: str):
    spec = parse_joint(
        edited(("stiffness: 1e4", f"stiffness: {rigid}"), ("stiffness: 20%, ", ""), ("bandwidth: 4000.0", "bandwidth: .inf")),
        "f",
    )
    assert math.isinf(spec.source.stiffness)
    assert spec.drives[0].is_ideal


def test_without_a_rate_in_control_the_model_is_continuous():
    spec = parse_joint(edited(("  sample_rate_hz: 2000\n", ""), ("ticks: 4.5", "ticks: 4.5, sample_rate_hz: 2000")), "f")
    assert spec.control.sample_time is None
    assert spec.drives[0].delay == approx(4.5 / 2000)


def test_a_continuous_clock_decides_that_no_rate_is_missing():
    """The same loop, margins and missed requirements, and nothing of what a usual rate would cost; a tick may still have a length."""
    text = joint_examples()["fig9"]
    stated, missing = (analyze(parse_joint(each, "f")) for each in (text, text.replace("clock: continuous", "#")))
    assert (stated.system.rate_is_missing, missing.system.rate_is_missing) == (False, True)
    assert (stated.missed_at_usual_rate == {}, missing.missed_at_usual_rate == {}) == (True, False)
    assert stated.states[0].margins == missing.states[0].margins
    assert stated.unmet.keys() == missing.unmet.keys()
    in_ticks = parse_joint(text.replace("delay_ms: 2.0", "delay_ticks: 4\n  sample_rate_hz: 2000"), "f")
    assert (in_ticks.delay, in_ticks.control) == (approx(2e-3), stated.system.control)


@pytest.mark.parametrize(("kind", "gains"), [("pid", {"kp": 100.0, "ki": 5.0, "kd": 3.0}), ("ppi", {"kp": 40.0, "kv": 5.0, "ki": 1.0})])
def test_other_controllers(kind: str, gains: dict[str, float]):
    keys = "".join(f"  {name}: {value}\n" for name, value in gains.items())
    spec = parse_joint(edited(("type: pd", f"type: {kind}"), ("  kp: 1.0e4\n  kd: 300.0\n", keys)), "f")
    assert type(spec.control.controller).__name__.lower() == kind
    assert {name: float(getattr(spec.control.controller, name)) for name in gains} == gains


def test_only_the_margins_that_are_named_are_required():
    spec = parse_joint(edited(("gain_margin_db: 6.0, phase_margin_deg: 30.0, ", "")), "f")
    assert (spec.requirements.gain_margin, spec.requirements.phase_margin) == (None, None)


@pytest.mark.parametrize(
    ("old", "new", "start", "contains"),
    [
        ("delay_ticks: 4.5", "delay_ms: -2.0", "drive.delay_ms: -2.0 must be >= 0", ""),
        ("delay_ticks: 4.5", "delay_ms: 2 ms", "drive.delay_ms: '2 ms' is text", "unit"),
        ("delay_ticks: 4.5", "delay_s: 0.002", "drive.delay_s: unknown key", "did you mean delay_ms?"),
        ("delay_ticks: 4.5", "delay: 2", "drive.delay: unknown key", "did you mean delay_ms?"),
        ("delay_ticks: 4.5", "delay_ms: 2, delay_ticks: 4", "drive: give either delay_ms", ""),
        ("delay_ticks: 4.5", "sample_rate_hz: 2000", "drive.delay_ms is missing", "or give delay_ticks"),
        ("delay_ticks: 4.5", "delay_ms: 0.002 s", "drive.delay_ms: '0.002 s' is text", ""),
        ("delay_ticks: 4.5", "delay_ms: 1e9", "drive.delay_ms: 1000000000.0 must be <= 10000", ""),
        ("delay_ticks: 4.5", "delay_ms: 9000", "drive.delay_ms: 9000 ms must be <= 500 ms, 1000 ticks at 2000 Hz", ""),
        ("delay_ticks: 4.5", "delay_ticks: 4, sample_rate_hz: 1000", "drive.sample_rate_hz: 1000.0 must equal", "2000"),
        ("  sample_rate_hz: 2000\n", "", "drive.delay_ticks: 4.5 needs sample_rate_hz", ""),
        ("delay_ticks: 4.5", "delay_ticks: 4.5, clock: sampled", "drive.clock: 'sampled' must be continuous", ""),
        ("delay_ticks: 4.5", "delay_ticks: 4.5, clock: continuous", "drive.clock: must be left out with control.sample_rate_hz", ""),
        ("link_inertia: 16.0", "link_inertia: true", "joint.link_inertia: true is not a number", ""),
        ("link_inertia: 16.0", "link_inertia: 0", "joint.link_inertia: 0 must be > 0", ""),
        ("link_inertia: 16.0", "link_inertia: -1", "joint.link_inertia: -1 must be > 0", ""),
        ("link_inertia: 16.0", "link_inertia: .nan", "joint.link_inertia: nan is not a number", ""),
        ("link_inertia: 16.0", "link_inertia:", "joint.link_inertia: nothing is not a number", ""),
        ("link_inertia: 16.0, ", "", "joint.link_inertia is missing", "kg·m²"),
        ("link_inertia: 16.0", "link_inertia: 1e-200", "joint.link_inertia: 1e-200 must be >= 1e-12", ""),
        ("link_inertia: 16.0", "link_inertia: 1_6", "joint.link_inertia: '1_6' is text", ""),
        ("link_inertia: 16.0", "link_inertia: 016", "joint.link_inertia: '016' is text", ""),
        ("link_inertia: 16.0", "link_inertia: 1e999", "line 1, column", "too large"),
        (
            "stiffness: 1e4",
            "stifness: 1e4",
            "joint.stifness: unknown key",
            "did you mean stiffness? (allowed: actuator, motor_inertia, ",
        ),
        ("gear_ratio: 100", "motor_inertia: 1", "joint: rotor_inertia has no meaning beside motor_inertia", "give either"),
        ("gear_ratio: 100, ", "", "joint: rotor_inertia needs gear_ratio", "motor_inertia"),
        ("rotor_inertia: 1.0e-4, gear_ratio: 100, ", "", "joint.motor_inertia is missing", "rotor_inertia with gear_ratio"),
        (
            "feedback: motor",
            "feedback: moter",
            "control.feedback: 'moter' must be motor or link",
            "did you mean motor?",
        ),
        ("  feedback: motor\n", "", "control.feedback is missing", "motor or link"),
        ("type: pd", "type: lqr", "control.type: 'lqr' must be pd, pid, ppi, torque_feedback, dob or lti", ""),
        ("  type: pd\n", "", "control.type is missing", ""),
        ("type: pd", "type: ppi", "control.kd is not a gain of type ppi", "kp, kv, ki"),
        ("type: pd", "type: ppi", "control.kd is not a gain of type ppi", "did you mean kv?"),
        ("kd: 300.0", "kv: 300.0", "control.kv is not a gain of type pd, which has kp, kd", "did you mean kd?"),
        ("kp: 1.0e4", "kp: -1.0e4", "control.kp: -10000.0 must be > 0", ""),
        ("kd: 300.0", "kd: -300.0", "control.kd: -300.0 must be >= 0", ""),
        ("order: 2", "order: 3", "control.velocity_filter.order: 3 must be 1 or 2", ""),
        ("order: 2", "order: 1", "control.velocity_filter.damping_ratio is for order 2", ""),
        ("depth: 0.2", "depth: 2", "control.notches[0].depth: 2 must be <= 1", ""),
        ("zero_damping: 0.1", "zero_damping: -1", "control.biquads[0].zero_damping: -1 must be >= 0", ""),
        ("pole_damping: 0.6", "pole_damping: 0", "control.biquads[0].pole_damping: 0 must be > 0", ""),
        (", pole_damping: 0.6", "", "control.biquads[0].pole_damping is missing", ""),
        ("pole_frequency: 350.0, ", "", "control.biquads[0]: give either pole_frequency [rad/s] or pole_frequency_hz", ""),
        ("{frequency_hz: 80}", "{hz: 80}", "control.notches[1].hz: unknown key", ""),
        ("stiffness: 20%", "stiffness: 0.2", "uncertainty.stiffness: 0.2 must be [low, high]", "20%"),
        ("stiffness: 20%", "stiffness: 120%", "uncertainty.stiffness: '120%' must be less than 100%", ""),
        ("stiffness: 20%", "stiffness: [0, 2e4]", "uncertainty.stiffness: 0 must be > 0", ""),
        ("stiffness: 20%", "stiffness: [2e4, 3e4]", "uncertainty.stiffness: [20000.0, 30000.0] must contain", "10000"),
        ("delay_ticks: [4, 6]", "delay_ticks: [6, 4]", "uncertainty.delay_ticks: [6, 4] must be", "low <= high"),
        ("delay_ticks: [4, 6]", "delay_ms: 1%, delay_ticks: [4, 6]", "uncertainty: give either", ""),
        ("peak_sensitivity: 2.0", "peak_sensitivity: 1", "limits.peak_sensitivity: 1 must be > 1", ""),
        ("gain_margin_db: 6.0", "gain_margin_db: 0", "limits.gain_margin_db: 0 must be > 0", ""),
        ("phase_margin_deg: 30.0", "phase_margin_deg: 0", "limits.phase_margin_deg: 0 must be > 0", ""),
        ("link_inertia: 16.0", "link_inertia: sixteen", "joint.link_inertia: 'sixteen' is text and must be a number", ""),
        ("limits: {", "limit: {", "limit: unknown key", "did you mean limits?"),
        ("damping: 1,", "damping: ,", "joint.damping: nothing is not a number", ""),
        ("uncertainty: {", "uncertainty:\n# {", "uncertainty: nothing must be a section", "delay_ms"),
    ],
)
def test_what_is_wrong_is_named(old: str, new: str, start: str, contains: str):
    message = refusal((old, new))
    assert message.startswith(start)
    assert contains in message


def sections(of: type[Section] = Section) -> set[type[Section]]:
    return {of}.union(*map(sections, of.__subclasses__()))


def test_a_key_that_is_missing_is_told_in_a_sentence_that_says_what_it_is():
    """Not "drive.bandwidth: is missing: of the current loop"."""
    for name in ("files.robot_yaml", "files.logs", "files.gain_files"):  # all that a file may hold, whatever else was imported
        import_module(f"gainroom.{name}")
    told = {}
    for section in sections():
        for name, field in section.model_fields.items():
            if field.is_required() and get_origin(field.annotation) is not Literal:
                told[section.__name__, name] = field.description
    told = {key: text for key, text in told.items() if key[0] not in ("Ask", "Section")}  # Ask: of the page, not of a file
    assert len(told) > 20
    assert [key for key, text in told.items() if not re.match(r"(the|its|an?|what|how|when|whether|where) ", text or "")] == []
    with pytest.raises(GainroomError) as caught:
        parse_joint(FULL.replace("bandwidth: 4000.0, ", ""), "knee.yaml")
    said = "knee.yaml: drive.bandwidth is missing: the bandwidth of the current loop [rad/s], a number > 0, or .inf for an ideal one"
    assert str(caught.value) == said


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "is empty"),
        ("# only a comment\n", "is empty"),
        ("joint: &a {}\ndrive: *a\n", "anchors and aliases"),
        ("joint: {}\njoint: {}\n", "'joint' is given twice"),
        ("joint: !!python/object/apply:os.getcwd []\n", "tags (!) are not allowed"),
        ("[" * (MAX_DEPTH + 1), "deep"),
        ("[" * 21, "nested more than 20 deep"),
        ("[" + "1, " * MAX_NODES + "1]", "more than"),
        ("[" + "1, " * 20_000 + "1]", "more than 20000 values"),
        ("<<: {joint: 1}\n", "unknown key"),
        ("1: 2\n", "a key must be a word"),
        ("control: {kp: 900,5}\n", "a key must be a word; a decimal comma is written as a point"),
        ("- joint\n", "must be a section"),
        ("just words", "must be a section"),
        ("joint: 'open\n", "line"),
        ('joint: "\\U99999999"\n', "escape"),
        ("joint: 1\n---\njoint: 2\n", "another document"),
        ("joint: \x07", "character 8"),
    ],
)
def test_yaml_is_bounded(text: str, problem: str):
    with pytest.raises(GainroomError, match=r"knee\.yaml") as caught:
        parse_joint(text, "knee.yaml")
    assert problem in caught.value.problems[0]
    assert all("\n" not in message for message in caught.value.problems)


def test_scalars_follow_yaml_1_2():
    read = parse_yaml("{a: 1e4, b: 010, c: 1:30, d: on, e: 1_0, f: .inf, g: 2020-01-01, h: true, i: ~, j: -.5, k: 7}", "f")
    assert read["a"] == 1e4
    assert [read[key] for key in "bcdeg"] == ["010", "1:30", "on", "1_0", "2020-01-01"]
    assert (read["f"], read["h"], read["i"], read["j"]) == (math.inf, True, None, -0.5)
    assert type(read["k"]) is int


def test_a_decimal_comma_is_recognised():
    with pytest.raises(GainroomError, match=r"control.kp: '6,0' is text and must be a number: the decimal sign is a point, 6\.0$"):
        parse_joint(joint_examples()["testbed"].replace("kp: 1600.0", "kp: 6,0"), "f")
