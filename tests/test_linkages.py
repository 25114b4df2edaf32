"""Closed loops, joints that follow others and passive joints, against MuJoCo's own constraints, potential energies and closed forms."""

import json

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq

import gainroom as gr
from gainroom.cli import main
from gainroom.files.audit_options import AuditOptions, audited
from gainroom.files.robot_yaml import load_robot, load_robot_system
from gainroom.robot import load_model
from gainroom.robot.contact import Contact
from gainroom.robot.held_followers import followers, on_a_tree
from gainroom.robot.linearize import gravity_stiffness, linearize
from gainroom.simulation.mujoco_model import build_mujoco
from gainroom.studies.audit import audit
from mujoco_loops import in_mujoco, posed, projected, solid
from refusals import assert_refused
from robot_bodies import TREE, write
from robot_truths import actuators, hinge, link, write_robot

SOLVED = 1e-8
"""Of W: matrices of condition up to 1e6, inverted twice."""


FOUR_BAR = f"""<mujoco><compiler angle="radian"/><worldbody>
<body name="crank"><joint name="crank" axis="0 1 0" armature="0.01"/>{solid(0.4, 0.05, "0.05 0 0")}
  <body name="coupler" pos="0.1 0 0"><joint name="coupler" axis="0 1 0" armature="0.003"/>{solid(0.6, 0.1, "0 0 0.15")}</body></body>
<body name="rocker" pos="0.3 0 0"><joint name="rocker" axis="0 1 0" damping="0.1"/>{solid(0.5, 0.09, "-0.03 0 0.15")}
  <body name="tool" pos="0 0 0.3"><joint name="tool" axis="0 1 0" armature="0.02"/>{solid(0.3, 0.05, "0 0 0.1")}</body></body>
</worldbody>
<equality><connect name="bar" body1="coupler" body2="rocker" anchor="0.1 0 0.3"/></equality>
<actuator><position joint="crank" kp="300" kv="8"/><position joint="tool" kp="40" kv="2"/></actuator></mujoco>"""

# An ankle that two motors in the shank move through rods; ball joints at both ends of each.
ROD = """<body name="arm_{0}" pos="-0.03 {1} 0.2"><joint name="motor_{0}" axis="0 1 0" armature="0.02"/>{2}
  <body name="rod_{0}" pos="-0.04 0 0"><joint name="ball_{0}" type="ball"/>{3}</body></body>"""
ANKLE = f"""<mujoco><compiler angle="radian"/><worldbody><body name="shank" pos="0 0 0.5"><freejoint/>{solid(3.0, 0.12, "0 0 0.15")}
{ROD.format("left", 0.04, solid(0.2, 0.02, "-0.02 0 0"), solid(0.1, 0.06, "0 0 -0.1"))}
{ROD.format("right", -0.04, solid(0.2, 0.02, "-0.02 0 0"), solid(0.1, 0.06, "0 0 -0.1"))}
<body name="cross"><joint name="pitch" axis="0 1 0"/>{solid(0.05, 0.02)}
  <body name="foot"><joint name="roll" axis="1 0 0"/>{solid(1.0, 0.08, "0.03 0 -0.05")}<site name="sole" pos="0 0 -0.08"/></body></body>
</body></worldbody><equality>
<connect name="left" body1="rod_left" body2="foot" anchor="0 0 -0.2"/>
<connect name="right" body1="rod_right" body2="foot" anchor="0 0 -0.2"/>
</equality><actuator><motor joint="motor_left"/><motor joint="motor_right"/></actuator></mujoco>"""

WELDED = FOUR_BAR.replace(
    '<connect name="bar" body1="coupler" body2="rocker" anchor="0.1 0 0.3"/>',
    '<weld name="bar" body1="end" body2="rocker" anchor="-0.1 0 0.3"/>',
).replace(
    solid(0.6, 0.1, "0 0 0.15") + "</body>",
    solid(0.6, 0.1, "0 0 0.15") + f'<body name="end" pos="0.1 0 0.3"><joint name="pin" axis="0 1 0"/>{solid(0.05, 0.02)}</body></body>',
)
SITES = (
    FOUR_BAR.replace(
        '<connect name="bar" body1="coupler" body2="rocker" anchor="0.1 0 0.3"/>', '<connect name="bar" site1="one" site2="two"/>'
    )
    .replace(solid(0.6, 0.1, "0 0 0.15"), solid(0.6, 0.1, "0 0 0.15") + '<site name="one" pos="0.1 0 0.3" euler="0.3 0.2 0.1"/>')
    .replace(solid(0.5, 0.09, "-0.03 0 0.15"), solid(0.5, 0.09, "-0.03 0 0.15") + '<site name="two" pos="-0.1 0 0.3"/>')
)
TWICE = FOUR_BAR.replace("</equality>", '<connect name="again" body1="rocker" body2="coupler" anchor="-0.1 0 0.3"/></equality>')
FOUR_BARS = {"pin": FOUR_BAR, "weld": WELDED, "sites": SITES, "twice": TWICE}


@pytest.mark.parametrize("name", FOUR_BARS)
def test_a_four_bar_moves_as_in_mujoco(tmp_path, name):
    body = load_model(write(tmp_path, FOUR_BARS[name]))
    assert body.joint_names == ("crank", "tool")
    assert set(body.passive) == {"coupler", "rocker"} | ({"pin"} if name == "weld" else set())
    for crank, tool in ((0.0, 0.0), (0.4, -0.3), (-0.7, 1.0), (0.9, 2.0)):
        q = body.configuration({"crank": crank, "tool": tool})
        found = linearize(body, actuators(2), q).link_inverse_inertia
        assert_allclose(found, projected(*in_mujoco(FOUR_BARS[name], body, q)), rtol=SOLVED)


@pytest.mark.parametrize("angles", [(0.0, 0.0), (0.3, 0.3), (0.4, -0.2), (-0.5, 0.1)])
def test_a_parallel_ankle_moves_as_in_mujoco(tmp_path, angles):
    body = load_model(write(tmp_path, ANKLE))
    assert body.joint_names == ("motor_left", "motor_right")
    assert body.nv == 6 + 8 + 2  # base; two ball joints, pitch and roll; the motors
    q = body.configuration(dict(zip(body.joint_names, angles, strict=True)))
    mass, rows, picked = in_mujoco(ANKLE, body, q)
    assert_allclose(linearize(body, actuators(2), q).link_inverse_inertia, projected(mass, rows, picked), rtol=SOLVED)


def test_a_parallel_ankle_stands_on_its_foot(tmp_path):
    """On flat ground the foot's site cannot move in any direction."""
    body = load_model(write(tmp_path, ANKLE))
    q = body.configuration({"motor_left": 0.2, "motor_right": -0.1})
    found = linearize(body, actuators(2), q, [Contact("sole")]).link_inverse_inertia
    mass, rows, picked = in_mujoco(ANKLE, body, q)
    model, data = posed(ANKLE, body, q)
    ground = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, ground[:3], ground[3:], model.site("sole").id)
    assert_allclose(found, projected(mass, np.vstack([rows, ground]), picked), rtol=SOLVED)


def test_weight_in_a_closed_loop(tmp_path):
    """G is the second derivative of the weight's potential along closed postures, less what the holding torque does, which is constant."""
    body = load_model(write(tmp_path, FOUR_BAR))
    at, h = np.array([0.4, -0.3]), 1e-3  # differences are good to h² and to round-off over h²: about 1e-6 here

    def potential(shift):
        q = body.configuration(dict(zip(body.joint_names, at + shift, strict=True)))
        return 9.81 * body.total_mass * body.com(q)[2]

    unit = h * np.eye(2)
    truth = [[sum(s * t * potential(s * a + t * b) for s in (1, -1) for t in (1, -1)) / (4 * h**2) for a in unit] for b in unit]
    q = body.configuration(dict(zip(body.joint_names, at, strict=True)))
    assert_allclose(gravity_stiffness(body, q), truth, rtol=1e-4, atol=1e-5)


def test_a_passive_joint_that_nothing_moves_has_no_gravity_stiffness(tmp_path):
    body = load_model(write(tmp_path, FOUR_BAR), passive=["tool"])
    assert_refused(lambda: gravity_stiffness(body, body.neutral()), ["passive joints", "1 direction of them"])


BALL_ARMATURE = ANKLE.replace('type="ball"', 'type="ball" armature="0.004" damping="0.2"').replace(
    "<freejoint/>", '<joint name="free" type="free" armature="0.3" damping="0.5"/>'
)


@pytest.mark.parametrize("angles", [(0.0, 0.0), (0.4, -0.2)])
def test_armature_of_ball_and_free_joints_counts_about_every_axis(tmp_path, angles):
    """MuJoCo's dof_armature is on all 3 velocities of a ball joint, and on all 6 of a free one."""
    body = load_model(write(tmp_path, BALL_ARMATURE))
    q = body.configuration(dict(zip(body.joint_names, angles, strict=True)))
    found = linearize(body, actuators(2), q).link_inverse_inertia
    assert_allclose(found, projected(*in_mujoco(BALL_ARMATURE, body, q)), rtol=SOLVED)
    damped = next(note for note in body.notes if "damping of passive joints" in note)
    assert all(name in damped for name in ("ball_left", "ball_right", "root_joint"))


def test_springs_of_ball_and_free_joints_are_said_to_be_left_out(tmp_path):
    text = ANKLE.replace('name="ball_left" type="ball"', 'name="ball_left" type="ball" stiffness="3"')
    notes = load_model(write(tmp_path, text)).notes
    assert any("springs of ball and free joints are left out: ball_left" in note for note in notes)


def test_armature_of_a_free_joint_counts_without_loops_and_in_a_simulation(tmp_path):
    text = TREE.replace("<freejoint/>", '<joint type="free" armature="0.7"/>')
    body = load_model(write(tmp_path, text))
    q = body.configuration({"hip": 0.3, "knee": -0.5})
    found = linearize(body, actuators(3), q).link_inverse_inertia
    assert_allclose(found, projected(*in_mujoco(text, body, q)), rtol=SOLVED)
    simulated = build_mujoco(body, actuators(3, stiffness=np.inf), q, timestep=1e-3).model
    assert_allclose(simulated.dof_armature[:6], 0.7)


FOLLOWING = f"""<mujoco><compiler angle="radian"/><worldbody>
<body name="a"><joint name="lead" axis="0 0 1"/>{solid(2.0, 0.3)}</body>
<body name="b" pos="1 0 0"><joint name="follow" axis="0 0 1" ref="0.2"/>{solid(1.5, 0.2)}</body>
</worldbody><equality><joint joint1="follow" joint2="lead" polycoef="0.1 1.5 0.4 0 0"/></equality></mujoco>"""


def test_a_joint_that_follows(tmp_path):
    """q_f = 0.2 + 0.1 + 1.5 q + 0.4 q²: the leader moves its own inertia and the follower's by the square of the slope."""
    text = FOLLOWING
    body = load_model(write(tmp_path, text))
    assert (body.joint_names, body.passive) == (("lead",), ("follow",))
    assert any("follow others" in note and "'follow'" in note for note in body.notes)
    own, other = 0.9 * 2.0 * 0.3**2, 0.9 * 1.5 * 0.2**2
    for angle in (0.0, 0.5, -1.0):
        q = body.configuration({"lead": angle})
        assert body.position(q, "follow") == pytest.approx(0.3 + 1.5 * angle + 0.4 * angle**2, abs=1e-12)
        slope = 1.5 + 0.8 * angle
        assert_allclose(linearize(body, actuators(1), q).link_inverse_inertia, [[1 / (own + slope**2 * other)]], rtol=1e-12)
        mass, rows, picked = in_mujoco(text, body, q)
        assert_allclose(linearize(body, actuators(1), q).link_inverse_inertia, projected(mass, rows, picked), rtol=SOLVED)


def test_a_joint_that_is_locked_does_not_follow(tmp_path):
    """It stays where its leader puts it in the posture, and a leader that is locked moves nothing."""
    path = write(tmp_path, FOLLOWING)
    held = load_model(path, locked=["follow"], posture_for_locked={"lead": 0.5})
    assert dict(held.locked) == {"follow": pytest.approx(0.3 + 1.5 * 0.5 + 0.4 * 0.5**2, abs=1e-15)}
    assert_allclose(linearize(held, actuators(1), held.neutral()).link_inverse_inertia, [[1 / (0.9 * 2.0 * 0.3**2)]], rtol=1e-12)
    assert load_model(path, locked=["follow"], posture_for_locked={"follow": 0.7}).locked == {"follow": 0.7}
    third = f'<body name="c"><joint name="third" axis="0 0 1"/>{solid(1.0, 0.1)}</body></worldbody>'
    body = load_model(write(tmp_path, FOLLOWING.replace("</worldbody>", third)), locked=["lead"])
    assert body.joint_names == ("third",)
    assert not body.linkages
    assert dict(body.locked) == {"lead": 0.0, "follow": pytest.approx(0.3, abs=1e-15)}


def test_a_follower_that_moves_no_mass_is_held(tmp_path):
    """A pointer, say, for the eye alone: it would make the mass matrix singular, and adds nothing to its leader."""
    links = link("base") + link("one", 2.0, inertia=(1, 0.3, 1)) + '<link name="two"/><link name="tip"/>'
    joints = hinge("lead", "base", "one") + hinge("follow", "base", "two").replace("</joint>", '<mimic joint="lead"/></joint>')
    end = '<joint name="end" type="fixed"><parent link="two"/><child link="tip"/></joint>'
    body = load_model(write_robot(tmp_path, links, joints + end))
    assert dict(body.locked) == {"follow": 0.0}
    assert_allclose(linearize(body, actuators(1), body.neutral()).link_inverse_inertia, [[1 / 0.3]], rtol=1e-12)


@pytest.mark.parametrize("locked", [[], ["lead"]])
def test_a_follower_with_a_motor_of_its_own(tmp_path, locked):
    """Two motors that move one another: both have gains, as MuJoCo has it. Where the leader is locked neither moves."""
    third = f'<body name="c"><joint name="third" axis="0 0 1"/>{solid(1.0, 0.1)}</body></worldbody>'
    servos = "".join(f'<position joint="{name}" kp="30" kv="2"/>' for name in ("lead", "follow", "third"))
    text = FOLLOWING.replace("</worldbody>", third).replace("</mujoco>", f"<actuator>{servos}</actuator></mujoco>")
    body = load_model(write(tmp_path, text), locked=locked)
    assert body.joint_names == (("third",) if locked else ("lead", "follow", "third"))
    q = body.configuration({} if locked else {"lead": 0.4})
    found = linearize(body, actuators(body.size), q).link_inverse_inertia
    if not locked:
        assert_allclose(found, projected(*in_mujoco(text, body, q)), rtol=SOLVED, atol=SOLVED)  # third is apart from the others
        assert np.linalg.matrix_rank(found) == 2


def test_audit_of_a_follower_that_alone_has_gains(tmp_path, capsys):
    """The motor on either end of a pair of gears is the same motor: W of the leader is that of the follower times the ratio²."""
    limits = []
    for joint, servo in (("lead", 'kp="60" kv="3"'), ("follow", 'kp="15" kv="0.75"')):
        text = FOLLOWING.replace("0.1 1.5 0.4 0 0", "0 2 0 0 0").replace('joint="lead"', f'joint="{joint}"')
        path = write(tmp_path, text.replace("</mujoco>", f'<actuator><position joint="{joint}" {servo}/></actuator></mujoco>'))
        assert main(["audit", str(path), "--delay-ms", "2", "--json"]) != 2
        answer = json.loads(capsys.readouterr().out)
        assert [one["name"] for one in answer["joints"]] == [joint]
        limits.append(answer["gain_limit"])
    assert limits[0] == pytest.approx(limits[1], rel=1e-9)  # ends of an interval of round-off


RATIO = -2.5
PAIRS = {
    "a URDF's mimic": lambda folder: write_robot(
        folder,
        link("base") + link("one", 2.0, inertia=(1, 0.3, 1)) + link("two", 1.0, inertia=(1, 0.1, 1)),
        hinge("lead", "base", "one")
        + hinge("follow", "base", "two").replace("</joint>", f'<mimic joint="lead" multiplier="{RATIO}"/></joint>'),
    ),
    "an MJCF without actuators": lambda folder: write(folder, PAIR),
    "an MJCF with one on the leader": lambda folder: write(folder, PAIR.replace("</mujoco>", SERVO + "</mujoco>")),
    "an MJCF whose order is turned": lambda folder: write(folder, PAIR.replace(*TURNED)),
}
PAIR = f"""<mujoco><compiler angle="radian"/><worldbody>
<body name="a"><joint name="lead" axis="0 1 0"/><inertial pos="0 0 0" mass="2" diaginertia="1 0.3 1"/></body>
<body name="b"><joint name="follow" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 0.1 1"/></body>
</worldbody><equality><joint joint1="follow" joint2="lead" polycoef="0 {RATIO} 0 0 0"/></equality></mujoco>"""
SERVO = '<actuator><position joint="lead" kp="1" kv="1"/></actuator>'
TURNED = (f'joint1="follow" joint2="lead" polycoef="0 {RATIO}', f'joint1="lead" joint2="follow" polycoef="0 {1 / RATIO}')


@pytest.mark.parametrize("gains", [{"lead": (50, 4)}, {"follow": (20, 1.5)}, {"lead": (50, 4), "follow": (20, 1.5)}])
@pytest.mark.parametrize("pair", PAIRS)
def test_gains_on_either_joint_of_a_pair_count(tmp_path, pair, gains):
    """Both move as one: inertia, kp and kd of the joint that follows count at the other by the square of the ratio. The limit is in closed
    form: PD and delay T on a rigid inertia J cross −180° where ωT = atan(ω kd/kp), and there |L| = 1 at the limit."""
    path = PAIRS[pair](tmp_path)
    file = write(tmp_path, "".join(f"{name}: {{kp: {kp}, kd: {kd}}}\n" for name, (kp, kd) in gains.items()), "gains.yaml")
    found = audit(audited(str(path), file, AuditOptions(1.0)).system)
    assert {joint.name for joint in found.joints} == {*gains}
    kp, kd = (sum(each[k] * (RATIO**2 if name == "follow" else 1) for name, each in gains.items()) for k in (0, 1))
    inertia = 0.3 + RATIO**2 * 0.1
    omega = brentq(lambda w: w * 1e-3 - np.arctan(w * kd / kp), 1.0, 0.5 * np.pi / 1e-3)
    assert found.tightest.limit.gain == pytest.approx(inertia * omega**2 / np.hypot(kp, omega * kd), rel=1e-9)


def test_the_written_robot_of_a_driven_follower_is_the_same(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path, PAIR, "pair.xml")
    write(tmp_path, "follow: {kp: 20, kd: 1.5}\n", "gains.yaml")
    call = ["audit", "pair.xml", "--gains", "gains.yaml", "--delay-ms", "1", "--write-robot", "robot.yaml"]
    assert main(call) != 2
    body = load_robot("robot.yaml").body
    assert (body.joint_names, body.passive) == (("follow",), ("lead",))


def test_a_robot_yaml_is_told_of_gains_that_no_motor_has(tmp_path):
    """And takes them where `driven` says that there is one."""
    write(tmp_path, PAIR, "pair.xml")
    text = "model: {file: pair.xml}\njoints: {default: {}}\ndrive: {bandwidth: .inf, delay_ms: 1}\n"
    control = "control: {type: pd, feedback: motor, kp: {default: 50, follow: 20}, kd: 4}\n"
    plain = load_robot_system(write(tmp_path, text + control, "robot.yaml"))
    assert any("gains of joints without a motor do not count" in warning and "follow" in warning for warning in plain.warnings)
    driven = load_robot_system(write(tmp_path, text.replace("{default: {}}", "{default: {}, driven: [follow]}") + control, "robot.yaml"))
    assert driven.source.joint_names == ("lead", "follow")
    assert not any("without a motor do not count" in warning for warning in driven.warnings)


def coaxial(first: str, second: str, more: str = "") -> str:
    """A leg whose hip has two joints on one axis, the `first` and the `second` of its body, and no link between them."""
    servos = "".join(f'<position joint="{name}" kp="17" kv="0.5"/>' for name in ("hip", "knee"))
    return f"""<mujoco><worldbody><body name="upper" pos="0 0 1">{first}{second}
    <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="1"/>{more}
    <body name="lower" pos="0 0 -0.3"><joint name="knee" axis="0 1 0" armature="0.03"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/></body></body></worldbody>
    <actuator>{servos}</actuator></mujoco>"""


HIP = '<joint name="hip" axis="0 1 0" armature="0.03"/>'
BACKLASH = '<joint name="idle" axis="0 1 0" armature="0.01" range="-1 1"/>'
SLIDER = HIP.replace("/>", ' type="slide"/>')
TAIL = '<body name="tail" pos="0 0.1 0"><joint name="idle" type="ball"/><geom size="0.02" mass="0.2"/></body>'
IDLE = {
    "after the hip": (coaxial(HIP, BACKLASH), coaxial(HIP, "")),
    "before the hip": (coaxial(BACKLASH, HIP), coaxial("", HIP)),
    "a slide": (coaxial(SLIDER, BACKLASH.replace("/>", ' type="slide"/>')), coaxial(SLIDER, "")),
    "on an axis the other way round": (coaxial(HIP, BACKLASH.replace("0 1 0", "0 -1 0")), coaxial(HIP, "")),
    "a ball joint": (coaxial(HIP, "", TAIL), coaxial(HIP, "", TAIL.replace('<joint name="idle" type="ball"/>', ""))),
}


@pytest.mark.slow
@pytest.mark.parametrize("idle", IDLE)
def test_a_joint_without_gains_is_held_also_where_no_motor_could_move_it(tmp_path, idle):
    """As documented: with it the robot has the limit that it has without that joint."""
    limits = []
    for name, text in zip(("with.xml", "without.xml"), IDLE[idle], strict=True):
        found = audit(audited(str(write(tmp_path, text, name)), None, AuditOptions(3.0, rate_hz=500.0)).system)
        assert [joint.name for joint in found.joints] == ["hip", "knee"]
        limits.append(found.tightest.limit.gain)
    assert limits[0] == pytest.approx(limits[1], rel=1e-9)  # ends of an interval of round-off


def test_two_joints_with_gains_on_one_axis_are_refused_by_name(tmp_path):
    text = coaxial(HIP, BACKLASH).replace("<actuator>", '<actuator><position joint="idle" kp="5"/>')
    assert_refused(lambda: audited(str(write(tmp_path, text)), None, AuditOptions(3.0)), ["'hip'", "'idle'", "no mass moves"])


def test_gains_are_exported_for_a_model_with_such_a_joint(tmp_path, capsys):
    model, gains = write(tmp_path, coaxial(HIP, BACKLASH)), write(tmp_path, '"hip|knee": {kp: 17, kd: 0.5}\n', "gains.yaml")
    assert main(["export", str(gains), "--to", "yaml", "--model", str(model)]) == 0
    assert "17" in capsys.readouterr().out


def test_a_joint_held_by_a_constant_stays_held(tmp_path):
    body = load_model(write(tmp_path, FOLLOWING.replace(' joint2="lead"', "")), passive=["follow"])
    assert dict(body.locked) == {"follow": 0.0}
    assert not body.passive


def test_a_joint_that_mimics_another(tmp_path):
    """Two wheels with one motor: inertia of the other by the square of the ratio; where it is locked it does not count."""
    links = link("base") + link("one", 2.0, inertia=(1, 0.3, 1)) + link("two", 1.0, inertia=(1, 0.1, 1))
    mimic = '<mimic joint="lead" multiplier="-2.5" offset="0.1"/></joint>'
    joints = hinge("lead", "base", "one") + hinge("follow", "base", "two").replace("</joint>", mimic)
    path = write_robot(tmp_path, links, joints)
    for locked, inertia in ((["follow"], 0.3), ([], 0.3 + 2.5**2 * 0.1)):
        body = load_model(path, locked=locked)
        q = body.configuration({"lead": 0.2})
        assert_allclose(linearize(body, actuators(1), q).link_inverse_inertia, [[1 / inertia]], rtol=1e-12)
    assert body.position(q, "follow") == pytest.approx(0.1 - 2.5 * 0.2, abs=1e-12)
    path.write_text(path.read_text().replace("-2.5", "two"))
    assert_refused(lambda: load_model(path), ["follow", "multiplier", "two"])


def test_the_spring_of_a_passive_joint_gives_way(tmp_path):
    """W(s) with the spring in it, against the links' equations of motion solved whole, loops by multipliers."""
    text = FOUR_BAR.replace('name="rocker" axis="0 1 0" damping="0.1"', 'name="rocker" axis="0 1 0" damping="0.7" stiffness="90"')
    body = load_model(write(tmp_path, text))
    assert body.passive_springs == {"rocker": (90.0, 0.7)}
    q = body.configuration({"crank": 0.4, "tool": 0.2})
    model = linearize(body, actuators(2), q)
    soft = model.compliance
    mass, rows, picked = in_mujoco(text, body, q)
    rocker = mujoco.MjModel.from_xml_string(text).joint("rocker").dofadr[0]
    for s in (3j, 40 + 25j, 400j):
        whole = mass.astype(complex)
        whole[rocker, rocker] += (90.0 + 0.7 * s) / s**2
        truth = projected(whole, rows, picked)
        middle = soft.inverse_inertia + np.diag(s**2 / (soft.stiffness + s * soft.damping))
        found = model.link_inverse_inertia - soft.coupling @ np.linalg.solve(middle, soft.coupling.T)
        assert_allclose(found, truth, rtol=SOLVED)


def test_a_locked_loop_is_no_loop(tmp_path):
    body = load_model(write(tmp_path, FOUR_BAR), locked=["crank", "coupler", "rocker"])
    assert body.joint_names == ("tool",)
    assert not body.linkages
    assert not any("loop" in note for note in body.notes)


def test_without_actuators_every_joint_of_a_loop_has_a_motor_unless_it_is_said_to_be_passive(tmp_path):
    light = FOUR_BAR.replace(' armature="0.003"', "")  # of a motor it is a rotor, of a passive joint a part of the links
    bare = light[: light.index("<actuator>")] + "</mujoco>"
    every = load_model(write(tmp_path, bare))
    assert every.size == 4
    assert any("not listed as passive" in note for note in every.notes)
    q = every.configuration({"crank": 0.4, "tool": 0.1})  # the others close the loop
    moving = linearize(every, actuators(4), q).link_inverse_inertia
    assert np.linalg.matrix_rank(moving, tol=1e-9 * np.abs(moving).max()) == 2
    said = load_model(write(tmp_path, bare), passive=["coupler", "rocker"])
    driven = load_model(write(tmp_path, light))
    for body in (said, driven):
        assert body.joint_names == ("crank", "tool")
    two = [linearize(body, actuators(2), body.configuration({"crank": 0.4, "tool": 0.1})).link_inverse_inertia for body in (said, driven)]
    assert_allclose(two[0], two[1], rtol=SOLVED)
    picked = [every.joint_names.index(name) for name in ("crank", "tool")]
    assert_allclose(moving[np.ix_(picked, picked)], two[0], rtol=SOLVED)  # torques on these two alone


def test_a_keyframe_chooses_among_the_ways_to_close_a_loop(tmp_path):
    body = load_model(write(tmp_path, FOUR_BAR))
    near = body.configuration({"crank": 0.4})
    pin, ground = 0.1 * np.array([np.cos(0.4), -np.sin(0.4)]), np.array([0.3, 0.0])  # x and z of the ends of the two free bars
    along = (ground - pin) / np.linalg.norm(ground - pin)

    def turned(guess):
        """How far a bar has turned about y, from its direction at 0 to `guess`."""
        return [np.arctan2(now[0], now[1]) - np.arctan2(first[0], first[1]) for now, first in guess]

    rocker = body.position(near, "rocker")
    end = ground + np.array([-0.1 * np.cos(rocker) + 0.3 * np.sin(rocker), 0.1 * np.sin(rocker) + 0.3 * np.cos(rocker)])
    other = 2 * (pin + along * (along @ (end - pin))) - end  # mirrored about the line between the ends
    coupler, rocker = turned([(other - pin, (0.1, 0.3)), (other - ground, (-0.1, 0.3))])
    crossed = body.configuration({"crank": 0.4, "coupler": coupler - 0.4 + 0.05, "rocker": rocker - 0.05})
    for q in (near, crossed):
        in_mujoco(FOUR_BAR, body, q)
    assert np.sin(body.position(crossed, "rocker") - rocker) == pytest.approx(0.0, abs=1e-9)
    assert abs(np.sin(body.position(near, "rocker") - rocker)) > 0.1


def test_loops_that_cannot_be_closed_are_refused(tmp_path):
    body = load_model(
        write(tmp_path, FOUR_BAR.replace('pos="0.1 0 0"', 'pos="0.5 0 0"').replace('anchor="0.1 0 0.3"', 'anchor="-0.3 0 0.3"'))
    )
    assert_refused(lambda: body.configuration({"crank": 3.1}), ["'bar'", "cannot be closed", "open"])


def test_audit_keeps_loops(tmp_path, capsys):
    """The gain limit is that of the plant that MuJoCo's constraints leave; held open or locked, it is another."""
    path = write(tmp_path, FOUR_BAR)
    main(["audit", str(path), "--delay-ms", "2", "--stiffness", "5000", "--damping", "1", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert [joint["name"] for joint in found["joints"]] == ["crank", "tool"]
    assert any("closed" in text for text in found["assumptions"])
    body = load_model(path)
    inverse = projected(*in_mujoco(FOUR_BAR, body, body.configuration({})))
    plant = gr.Plant(inverse, np.array([0.01, 0.02]), np.full(2, 5000.0), np.ones(2))
    loop = gr.build_loop(plant, gr.Drive(np.inf, 1.0, 2e-3), gr.PD(np.array([300.0, 40.0]), np.array([8.0, 2.0])))
    assert found["gain_limit"] == pytest.approx(gr.gain_limit(loop).gain, rel=1e-6)


def test_robot_yaml_names_passive_joints(tmp_path):
    write(tmp_path, FOUR_BAR[: FOUR_BAR.index("<actuator>")] + "</mujoco>", "bars.xml")
    text = """
model: {file: bars.xml, base: fixed}
joints: {default: {motor_inertia: 0.02, stiffness: 5000, damping: 1}, passive: [coupler, rocker]}
drive: {bandwidth: 4000, damping_ratio: 0.9, delay_ms: 2}
postures: {bent: {crank: 0.4, tool: 0.3}}
control: {type: pd, space: joint, feedback: motor, kp: 100, kd: 3}
"""
    robot = gr.load_robot(write(tmp_path, text, "robot.yaml"))
    assert robot.joint_names == ("crank", "tool")
    body = robot.body
    truth = projected(*in_mujoco(FOUR_BAR, body, body.configuration({"crank": 0.4, "tool": 0.3})))
    assert_allclose(robot.linearize("bent").link_inverse_inertia, truth, rtol=SOLVED)
    wrong = write(tmp_path, text.replace("[coupler, rocker]", "[couplr]"), "wrong.yaml")
    assert_refused(lambda: gr.load_robot(wrong), ["joints.passive[0]", "couplr"])


@pytest.mark.parametrize("what", ["tracker", "simulation"])
def test_what_does_not_carry_loops_says_so(tmp_path, what, capsys):
    write(tmp_path, FOUR_BAR, "bars.xml")
    text = """
model: {file: bars.xml, base: fixed}
joints: {default: {motor_inertia: 0.02, stiffness: 5000, damping: 1}}
drive: {bandwidth: 4000, damping_ratio: 0.9, delay_ms: 2}
control: {type: pd, space: joint, feedback: motor, kp: 100, kd: 3, sample_rate_hz: 1000}
"""
    path = write(tmp_path, text, "robot.yaml")
    if what == "tracker":
        assert_refused(lambda: gr.GainTracker(gr.load_robot(path)), ["gain tracker", "closed loops"])
        return
    assert main(["simulate", str(path)]) == 2
    error = capsys.readouterr().err
    assert "closed loops" in error
    assert len(error.strip().splitlines()) == 1


def test_on_a_tree_followers_are_held_where_they_stand(tmp_path):
    """Sweeps and simulations carry no joints that follow others: the same numbers as with the joint locked there, and a warning."""
    finger = '<joint name="finger" axis="0 0 1" armature="0.01"/>' + solid(0.3, 0.02, "0.1 0 0")
    twin = '<joint name="twin" axis="0 0 1"/>' + solid(0.2, 0.02, "0.1 0 0.05")
    gripper = f"""<mujoco><compiler angle="radian"/><worldbody><body name="palm"><joint name="wrist" axis="0 1 0" armature="0.02"/>
{solid(0.5, 0.05, "0 0 0.1")}<body name="f" pos="0 0 0.2">{finger}</body><body name="t" pos="0 0.1 0.2">{twin}</body></body></worldbody>
<equality><joint name="gear" joint1="twin" joint2="finger" polycoef="0.1 -1 0 0 0"/></equality>
<actuator><motor joint="wrist"/><motor joint="finger"/></actuator></mujoco>"""
    (tmp_path / "gripper.xml").write_text(gripper, "utf-8")
    text = """model: {file: gripper.xml, base: fixed}
joints: {default: {motor_inertia: 0.02, stiffness: 200, damping: 0.2}%s}
drive: {bandwidth: 3000, delay_ms: 2}
postures: {open: {wrist: 0.3, finger: 0.5}}
contacts: {free: []}
control: {type: pd, feedback: motor, kp: 3, kd: 0.2, sample_rate_hz: 1000}
"""
    found = {}
    for name, locked in (("moving", ""), ("locked", ", locked: [twin]")):
        path = tmp_path / f"{name}.yaml"
        path.write_text(text % locked, "utf-8")
        system = load_robot_system(path)
        found[name] = on_a_tree(system)
        assert found[name].source.body.locked.keys() == {"twin"}
        assert sum("joints that follow others" in one for one in found[name].warnings) == (name == "moving")
        assert followers(system.source.body) == (("twin",) if name == "moving" else ())
    here, there = (each.source.linearize("open", "free") for each in found.values())
    assert found["moving"].source.body.locked["twin"] == pytest.approx(0.1 - 0.5)
    assert_allclose(here.link_inverse_inertia, there.link_inverse_inertia, rtol=1e-12)
    assert main(["verify", str(tmp_path / "moving.yaml"), "--json"]) == 0
