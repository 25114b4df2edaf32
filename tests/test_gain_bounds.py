"""Bounds of recommended gains, and joints with equal gains: the best within them, on grids worked out here, and what limits is named."""

import json
import math

import numpy as np
import pytest

import gainroom as gr
from gainroom.cli import main
from gainroom.design.robot_gains import recommend_robot
from gainroom.files.robot_yaml import parse_robot
from refusals import assert_refused
from robot_files import ROBOT, write_arm

BANDWIDTH, CURRENT_DAMPING, MS = 4000.0, 0.9, 2.0
ELBOW = {"motor_inertia": 0.448, "link_inertia": 0.35, "stiffness": 900.0, "damping": 0.0}, 3e-3, 1e-3
TESTBED = {"motor_inertia": 0.2, "link_inertia": 0.8, "stiffness": 1e4, "damping": 1.0}, 2.5e-3, None
# Without bounds the elbow's are about kp 628, kd 37.9 (link), the testbed's kp 883, kd 26.
BOXES = {
    "kp_max": {"kp_max": 200.0},
    "kp_min": {"kp_min": 1200.0},
    "kd_max": {"kd_max": 15.3},
    "kd_min": {"kd_min": 43.0},
    "both": {"kp_max": 333.3, "kd_max": 18.0},
    "of no effect": {"kp_min": 1.0, "kp_max": 1e5, "kd_min": 0.1, "kd_max": 1e4},
    "kp given": {"kp_min": 300.0, "kp_max": 300.0},
    "kd given": {"kd_min": 20.0, "kd_max": 20.0},
}


def parts_of(joint, delay, step):
    return gr.ElasticJoint(**joint), gr.Drive(BANDWIDTH, CURRENT_DAMPING, delay), step


def on_grid(joint, delay, step, kp, kd):
    """Dynamic stiffness [N m/rad] and least distance of L from −1 at gains (g,), from frequencies alone."""
    k, b = joint["stiffness"], joint["damping"]
    held, free = math.sqrt(k / joint["link_inertia"]), math.sqrt(k * (1 / joint["link_inertia"] + 1 / joint["motor_inertia"]))
    fine = np.linspace(-0.08, 0.08, 80)
    omega = np.concatenate([np.geomspace(1e-3 * held, max(30 * free, 30 / delay), 900), held * (1 + fine), free * (1 + fine)])
    omega = np.sort(omega if step is None else omega[omega < math.pi / step])
    s = 1j * omega
    late = BANDWIDTH**2 / (s * s + 2 * CURRENT_DAMPING * BANDWIDTH * s + BANDWIDTH**2) * np.exp(-s * delay)
    hold = 1.0 if step is None else (1 - np.exp(-s * step)) / (s * step)
    fed = kp[:, None] * late * hold + kd[:, None] * late * hold * (s if step is None else (1 - np.exp(-s * step)) / step)
    spring = k + s * b
    motor, link = joint["motor_inertia"] * s * s + spring, joint["link_inertia"] * s * s + spring
    compliance = np.abs((motor + fed) / ((motor + fed) * link - spring**2)) * np.abs(hold)
    return 1 / compliance.max(axis=1), np.abs(1 + fed * link / (motor * link - spring**2)).min(axis=1)


def best_on_grid(parts, box, largest_kp):
    """The largest dynamic stiffness, or kp, of gains in the box that meet the usual requirements, each judged by its own loop."""
    step = parts[2]
    low, high = ((box.get("kp_min", 5.0), box.get("kd_min", 0.5)), (box.get("kp_max", 5000.0), box.get("kd_max", 120.0)))
    kp, kd = (part.ravel() for part in np.meshgrid(*(np.geomspace(low[k], high[k], 61) for k in range(2))))
    stiffness, distance = on_grid(*parts, kp, kd)
    value = kp if largest_kp else stiffness
    elastic, drive, _ = parts_of(*parts)
    for k in np.flatnonzero(distance > 0.999 / MS)[np.argsort(-value[distance > 0.999 / MS], kind="stable")].tolist():
        loop = gr.build_loop(elastic, drive, gr.PD(kp[k], kd[k]), sample_time=step)
        if gr.Requirements.usual().met_by(gr.margins(loop)):
            return kp[k] if largest_kp else gr.dynamic_stiffness(loop).least
    return math.nan


@pytest.mark.slow
@pytest.mark.parametrize("objective", ["dynamic_stiffness", "largest_kp"])
@pytest.mark.parametrize("box", BOXES)
@pytest.mark.parametrize("parts", [ELBOW, pytest.param(TESTBED, marks=pytest.mark.slow)], ids=["elbow", "testbed"])
def test_no_gains_within_the_bounds_are_better(parts, box, objective):
    elastic, drive, step = parts_of(*parts)
    found = gr.recommend_pd(elastic, drive, sample_time=step, objective=objective, bounds=gr.GainBounds(**BOXES[box]))
    best = best_on_grid(parts, BOXES[box], objective == "largest_kp")
    if found is None:
        assert math.isnan(best)
        return
    bounds = gr.GainBounds(**BOXES[box])
    assert bounds.kp_min <= found.kp <= bounds.kp_max
    assert bounds.kd_min <= found.kd <= bounds.kd_max
    loop = gr.build_loop(elastic, drive, gr.PD(found.kp, found.kd), sample_time=step)
    assert gr.Requirements.usual().met_by(gr.margins(loop))
    own = found.kp if objective == "largest_kp" else gr.dynamic_stiffness(loop).least
    assert own >= 0.99 * best  # gains in few digits may lose 0.3 %, a peak between frequencies 0.3 %


@pytest.mark.slow
@pytest.mark.parametrize(
    ("box", "objective", "limit"),
    [
        ("kp_max", "dynamic_stiffness", "kp_max"),
        pytest.param("kp_min", "dynamic_stiffness", "kp_min", marks=pytest.mark.slow),
        ("kd_max", "dynamic_stiffness", "kd_max"),
        pytest.param("kd_min", "dynamic_stiffness", "kd_min", marks=pytest.mark.slow),
        ("of no effect", "dynamic_stiffness", "link"),
        ("kp_max", "largest_kp", "kp_max"),
        ("kd_max", "largest_kp", "kd_max"),
        ("of no effect", "largest_kp", "peak_sensitivity"),
    ],
)
def test_the_bound_that_limits_is_named_with_what_it_costs(box, objective, limit):
    elastic, drive, step = parts_of(*ELBOW)
    found = gr.recommend_pd(elastic, drive, sample_time=step, objective=objective, bounds=gr.GainBounds(**BOXES[box]))
    free = gr.recommend_pd(elastic, drive, sample_time=step, objective=objective)
    assert found.binding == limit
    if limit in BOXES[box]:
        if limit[:2] == "kp" or objective == "dynamic_stiffness":  # kd is where the peak sensitivity is lowest, between its bounds
            assert getattr(found, limit[:2]) == BOXES[box][limit]
        assert found.costs[limit] == pytest.approx(free.value, rel=0.01)  # digits and the costs' own accuracy
        assert f"bound {limit}" in found.held_back_by()


@pytest.mark.slow
@pytest.mark.parametrize("most", [123.4567, 1e7])
@pytest.mark.parametrize("objective", ["dynamic_stiffness", "largest_kp"])
def test_where_nothing_else_limits_kp_its_bound_does(objective, most):
    """A rigid joint without delay takes any gains; as stiff as kp at rest, its link is so at all frequencies where kd damps it."""
    parts = gr.ElasticJoint(1.0, 1.0, math.inf), gr.Drive(math.inf, 0.9, 0.0)
    assert gr.recommend_pd(*parts, objective=objective) is None
    found = gr.recommend_pd(*parts, objective=objective, bounds=gr.GainBounds(kp_max=most))
    assert found.kp == most
    assert found.binding == "kp_max"


@pytest.mark.slow
def test_bounds_hold_over_an_uncertainty_too():
    elastic, drive, step = parts_of(*ELBOW)
    uncertain = gr.Uncertainty(delay=(3e-3, 3.5e-3), stiffness=(800.0, 1000.0))
    free, found = (
        gr.recommend_pd(elastic, drive, uncertainty=uncertain, sample_time=step, bounds=bounds)
        for bounds in (None, gr.GainBounds(kp_max=300.0, kd_max=20.0))
    )
    assert free.kp > 300.0 or free.kd > 20.0
    assert found.kp <= 300.0
    assert found.kd <= 20.0
    assert found.proved
    assert found.binding in ("kp_max", "kd_max")


@pytest.mark.parametrize(
    ("bounds", "words"),
    [
        ({"kp_min": 800.0, "kp_max": 50.0}, ["kp_min 800 must be <= kp_max 50"]),
        ({"kd_min": -1.0}, ["kd_min -1 must be finite and >= 0"]),
        ({"kp_min": math.inf}, ["kp_min inf must be finite"]),
        ({"kp_max": math.nan}, ["kp_max nan must be > 0"]),
        ({"kd_max": "x"}, ["kd_max 'x' must be a number"]),
    ],
)
def test_wrong_bounds_are_refused_in_python(bounds, words):
    assert_refused(lambda: gr.GainBounds(**bounds), words)


JOINT = """\
joint: {motor_inertia: 0.448, link_inertia: 0.35, stiffness: 900, damping: 0}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 3.0}
control: {type: pd, feedback: motor, sample_rate_hz: 1000, kp: 300, kd: 20}
gain_bounds: BOUNDS
"""
WRONG = [
    ("{kp_mx: 5}", "gain_bounds.kp_mx: unknown key; did you mean kp_max?"),
    ("{kp_min: 6, kp_max: 5}", "gain_bounds.kp_min: 6 must be <= kp_max 5"),
    ("{kp_max: .inf}", "gain_bounds.kp_max: inf must be <= 1e+12"),
    ("{kp_max: .nan}", "gain_bounds.kp_max: nan is not a number"),
    ("{kd_min: -1}", "gain_bounds.kd_min: -1 must be >= 0"),
    ("{kp_max: 0}", "gain_bounds.kp_max: 0 must be > 0"),
    ("5", "gain_bounds: 5 must be a section with keys among kp_min, kp_max, kd_min, kd_max"),
]


@pytest.mark.parametrize(("bounds", "says"), WRONG)
def test_wrong_bounds_of_a_joint_are_one_line(tmp_path, capsys, bounds, says):
    path = tmp_path / "joint.yaml"
    path.write_text(JOINT.replace("BOUNDS", bounds), "utf-8")
    assert refused(capsys, "joint", path).startswith(f"gainroom: error: {path}: {says}")


def test_a_controller_without_kp_and_kd_has_no_bounds(tmp_path, capsys):
    path = tmp_path / "joint.yaml"
    path.write_text(JOINT.replace("BOUNDS", "{kp_max: 5}").replace("type: pd", "type: ppi").replace("kd: 20", "kv: 20, ki: 0"), "utf-8")
    assert "gain_bounds: are of kp [N·m/rad] and kd [N·m·s/rad], which type ppi has not" in refused(capsys, "joint", path)


def refused(capsys, *arguments):
    """The one line on standard error of a call that ends with status 2."""
    assert main([str(argument) for argument in arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err.strip()


def answer(capsys, *arguments):
    main([*map(str, arguments), "--json"])
    return json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_a_joint_file_and_its_answer(tmp_path, capsys):
    path = tmp_path / "joint.yaml"
    path.write_text(JOINT.replace("BOUNDS", "{kp_max: 200}"), "utf-8")
    found = answer(capsys, "joint", path)["recommended"]
    assert found["kp"] == 200.0
    assert found["binding"] == "kp_max"
    assert found["costs"]["kp_max"] > 2 * found["dynamic_stiffness"]
    main(["joint", str(path), "--verbose"])
    assert "limited by the bound kp_max" in capsys.readouterr().out


@pytest.mark.parametrize("gains", ["kp: 300, kd: 20", ""])
def test_where_bounds_leave_no_gains_they_are_the_reason(tmp_path, capsys, gains):
    """kp_min above the largest kp that meets the requirements, 2630; kd_max is harmless."""
    path = tmp_path / "joint.yaml"
    path.write_text(
        JOINT.replace("BOUNDS", "{kp_min: 4000, kd_max: 1000}").replace(", kp: 300, kd: 20", f", {gains}".rstrip(", ")), "utf-8"
    )
    found = answer(capsys, "joint", path)
    assert found["recommended"] is None
    text = " ".join([found["sentence"], *found.get("warnings", ())])
    assert "as kp_min 4000 N·m/rad of gain_bounds prevents it" in text.replace("\u202f", "")
    if not gains:
        assert found["findings"] == [{"code": "no_gains", "bounds": ["kp_min"]}]


# A robot.


@pytest.fixture
def arm(tmp_path):
    def read(more):
        return parse_robot(ROBOT[: ROBOT.index("tasks:")] + more, "arm", write_arm(tmp_path).parent)

    return read


def softness(system, kp, kd):
    """Mean ln of the links' compliance with these gains; inf where a requirement is missed. Both from a loop that is built anew."""
    loop = system.loop(system.source.linearize(*system.source.states[0]), gr.PD(kp, kd))
    if not system.requirements.met_by(gr.margins(loop)):
        return math.inf
    return -float(np.log(gr.dynamic_stiffness(loop).stiffness).mean())


ARM_BOUNDS = [
    "gain_bounds: {elbow: {kd_max: 12.5}, shoulder: {kd_min: 80}}",
    "groups: [['.*']]\ngain_bounds: {shoulder: {kp_max: 333.3}}",
    *(
        pytest.param(more, marks=pytest.mark.slow)
        for more in (
            "gain_bounds: {shoulder: {kp_max: 400}}",
            "gain_bounds: {default: {kp_max: 700, kd_max: 30}, elbow: {kp_max: 250}}",
            "gain_bounds: {elbow: {kp_min: 150, kp_max: 150, kd_max: 9}}",
            "groups: [[shoulder, elbow]]",
        )
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize("more", ARM_BOUNDS)
def test_no_gains_of_a_robot_near_those_found_are_better_within_the_bounds(arm, more):
    """Random gains from a third to three times the found ones, brought into the bounds, so that many are on them."""
    system = arm(more)
    found = recommend_robot(system).everywhere
    low, high = (np.array([np.broadcast_to(getattr(system.bounds, f"{gain}_{end}"), 2) for gain in ("kp", "kd")]) for end in ("min", "max"))
    together = [[0, 1]] if system.groups else [[0], [1]]
    for group in together:
        low[:, group], high[:, group] = low[:, group].max(axis=1, keepdims=True), high[:, group].min(axis=1, keepdims=True)
        assert len(set(found.kp[group])) == len(set(found.kd[group])) == 1
    own = np.array([found.kp, found.kd])
    assert np.all((low <= own) & (own <= high))
    best, rng = softness(system, *own), np.random.default_rng(1)
    assert best < math.inf
    for _ in range(150):
        factors = np.exp(rng.uniform(-1, 1, (2, 2)) * rng.choice([0.1, 0.3, 1.1]))
        for group in together:
            factors[:, group] = factors[:, group[:1]]
        tried = np.clip(own * factors, low, high)
        assert softness(system, *tried) >= best - 0.01  # the search ends within 1 % of its cost


def test_a_joint_that_its_bound_limits_is_on_it_and_says_so(arm):
    free = recommend_robot(arm("")).everywhere
    found = recommend_robot(arm("gain_bounds: {shoulder: {kp_max: 123.4567}, elbow: {kd_max: 6.54321, kp_max: 1.0e+5}}")).everywhere
    assert free.kp[0] > 124
    assert free.kd[1] > 6.6
    assert found.kp[0] == pytest.approx(123.4567, rel=5e-4)  # gains have four digits
    assert found.kd[1] == pytest.approx(6.54321, rel=5e-4)
    assert found.margin == ("kp_max", "kd_max")
    assert found.case == ("", "")


@pytest.mark.parametrize("objective", ["dynamic_stiffness", "largest_kp"])
def test_bounds_that_limit_nothing_change_nothing(arm, objective):
    free, found = (
        recommend_robot(arm(f"objective: {objective}\n{more}")).everywhere
        for more in ("", "gain_bounds: {default: {kp_max: 1.0e+6, kd_min: 1.0e-3}}")
    )
    np.testing.assert_array_equal(found.kp, free.kp)
    np.testing.assert_array_equal(found.kd, free.kd)
    assert found.margin == free.margin


def test_the_largest_kp_goes_no_higher_than_the_bound(arm):
    free, found = (
        recommend_robot(arm(f"objective: largest_kp\n{more}")).everywhere for more in ("", "gain_bounds: {elbow: {kp_max: 345.6}}")
    )
    assert free.kp[1] > 346
    assert found.kp[1] == 345.6
    assert found.margin[1] == "kp_max"
    assert found.kp[0] > 345.6
    assert found.margin[0] != "kp_max"


@pytest.mark.slow
def test_the_answer_of_a_robot_names_the_bound(arm, tmp_path, capsys):
    text = ROBOT + "gain_bounds: {shoulder: {kp_max: 100}, elbow: {kp_max: 50}}\n"
    path = write_arm(tmp_path, text)
    found = answer(capsys, "robot", path)
    one = found["recommended"]["joint"]["sets"][0] if isinstance(found["recommended"], dict) else found["recommended"][0]["sets"][0]
    assert one["kp"] == [100.0, 50.0]
    assert [each["margin"] for each in one["held_back_by"]] == ["kp_max", "kp_max"]
    assert one["binding_margin"] == "kp_max"
    assert one["binding_joint"] in ("shoulder", "elbow")
    main(["robot", str(path), "--verbose"])
    out = capsys.readouterr().out
    assert "bound kp_max" in out
    assert "gain_bounds: of the joints alone, and gains recommended for tasks do not keep them" in " ".join(out.split())


def test_where_bounds_leave_a_robot_no_gains_they_are_named(arm):
    found = recommend_robot(arm("gain_bounds: {elbow: {kp_min: 20000}}"))
    assert found.everywhere is None
    assert ", on the bounds kp_min of elbow" in found.nearest[""]


ROBOT_WRONG = [
    ("gain_bounds: {elbo: {kp_max: 5}}", ["gain_bounds.'elbo' matches no joint", "did you mean 'elbow'?"]),
    ("gain_bounds: {kp_max: 5}", ["gain_bounds.kp_max: 5 must be a section", "a joint's name or pattern"]),
    ("gain_bounds: {elbow: {kq: 3}}", ["gain_bounds.elbow.kq: unknown key", "kp_max"]),
    ("gain_bounds: {elbow: {kp_max: -3}}", ["gain_bounds.elbow.kp_max: -3 must be > 0"]),
    ("gain_bounds: {elbow: {kp_min: 3, kp_max: 2}}", ["gain_bounds.elbow.kp_min: 3 must be <= kp_max 2"]),
    ("gain_bounds: {elbow: {kp_min: 9}, default: {kp_max: 5}}", ["gain_bounds: kp_min 9 of joint 'elbow' must be <= kp_max 5"]),
    (
        "gain_bounds: {elbow: {kp_min: 9}, shoulder: {kp_max: 5}}\ngroups: [[elbow, shoulder]]",
        ["gain_bounds: kp_min 9 of joint 'elbow' must be <= kp_max 5 of 'shoulder'", "equal gains"],
    ),
    ("groups: [[elbow], ['.*']]", ["groups[1]: joint 'elbow' is in groups[0], too"]),
    ("groups: [[elbo]]", ["groups[0]: 'elbo' matches no joint", "did you mean 'elbow'?"]),
    ("groups: [elbow]", ["groups[0]: 'elbow' must be a list: ['elbow']"]),
    ("groups: [[]]", ["groups[0]: [] must be one entry or more"]),
]


@pytest.mark.parametrize(("more", "says"), ROBOT_WRONG)
def test_wrong_bounds_and_groups_of_a_robot_are_one_line(tmp_path, capsys, more, says):
    line = refused(capsys, "robot", write_arm(tmp_path, ROBOT + more + "\n"))
    assert all(words in line for words in says), line


@pytest.mark.parametrize("more", ["gain_bounds: {elbow: {kp_max: 5}}", "groups: []"])
def test_in_task_space_they_are_refused(tmp_path, capsys, more):
    text = ROBOT.replace("feedback: motor", "space: task, feedback: motor").replace(", kp: 400.0, kd: 30.0", "")
    assert f"{more.partition(':')[0]} is for space joint" in refused(capsys, "robot", write_arm(tmp_path, text + more + "\n"))


# Joints that are images of each other.


@pytest.fixture(scope="module")
def biped():
    def read(more):
        return parse_robot(BIPED + more, "biped")

    return read


BIPED = """\
model: {package: gainroom, file: biped.urdf, base: floating, gravity_stiffness: false}
joints: {default: {motor_inertia: 1.0, stiffness: 1.0e4, damping: 1.0}}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 2.0}
postures: {stand: {".*_hip_pitch": -0.3, ".*_knee": 0.6, ".*_ankle_pitch": -0.3}}
contacts: {double: [left_sole, right_sole], left: [left_sole], right: [right_sole]}
control: {type: pd, feedback: motor, sample_rate_hz: 2000, kp: 2000.0, kd: 100.0}
"""
KNEES, ANKLES = [3, 9], [4, 5, 10, 11]


def assert_meet_what_is_required(system, found, contact=""):
    for posture, place in system.source.states:
        if contact in ("", place):
            loop = system.loop(system.source.linearize(posture, place), gr.PD(found.kp, found.kd))
            assert system.requirements.met_by(gr.margins(loop))


@pytest.mark.slow
def test_a_bound_of_one_joint_is_its_images_too(biped):
    system = biped("gain_bounds: {left_knee: {kp_max: 777.7}}\n")
    gains = recommend_robot(system)
    for name, found in (("", gains.everywhere), *gains.per_contact.items()):
        assert found.kp[KNEES].tolist() == [777.7, 777.7]
        assert found.margin[3] == "kp_max"
        np.testing.assert_array_equal(found.kp[:6], found.kp[6:])
        np.testing.assert_array_equal(found.kd[:6], found.kd[6:])
        assert_meet_what_is_required(system, found, name)


@pytest.mark.slow
def test_groups_of_the_file_are_the_only_equal_joints(biped):
    system = biped("groups: [[left_knee, right_knee], ['.*ankle.*']]\n")
    assert system.groups == (tuple(KNEES), tuple(ANKLES))
    found = recommend_robot(system, by_contact=False).everywhere
    for group in (KNEES, ANKLES):
        assert len(set(found.kp[group])) == len(set(found.kd[group])) == 1
    assert_meet_what_is_required(system, found)


@pytest.mark.slow
def test_without_groups_each_joint_is_by_itself(biped):
    """With a bound on the left knee alone the right one is stiffer; states that mirror each other are then searched each for itself."""
    system = biped("groups: []\ngain_bounds: {left_knee: {kp_max: 777.7}}\n")
    gains = recommend_robot(system)
    for name, found in (("", gains.everywhere), *gains.per_contact.items()):
        assert found.kp[3] <= 777.7
        assert found.kp[9] > 800
        assert_meet_what_is_required(system, found, name)
