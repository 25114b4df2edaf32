"""Published figures of actuators: what is plausible of them, and what files and audits make of them."""

import json
import math
from pathlib import Path

import pytest

import gainroom as gr
from gainroom.cli import main
from gainroom.files.actuator_facts import GRADES, UNITS, Actuator, Figure, actuators, known_robots, recognised
from gainroom.files.joint_yaml import parse_joint
from gainroom.files.robot_yaml import load_robot_system
from gainroom.system.actuator_entry import ActuatorEntry
from robot_files import ROBOT, write_arm

JOINT = """\
joint: {link_inertia: 4.0, MOTOR}
drive: {bandwidth: 4000, delay_ms: 2}
control: {type: pd, feedback: motor, kp: 900, kd: 100, sample_rate_hz: 1000}
"""
WORDS = {"gains_run": {"host", "drive"}, "encoder_side": {"motor", "output", "both"}, "torque_sensor": {True, False}}
DENSEST = 200.0
"""Peak torque per mass [N·m/kg] that no actuator reaches: the makers' own figures of planetary and strain wave drives end at 165."""
GEARS = 2.1
"""Largest ratio of the inertia on the joint side to rotor × ratio²: of WALK-MAN's joint 1.10 kg·m² was identified, beside 0.548 out of its
data sheet; gears and wave generator add to a rotor."""


def figure(low, grade, high=None, **more) -> Figure:
    return Figure(low, low if high is None else high, "somewhere", grade, **more)


def actuator(**figures) -> Actuator:
    return Actuator("a", "A", "Maker", (), {name: tuple(given) for name, given in figures.items()})


@pytest.mark.parametrize("name", actuators())
def test_figures_are_plausible(name: str):
    one = actuators()[name]
    assert one.title
    for quantity, given in one.figures.items():
        assert quantity in UNITS
        for each in given:
            assert each.grade in GRADES
            assert len(each.source) > 8, each
            assert "." in each.source, each  # an address, a repository or a document
            if quantity in WORDS:
                assert each.low in WORDS[quantity]
            else:
                assert 0 <= each.low <= each.high < math.inf
                assert each.low > 0 or quantity in ("backlash", "viscous_friction")
    torque, mass = one.used("peak_torque"), one.used("mass")
    if torque is not None and mass is not None:
        assert torque.value / mass.value < DENSEST
    rotor, ratio, motor = one.used("rotor_inertia"), one.used("ratio"), one.used("motor_inertia")
    reflected = [each for each in one.figures.get("reflected_inertia", ()) if not each.set_aside]
    if reflected and rotor is not None and ratio is not None and motor is not None and rotor.grade != "inferred":
        assert motor.low / GEARS < rotor.value * ratio.value**2 < GEARS * motor.high


def test_there_are_enough():
    whole = [
        one
        for one in actuators().values()
        if one.used("rotor_inertia") and one.used("ratio") and one.used("peak_torque") and one.word("gains_run")
    ]
    assert len(actuators()) >= 150  # as README and changelog say
    assert len(whole) >= 25


def test_stiffness_rises_with_the_size_of_a_gear():
    """Strain wave gears: the torsional stiffness of a size rises with its cube; 0.8 and 1.5 are the steps between catalogued sizes."""
    sizes = (14, 17, 20, 25, 32, 40)
    for ratio in (50, 100):
        found = [actuators()[f"harmonic-drive-csg-{size}-{ratio}"].used("stiffness") for size in sizes]
        for size, larger, one, other in zip(sizes, sizes[1:], found, found[1:], strict=False):
            assert one is not None
            assert other is not None
            assert 0.8 * (larger / size) ** 3 < other.value / one.value < 1.5 * (larger / size) ** 3


def test_the_best_grade_counts_and_its_range():
    one = actuator(reflected_inertia=[figure(0.01, "model"), figure(0.02, "datasheet"), figure(0.03, "datasheet"), figure(9, "inferred")])
    used = one.used("motor_inertia")
    assert used is not None
    assert (used.value, used.low, used.high, used.grade) == (0.02, 0.02, 0.03, "datasheet")
    assert one.entry().ranges == {"motor_inertia": (0.02, 0.03)}
    aside = actuator(reflected_inertia=[figure(0.01, "model"), figure(0.02, "datasheet", set_aside="a placeholder")])
    assert aside.entry() == ActuatorEntry(motor_inertia=0.01, actuator="a", published=frozenset({"motor_inertia"}))
    assert actuator(stiffness=[figure(100.0, "datasheet", 400.0)]).entry().stiffness == pytest.approx(200.0)
    assert actuator().entry() == ActuatorEntry(actuator="a")


def test_rotor_and_ratio_count_where_they_are_better():
    rotor, ratio = [figure(2e-5, "datasheet")], [figure(40.0, "datasheet"), figure(41.0, "model")]
    better = actuator(rotor_inertia=rotor, ratio=ratio, reflected_inertia=[figure(0.16, "model")]).used("motor_inertia")
    assert better is not None
    assert better.value == pytest.approx(2e-5 * 40**2)
    assert better.grade == "datasheet"
    worse = actuator(rotor_inertia=rotor, ratio=[figure(40.0, "inferred")], reflected_inertia=[figure(0.16, "model")]).used("motor_inertia")
    assert worse is not None
    assert worse.value == 0.16


def test_a_joint_has_the_figures_of_its_actuator():
    """Those of its actuator and no others: the same system as with the numbers typed; the file's own win; ranges are its uncertainty."""
    named = parse_joint(JOINT.replace("MOTOR", "actuator: harmonic-drive-csg-25-100, motor_inertia: 1.0"), "joint.yaml")
    low, high = 31000.0, 57000.0  # K1 and K3 of the catalogue
    assert named.uncertainty.stiffness == (low, high)
    assert named.source.stiffness == pytest.approx(math.sqrt(low * high))
    typed = parse_joint(JOINT.replace("MOTOR", "actuator: harmonic-drive-csg-25-100, motor_inertia: 1.0, stiffness: 4.0e4"), "joint.yaml")
    assert typed.source.stiffness == 4e4
    assert not typed.uncertainty.names
    given = (
        JOINT.replace("MOTOR", "actuator: harmonic-drive-csg-25-100, motor_inertia: 1.0") + "uncertainty: {stiffness: [3.0e+4, 5.0e+4]}\n"
    )
    assert parse_joint(given, "joint.yaml").uncertainty.stiffness == (3e4, 5e4)
    motor = parse_joint(JOINT.replace("MOTOR", "actuator: unitree-7520-14, stiffness: 3000"), "joint.yaml")
    assert motor.source.motor_inertia == pytest.approx(0.010178, rel=1e-3)  # as mjlab and Unitree's own training have it
    assert any("datasheet" in text for text in motor.assumptions)


@pytest.mark.parametrize(
    ("motor", "words"),
    [
        ("actuator: unitree-7520-15, stiffness: 3000", ["joint.actuator", "'unitree-7520-15'", "did you mean 'unitree-7520-14'"]),
        ("actuator: unitree-7520-14", ["joint.stiffness is missing", "of Unitree N7520-14.3 (7520-14) none is published"]),
        ("actuator: harmonic-drive-csg-25-100", ["joint.motor_inertia is missing"]),
        ("actuator: 3, stiffness: 3000", ["joint.actuator", "3"]),
    ],
)
def test_what_is_not_known_is_one_line(motor: str, words: list[str]):
    with pytest.raises(gr.GainroomError) as error:
        parse_joint(JOINT.replace("MOTOR", motor), "joint.yaml")
    assert len(error.value.problems) == 1
    assert all(word in str(error.value) for word in words), str(error.value)


def test_a_robots_joints_have_those_of_their_own(tmp_path: Path):
    """The later pattern's actuator replaces the former's, whose other figures do not stay; what the file says stays."""
    text = ROBOT.replace(
        "default: {motor_inertia: 0.5, stiffness: 8000.0, damping: 4.0}",
        "default: {actuator: harmonic-drive-csg-25-100, motor_inertia: 0.5, damping: 4.0}\n"
        "  elbow: {actuator: unitree-7520-14, stiffness: 500}",
    )
    system = load_robot_system(write_arm(tmp_path, text))
    found = system.source.actuators
    assert found.stiffness.tolist() == pytest.approx([math.sqrt(31000 * 57000), 500.0])
    assert found.damping.tolist() == [4.0, 4.0]
    assert found.motor_inertia[0] == 0.5
    assert found.motor_inertia[1] == pytest.approx(0.010178, rel=1e-3)  # the stronger pattern's actuator, over the default's number
    low, high = system.uncertainty.stiffness
    assert (low.tolist(), high.tolist()) == ([31000.0, 500.0], [57000.0, 500.0])
    assert any(text.startswith("shoulder: ") and "datasheet" in text for text in system.assumptions)


def test_entries_of_actuators_merge_key_by_key():
    one = ActuatorEntry(stiffness=1.0, ranges={"stiffness": (0.5, 2.0)}, actuator="one", published=frozenset({"stiffness"}))
    other = ActuatorEntry(motor_inertia=3.0, actuator="other", published=frozenset({"motor_inertia"}))
    assert other.over(one) == other
    assert ActuatorEntry(stiffness=7.0).over(one) == ActuatorEntry(stiffness=7.0, actuator="one")
    assert ActuatorEntry(gearbox="harmonic").over(one) == ActuatorEntry(gearbox="harmonic", actuator="one")


URDF_JOINT = """\
<joint name="NAME" type="revolute"><parent link="PARENT"/><child link="NAME_link"/><axis xyz="0 1 0"/><origin xyz="0 0 -0.3"/>
<limit lower="-2" upper="2" effort="50" velocity="10"/></joint>
<link name="NAME_link"><inertial><mass value="3"/><origin xyz="0 0 -0.1"/>
<inertia ixx="0.03" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
"""
ARM = [f"openarm_left_joint{k}" for k in range(1, 8)]


def model(folder: Path, names: list[str]) -> Path:
    """A chain of joints with these names; its file says nothing of motors."""
    parents = ["base", *(f"{name}_link" for name in names)]
    joints = "".join(URDF_JOINT.replace("PARENT", parent).replace("NAME", name) for parent, name in zip(parents, names, strict=False))
    path = folder / "chain.urdf"
    path.write_text(f'<robot name="chain"><link name="base"/>{joints}</robot>', "utf-8")
    return path


def audited(capsys: pytest.CaptureFixture[str], path: Path, *options: str) -> dict:
    gains = path.with_name("gains.yaml")
    gains.write_text('".*": {kp: 100, kd: 4}', "utf-8")
    call = ["audit", str(path), "--delay-ms", "2", "--rate-hz", "1000", "--gearbox", "direct", "--gains", str(gains), "--json", *options]
    main(call)
    return json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_an_audit_takes_them_by_name_and_by_robot(tmp_path: Path, capsys):
    """A known robot's from its joints' names; an option's instead; a number that is typed wins over both; other joints get none."""
    path = model(tmp_path, ARM)
    found = audited(capsys, path)
    own = {name: actuators()[name].entry() for name in ("damiao-dm-j8009", "damiao-dm-j4340", "damiao-dm-j4310")}
    expected = [own["damiao-dm-j8009"]] * 2 + [own["damiao-dm-j4340"]] * 2 + [own["damiao-dm-j4310"]] * 3
    ranges = [entry.ranges.get("motor_inertia", (entry.motor_inertia,) * 2) for entry in expected]
    for joint, (low, high) in zip(found["joints"], ranges, strict=True):
        assert low * (1 - 1e-9) <= joint["motor_inertia"] <= high * (1 + 1e-9)
    assert any("OpenArm" in text or "J8009" in text for text in found["assumptions"])
    typed = audited(capsys, path, "--actuator", ".*joint[12]=unitree-7520-22", "--motor-inertia", ".*joint1=0.5")
    assert typed["joints"][0]["motor_inertia"] == 0.5
    assert typed["joints"][1]["motor_inertia"] == pytest.approx(0.0251, rel=2e-3)
    every = audited(capsys, path, "--motor-inertia", "0.02")
    assert [joint["motor_inertia"] for joint in every["joints"]] == [0.02] * 7
    again = tmp_path / "found.json"  # which audits are read back from, with the names of the actuators
    again.write_text(json.dumps(found), "utf-8")
    main(["audit", str(path), "--delay-ms", "2", "--rate-hz", "1000", "--gearbox", "direct", "--gains", str(again), "--json"])
    second = json.loads(capsys.readouterr().out)
    assert [joint["motor_inertia"] for joint in second["joints"]] == [joint["motor_inertia"] for joint in found["joints"]]
    assert second["gain_limit"] == found["gain_limit"]
    for name in ("hip", "knee"):
        assert recognised([*ARM, name], [*ARM, name], ["chain"]) is None
    plain = audited(capsys, model(tmp_path, ["hip", "knee"]))
    assert [joint["motor_inertia"] for joint in plain["joints"]] == [0.0, 0.0]


def with_armatures(path: Path, of: dict[str, float]) -> Path:
    """The chain as MJCF, each joint with its armature."""
    bodies = "".join(
        f'<body name="{name}_link" pos="0 0 0.1"><joint name="{name}" axis="0 0 1" armature="{one}"/>'
        '<inertial pos="0.05 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'
        for name, one in of.items()
    )
    path = path.with_suffix(".xml")
    path.write_text(
        f'<mujoco model="chain"><worldbody><body name="base">{bodies}{"</body>" * len(of)}</body></worldbody></mujoco>', "utf-8"
    )
    return path


def test_one_armature_for_unlike_motors_of_a_known_robot_is_a_placeholder(tmp_path: Path, capsys):
    """An armature of 0.01 kg·m² on all, as in a model of the Booster T1, is a fifth of what is published. Armatures that differ count."""
    alike = with_armatures(tmp_path / "chain", dict.fromkeys(ARM, 0.01))
    placeholder, silent = audited(capsys, alike), audited(capsys, with_armatures(tmp_path / "bare", dict.fromkeys(ARM, 0.0)))
    assert [joint["motor_inertia"] for joint in placeholder["joints"]] == [joint["motor_inertia"] for joint in silent["joints"]]
    assert main(["audit", str(alike), "--delay-ms", "2", "--gains", str(tmp_path / "gains.yaml"), "--gearbox", "direct"]) != 2
    assert "in place of the model's armature of 0.01 kg·m²" in " ".join(capsys.readouterr().out.split())
    unlike = dict(zip(ARM, (0.02, 0.02, 0.03, 0.03, 0.005, 0.005, 0.005), strict=True))
    told = audited(capsys, with_armatures(tmp_path / "told", unlike))
    assert [joint["motor_inertia"] for joint in told["joints"]] == [*unlike.values()]
    contradicted = [text for text in told["warnings"] if "is not the published one of OpenArm" in text]
    published = {name: actuators()[name].used("motor_inertia") for name in ("damiao-dm-j8009", "damiao-dm-j4340", "damiao-dm-j4310")}
    far = [
        name
        for name, own in zip(published, (0.02, 0.03, 0.005), strict=True)
        if not published[name].low / 1.5 <= own <= published[name].high * 1.5
    ]
    assert [any(name in text for text in contradicted) for name in published] == [name in far for name in published]
    assert far


def test_an_actuator_that_takes_kp_and_kd_makes_where_they_run_a_question(tmp_path: Path, capsys):
    """kd 8 N·m·s/rad on 0.06 kg·m²: 12 ms in the loop are too much, as 8·0.014/0.06 > π/2; 1 ms is not."""
    path = model(tmp_path, ["hip"])
    call = ["audit", str(path), "--delay-ms", "12", "--rate-hz", "500", "--gearbox", "direct", "--gains", str(tmp_path / "gains.yaml")]
    (tmp_path / "gains.yaml").write_text("hip: {kp: 100, kd: 8}", "utf-8")
    levels = {}
    for name in ("robstride-04", "agility-cassie-toe"):
        main([*call, "--actuator", name, "--json"])
        levels[name] = json.loads(capsys.readouterr().out)
    assert [one["option"] for one in levels["robstride-04"]["readings"]] == [
        "--gains-run host",
        "--gains-run drive --drive-rate-hz 1000 --drive-delay-ms 1",
    ]
    assert not levels["agility-cassie-toe"].get("readings")


def test_a_gearbox_of_known_peak_torque_is_no_softer_than_it_would_wind_up(tmp_path: Path):
    """RobStride 04, 120 N·m: K ≥ 120/(5°), where the type alone allows 100 rad/s on 0.04 kg·m²; without a published torque that holds."""
    used = {name: actuators()["robstride-04"].used(name).value for name in ("motor_inertia", "peak_torque")}
    joints = "joints:\n  default: {motor_inertia: 0.5, stiffness: 8000.0, damping: 4.0}"
    published = ROBOT.replace(joints, "joints: {default: {actuator: robstride-04, gearbox: planetary}}")
    low, high = (ends[0] for ends in load_robot_system(write_arm(tmp_path, published)).uncertainty.resonance)
    assert low == pytest.approx(math.sqrt(used["peak_torque"] / math.radians(5) / used["motor_inertia"]), rel=1e-9)
    assert low < high == 1600.0
    own = f"motor_inertia: {used['motor_inertia']}, effort_limit: {used['peak_torque']}"
    limited = ROBOT.replace(joints, f"joints: {{default: {{{own}, gearbox: planetary}}}}")
    assert load_robot_system(write_arm(tmp_path, limited)).uncertainty.resonance[0][0] == 100.0


def test_a_command_to_start_from_has_the_gearbox_of_the_actuator(tmp_path: Path, capsys):
    path = model(tmp_path, ["hip"])
    (tmp_path / "gains.yaml").write_text("hip: {kp: 20, kd: 1}", "utf-8")
    call = ["audit", str(path), "--delay-ms", "1", "--gains", str(tmp_path / "gains.yaml"), "--gains-run", "host", "--rate-hz", "1000"]
    for name, kind in (("robstride-04", "planetary"), ("agility-cassie-toe", "harmonic")):
        assert main([*call, "--actuator", name]) != 2
        assert f"--gearbox {kind}" in capsys.readouterr().out


def test_bad_options_are_one_line(tmp_path: Path, capsys):
    path = model(tmp_path, ["hip"])
    gains = tmp_path / "gains.yaml"
    gains.write_text("hip: {kp: 100, kd: 4}", "utf-8")
    call = ["audit", str(path), "--delay-ms", "2", "--gains", str(gains), "--actuator"]
    assert main([*call, "hip=robotstride-04"]) == 2
    assert "--actuator hip=robotstride-04: 'robotstride-04' is no actuator" in capsys.readouterr().err
    assert main([*call, "knee=robstride-04"]) == 2
    assert "knee" in capsys.readouterr().err


def test_the_command_lists_and_tells(capsys):
    assert main(["actuators"]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in ("unitree-7520-14", "harmonic-drive-csg-25-100"))
    assert main(["actuators", "robstride-04"]) == 0
    told = capsys.readouterr().out
    assert "github.com" in told
    assert "actuator: robstride-04" in told
    assert main(["actuators", "G1 knee", "--json"]) == 0
    (one,) = json.loads(capsys.readouterr().out)["actuators"]
    assert one["name"] == "unitree-7520-22"
    assert all(figure["source"] for given in one["figures"].values() for figure in given)
    assert main(["actuators", "nobody-knows"]) == 2
    assert "actuators 'nobody-knows': no name has this" in capsys.readouterr().err


CALLED = {
    "Unitree Go2": "go2",
    "Unitree Go1": "unitree_go1/go1",
    "Unitree H1-2": "h1_2",
    "MIT Mini Cheetah": "mini_cheetah",
    "ViperX 300": "aloha",
}
"""Names of models whose joints alone do not tell the robot."""


@pytest.mark.parametrize("robot", known_robots(), ids=lambda robot: robot.title)
def test_robots_name_actuators_that_there_are(robot):
    assert all(name is None or name in actuators() for name in robot.joints.values())
    assert robot.source
    called = CALLED.get(robot.title, "").split("/")
    assert robot.is_of([*robot.has], [*robot.has, "another"], called)
    assert not robot.is_of([*robot.has, "another"], [*robot.has, "another"], called)
    assert not robot.is_of([*robot.has], robot.has[1:], called)
    if robot.named:
        assert not robot.is_of([*robot.has], [*robot.has], ["margo2", "xgo10", "stuff"])
    assert bool(robot.named) == (robot.title in CALLED)
