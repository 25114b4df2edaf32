"""Stability of gains in the simulator that trains a policy, against that simulator stepped (simulator_witness.py), and closed forms."""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from pytest import approx

from gainroom.files.audit_options import AuditOptions, audited
from gainroom.robot.formats.model_names import locate
from gainroom.simulation.simulated_gains import SimulatedRobot, Simulator
from simulator_witness import Witness, public_urdf, urdf_text

WITHIN = 1.01
"""Of a factor: the witness knows it to 0.4 %."""


@dataclass(frozen=True)
class Case:
    """A model, its gains by joint, and how it stands."""

    text: str
    gains: dict[str, tuple[float, float]]
    timestep: float = 2e-3
    feet: tuple[str, ...] = ()
    angles: dict[str, float] = field(default_factory=dict)
    floating: bool = False
    armature: float | None = None
    file: str = ""


def capsule(end: str, mass: float, size: float = 0.03) -> str:
    return f'<geom type="capsule" fromto="0 0 0 {end}" size="{size}" mass="{mass}" contype="0" conaffinity="0"/>'


PENDULUM = f'<mujoco><worldbody><body><joint name="j" axis="0 1 0" armature="0.05"/>{capsule("0 0 .4", 1)}</body></worldbody></mujoco>'
ARM = f"""<mujoco><worldbody><body><joint name="yaw" axis="0 0 1" armature=".2" damping=".5"/>{capsule("0 .1 .3", 3)}
  <body pos="0 0 .3"><joint name="lift" axis="0 1 0" armature=".15" damping=".4"/>{capsule(".4 0 0", 2)}
  <body pos=".4 0 0"><joint name="bend" axis="0 1 0" armature=".1" damping=".3"/>{capsule(".3 0 .1", 1.5)}
  <body pos=".3 0 .1"><joint name="turn" axis="1 0 0" armature=".02" damping=".1"/>{capsule("0 .1 0", 0.5)}
  <body pos="0 .1 0"><joint name="tilt" axis="0 0 1" armature=".01" damping=".05"/>{capsule(".1 0 0", 0.2)}
  </body></body></body></body></body></worldbody></mujoco>"""
GANTRY = f"""<mujoco><worldbody><body><joint name="rail" type="slide" axis="1 0 0" armature="2" stiffness="30" damping="4"/>
  <geom type="box" size=".2 .1 .1" mass="4"/><body pos="0 0 .1"><joint name="pole" axis="0 1 0" stiffness="3"/>{capsule("0 0 .6", 0.8)}
  </body></body></worldbody></mujoco>"""
SPACE = f"""<mujoco><worldbody><body name="hull" pos="0 0 2"><freejoint/><geom type="box" size=".2 .15 .1" mass="6"/>
  <body pos=".2 0 0"><joint name="a1" axis="0 1 .3" armature=".02"/>{capsule(".3 0 0", 1)}
    <body pos=".3 0 0"><joint name="a2" axis="0 1 0" armature=".02"/>{capsule(".2 0 .1", 0.7)}</body></body>
  <body pos="-.2 0 0"><joint name="b1" axis="0 1 0" armature=".02" damping=".2"/>{capsule("-.3 .1 0", 1)}</body>
</body></worldbody></mujoco>"""
HOPPER = f"""<mujoco><worldbody><body name="trunk" pos="0 0 .75"><freejoint/><geom type="box" size=".12 .1 .1" mass="8"/>
  <body euler="0 25 0"><joint name="hip" axis="0 1 0" armature=".03"/>{capsule("0 0 -.4", 2)}
    <body pos="0 0 -.4" euler="0 -50 0"><joint name="knee" axis="0 1 0" armature=".03" damping=".1"/>{capsule("0 0 -.4", 1)}
      <body name="foot" pos="0 0 -.4" euler="0 25 0"><joint name="ankle" axis="0 1 0" armature=".02"/>
        <geom type="box" size=".1 .05 .02" mass=".4"/></body></body></body></body></worldbody></mujoco>"""


def leg(side: str, y: float) -> str:
    return f"""<body pos="0 {y} -.1"><joint name="{side}_roll" axis="1 0 0"/>{capsule("0 0 -.05", 1, 0.05)}
  <body euler="0 -20 0"><joint name="{side}_hip" axis="0 1 0"/>{capsule("0 0 -.35", 3, 0.05)}<body pos="0 0 -.35" euler="0 40 0">
  <joint name="{side}_knee" axis="0 1 0"/>{capsule("0 0 -.35", 2, 0.04)}<body name="{side}_foot" pos="0 0 -.35" euler="0 -20 0">
  <joint name="{side}_ankle" axis="0 1 0"/><geom type="box" size=".12 .06 .02" mass=".8"/></body></body></body></body>"""


WALKER = f"""<mujoco><default><joint armature=".08" damping=".2"/></default><worldbody><body name="pelvis" pos="0 0 .9"><freejoint/>
  <geom type="box" size=".1 .15 .2" mass="15"/>{leg("left", 0.1)}{leg("right", -0.1)}</body></worldbody></mujoco>"""
BIPED_ANGLES = (("hip_pitch", -0.3), ("knee", 0.6), ("ankle_pitch", -0.3))
BIPED = {f"{side}_{name}": angle for side in ("left", "right") for name, angle in BIPED_ANGLES}


def urdf(name: str, gains: tuple[float, float], armature: float, **how) -> Case:
    import pinocchio

    path = locate("gainroom:biped.urdf") if name == "biped" else public_urdf(name)
    joints = list(pinocchio.buildModelFromUrdf(str(path)).names)[1:]
    assert joints
    return Case(urdf_text(path), dict.fromkeys(joints, gains), armature=armature, file=str(path), **how)


def case(name: str) -> Case:
    legs = {f"{side}_{joint}": gains for side in ("left", "right") for joint, gains in WALKER_GAINS.items()}
    return {
        "pendulum": lambda: Case(PENDULUM, {"j": (600.0, 5.0)}),
        "arm": lambda: Case(ARM, {"yaw": (900, 40), "lift": (900, 40), "bend": (400, 15), "turn": (60, 2), "tilt": (20, 0.5)}),
        "arm, another posture": lambda: Case(ARM, dict.fromkeys(ARM_JOINTS, (80.0, 1.0)), 4e-3, angles={"bend": 1.1, "lift": -0.7}),
        "gantry": lambda: Case(GANTRY, {"rail": (4000, 150), "pole": (50, 2)}, 5e-3),
        "in space": lambda: Case(SPACE, {"a1": (150, 4), "a2": (60, 1.5), "b1": (150, 4)}),
        "hopper": lambda: Case(HOPPER, {"hip": (200, 6), "knee": (200, 6), "ankle": (40, 1)}, feet=("foot",)),
        "walker, one foot": lambda: Case(WALKER, legs, feet=("left_foot",)),
        "walker, two feet": lambda: Case(WALKER, legs, 5e-3, feet=("left_foot", "right_foot")),
        "biped": lambda: urdf("biped", (2000, 100), 1.0, angles=BIPED, floating=True),
        "biped, standing": lambda: urdf("biped", (2000, 100), 0.5, angles=BIPED, floating=True, feet=("left_sole",)),
        "quadruped": lambda: urdf("solo12.urdf", (10, 0.2), 0.002, floating=True),
        "industrial": lambda: urdf("ur5_robot.urdf", (3000, 120), 0.3),
    }[name]()


WALKER_GAINS = {"roll": (200, 8), "hip": (250, 8), "knee": (250, 8), "ankle": (60, 2)}
ARM_JOINTS = ("yaw", "lift", "bend", "turn", "tilt")
NAMES = (
    *("pendulum", "arm", "arm, another posture", "gantry", "in space", "hopper", "walker, one foot", "walker, two feet"),
    *("biped", "biped, standing", "quadruped", "industrial"),
)


def robot_of(chosen: Case, folder: Path) -> tuple[SimulatedRobot, np.ndarray, np.ndarray]:
    """As the audit makes it of the model's file; kp, kd in the order of its joints."""
    path = Path(chosen.file) if chosen.file else folder / "robot.xml"
    if not chosen.file:
        path.write_text(chosen.text, "utf-8")
    gains = folder / "gains.yaml"
    extra = "" if chosen.armature is None else f", motor_inertia: {chosen.armature}"
    gains.write_text("".join(f'"{name}": {{kp: {kp}, kd: {kd}{extra}}}\n' for name, (kp, kd) in chosen.gains.items()), "utf-8")
    posture = tuple(f"{name}={angle}" for name, angle in chosen.angles.items())
    options = AuditOptions(1.0, base="floating" if chosen.floating else None, contacts=chosen.feet, posture=posture)
    source = audited(str(path), gains, options).system.source
    (stance,) = source.postures.values()
    contacts = list(source.contacts.values())[-1]
    body = stance.body
    kp, kd = np.array([chosen.gains[name] for name in body.joint_names], dtype=float).T
    inertia = body.armature if chosen.armature is None else np.full(body.size, chosen.armature)
    return SimulatedRobot(body, body.configuration(stance.angles), inertia, contacts), kp, kd


def agree(chosen: Case, folder: Path, **how) -> float:
    robot, kp, kd = robot_of(chosen, folder)
    found = robot.limit(Simulator(timestep=chosen.timestep, **how), kp, kd)
    witness = Witness(
        *(chosen.text, chosen.gains, chosen.timestep),
        feet=chosen.feet,
        angles=chosen.angles,
        floating=chosen.floating,
        armature=chosen.armature,
        **how,
    )
    decays, grows = witness.onset()
    if math.isinf(grows):
        assert math.isinf(found.gain)
    else:
        assert grows / WITHIN <= found.gain <= decays * WITHIN
    assert found.stable == (not witness.grows(1.0))
    return found.gain


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_explicit_gains_are_stable_up_to_where_mujoco_says(name: str, tmp_path: Path):
    assert math.isfinite(agree(case(name), tmp_path, integrator="Euler", pd="explicit"))


def lightly_damped(name: str) -> Case:
    """With kd = kp h/8: too little for the implicit integrators to be stable at any gain."""
    chosen = case(name)
    return replace(chosen, gains={joint: (kp, kp * chosen.timestep / 8) for joint, (kp, _) in chosen.gains.items()})


OTHERS = ("gantry", "in space", "walker, one foot", "biped", "quadruped", "industrial")
"""The rest of NAMES is what these are: an arm, bodies in space, feet on the ground, a URDF; explicit gains have all of them every time."""


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param(name, marks=() if name not in OTHERS else pytest.mark.population) for name in NAMES])
def test_mujocos_own_actuators_are_stable_up_to_where_it_says(name: str, tmp_path: Path):
    assert math.isfinite(agree(lightly_damped(name), tmp_path, integrator="implicitfast", pd="implicit"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["arm", pytest.param("walker, one foot", marks=pytest.mark.population)])
@pytest.mark.parametrize(
    ("integrator", "pd", "decimation"),
    [
        ("Euler", "implicit", 1),  # which takes an actuator's kv explicitly
        ("Euler", "joint-damping", 1),  # and the joints' damping implicitly
        ("implicit", "implicit", 1),
        ("implicitfast", "joint-damping", 1),
        ("implicitfast", "explicit", 5),
        ("RK4", "explicit", 2),
        ("RK4", "implicit", 1),
        ("discrete", "implicit", 1),
    ],
)
def test_every_integrator_and_kind_of_pd(name: str, integrator: str, pd: str, decimation: int, tmp_path: Path):
    if not hasattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}"):
        pytest.skip("not in this MuJoCo")
    chosen = case(name) if pd == "explicit" else lightly_damped(name)
    agree(chosen, tmp_path, integrator=integrator, pd=pd, decimation=decimation)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pendulum", "in space", "walker, two feet"])
def test_implicit_damping_that_is_strong_holds_any_gains(name: str, tmp_path: Path):
    """The witness grows at no factor up to 1000, either."""
    assert math.isinf(agree(case(name), tmp_path, integrator="implicitfast", pd="implicit"))


@pytest.mark.parametrize("name", ["in space", "hopper"])
def test_one_joint_alone(name: str, tmp_path: Path):
    """The others free: their places, which nothing holds, make no gains unstable."""
    chosen = case(name)
    first = next(iter(chosen.gains))
    robot, kp, kd = robot_of(chosen, tmp_path)
    alone = np.array([joint == first for joint in robot.body.joint_names])
    found = robot.limit(Simulator(timestep=chosen.timestep), alone * kp, alone * kd)
    decays, grows = Witness(chosen.text, {first: chosen.gains[first]}, chosen.timestep, feet=chosen.feet).onset()
    assert grows / WITHIN <= found.gain <= decays * WITHIN
    assert found.gain > robot.limit(Simulator(timestep=chosen.timestep), kp, kd).gain * 1.01


INERTIA = 0.5
WEIGHTLESS = f"""<mujoco><worldbody><body><joint name="j" axis="0 1 0" armature="0.2"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.2 {INERTIA - 0.2} 0.2"/></body></worldbody></mujoco>"""


def one_joint(folder: Path, kp: float, kd: float) -> SimulatedRobot:
    return robot_of(Case(WEIGHTLESS, {"j": (kp, kd)}), folder)[0]


@pytest.mark.slow
@pytest.mark.parametrize(("kp", "kd"), [(300.0, 2.0), (2000.0, 0.5), (10.0, 30.0)])
def test_closed_forms_of_one_joint(tmp_path: Path, kp: float, kd: float):
    """Of z² − a z + b, both roots lie inside the unit circle where |b| < 1 and |a| < 1 + b (Jury). At z = −1:

    explicit, Euler: v⁺ = v − h/J (kp q + kd v), q⁺ = q + h v⁺; implicit: v⁺ = (J v − h kp q)/(J + h kd); RK4 with a held torque:
    q⁺ = q + h v + h² τ/(2 J), where |b| < 1 may be the first to go.
    """
    robot, h = one_joint(tmp_path, kp, kd), 2e-3
    gains = np.array([kp]), np.array([kd])
    euler = robot.limit(Simulator(timestep=h), *gains)
    assert euler.gain == approx(4 * INERTIA / (h**2 * kp + 2 * h * kd), rel=1e-5)
    assert euler.frequency == approx(math.pi / h, rel=1e-6)
    implicit = [
        robot.limit(Simulator(timestep=h, integrator=integrator, pd=pd), *gains)
        for integrator, pd in (("implicitfast", "implicit"), ("implicit", "implicit"), ("Euler", "joint-damping"))
    ]
    margin = h**2 * kp - 2 * h * kd
    assert [found.gain for found in implicit] == approx([4 * INERTIA / margin if margin > 0 else math.inf] * 3, rel=1e-5)
    held = robot.limit(Simulator(timestep=h, integrator="RK4"), *gains)  # z² − (2 − c/2 − d) z + 1 + c/2 − d, c = g h² kp/J, d = g h kd/J
    assert held.gain == approx(2 * INERTIA / (h * kd) if h * kp < 2 * kd else 0.0, rel=1e-5)


@pytest.mark.parametrize(("kp", "kd", "steps"), [(300.0, 10.0, 3), (100.0, 20.0, 7)])
def test_closed_form_of_a_held_torque(tmp_path: Path, kp: float, kd: float, steps: int):
    """Over d steps of a constant acceleration α: v⁺ = v + d h α, q⁺ = q + d h v + h² α d (d + 1)/2; again Jury's conditions."""
    h, d = 2e-3, steps
    found = one_joint(tmp_path, kp, kd).limit(Simulator(timestep=h, decimation=d), np.array([kp]), np.array([kd]))

    def stable(g: float) -> bool:
        gain = g / INERTIA * np.array([kp, kd])
        step = np.array([[1, d * h], [0, 1]]) - np.outer([h**2 * d * (d + 1) / 2, d * h], gain)
        a, b = np.trace(step), np.linalg.det(step)
        return bool(abs(b) < 1 and abs(a) < 1 + b)

    assert stable(found.gain * (1 - 1e-4))
    assert not stable(found.gain * (1 + 1e-4))


def test_the_time_step_from_which_gains_hold(tmp_path: Path):
    kp, kd = 2000.0, 90.0
    robot, gains = one_joint(tmp_path, kp, kd), (np.array([kp]), np.array([kd]))
    simulator = Simulator(timestep=0.02)
    assert not robot.limit(simulator, *gains).stable
    largest = (-kd + math.sqrt(kd**2 + 4 * kp * INERTIA)) / kp  # of 4 J = h² kp + 2 h kd
    assert robot.largest_timestep(simulator, *gains) == approx(largest, rel=1e-5)


def test_damping_that_the_file_switches_off(tmp_path: Path):
    """Without eulerdamp the joints' damping is explicit, too: kd counts as it does in a program."""
    robot, h, kp, kd = one_joint(tmp_path, 300.0, 9.0), 2e-3, np.array([300.0]), np.array([9.0])
    simulator = Simulator(timestep=h, pd="joint-damping", flags=int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP))
    assert robot.limit(simulator, kp, kd).gain == approx(robot.limit(Simulator(timestep=h), kp, kd).gain, rel=1e-5)
    assert math.isinf(robot.limit(replace(simulator, flags=0), kp, kd).gain)


@pytest.mark.parametrize("timestep", [2e-3, 5e-3])
def test_feet_that_stand_by_weight_and_friction_are_nearly_held(tmp_path: Path, timestep: float):
    """The same walker with its weight on a plane, contacts as MuJoCo finds them: it stands below the limit with held feet, and explodes
    above; 15 % are for what a plane holds more than MuJoCo's default constraint on six directions of a foot."""
    chosen = replace(case("walker, two feet"), timestep=timestep)
    robot, kp, kd = robot_of(chosen, tmp_path)
    limit = robot.limit(Simulator(timestep=timestep), kp, kd).gain
    free = robot_of(replace(chosen, feet=()), tmp_path)[0].limit(Simulator(timestep=timestep), kp, kd).gain
    assert free < limit / WITHIN  # so that the feet matter
    assert fastest_joint(chosen, limit * 0.95) < 0.1
    assert not fastest_joint(chosen, limit * 1.15) < 100


def fastest_joint(walker: Case, factor: float) -> float:
    """The largest joint rate [rad/s] at the end of a second on the ground; large as soon as it explodes."""
    spec = mujoco.MjSpec.from_string(walker.text)
    spec.option.timestep = walker.timestep
    for joint in walker.gains:
        spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT).gainprm[0] = 1.0
    place = spec.compile()
    data = mujoco.MjData(place)
    mujoco.mj_forward(place, data)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1], pos=[0, 0, data.body("left_foot").xpos[2] - 0.0199])
    model = spec.compile()
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in walker.gains]
    places, rates = [joint.qposadr[0] for joint in joints], [joint.dofadr[0] for joint in joints]
    kp, kd = factor * np.array(list(walker.gains.values())).T
    rest, seen = data.qpos[places].copy(), [0.0]
    for _ in range(int(1 / walker.timestep)):
        data.ctrl[:] = kp * (rest - data.qpos[places]) - kd * data.qvel[rates]
        mujoco.mj_step(model, data)
        seen.append(float(np.abs(data.qvel[rates]).max()))
        if not seen[-1] < 200:
            return math.inf
    return max(seen[-30:])
