"""Motion of motor and link after steps of reference and load: against transforms, a simulation by exponentials, and the method's order."""

import itertools
import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import scipy.linalg

import gainroom as gr
from gainroom.app.bench import Opened
from gainroom.app.joint_bench import JointBench
from gainroom.app.messages import View
from gainroom.report.joint_tables import JointPresentation
from gainroom.report.number_format import digits
from gainroom.report.over_time import motion_text
from gainroom.simulation.step_response import _delayed, _responding, step_response
from gainroom.system.loop_part import LoopPart
from refusals import assert_refused

INERTIA = np.array([[3.0, 1.1, 0.4], [1.1, 2.0, 0.6], [0.4, 0.6, 1.2]])
DELAYS = [(2e-3, 3.3e-3, 5e-3), (2e-3, 0.0, 2.71e-3), (1e-3, 1e-3, 1e-3)]


def coupled(delays: tuple[float, ...], inertia: np.ndarray = INERTIA) -> gr.Loop:
    """Three elastic joints, link inertias coupled."""
    size = len(inertia)
    plant = gr.Plant(
        link_inverse_inertia=np.linalg.inv(inertia),
        motor_inertia=np.full(size, 0.3),
        stiffness=np.array([4e3, 3e3, 2e3])[:size],
        damping=np.full(size, 2.0),
    )
    return gr.build_loop(plant, [gr.Drive(3000.0, 0.8, delay) for delay in delays], gr.PD(np.array([600.0, 400, 200])[:size], 30.0))


def laplace_inverse(value_at, time: float) -> float:
    """f(t) of F(s) by the damped Fourier series (Dubner and Abate 1968); its error is e^{−16} and the series' tail."""
    span, shift = 4.0, 16 / 8.0
    s = shift + 1j * np.pi / span * np.arange(1 << 17)
    terms = (value_at(s) * np.exp(1j * s.imag * time)).real
    return float(np.exp(shift * time) / span * (terms.sum() - terms[0] / 2))


PLACES = [(delays, joint) for delays in DELAYS for joint in (0, 2)]
"""All with -m population; every time each set of delays, and both joints."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("delays", "joint"), [pair if k in (0, 3, 4) else pytest.param(*pair, marks=pytest.mark.population) for k, pair in enumerate(PLACES)]
)
def test_it_is_the_inverse_transform_of_the_closed_loop(delays: tuple[float, ...], joint: int):
    """Motors and links from their equations of motion and the formulas of one drive and one PD, not from states."""
    loop = coupled(delays)
    found = step_response(loop, 0.25, LoopPart.of_joint(loop, joint))
    assert found.change < 1e-3
    gains = (600.0, 400.0, 200.0)

    def closed(s: np.ndarray, input_: str, side: str) -> np.ndarray:
        """Position of the joint's `side` by its "reference" or by a "load" on its link; s (k,)."""
        own = np.zeros((len(s), 3, 3), complex)
        for k, stiffness in enumerate((4e3, 3e3, 2e3)):
            own[:, k, k] = stiffness + 2.0 * s
        links = s[:, None, None] ** 2 * INERTIA + own
        motors = np.zeros_like(own)
        motors[:, range(3), range(3)] = 0.3 * s[:, None] ** 2
        drive = 3000.0**2 / (s**2 + 2 * 0.8 * 3000.0 * s + 3000.0**2)
        driven = drive[:, None] * np.exp(-s[:, None] * np.array(delays))  # (k, 3)
        held = np.zeros_like(own)
        for k, kp in enumerate(gains):
            held[:, k, k] = driven[:, k] * (kp + 30.0 * s)
        both = np.block([[motors + own + held, -own], [-own, links]])
        torque = np.zeros((len(s), 6, 1), complex)
        torque[:, joint if input_ == "reference" else 3 + joint, 0] = gains[joint] * driven[:, joint] if input_ == "reference" else 1.0
        return np.linalg.solve(both, torque)[:, joint if side == "motor" else 3 + joint, 0]

    for time, side in itertools.product((0.03, 0.08, 0.2), ("motor", "link")):
        k = int(np.argmin(np.abs(found.time - time)))
        moment = float(found.time[k])
        loaded, stepped = (laplace_inverse(lambda s, by=by: closed(s, by, side) / s, moment) for by in ("load", "reference"))  # noqa: B023
        assert getattr(found.load, side)[k] == pytest.approx(loaded, abs=2e-6)  # of 2e-3
        assert getattr(found.reference, side)[k] == pytest.approx(stepped, abs=1e-3)  # the series' tail, and the halved step's own error


def test_apart_each_joint_moves_as_by_itself():
    """Without coupling the others' delays are none of its own."""
    both, alone = coupled((2e-3, 3.3e-3), np.diag([3.0, 2.0])), coupled((2e-3,), np.diag([3.0]))
    found = step_response(both, 0.2, LoopPart.of_joint(both, 0))
    truth = step_response(alone, 0.2)
    alike = np.interp(found.time, truth.time, truth.reference.link)
    assert np.allclose(found.reference.link, alike, atol=2e-3)  # both steps are halved to 3e-4


@pytest.mark.parametrize("delays", DELAYS)
def test_the_error_falls_with_the_square_of_the_step(delays: tuple[float, ...]):
    """Delays that are no whole number of steps, too."""
    loop = coupled(delays)
    part = LoopPart.of_joint(loop, 0)
    system, least = _responding(loop, part), min(delay for delay in delays if delay)
    entry, late_by = np.append(part.left, 0.0), np.append(delays, 0.0)  # the last: the load

    def last(late: int) -> float:
        return float(_delayed(system, entry, late_by, least / late, 60 * late)[-1, 0])

    exact = last(512)
    errors = [abs(last(late) - exact) for late in (8, 16, 32, 64)]
    assert errors[-1] < 1e-5
    assert errors[0] / errors[-1] > 4**3 / 2  # three halvings; where straight lines meet their corners differs


@pytest.mark.slow
@pytest.mark.parametrize(("feedback", "delay"), [("motor", 0.0), ("motor", 2e-3), ("link", 2e-3)])
def test_of_one_joint_it_is_the_inverse_transform(feedback: Literal["motor", "link"], delay: float):
    """Eq. (1) solved for motor and link; the reference acts through kp alone."""
    kp, kd, damping = (1e4, 300.0, 1.0) if feedback == "motor" else (800.0, 100.0, 100.0)  # a link's encoder needs a damped gearbox
    joint = gr.ElasticJoint(motor_inertia=1.0, link_inertia=16.0, stiffness=1e4, damping=damping)
    found = step_response(gr.build_loop(joint, gr.Drive(4000.0, 0.9, delay), gr.PD(kp, kd), feedback), 0.3)
    assert found.change < 1e-3

    def closed(s: np.ndarray, by: str) -> np.ndarray:
        """Positions (k, 2) by "reference" or "load"."""
        gear, driven = damping * s + 1e4, np.exp(-s * delay) / ((s / 4000.0) ** 2 + 2 * 0.9 * s / 4000.0 + 1)
        matrix = np.moveaxis(np.array([[1.0 * s**2 + gear, -gear], [-gear, 16.0 * s**2 + gear]]), 2, 0)
        matrix[:, 0, 0 if feedback == "motor" else 1] += driven * (kp + kd * s)
        torque = np.stack([kp * driven, 0 * s] if by == "reference" else [0 * s, 1 + 0 * s], axis=1)
        return np.linalg.solve(matrix, torque[:, :, None])[:, :, 0]

    for time, (k, side), by in itertools.product((0.05, 0.1, 0.2), enumerate(("motor", "link")), ("reference", "load")):
        truth = laplace_inverse(lambda s, k=k, by=by: closed(s, by)[:, k] / s, time)
        curve = getattr(getattr(found, by), side)
        # Linear reading between steps of 0.1 ms and the halved step's own error leave about 1e-5 of the largest
        assert np.interp(time, found.time, curve) == pytest.approx(truth, abs=3e-5 * np.abs(curve).max())


ELBOW = gr.ElasticJoint(motor_inertia=7e-5 * 80**2, link_inertia=0.35, stiffness=900.0)
ELBOW_DRIVE = gr.Drive(bandwidth=4000.0, damping_ratio=0.9, delay=3e-3)
TICK = 1e-3


def pushed(kp: float, kd: float, reference: float, load: float, ticks: int) -> np.ndarray:
    """Positions (ticks, 2) of the elbow's motor and link at the ticks: matrix exponentials, held commands, three ticks late."""
    inertia, link, stiffness, bandwidth, ratio = 7e-5 * 80**2, 0.35, 900.0, 4000.0, 0.9
    flow = np.zeros((8, 8))  # θ, q, θ̇, q̇, τ, τ̇; command, load
    flow[0, 2] = flow[1, 3] = flow[4, 5] = 1.0
    flow[2, [0, 1, 4]] = -stiffness / inertia, stiffness / inertia, 1 / inertia
    flow[3, [0, 1, 7]] = stiffness / link, -stiffness / link, 1 / link
    flow[5, [4, 5, 6]] = -(bandwidth**2), -2 * ratio * bandwidth, bandwidth**2
    over = scipy.linalg.expm(flow * TICK)[:6]
    state, sent, last, seen = np.zeros(6), [0.0] * 3, 0.0, []
    for _ in range(ticks):
        seen.append(state[:2])
        sent.append(kp * (reference - state[0]) - kd * (state[0] - last) / TICK)
        last = state[0]
        state = over @ [*state, sent.pop(0), load]
    return np.array(seen)


def judged(curve: np.ndarray, rest: float) -> tuple[float, float]:
    """Overshoot relative to the rest, and the time from which the curve is within 2 % of it."""
    away = np.flatnonzero(np.abs(curve / rest - 1) > 0.02)
    return float(curve.max() / rest - 1), TICK * float(away[-1] + 1)


@pytest.fixture(scope="module")
def elbow() -> gr.JointStudy:
    """Study of the elbow with the largest kp under the margins."""
    asked = gr.Requirements(gain_margin=2.0, phase_margin=math.pi / 6, peak_sensitivity=2.0)
    system = gr.System.of_joint(ELBOW, ELBOW_DRIVE, gr.PD(2544.0, 49.9), "motor", TICK, asked)
    return gr.study_joint(system)


@pytest.fixture(scope="module")
def recommended(elbow: gr.JointStudy) -> tuple[float, float]:
    assert elbow.recommended is not None
    return elbow.recommended.kp, elbow.recommended.kd


@pytest.mark.slow
def test_a_joint_s_answer_has_the_motion_of_its_link(elbow: gr.JointStudy, recommended: tuple[float, float]):
    """JSON and sentences, for present and recommended gains, against the simulation here."""
    facts, words = JointPresentation(elbow).facts(), motion_text(elbow)
    for said, (kp, kd) in ((facts, (2544.0, 49.9)), (facts["recommended"], recommended)):
        stepped, loaded = pushed(kp, kd, 1.0, 0.0, 3000)[:, 1], pushed(kp, kd, 0.0, 5.0, 3000)[:, 1]
        rest = 5.0 * (1 / kp + 1 / 900.0)
        for found, (over, settled) in ((said["step"], judged(stepped, 1.0)), (said["disturbance"], judged(loaded, rest))):
            assert found["of"] == "link"
            assert found["overshoot_percent"] == pytest.approx(100 * over, rel=1e-6)
            assert found["settling_s"] == pytest.approx(settled, abs=TICK / 2)
            assert f"{100 * over:.0f} %" in words
            assert digits(settled, "s", 3) in words
        assert said["disturbance"]["peak_deflection"] == pytest.approx(loaded.max(), rel=1e-8)
        assert said["disturbance"]["rest_deflection"] == pytest.approx(rest, rel=1e-8)
        assert digits(1e3 * float(loaded.max()), "mrad", 3) in words
        assert digits(math.radians(5.0 / rest), "N·m", 3) in words  # 1° at rest


def test_recommended_gains_damp_the_link_of_an_elbow(recommended: tuple[float, float]):
    """5 N·m on the link: the largest kp under the margins, 2544, lets it swing; simulated here, not by the package."""
    (over, settled), (worse, late) = (
        judged(pushed(kp, kd, 0.0, 5.0, 4000)[:, 1], 5.0 * (1 / kp + 1 / 900.0)) for kp, kd in (recommended, (2544.0, 49.9))
    )
    assert over < 0.35
    assert settled < 0.5
    assert worse > 2 * 0.35
    assert late > 1.5 * 0.5


@pytest.mark.parametrize("gains", ["recommended", (2544.0, 49.9)])
def test_a_sampled_joint_moves_as_simulated_by_exponentials(gains: Any, request: pytest.FixtureRequest):
    kp, kd = request.getfixturevalue(gains) if isinstance(gains, str) else gains
    found = step_response(gr.build_loop(ELBOW, ELBOW_DRIVE, gr.PD(kp, kd), sample_time=TICK))
    ticks = len(found.time)
    for sides, rest, truth in (
        (found.reference, 1.0, pushed(kp, kd, 1.0, 0.0, ticks)),
        (found.load, 1 / kp + 1 / 900.0, pushed(kp, kd, 0.0, 1.0, ticks)),
    ):
        for k, side in enumerate(("motor", "link")):
            # Round-off of some thousand ticks
            assert getattr(sides, side) == pytest.approx(truth[:, k], abs=1e-9 * np.abs(truth).max())
        assert sides.link_rest == pytest.approx(rest, rel=1e-9)
        swing = found.link_step if sides is found.reference else found.link_load
        over, settled = judged(truth[:, 1], rest)
        assert swing.overshoot == pytest.approx(over, rel=1e-6)
        assert swing.settling_time == pytest.approx(settled, abs=TICK / 2)
        assert swing.peak == pytest.approx(truth[:, 1].max(), rel=1e-8)


def test_integral_action_turns_the_motor_back_under_a_load_and_kp_0_lets_it_drift():
    """With an integrator the gearbox alone is turned at rest, 1/K, which is no measure of the largest deflection."""
    held = step_response(gr.build_loop(ELBOW, ELBOW_DRIVE, gr.PID(400.0, 300.0, 25.0), sample_time=TICK))
    assert held.load.link_rest == pytest.approx(1 / 900.0, rel=1e-6)
    assert math.isnan(held.link_load.overshoot)
    curve = held.load.link
    away = np.flatnonzero(np.abs(curve - 1 / 900.0) > 0.02 * curve.max())
    assert held.link_load.settling_time == pytest.approx(TICK * (away[-1] + 1), abs=TICK / 2)
    loose = step_response(gr.build_loop(ELBOW, ELBOW_DRIVE, gr.PD(0.0, 10.0), sample_time=TICK))
    assert math.isnan(loose.link_load.rest)
    assert math.isnan(loose.link_load.settling_time)


def test_a_loop_with_kd_on_a_path_of_its_own_is_refused():
    loop = gr.build_loop(ELBOW, ELBOW_DRIVE, gr.PD(600.0, 30.0), sample_time=TICK, kd_path=gr.GainPath(delay=1e-3, sample_time=TICK / 2))
    assert_refused(lambda: step_response(loop), ["kd_path: a step response is not known"])


def test_the_live_page_draws_link_and_motor(tmp_path: Path):
    """Under 5 N·m on the link, in mrad, and after a step; at the ticks that are drawn, to five digits."""
    text = (
        "joint: {rotor_inertia: 7.0e-5, gear_ratio: 80, link_inertia: 0.35, stiffness: 900, damping: 0}\n"
        "drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 3.0}\n"
        "control: {type: pd, kp: 628, kd: 37.9, feedback: motor, sample_rate_hz: 1000}\n"
    )
    bench = JointBench(Opened(text, "elbow.yaml", tmp_path))
    drawn = dict(bench.curves(View(), None, bench.plant(View()), True))["step"]
    assert (drawn["unit"], drawn["added"]) == ("mrad", "5 N·m on the link")
    ticks = np.rint(drawn["ms"]).astype(int)
    assert len(ticks) > 100
    for key, truth in (("reference", pushed(628.0, 37.9, 1.0, 0.0, 1000)), ("disturbance", 1e3 * pushed(628.0, 37.9, 0.0, 5.0, 1000))):
        for name, side in ((f"{key}_motor", 0), (key, 1)):
            assert drawn[name] == pytest.approx(truth[ticks, side], rel=1e-4, abs=1e-9)
