"""Actuator configurations of mjlab and Isaac Lab, read from the syntax tree: as Python itself would have them, and never run."""

import re
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from numpy.testing import assert_allclose

from gainroom.errors import GainroomError
from gainroom.files.gain_files import gains_of, read_gains
from gainroom.files.gain_formats.actuator_configs import read_actuator_configs
from mutations import RANDOMS, mutated_bytes

LEGS = ("left_hip_pitch", "left_knee", "left_ankle", "right_hip_pitch", "right_knee", "right_ankle")
MJLAB = '''\
"""Constants of a robot."""
import math
from dataclasses import replace

from mjlab.actuator import BuiltinPositionActuatorCfg, DelayedActuatorCfg
from mjlab.entity import EntityArticulationInfoCfg, EntityCfg
from mjlab.utils.actuator import ElectricActuator, reflected_inertia_from_two_stage_planetary

ROTORS = (0.489e-4, 0.109e-4, 0.738e-4)
GEARS = (1, 4.5, 1 + (48 / 22))
MOTOR = ElectricActuator(
  reflected_inertia=reflected_inertia_from_two_stage_planetary(ROTORS, GEARS), velocity_limit=20.0, effort_limit=139.0
)
NATURAL_FREQUENCY = 10 * 2 * math.pi
STIFFNESS = MOTOR.reflected_inertia * NATURAL_FREQUENCY**2
DAMPING: float = 2.0 * 2 * MOTOR.reflected_inertia * NATURAL_FREQUENCY
SIDES = ("left", "right")

HIP = BuiltinPositionActuatorCfg(
  target_names_expr=(".*_hip_pitch",),
  stiffness=STIFFNESS,
  damping=DAMPING,
  effort_limit=MOTOR.effort_limit,
  armature=MOTOR.reflected_inertia,
)
KNEE = replace(HIP, target_names_expr=(f"{SIDES[0]}_knee", f"{SIDES[1]}_knee"), stiffness=1.5 * STIFFNESS)
ANKLE = DelayedActuatorCfg(
  base_cfg=BuiltinPositionActuatorCfg(target_names_expr=(".*_ankle",), stiffness=40.0, damping=2.0, armature=0.01),
  delay_min_lag=1,
  delay_max_lag=3,
)
ARTICULATION = EntityArticulationInfoCfg(actuators=(HIP, KNEE, ANKLE), soft_joint_pos_limit_factor=0.9)


def get_robot():
  return EntityCfg(articulation=ARTICULATION)


ROBOT = EntityCfg(spec_fn=get_robot, articulation=ARTICULATION)
ACTION_SCALE = {}
for each in (HIP, KNEE):
  scale = 0.25 * each.effort_limit / each.stiffness
  ACTION_SCALE[each.target_names_expr[0]] = scale

if __name__ == "__main__":
  HIP.stiffness = 1e9
'''
ISAAC = """\
import numpy as np
import isaaclab.sim as sim_utils
from isaaclab.actuators import DCMotorCfg, DelayedPDActuatorCfg, ImplicitActuatorCfg
from isaaclab.assets.articulation import ArticulationCfg
from isaaclab.utils import configclass

@configclass
class Ankles(ImplicitActuatorCfg):
    joint_names_expr = [".*_ankle"]
    stiffness = {"left_.*": 20.0, "right_.*": 2 * 15}
    damping = np.sqrt(4.0)

TWO_CFG = ArticulationCfg(
    spawn=sim_utils.UsdFileCfg(usd_path=f"{DIR}/two.usd"),
    actuators={
        "legs": DCMotorCfg(
            joint_names_expr=[".*_hip_.*", ".*_knee"],
            effort_limit=88.0,
            stiffness={".*_hip_pitch": 100.0, ".*_knee": 150.0},
            damping={".*_hip_pitch": 2.0, ".*_knee": 4.0},
            armature={".*": 0.01},
            saturation_effort=180.0,
        ),
        "feet": Ankles(effort_limit_sim=50),
    },
)
OTHER_CFG = TWO_CFG.copy()
OTHER_CFG.actuators["legs"].damping = 3.0
OTHER_CFG.actuators["feet"].stiffness["left_.*"] *= 2
"""


def stub(name: str) -> type:
    """A configuration's class, as far as Python's own evaluation of the texts above needs one."""

    class Stub:
        def __init__(self, **fields: Any) -> None:
            for key in dir(type(self)):
                if not key.startswith("_") and not callable(getattr(type(self), key)):
                    setattr(self, key, getattr(type(self), key))
            self.__dict__.update(fields)

        def copy(self) -> "Stub":
            import copy

            return copy.deepcopy(self)

        def __replace__(self, **changes: Any) -> "Stub":
            return type(self)(**{**self.__dict__, **changes})

    Stub.__name__ = name
    if name in ("EntityCfg", "ArticulationCfg"):
        Stub.InitialStateCfg = stub("InitialStateCfg")
    return Stub


def run(text: str, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The names of a text that Python itself runs, with stubs of the libraries: the truth for the reader."""

    def planetary(rotors: Any, gears: Any) -> float:
        return rotors[0] * (gears[1] * gears[2]) ** 2 + rotors[1] * gears[2] ** 2 + rotors[2]

    class Library(types.ModuleType):
        def __getattr__(self, name: str) -> Any:
            if name.startswith("__"):
                raise AttributeError(name)
            made = {"configclass": lambda cls: cls, "reflected_inertia_from_two_stage_planetary": planetary}.get(name) or stub(name)
            setattr(self, name, made)
            return made

    names = re.findall(r"^(?:from|import) ((?:mjlab|isaaclab)\.[\w.]+)", text, re.MULTILINE)
    parents = [name.rpartition(".")[0] for name in names]
    for name in {"mjlab", "isaaclab", *parents, *names}:
        library = Library(name)
        library.__path__ = []
        monkeypatch.setitem(sys.modules, name, library)
    for name in names:
        parent, _, child = name.rpartition(".")
        setattr(sys.modules[parent], child, sys.modules[name])
    monkeypatch.setattr("dataclasses.replace", lambda value, **changes: value.__replace__(**changes))
    space = {"__name__": "robot", "DIR": "x"}
    exec(text, space)
    return space


def truth(actuators: Any, joints: tuple[str, ...]) -> dict[str, list[float]]:
    """kp, kd and armature of each joint, by full matches as the libraries have it; 0 where there is none."""
    found = {key: [0.0] * len(joints) for key in ("stiffness", "damping", "armature")}
    for each in actuators.values() if isinstance(actuators, dict) else actuators:
        each = getattr(each, "base_cfg", each)
        patterns = getattr(each, "target_names_expr", None) or each.joint_names_expr
        for k, joint in enumerate(joints):
            if any(re.fullmatch(pattern, joint) for pattern in patterns):
                for key, column in found.items():
                    value = getattr(each, key, 0.0)
                    by_pattern = value.items() if isinstance(value, dict) else [(".*", value)]
                    column[k] = next((number for pattern, number in by_pattern if re.fullmatch(pattern, joint)), 0.0)
    return found


def assert_as_run(actuators: Any, text: str, name: str = "") -> None:
    expected = truth(actuators, LEGS)
    found = gains_of(read_actuator_configs(text, "robot.py", name), LEGS)
    # Both do the same operations in doubles, but for the order of factors in the helper: round-off.
    assert_allclose(found.kp, expected["stiffness"], rtol=1e-14)
    assert_allclose(found.kd, expected["damping"], rtol=1e-14)
    assert_allclose(np.nan_to_num(found.motor_inertia), expected["armature"], rtol=1e-14)


def test_mjlab_as_python_has_it(monkeypatch: pytest.MonkeyPatch):
    assert_as_run(run(MJLAB, monkeypatch)["ROBOT"].articulation.actuators, MJLAB)
    file = read_actuator_configs(MJLAB, "robot.py")
    assert file.form == "mjlab"
    assert [gain[0].effort_limit for gain in file.matched(LEGS)] == [139.0, 139.0, None] * 2
    (lag,) = file.notes
    assert "line 27: DelayedActuatorCfg: its lag of 1 to 3 physics steps delays the set-point, not the feedback" in lag


@pytest.mark.parametrize("name", ["TWO_CFG", "OTHER_CFG"])
def test_isaac_lab_as_python_has_it(monkeypatch: pytest.MonkeyPatch, name: str):
    space = run(ISAAC, monkeypatch)
    assert_as_run(space[name].actuators, ISAAC, name)
    assert read_actuator_configs(ISAAC, "robot.py", name).form == "Isaac Lab"


def test_of_several_robots_one_is_named(tmp_path: Path):
    path = tmp_path / "robot.py"
    path.write_text(ISAAC, "utf-8")
    with pytest.raises(GainroomError, match=r"the actuators of 2 robots; name one, .*robot.py:TWO_CFG \(TWO_CFG, OTHER_CFG\)"):
        read_gains(path)
    assert gains_of(read_gains(Path(f"{path}:OTHER_CFG")), LEGS).kd.tolist() == [3, 3, 2] * 2
    with pytest.raises(GainroomError, match="'TWO_CG' holds no actuators; did you mean 'TWO_CFG'"):
        read_gains(Path(f"{path}:TWO_CG"))


def small(stiffness: str = "50.0", rest: str = "", before: str = "", after: str = "") -> str:
    return f"{before}\nACTUATOR = SomeCfg(joint_names_expr=['.*'], stiffness={stiffness}, damping=1.0{rest})\n{after}\n"


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ("2 * (3 + 4) ** 2 / 7 - 1 // 1", 13.0),
        ("-(-5)", 5.0),
        ("min(3, 4) + abs(-1)", 4.0),
        ("{'.*': 7}['.*']", 7.0),
        ("[1, *[2, 3]][-1]", 3.0),
    ],
)
def test_computed_constants(expression: str, value: float):
    assert gains_of(read_actuator_configs(small(expression), "r.py"), ("a",)).kp.tolist() == [value]


HOSTILE = [
    "__import__('pathlib').Path('touched').touch()",
    "open('touched', 'w')",
    "[open('touched', 'w') for _ in range(1)]",
    "(lambda: open('touched', 'w'))()",
    "f\"{open('touched', 'w')}\"",
    'eval(\'open("touched", "w")\')',
]


@pytest.mark.parametrize("call", HOSTILE)
@pytest.mark.parametrize(
    "place", ["{0}", "class A:\n    x = {0}", "def f(x={0}): pass", "@{0}\ndef f(): pass", "assert {0}", "with {0}: pass"]
)
def test_nothing_is_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str, place: str):
    monkeypatch.chdir(tmp_path)
    assert gains_of(read_actuator_configs(small(before=place.format(call)), "r.py"), ("a",)).kp.tolist() == [50.0]
    with pytest.raises(GainroomError, match="line 2: SomeCfg: stiffness"):
        read_actuator_configs(small(call), "r.py")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "r.py: holds no actuator configurations"),
        ("x = 1 +", "r.py: line 1: is no Python"),
        ("\0", "r.py: line 1: is no Python"),
        (small("UNKNOWN"), "line 2: SomeCfg: stiffness: 'UNKNOWN' is no name of this file"),
        (small("K", before="from other import K"), "stiffness: 'K' comes with `from other`, and other files are not read, unless "
            "they lie beside this one (line 1)"),
        (small("f(2)", before="def f(x): return x * UNKNOWN"), "stiffness: 'UNKNOWN' is no name of this file"),
        (small("f(2)"), "stiffness: 'f(2)' is a call, and f is no name of this file"),
        (small("K", before="if USE:\n    K = 1\nelse:\n    K = 2"), "stiffness: 'if USE' cannot be decided"),
        (small("10 ** 400"), "stiffness: '10 ** 400' is not understood"),
        (small("1 / 0"), "stiffness: '1 / 0' is not understood"),
        (small("True"), "stiffness: true is not a number"),
        (small("'50'"), "stiffness: '50' is text and must be a number"),
        (small("-50.0"), "stiffness: -50.0 must be >= 0"),
        (small("None"), "stiffness is None: the value stands in the robot's file"),
        (small("{'.*': -1}"), "stiffness.'.*': -1 must be >= 0"),
        (small("{1: 2.0}"), "stiffness: 1 must be a joint name or pattern"),
        (small("{'x': 2.0}"), "stiffness: 'x' matches no joint"),
        (small("{'.*': 2.0, 'a.*': 3.0}"), "joint 'a' is matched by two patterns, 'a.*' the second"),
        (small(rest=", armature='x'"), "armature: 'x' is text"),
        (small(rest=", min_delay=3, max_delay=1"), "min_delay 3 must be at most max_delay 1"),
        (small(rest=", max_delay=-1"), "max_delay: -1 must be >= 0"),
        (small(after="for a in [ACTUATOR]:\n    if N: a.stiffness = 2"), "stiffness: 'if N' cannot be decided"),
        (small(after="for a in (ACTUATOR, UNKNOWN)[N:]:\n    a.stiffness = 2"), "line 4: changes stiffness of what is not understood here"),
        (small(after="ROBOT = Cfg(actuators=[ACTUATOR])\nROBOT.actuators.pop()"), "r.py: ROBOT: has no actuators"),
        (small(after="ROBOT = Cfg(actuators=[ACTUATOR])\nROBOT.actuators.pop(N)"), "line 4: ROBOT: actuators: 'N' is no name of this file"),
        (small(after="ROBOT = Cfg(actuators=[ACTUATOR])\nROBOT.tune()"), "line 4: ROBOT: actuators: 'ROBOT.tune()' is a call"),
        (small(after="exec('ACTUATOR.stiffness = 3')"), "line 3: runs text with exec, which is not followed"),
        (small(after="B = SomeCfg(joint_names_expr=['a'], stiffness=1, damping=1)"), "joint 'a' has gains in"),
        ("A = SomeCfg(joint_names_expr='(', stiffness=1, damping=1)", "'(' is not a regular expression"),
        ("A = SomeCfg(joint_names_expr=['(a|b)*x'], stiffness=1, damping=1)", "can match in too many ways"),
        ("A = SomeCfg(joint_names_expr=[], stiffness=1, damping=1)", "joint_names_expr [] must be a list of joint names"),
        ("A = SomeCfg(joint_names_expr=[3], stiffness=1, damping=1)", "joint_names_expr: 3 must be a name or pattern"),
        ("A = SomeCfg(joint_names_expr=NAMES, stiffness=1, damping=1)", "joint_names_expr: 'NAMES' is no name of this file"),
        ("A = SomeCfg(joint_names_expr=['a'], damping=1)", "line 1: SomeCfg: stiffness is missing"),
        ("A = ActuatorNetMLPCfg(joint_names_expr=['a'])", "no gains are known, as it is a network: a; name another, or write"),
        (small(after="ROBOT = Art(actuators=({'x': ACTUATOR},))"), "line 2: ROBOT: actuators: a dict stands where an actuator must; write"),
        (
            small(before="from mine import reflected_inertia", after="ACTUATOR.stiffness = reflected_inertia(1, 2)"),
            "is a call, and reflected_inertia comes with `from mine`, and other files are not read",
        ),
        ("A = XmlPositionActuatorCfg(target_names_expr=('a',))", "its gains stand in the MJCF: audit that without --gains"),
        ("def f(k):\n    return SomeCfg(joint_names_expr=['a'], stiffness=k, damping=1)", "outside functions that need arguments: line 2"),
        (
            "class A(Cfg):\n    def __post_init__(self):\n        self.damping = N\nB = A(joint_names_expr=['a'], stiffness=1, damping=1)",
            "line 4: A: damping: 'N' is no name of this file (line 3)",
        ),
        ("x = " + "-" * 100_000 + "1", "is no Python that can be read here"),
        ("x = " + "[" * 150 + "]" * 150, "holds no actuator"),
        ("x = [1]\n" + "x = [*x, *x]\n" * 60, "holds no actuator"),
        ("x = A(y=1)\n" + "x = A(a=x.copy(), b=x.copy())\n" * 60, "more than 250000 expressions"),
        ("x = 0\n" + "for i in range(2000): x += sum(range(100))\n" * 60, "more than 250000 expressions"),
        ("x = [1]\nx.append(x)\n" + "y = [x, x]\nx = [y, y]\n" * 200, "holds no actuator"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_its_line(text: str, says: str):
    """And soon: some of these would take for ever, were they read to the end."""
    with pytest.raises(GainroomError) as caught:
        gains_of(read_actuator_configs(text, "r.py"), ("a",))
    message = str(caught.value)
    assert says in message
    assert message.startswith("r.py")
    assert "\n" not in message


@pytest.mark.parametrize("call", ["double(ACTUATOR)", "x = double(robot=[ACTUATOR])"])
def test_a_function_of_the_file_that_changes_a_configuration_is_followed(call: str):
    before = "def double(robot):\n    for x in robot if isinstance(robot, list) else [robot]: x.stiffness *= 2"
    assert gains_of(read_actuator_configs(small(before=before, after=call), "r.py"), ("a",)).kp.tolist() == [100.0]


def test_a_motor_on_a_line_as_mjlab_reflects_it():
    """m = I/r², F = τ/r, by hand: 0.02/0.1² = 2 kg, 5/0.1 = 50 N."""
    text = """
from mjlab.utils.actuator import reflect_rotary_to_linear as along
MASS, SPEED, FORCE = along(0.02, velocity_limit_rotary=30.0, effort_limit_rotary=5.0, transmission_ratio=0.1)
SAME = along(0.02, 30.0, 5.0, 0.1)
A = Cfg(target_names_expr=("a",), stiffness=FORCE, damping=SAME.velocity_limit, armature=MASS, effort_limit=SAME.effort_limit)
"""
    ((gain,),) = read_actuator_configs(text, "r.py").matched(("a",))
    assert [gain.kp, gain.kd, gain.motor_inertia, gain.effort_limit] == pytest.approx([50.0, 3.0, 2.0, 50.0], rel=1e-12)  # round-off


def test_another_function_that_gets_a_configuration_is_told():
    """It may change what it gets: where nobody takes its value, and its name does not say that it only looks, that is what it is for."""
    text = small(before="from other import double, register", after="x = double(ACTUATOR)\nregister(ACTUATOR)")
    file = read_actuator_configs(text, "r.py")
    assert file.notes == (
        "r.py: line 3: double(…) gets a configuration: it is not run, and may change it",
        "r.py: line 4: register(…) gets a configuration: it is not run, and may change it",
    )
    with pytest.raises(GainroomError, match=r"r\.py: line 2: SomeCfg: 'double\(ACTUATOR\)' is not run, and may change what it gets"):
        read_actuator_configs(small(before="from other import double", after="double(ACTUATOR)"), "r.py")


def test_a_velocity_actuator_has_damping_alone():
    found = gains_of(read_actuator_configs("A = BuiltinVelocityActuatorCfg(target_names_expr=('a',), damping=3.0)", "r.py"), ("a", "b"))
    assert (found.kp.tolist(), found.kd.tolist()) == ([0, 0], [3, 0])


def test_lists_of_gains_are_arrays():
    found = gains_of(read_actuator_configs("Kp = [60, 60.5]\nKd = [1] + [2]\n", "r.py"), ("a", "b"))
    assert (found.kp.tolist(), found.kd.tolist()) == ([60, 60.5], [1, 2])
    assert "the order is taken to be the model's (a, b)" in found.notes[0]


@settings(max_examples=200, deadline=None, suppress_health_check=list(HealthCheck))
@given(random=RANDOMS, text=st.sampled_from([MJLAB, ISAAC]))
def test_mutated_files_are_read_or_refused_in_one_line(random: Any, text: str):
    damaged = mutated_bytes(random, text.encode(), (b"(", b"*", b"\n", b"lambda: ", b"None", b"1e999")).decode("utf-8", "replace")
    problems = ()
    try:
        gains_of(read_actuator_configs(damaged, "r.py", "TWO_CFG" if text is ISAAC else ""), LEGS)
    except GainroomError as error:
        problems = error.problems
    assert all(message.startswith("r.py") and "\n" not in message for message in problems)


ISAAC_LAB = """\
from isaaclab.actuators import ImplicitActuatorCfg
from isaaclab.assets import ArticulationCfg

LEGS = ImplicitActuatorCfg(joint_names_expr=[".*"], stiffness=25.0, damping=0.5)
OTHER_INIT = ArticulationCfg.InitialStateCfg(joint_pos={".*_knee": -0.1, ".*_hip_pitch": 0.3})
ONE = ArticulationCfg(
    init_state=ArticulationCfg.InitialStateCfg(joint_pos={".*_knee": -1.5, ".*_hip_pitch": 0.8}), actuators={"legs": LEGS}
)
"""
OTHER = """\
OTHER = ArticulationCfg(
    init_state=OTHER_INIT, actuators={"legs": ImplicitActuatorCfg(joint_names_expr=[".*"], stiffness=60.0, damping=1.0)}
)
BARE = ArticulationCfg(actuators={"legs": ImplicitActuatorCfg(joint_names_expr=[".*"], stiffness=70.0, damping=1.0)})
"""


@pytest.mark.parametrize(
    ("text", "robot", "knee"), [(ISAAC_LAB, "", -1.5), (ISAAC_LAB + OTHER, "ONE", -1.5), (ISAAC_LAB + OTHER, "OTHER", -0.1)]
)
def test_a_robot_s_initial_state_is_its_own(text: str, robot: str, knee: float):
    (angles,) = read_actuator_configs(text, "cfg.py", robot).postures_for(LEGS).values()
    assert angles["left_knee"] == angles["right_knee"] == knee


def test_a_robot_without_an_initial_state_does_not_take_another_s():
    assert read_actuator_configs(ISAAC_LAB + OTHER, "cfg.py", "BARE").postures_for(LEGS) == {}
