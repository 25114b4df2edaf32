"""Gains of a robot that make its links dynamically stiffest: against another program, from several starts, and by their definition."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.dynamic_stiffness import stiffness_of
from gainroom.design.gain_cases import joint_case
from gainroom.design.gain_search import raised_gains
from gainroom.design.margin_slopes import GainCase
from gainroom.design.objectives import goal_of
from gainroom.design.robot_gains import recommend_robot
from gainroom.files.robot_yaml import parse_robot

IMAGES = [[j, j + 6] for j in range(6)]


@pytest.fixture(scope="module")
def biped():
    """The example's biped without its weight and tasks, in double support, on its left leg and in the air."""
    text = files("gainroom").joinpath("files", "examples", "biped.yaml").read_text("utf-8")
    text = text.replace("base: floating}", "base: floating, gravity_stiffness: false}").replace("  right: [right_sole]\n", "")
    return parse_robot(text[: text.index("tasks:")] + text[text.index("balance:") :], "biped")


@pytest.fixture(scope="module")
def found(biped):
    return recommend_robot(biped)


def stiffness_in(system, found, contact=""):
    """Least dynamic stiffness of each joint, of both legs, over the states, from roots of loops that are built anew."""
    every = []
    for posture, place in system.source.states:
        if contact in ("", place):
            loop = system.loop(system.source.linearize(posture, place), gr.PD(found.kp, found.kd))
            margins = gr.margins(loop)
            assert system.requirements.met_by(margins), (posture, place)
            every.append(stiffness_of(loop, margins.stable).stiffness)
    least = np.min(every, axis=0)
    return np.minimum(least[:6], least[6:])


# By another program, which has its own model of loop, peaks and gradients, and a linear programme at each step; [N m/rad] of hip yaw, roll,
# pitch, knee, ankle pitch, roll. One set for all states, and one for each contact state alone.
DESIGNS = {
    "": [1328.0, 2464.0, 2726.0, 3160.0, 600.0, 718.0],
    "double": [8946.0, 10251.0, 8165.0, 6013.0, 1886.0, 3660.0],
    "flight": [2183.0, 3077.0, 3130.0, 4253.0, 639.0, 834.0],
}


@pytest.mark.slow
@pytest.mark.parametrize("contact", DESIGNS)
def test_as_stiff_as_another_program_makes_it(biped, found, contact):
    """Each joint within the 1 % that is left where one is traded for another, and on the whole no softer."""
    one = found.everywhere if not contact else found.per_contact[contact]
    own = stiffness_in(biped, one, contact)
    assert np.log(own / DESIGNS[contact]).mean() > -1e-3
    assert own == pytest.approx(DESIGNS[contact], rel={"": 0.01, "double": 0.03, "flight": 0.07}[contact])
    assert own == pytest.approx(np.minimum(one.stiffness[:6], one.stiffness[6:]), rel=1e-3)
    np.testing.assert_array_equal(one.kp[:6], one.kp[6:])


@pytest.mark.slow
def test_all_starts_end_alike(biped):
    """Stiff, soft and in between: the costs, mean logarithms of compliance, agree to 1e-3."""
    tight = replace(biped, requirements=biped.requirements.tightened(1e-3))
    states = biped.source.states
    cases = [joint_case("/".join(each), tight, biped.source.linearize(*each), each[1]) for each in states]
    goal = goal_of("dynamic_stiffness", cases, np.ones(12), np.ones(12), IMAGES)
    costs = []
    for kp, kd in ((1000.0, 150.0), (300.0, 60.0), (4000.0, 180.0)):
        start = np.array([np.full(12, kp), np.full(12, kd), np.zeros(12)])
        reached = raised_gains(cases, start, np.ones(12), IMAGES, 1e9, objective="dynamic_stiffness")
        assert reached.holds
        assert goal.complete(reached.gains) or goal.complete(reached.gains)
        costs.append(goal.at(reached.gains)[0].value)
    assert np.ptp(costs) < 1e-3


@pytest.mark.slow
def test_no_small_change_of_gains_is_better(biped, found):
    """The definition: of gains a little aside none that keep what is required make links stiffer on the whole."""
    rng = np.random.default_rng(4)
    best = found.everywhere

    def cost(kp, kd):
        worst = {}
        for posture, contact in biped.source.states:
            loop = biped.loop(biped.source.linearize(posture, contact), gr.PD(kp, kd))
            margins = gr.margins(loop)
            if not biped.requirements.met_by(margins):
                return np.inf
            own = -np.log(stiffness_of(loop, True).stiffness)
            worst[contact] = np.maximum(worst.get(contact, -np.inf), own)
        return float(np.mean(list(worst.values())))

    here, tried = cost(best.kp, best.kd), []
    while len(tried) < 6:
        way = rng.normal(size=(2, 6)) * 10 ** rng.uniform(-2.5, -1)
        other = cost(*(gains * np.exp(np.tile(one, 2)) for gains, one in zip((best.kp, best.kd), way, strict=True)))
        if np.isfinite(other):
            tried.append(other)
    assert here < min(tried) + 1e-3


GO2 = """\
model: {package: example-robot-data, file: go2_description/urdf/go2.urdf, base: floating}
joints: {default: {motor_inertia: 0.01, stiffness: .inf}, ".*_calf_joint": {motor_inertia: 0.02}}
drive: {bandwidth: .inf, delay_ms: 3.0}
postures: {stand: {".*_thigh_joint": 0.8, ".*_calf_joint": -1.6}}
contacts: {four: [FEET], flight: []}
control: {type: pd, feedback: motor, sample_rate_hz: 500, kp: 20, kd: 1}
balance: controller
""".replace("FEET", ", ".join(f"{{frame: {leg}_foot, type: point}}" for leg in ("FL", "FR", "RL", "RR")))


@pytest.mark.slow
def test_a_quadruped_is_as_stiff_as_from_gains_typed_at_random():
    """Its costs have several minima; from gains of each joint alone the search ended where links are half as stiff."""
    system = parse_robot(GO2, "go2")
    tight = replace(system, requirements=system.requirements.tightened(1e-3))
    cases = [joint_case("/".join(each), tight, system.source.linearize(*each), each[1]) for each in system.source.states]
    legs = [[j, j + 3, j + 6, j + 9] for j in range(3)]
    goal = goal_of("dynamic_stiffness", cases, np.ones(12), np.ones(12), legs)
    best = recommend_robot(system, by_contact=False).everywhere
    assert best is not None
    own = np.array([best.kp, best.kd, np.zeros(12)])
    rng, costs = np.random.default_rng(2), []
    for _ in range(4):
        kp, kd = np.tile(rng.uniform(1, 10, 3), 4), np.tile(rng.uniform(0.2, 1, 3), 4)
        start = np.array([kp, kd, np.zeros(12)])
        if all(case.known(start) for case in cases):
            reached = raised_gains(cases, start, np.ones(12), legs, 1e9, objective="dynamic_stiffness")
            if reached.holds:
                assert goal.complete(reached.gains) or goal.complete(reached.gains)
                costs.append(goal.at(reached.gains)[0].value)
    assert goal.at(own)[0].value < min(costs) + 0.01


def test_a_joint_damps_by_its_own_gains():
    """A light pelvis between legs and trunk: the product alone leaves one joint to the damping of the other, which it needs then."""
    legs, pelvis, trunk, delay, tick = 1.0, 0.02, 2.0, 3e-3, 2e-3
    mobility = np.array([[1 / legs + 1 / pelvis, -1 / pelvis], [-1 / pelvis, 1 / trunk + 1 / pelvis]])
    drive, weight, start = gr.Drive(np.inf, delay=delay), np.array([4.0, 1.0]), np.array([np.ones(2), np.full(2, 0.3), np.zeros(2)])
    plant, late = gr.Plant(mobility, np.full(2, 0.007), np.full(2, np.inf), np.zeros(2)), delay + tick / 2

    def loop(gains):
        return gr.build_loop(plant, drive, gr.PD(gains[0], gains[1]), sample_time=tick)

    def found(lag):
        case = GainCase("", loop, np.eye(2), np.eye(2), np.zeros(2, dtype=bool), gr.Requirements.usual(), lag=lag)
        reached = raised_gains([case], start, np.ones(2), [[0], [1]], 1e9, objective="dynamic_stiffness", weight=weight)
        assert reached.holds
        return reached.gains, float(weight @ np.log(stiffness_of(loop(reached.gains), True).stiffness)) / weight.sum()

    def held(kp, kd):
        """The first joint's loop with the other locked, on a load so heavy that it is slow."""
        heavy = gr.ElasticJoint(0.007, 100.0, np.inf, 0.0)
        return gr.margins(gr.build_loop(heavy, drive, gr.PD(kp, kd), sample_time=tick)).stable

    (gains, stiffness), (alone, without) = found(np.full(2, late)), found(None)
    assert not held(*alone[:2, 0])
    assert held(gains[0, 0], 1.01 * gains[1, 0])  # that kd is on the border, to four digits
    assert np.all(gains[1] >= (1 - 1e-3) * late * gains[0])
    assert stiffness > without - 0.01  # and costs less than 1 % of dynamic stiffness


def test_a_weight_makes_a_joint_stiffer():
    """Two joints that take from each other: a weight is an exponent of its stiffness."""
    plant = gr.Plant(np.array([[2.0, 0.9], [0.9, 1.0]]), np.full(2, 0.05), np.full(2, 1e3), np.full(2, 1.0))
    drive = gr.Drive(4000.0, 0.9, 3e-3)

    def loop(gains):
        return gr.build_loop(plant, drive, gr.PD(gains[0], gains[1]))

    case = GainCase("", loop, np.eye(2), np.eye(2), np.zeros(2, dtype=bool), gr.Requirements.usual())
    start = np.array([np.full(2, 1.0), np.full(2, 1.0), np.zeros(2)])

    def stiffness(weight):
        found = raised_gains([case], start, np.ones(2), [[0], [1]], 1e9, objective="dynamic_stiffness", weight=np.array(weight))
        return stiffness_of(loop(found.gains), True).stiffness

    light, heavy = stiffness((0.1, 1.0)), stiffness((10.0, 1.0))
    assert heavy[0] > light[0]
    assert heavy[1] < light[1]
