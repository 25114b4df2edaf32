"""Slips of units in files are told; public actuators, shipped examples and joints from a small hand to a heavy humanoid are not."""

import json
from importlib.resources import files
from math import inf, pi, radians
from pathlib import Path

import pytest
import yaml

import gainroom as gr
from gainroom.cli import main
from gainroom.errors import THIN
from gainroom.files.joint_yaml import load_joint, load_simulation, parse_joint, parse_simulation
from gainroom.report.simulation_text import warnings
from gainroom.studies.simulation import simulate_study
from gainroom.system.plausibility import FAR, doubts_first, unusual, unusual_values
from gainroom.system.requirements import Requirements

EXAMPLES = files("gainroom") / "files" / "examples"
TESTBED = (EXAMPLES / "testbed-sampled.yaml").read_text()

# What the file says in SI, written in another unit by mistake: section, key, value, and the word that the warning names.
SLIPS = {
    "delay in µs": ("drive", "delay_ms", 400.0, "delay"),
    "delay in s": ("drive", "delay_ms", 0.002174, "delay"),
    "delay of 0.9 s": ("drive", "delay_ms", 900.0, "delay"),
    "delay in µs as ticks": ("drive", "delay_ticks", 500.0, "delay"),
    "bandwidth in kHz": ("drive", "bandwidth", 0.637, "bandwidth"),
    "damping ratio in percent": ("drive", "damping_ratio", 90.0, "damping_ratio"),
    "rotor in g cm2": ("joint", "rotor_inertia", 200.0, "rotor_inertia"),
    "rotor in kg cm2": ("joint", "rotor_inertia", 0.2, "rotor_inertia"),
    "gear ratio upside down": ("joint", "gear_ratio", 0.01, "gear_ratio"),
    "link in kg mm2": ("joint", "link_inertia", 8e5, "link_inertia"),
    "link in g m2": ("joint", "link_inertia", 800.0, "link_inertia"),
    "stiffness in N mm/rad": ("joint", "stiffness", 1e7, "stiffness"),
    "damping in N mm s/rad": ("joint", "damping", 1000.0, "damping"),
    "rate in kHz": ("control", "sample_rate_hz", 2.0, "sample_rate_hz"),
    "kp in N mm/rad": ("control", "kp", 1.6e6, "kp"),
    "kd in N mm s/rad": ("control", "kd", 7e4, "kd"),
    "gain margin as a factor": ("limits", "gain_margin_db", 2.0, "gain_margin_db"),
    "phase margin in rad": ("limits", "phase_margin_deg", 0.5236, "phase_margin_deg"),
    "Ms in dB": ("limits", "peak_sensitivity", 6.0, "peak_sensitivity"),
}
# These stay within what actuators have, and no check of one joint can see them.
UNSEEN = {
    "bandwidth in Hz": ("drive", "bandwidth", 637.0),
    "stiffness in N m/deg": ("joint", "stiffness", 174.5),
    "kp in N m/deg": ("control", "kp", 27.9),
}


def changed(section: str, key: str, value: float) -> str:
    data = yaml.safe_load(TESTBED)
    if key.startswith("delay"):
        del data["drive"]["delay_ms"]
    if key == "delay_ms" and value > 500:  # a sampled loop refuses so many ticks
        del data["control"]["sample_rate_hz"]
    data[section][key] = value
    return yaml.safe_dump(data)


@pytest.mark.parametrize("slip", SLIPS)
def test_slips_of_units_are_told(slip):
    *change, word = SLIPS[slip]
    told = unusual_values(parse_joint(changed(*change), "f"))
    assert any(word in text for text in told), told


@pytest.mark.parametrize("slip", UNSEEN)
def test_slips_that_cannot_be_seen(slip):
    """Not told, and the module says so: the day they are, this list shrinks."""
    assert unusual_values(parse_joint(changed(*UNSEEN[slip]), "f")) == ()


@pytest.mark.parametrize("name", ["fig9", "talos-knee", "testbed", "testbed-sampled", "testbed-simulated"])
def test_shipped_joints_are_usual(name):
    spec = load_joint(EXAMPLES / f"{name}.yaml")
    assert unusual_values(spec) == ()


@pytest.mark.parametrize("name", ["biped", "biped-simulated"])
def test_shipped_robots_are_usual(name):
    pytest.importorskip("pinocchio")
    from gainroom.files.robot_yaml import load_robot_system

    assert not any("usual" in text for text in load_robot_system(EXAMPLES / f"{name}.yaml").warnings)


# motor inertia, stiffness, damping [kg m2, N m/rad, N m s/rad], joint side, with their public sources; loads from light to a whole body
PUBLIC = {
    "TALOS knee (talos_robot)": (4.05, 1e4, 20.0, (1.0, 60.0)),
    "TALOS hip, flexible (talos_robot)": (1.94, 4e3, 5.0, (1.0, 60.0)),
    "WALK-MAN class (Compliant Joint Toolbox)": (0.548, 31e3, 14.8, (0.1, 30.0)),
    "WALK-MAN class, identified (Compliant Joint Toolbox)": (1.10, 75e3, 14.8, (0.1, 30.0)),
    "HyQ HAA (Focchi et al. 2013)": (0.572, 8076.9, 1.008, (0.198, 20.0)),
    "Cassie knee (mujoco_menagerie)": (0.0934, 1500.0, 0.1, (0.1, 30.0)),
    "Cassie foot (mujoco_menagerie)": (0.01225, 1250.0, 0.1, (0.01, 10.0)),
    "Unitree G1 (mjlab)": (0.00361, inf, 0.0, (0.001, 10.0)),
    "Franka FR3 (Drake)": (0.6057, 1.4e4, 5.0, (0.05, 3.0)),
    "finger of a hand (0.02 g cm2 rotor, ratio 200)": (8e-5, 0.5, 1e-5, (1e-6, 1e-3)),
    "hip of a 500 kg humanoid": (40.0, 3e5, 500.0, (20.0, 500.0)),
}


@pytest.mark.parametrize("name", PUBLIC)
@pytest.mark.parametrize("end", [0, 1])
def test_public_actuators_are_usual(name, end):
    motor, stiffness, damping, loads = PUBLIC[name]
    joint = gr.ElasticJoint(motor, loads[end], stiffness, damping)
    omega = 2 * pi * 10  # the rule of reinforcement learning
    controller = gr.PD(motor * omega**2, 4 * motor * omega)
    for delay, rate in ((0.2e-3, 10e3), (2e-3, 2e3), (20e-3, 50.0)):
        drive = gr.Drive(4000.0, 0.9, delay)
        assert unusual_values(gr.JointSpec(joint, drive, controller, "motor", 1 / rate)) == ()


def test_none_and_rigid_pass():
    assert unusual({"delay": 0.0, "damping": 0.0, "stiffness": inf, "bandwidth": inf, "link_inertia": inf, "kp": 0.0}) == {}


def test_ends_of_ranges_are_told():
    spec = parse_joint(TESTBED + "\nuncertainty: {link_inertia: [0.5, 50000]}\n", "f")
    (told,) = unusual_values(spec)
    assert told.startswith(f"uncertainty.link_inertia 50{THIN}000 kg·m²")


def test_a_robot_names_its_joints():
    pytest.importorskip("pinocchio")
    from gainroom.files.robot_yaml import parse_robot

    text = (EXAMPLES / "biped.yaml").read_text()
    data = yaml.safe_load(text)
    data["joints"].setdefault("default", {})["motor_inertia"] = 2e4
    data["joints"]["default"].pop("rotor_inertia", None)
    data["joints"]["default"].pop("gear_ratio", None)
    told = [text for text in parse_robot(yaml.safe_dump(data), "f").warnings if "motor_inertia" in text]
    assert told
    assert "joints " in told[0]
    assert f"20{THIN}000 kg·m²" in told[0]


@pytest.mark.slow
def test_what_makes_numbers_doubtful_stands_before_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """On the terminal before the verdict, on pages before the headline, in --json as the first warning; other warnings stay below."""
    joint, leg, page = tmp_path / "joint.yaml", str(Path(__file__).parents[1] / "examples" / "robot.xml"), tmp_path / "page.html"
    joint.write_text(changed("drive", "bandwidth", 3.0), "utf-8")
    for call, verdict in (
        (["joint", str(joint)], "Not safe: unstable"),
        (["audit", leg, "--delay-ms", "2", "--rate-hz", "1000", "--stiffness", "3", "--damping", "0.1"], "Not safe: unstable"),
        (["audit", leg, "--delay-ms", "2", "--rate-hz", "1000", "--stiffness", "3", "--damping", "0.1", "--verbose"], "Not safe: unstable"),
    ):
        main([*call, "--report", str(page)])
        told, written = " ".join(capsys.readouterr().out.split()), page.read_text("utf-8")
        assert told.startswith("Warning: ")
        assert told.index(FAR) < told.index(verdict)
        assert told.count(FAR) == 1
        assert written.index('<p class="warning">') < written.index("<h1>")
        main([*call, "--json"])
        assert FAR in json.loads(capsys.readouterr().out)["warnings"][0]
    assert doubts_first(["b", f"delay {FAR}", "a"]) == [f"delay {FAR}", "b", "a"]


def test_margins_asked_for_are_told_in_their_units():
    asked = Requirements(gain_margin=2.0, phase_margin=radians(0.5))
    told = unusual_values(gr.JointSpec(gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.Drive(), gr.PD(100.0, 5.0), requirements=asked))
    assert len(told) == 1
    assert "phase_margin_deg 0.5°" in told[0]


@pytest.mark.parametrize("duration", [1e-9, 0.0094])
def test_a_run_too_short_to_tell_is_refused(duration):
    with pytest.raises(gr.GainroomError, match=r"scenario.duration: .* at least 20 ticks of 0.0005 s, 0.01 s"):
        parse_simulation(TESTBED + f"\nscenario: {{duration: {duration}, reference: {{type: hold}}}}\n", "f")


def test_a_run_of_few_periods_says_what_it_cannot_show():
    short = parse_simulation(TESTBED + "\nscenario: {duration: 0.02, reference: {type: hold}}\n", "f")
    study = simulate_study(short)
    assert any("cannot show vibration below 150 Hz" in text for text in warnings(study))
    whole = simulate_study(load_simulation(EXAMPLES / "testbed-simulated.yaml"))
    assert not any("cannot show vibration below" in text for text in warnings(whole))
