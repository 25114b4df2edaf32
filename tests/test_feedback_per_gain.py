"""Gains of one joint that measure both sides of the gearbox, against the two-mass equations written out here by hand."""

import json
import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

import gainroom as gr
from gainroom.analysis.dynamic_stiffness import stiffness_of
from gainroom.cli import main
from gainroom.errors import GainroomError
from gainroom.files.joint_yaml import parse_joint
from gainroom.simulation.run import simulate
from gainroom.simulation.scenario import Scenario
from gainroom.simulation.step_response import step_response
from gainroom.simulation.testbed import Testbed
from gainroom.simulation.trajectories import Step
from gainroom.system.feedback import Feedback
from gainroom.system.torque_noise import torque_noise

LINK_MOTOR, MOTOR_LINK = {"kp": "link", "kd": "motor"}, {"kp": "motor", "kd": "link"}


@dataclass(frozen=True)
class Drawn:
    """A joint, its drive and its PD gains; `position`, `velocity`: the coordinate, 0 the motor's and 1 the link's, that each measures."""

    jm: float
    jl: float
    k: float
    b: float
    bandwidth: float
    delay: float
    step: float
    kp: float
    kd: float
    feedback: dict[str, str]

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Drawn":
        jm, jl = 10 ** rng.uniform(-1.5, 0.5, 2)
        omega = 10 ** rng.uniform(1.0, 2.3)
        k = jm * jl / (jm + jl) * omega**2
        crossover = rng.uniform(0.05, 0.5) * omega
        return cls(
            jm,
            jl,
            k,
            rng.choice([0.0, 2 * rng.uniform(0.01, 0.1)]) * math.sqrt(k * jm),
            rng.choice([math.inf, 10 ** rng.uniform(2.7, 4)]),
            rng.choice([0.0, rng.uniform(0.0, 4e-3)]),
            rng.choice([5e-4, 1e-3, 2e-3]),
            (jm + jl) * crossover**2,
            (jm + jl) * crossover * 10 ** rng.uniform(-0.5, 0.3),
            LINK_MOTOR if rng.random() < 0.7 else MOTOR_LINK,
        )

    @property
    def position(self) -> int:
        return int(self.feedback["kp"] == "link")

    @property
    def velocity(self) -> int:
        return int(self.feedback["kd"] == "link")

    @property
    def joint(self) -> gr.ElasticJoint:
        return gr.ElasticJoint(motor_inertia=self.jm, link_inertia=self.jl, stiffness=self.k, damping=self.b)

    @property
    def drive(self) -> gr.Drive:
        return gr.Drive(self.bandwidth, 0.9, self.delay)

    def loop(self, sampled: bool = True) -> gr.Loop:
        law = gr.PD(self.kp, self.kd)
        return gr.build_loop(self.joint, self.drive, law, feedback=self.feedback, sample_time=self.step if sampled else None)

    def equations(self) -> tuple[np.ndarray, np.ndarray]:
        """States θ, q, their rates, and those of the current loop: x' = A x + b u."""
        size = 4 if math.isinf(self.bandwidth) else 6
        a, b = np.zeros((size, size)), np.zeros(size)
        a[0, 2] = a[1, 3] = 1.0
        a[2, :4] = np.array([-self.k, self.k, -self.b, self.b]) / self.jm
        a[3, :4] = np.array([self.k, -self.k, self.b, -self.b]) / self.jl
        if size == 4:
            b[2] = 1 / self.jm
            return a, b
        a[2, 4], a[4, 5] = 1 / self.jm, 1.0
        a[5, 4:], b[5] = [-(self.bandwidth**2), -1.8 * self.bandwidth], self.bandwidth**2
        return a, b

    def sampled(self, kp: float, kd: float, extra: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Closed loop tick by tick: states x, the last reading that velocity is made from, commands under way.

        Its transition matrix, the row that makes a command of a state, and what noise (2,) of both readings adds to a state by `noise`.
        """
        a, b = self.equations()
        size, delay = len(a), self.delay + extra
        whole = math.floor(delay / self.step + 1e-9)
        part = max(delay - whole * self.step, 0.0)

        def over(time: float) -> tuple[np.ndarray, np.ndarray]:
            both = np.zeros((size + 1, size + 1))
            both[:size, :size], both[:size, size] = time * a, time * b
            grown = expm(both)
            return grown[:size, :size], grown[:size, size]

        (every, _), (rest, late), (_, early) = over(self.step), over(self.step - part), over(part)
        total = size + whole + 2
        law, place = np.zeros(total), np.eye(total)
        law[self.position] -= kp
        law[self.velocity] -= kd / self.step
        law[size] += kd / self.step
        sent = [law, *place[size + 1 :]]  # now, one tick ago, …
        matrix = np.zeros((total, total))
        matrix[:size, :size] = every
        matrix[:size] += np.outer(late, sent[whole]) + np.outer(rest @ early, sent[whole + 1])
        matrix[size] = place[self.velocity]
        matrix[size + 1 :] = sent[: whole + 1]
        of_law = np.array([-kp, -kd / self.step])
        noise = np.zeros((total, 2))
        noise[size + 1] = of_law
        noise[size, 1] = 1.0
        if whole == 0:
            noise[:size] = np.outer(late, of_law)
        return matrix, law, noise

    def radius(self, kp: float, kd: float, extra: float = 0.0) -> float:
        return float(np.abs(np.linalg.eigvals(self.sampled(kp, kd, extra)[0])).max())

    def actuator(self, s: np.ndarray) -> np.ndarray:
        lag = 0 * s if math.isinf(self.bandwidth) else s / self.bandwidth
        return np.exp(-s * self.delay) / (lag * lag + 1.8 * lag + 1)

    def moved(self, s: np.ndarray) -> list[np.ndarray]:
        """Motor and link position by motor torque, from the two equations of motion."""
        spring = self.k + self.b * s
        matrix = np.array([[self.jm * s**2 + spring, -spring], [-spring, self.jl * s**2 + spring]]).transpose(2, 0, 1)
        return list(np.linalg.solve(matrix, np.array([[1.0], [0.0]]))[:, :, 0].T)


DRAWN = [Drawn.draw(np.random.default_rng([7, k])) for k in range(40)]
STABLE = [one for one in DRAWN if one.radius(one.kp, one.kd) < 1]


def test_there_are_stable_joints_of_both_kinds() -> None:
    assert {tuple(one.feedback.values()) for one in STABLE} == {("link", "motor"), ("motor", "link")}
    assert len(STABLE) >= 15


@pytest.mark.parametrize("drawn", DRAWN)
def test_a_sampled_loop_is_stable_where_its_matrix_is(drawn: Drawn) -> None:
    found = gr.margins(drawn.loop())
    assert found.stable == (drawn.radius(drawn.kp, drawn.kd) < 1)
    if not found.stable:
        return
    limit = gr.gain_limit(drawn.loop())
    assert limit.certified
    if math.isfinite(limit.gain):
        gains = limit.gain * drawn.kp, limit.gain * drawn.kd
        assert drawn.radius(*gains) == pytest.approx(1.0, abs=1e-9)  # eigenvalues of the matrix are no better
    for factor in np.geomspace(max(limit.lower_gain, 1e-2) * 1.01, min(limit.gain, 1e2) * 0.99, 12).tolist():
        assert drawn.radius(factor * drawn.kp, factor * drawn.kd) < 1


@pytest.mark.parametrize("drawn", STABLE)
def test_the_delay_margin_of_a_sampled_loop_is_where_its_matrix_loses_stability(drawn: Drawn) -> None:
    found = gr.margins(drawn.loop())
    assert found.certified
    assert drawn.radius(drawn.kp, drawn.kd, found.delay_margin * (1 - 1e-5)) < 1
    assert drawn.radius(drawn.kp, drawn.kd, found.delay_margin * (1 + 1e-5)) > 1


@pytest.mark.parametrize("drawn", DRAWN)
def test_the_return_ratio_in_continuous_time_is_that_of_the_equations(drawn: Drawn) -> None:
    s = 1j * np.geomspace(0.3, 3e3, 400)
    motor_link = drawn.moved(s)
    notch, low_pass = gr.Notch(90.0, 0.5, 0.2), gr.LowPass(700.0, order=2)
    filters: dict[str, Any] = {"velocity_filter": low_pass, "notches": (notch,)}
    passed = s / ((s / 700) ** 2 + 2 * low_pass.damping_ratio * s / 700 + 1)
    cut = gr.build_loop(drawn.joint, gr.Drive(math.inf), gr.PD(1.0, 0.0, notches=(notch,))).at(s) / motor_link[0]  # tested elsewhere
    kp, kd, ki = drawn.kp, drawn.kd, 3 * drawn.kp
    y, rate = motor_link[drawn.position], motor_link[drawn.velocity]
    laws: list[tuple[Any, np.ndarray, str]] = [
        (gr.PD(kp, kd), kp * y + kd * s * rate, "kd"),
        (gr.PD(kp, kd, **filters), (kp * y + kd * passed * rate) * cut, "kd"),
        (gr.PID(kp, ki, kd, **filters), ((kp + ki / s) * y + kd * passed * rate) * cut, "kd"),
        (gr.PPI(kp / kd, kd, ki, **filters), (kd + ki / s) * (kp / kd * y + passed * rate) * cut, "kv"),
    ]
    for law, wanted, damping in laws:
        feedback = {"kp": drawn.feedback["kp"], damping: drawn.feedback["kd"]}
        loop = gr.build_loop(drawn.joint, drawn.drive, law, feedback=feedback)
        assert loop.scalar is not None  # zeros and poles, of which all margins are made
        size = np.abs(wanted).max()
        assert loop.at(s) == pytest.approx(wanted * drawn.actuator(s), rel=1e-7, abs=1e-11 * size), law.kind  # zeros beside poles


@pytest.mark.parametrize("drawn", [one for one in DRAWN if one.delay > 0])
def test_a_continuous_loop_is_lost_where_the_equations_with_a_pade_delay_are(drawn: Drawn) -> None:
    limit = gr.gain_limit(drawn.loop(sampled=False))
    a, b = drawn.equations()
    # A Padé delay of order 6 to the sixth power is exact to 1e-9 up to ωT of 10.
    order, parts = 6, 2
    c = [math.factorial(2 * order - k) * math.factorial(order) / (math.factorial(2 * order) * math.factorial(k) * math.factorial(order - k))
         for k in range(order + 1)]  # fmt: skip
    time = drawn.delay / parts
    den = np.array([c[k] * time**k for k in range(order, -1, -1)])
    num = den * (-1.0) ** np.arange(order, -1, -1)
    for _ in range(parts):  # chain of Padé sections before the drive
        companion = np.diag(np.ones(order - 1), -1)
        companion[0] = -den[1:] / den[0]
        direct = num[0] / den[0]
        out = num[1:] / den[0] - direct * den[1:] / den[0]
        size = len(a)
        a = np.block([[a, np.outer(b, out)], [np.zeros((order, size)), companion]])
        b = np.append(b * direct, np.eye(1, order)[0])
    row = np.zeros(len(a))
    row[drawn.position] += drawn.kp
    row[2 + drawn.velocity] += drawn.kd

    def growth(factor: float) -> float:
        return float(np.linalg.eigvals(a - factor * np.outer(b, row)).real.max())

    assert limit.stable == (growth(1.0) < 0)
    if limit.stable and math.isfinite(limit.gain):
        assert growth(0.999 * limit.gain) < 0 < growth(1.001 * limit.gain)


@pytest.mark.parametrize("side", ["motor", "link"])
@pytest.mark.parametrize("step", [None, 1e-3])
def test_the_same_side_twice_is_that_side_to_the_last_bit(side: Any, step: float | None) -> None:
    drawn = STABLE[0]
    parts = drawn.joint, drawn.drive, gr.PD(drawn.kp, drawn.kd)
    one: Any = gr.build_loop(*parts, feedback=side, sample_time=step)
    both: Any = gr.build_loop(*parts, feedback={"kp": side, "kd": side}, sample_time=step)
    assert one.parts.feedback == both.parts.feedback == Feedback.of(side)
    for name in ("zeros", "poles", "gain", "delay"):
        assert np.array_equal(getattr(one.scalar, name), getattr(both.scalar, name))
    found, other = gr.margins(one), gr.margins(both)
    for field in fields(found):
        if isinstance(getattr(found, field.name), float):
            assert repr(getattr(found, field.name)) == repr(getattr(other, field.name))


@pytest.mark.parametrize("drawn", STABLE)
@pytest.mark.parametrize("sampled", [False, True])
def test_dynamic_stiffness_is_that_of_the_two_equations(drawn: Drawn, sampled: bool) -> None:
    loop = drawn.loop(sampled)
    if not gr.is_stable(loop):
        return
    found = stiffness_of(loop, True)
    step = drawn.step if sampled else 0.0
    s = 1j * np.geomspace(1e-3, 0.9999 * math.pi / step if sampled else 3e4, 60_000)
    held = -np.expm1(-s * step) / (s * step) if sampled else np.ones_like(s)
    rate = -np.expm1(-s * step) / step if sampled else s
    spring, sent = drawn.k + drawn.b * s, drawn.actuator(s) * held
    fed = [np.zeros_like(s), np.zeros_like(s)]
    fed[drawn.position] = fed[drawn.position] + sent * drawn.kp
    fed[drawn.velocity] = fed[drawn.velocity] + sent * drawn.kd * rate
    matrix = np.array([[drawn.jm * s**2 + spring + fed[0], fed[1] - spring], [-spring, drawn.jl * s**2 + spring]]).transpose(2, 0, 1)
    compliance = np.linalg.solve(matrix, np.array([[0.0], [1.0]]))[:, 1, 0] * np.abs(held)
    # Neighbours are 3e-4 apart: a peak of damping ratio above 0.01 is met to 1e-4, one of 0.001 to a few per cent.
    near = 2e-4 + (3e-4 / max(found.damping_ratio, 1e-4)) ** 2
    assert found.stiffness[0] == pytest.approx(1 / np.abs(compliance).max(), rel=near)


@pytest.mark.parametrize("drawn", DRAWN[:12])
def test_the_region_of_gains_is_where_the_matrix_is_stable(drawn: Drawn) -> None:
    region = gr.pd_region(drawn.joint, drawn.drive, feedback=drawn.feedback, sample_time=drawn.step)
    rng = np.random.default_rng(3)
    kp, kd = drawn.kp * 10 ** rng.uniform(-2, 2, 150), drawn.kd * 10 ** rng.uniform(-2, 2, 150)
    radius = np.array([drawn.radius(*gains) for gains in zip(kp, kd, strict=True)])
    clear = np.abs(radius - 1) > 1e-9  # round-off of eigenvalues
    assert np.array_equal(region.contains(kp, kd)[clear], radius[clear] < 1)


def test_a_region_with_margins_holds_the_gains_that_have_them() -> None:
    drawn = next(one for one in STABLE if one.feedback == LINK_MOTOR and one.b == 0)
    asked = {"gain_margin": 2.0, "phase_margin": math.radians(30), "peak_sensitivity": 2.0}
    region = gr.pd_region(drawn.joint, drawn.drive, **asked, feedback=drawn.feedback, sample_time=drawn.step)
    rng = np.random.default_rng(4)
    kp, kd = drawn.kp * 10 ** rng.uniform(-1.5, 0.7, 80), drawn.kd * 10 ** rng.uniform(-1, 1, 80)
    omega = np.concatenate([np.geomspace(1e-2, math.pi / drawn.step, 20_000)])
    returned = {key: _held(drawn, omega, side) for key, side in (("kp", drawn.position), ("kd", drawn.velocity))}
    inside = region.contains(kp, kd)
    assert 5 < inside.sum() < 75
    for one, p, d in zip(inside.tolist(), kp.tolist(), kd.tolist(), strict=True):
        if drawn.radius(p, d) >= 1:
            assert not one
            continue
        value = p * returned["kp"] + d * -np.expm1(-1j * omega * drawn.step) / drawn.step * returned["kd"]
        peak = float((1 / np.abs(1 + value)).max())
        if one:
            assert peak < 2.001  # between the grid's frequencies
        elif peak < 1.9:  # then 5.9 dB up and 30.5°: only the margin down can be missed
            real = value[np.flatnonzero(np.diff(np.sign(value.imag)))].real
            assert np.any((real < -1) & (real > -2.02))


def _held(drawn: Drawn, omega: np.ndarray, side: int) -> np.ndarray:
    """Response of a reading to commands, sampled, from the matrices of the open loop."""
    matrix, _, _ = drawn.sampled(0.0, 0.0)
    size = len(drawn.equations()[0])
    _, _, push = drawn.sampled(-1.0, 0.0)  # what a reading of 1 sends
    z = np.exp(1j * omega * drawn.step)
    states = np.linalg.solve(z[:, None, None] * np.eye(len(matrix)) - matrix, push[:, :1].astype(complex))
    assert size <= len(matrix)
    return states[:, side, 0]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_no_gains_of_a_grid_have_a_stiffer_link_than_the_recommended(seed: int) -> None:
    drawn = [one for one in STABLE if one.feedback == LINK_MOTOR][seed]
    best = gr.recommend_pd(drawn.joint, drawn.drive, feedback=drawn.feedback, sample_time=drawn.step)
    assert best is not None
    asked = {"gain_margin": 10 ** (6 / 20), "phase_margin": math.radians(30), "peak_sensitivity": 2.0}
    usual = gr.Requirements(**asked)
    found = gr.margins(gr.build_loop(drawn.joint, drawn.drive, best.controller, feedback=drawn.feedback, sample_time=drawn.step))
    assert usual.met_by(found)
    for kp in np.geomspace(0.2, 4.0, 14) * best.kp:
        for kd in np.geomspace(0.2, 4.0, 14) * best.kd:
            loop = gr.build_loop(drawn.joint, drawn.drive, gr.PD(kp, kd), feedback=drawn.feedback, sample_time=drawn.step)
            if usual.met_by(gr.margins(loop)):
                assert stiffness_of(loop, True).stiffness[0] <= 1.01 * best.stiffness


@pytest.mark.parametrize("drawn", STABLE[:8])
def test_a_simulated_step_is_that_of_the_matrix(drawn: Drawn) -> None:
    ticks = 400
    scenario = Scenario(duration=ticks * drawn.step, reference=Step(0.1), reference_velocity=False)
    loop = drawn.loop()
    run, bed = simulate(loop, scenario), simulate(Testbed(loop), scenario)
    matrix, _, push = drawn.sampled(drawn.kp, drawn.kd)
    states = np.zeros((ticks, len(matrix)))
    for k in range(1, ticks):
        states[k] = matrix @ states[k - 1] - 0.1 * push[:, 0]
    scale = np.abs(states[:, :2]).max()
    for found in (run, bed):
        assert found.motor_position[:ticks, 0] == pytest.approx(states[:, 0], abs=1e-9 * scale)
        assert found.link_position[:ticks, 0] == pytest.approx(states[:, 1], abs=1e-9 * scale)
        assert found.feedback == drawn.feedback["kp"]


@pytest.mark.parametrize("drawn", STABLE[:8])
def test_steps_of_reference_and_load_are_those_of_the_matrix(drawn: Drawn) -> None:
    found = step_response(drawn.loop(), 300 * drawn.step)
    matrix, _, push = drawn.sampled(drawn.kp, drawn.kd)
    a, _ = drawn.equations()
    both = np.zeros((len(a) + 1, len(a) + 1))
    both[: len(a), : len(a)], both[3, -1] = drawn.step * a, drawn.step / drawn.jl
    pushed = np.zeros(len(matrix))
    pushed[: len(a)] = expm(both)[: len(a), -1]
    for steps, entry in ((found.reference, -push[:, 0]), (found.load, pushed)):
        states = np.zeros((len(found.time), len(matrix)))
        for k in range(1, len(states)):
            states[k] = matrix @ states[k - 1] + entry
        scale = np.abs(states[:, :2]).max()
        assert steps.motor == pytest.approx(states[:, 0], abs=1e-9 * scale)
        assert steps.link == pytest.approx(states[:, 1], abs=1e-9 * scale)
    softness = 1 / drawn.kp + (1 / drawn.k if drawn.feedback == MOTOR_LINK else 0.0)  # in series with the gearbox, or in its stead
    assert found.load.link_rest == pytest.approx(softness, rel=1e-6)


@pytest.mark.parametrize("drawn", STABLE[:8])
def test_torque_noise_of_two_encoders_is_that_of_two_independent_noises(drawn: Drawn) -> None:
    count = 1e-4
    drive = gr.Drive(drawn.bandwidth, 0.9, drawn.delay, count)
    loop = gr.build_loop(drawn.joint, drive, gr.PD(drawn.kp, drawn.kd), feedback=drawn.feedback, sample_time=drawn.step)
    matrix, law, push = drawn.sampled(drawn.kp, drawn.kd)
    spread = push @ push.T
    for _ in range(40):  # the sum over all past ticks, twice as many each time
        spread, matrix = spread + matrix @ spread @ matrix.T, matrix @ matrix
    variance = law @ spread @ law + drawn.kp**2 + (drawn.kd / drawn.step) ** 2
    assert torque_noise(loop)[0] == pytest.approx(
        count / math.sqrt(12) * math.sqrt(variance), rel=1e-6
    )  # round-off of fast states beside slow ones


def test_what_both_sides_do_not_have_is_refused_and_not_guessed() -> None:
    drawn = STABLE[0]
    loop = drawn.loop()
    s = 1j * np.ones(1)
    for refused in (gr.jitter_margin, gr.closed_loop, lambda one: one.actuated_at(s), lambda one: one.control_at(s)):
        with pytest.raises(GainroomError, match=r"feedback: .* is not known where gains measure both sides"):
            refused(loop)
    assert gr.jitter_margin(drawn.loop(sampled=False)).width > 0  # continuous: by the return ratio alone


@pytest.mark.slow
def test_nothing_is_called_proved_over_ranges_where_gains_measure_both_sides() -> None:
    drawn = STABLE[0]
    ranges = gr.Uncertainty(stiffness=(0.8 * drawn.k, 1.2 * drawn.k))
    best = gr.recommend_pd(drawn.joint, drawn.drive, None, ranges, feedback=drawn.feedback, sample_time=drawn.step)
    assert best is not None
    assert not best.proved
    assert "not proved" in best.certificate


FILE = """
joint: {motor_inertia: 0.448, link_inertia: 0.35, stiffness: 900.0}
drive: {bandwidth: 4000.0, damping_ratio: 0.9, delay_ms: 3.0}
control: {type: TYPE, kp: 300.0, GAINS, feedback: FEEDBACK, sample_rate_hz: 1000}
"""


def _file(feedback: str, kind: str = "pd", gains: str = "kd: 25.0") -> str:
    return FILE.replace("TYPE", kind).replace("GAINS", gains).replace("FEEDBACK", feedback)


@pytest.mark.parametrize(
    ("feedback", "problem"),
    [
        ("{kp: link}", "control.feedback.kd is missing: motor or link"),
        ("{kd: motor}", "control.feedback.kp is missing: motor or link"),
        ("{kp: link, kd: moter}", "control.feedback.kd: 'moter' must be motor or link"),
        ("{kp: 3, kd: motor}", "control.feedback.kp: 3 must be motor or link"),
        ("{kp: [link], kd: motor}", "control.feedback.kp: ['link'] must be motor or link"),
        ("{kp: link, kd: motor, kv: motor}", "control.feedback.kv: must be one of kp, ki, kd"),
        ("{kp: link, ki: motor, kd: motor}", "control.feedback.ki: 'motor' must be as kp, 'link': both measure one encoder"),
        ("moter", "control.feedback: 'moter' must be motor or link; did you mean motor?"),
        ("[link, motor]", "control.feedback: ['link', 'motor'] must be motor or link"),
    ],
)
def test_a_file_with_wrong_sides_is_refused_in_one_line(feedback: str, problem: str) -> None:
    with pytest.raises(GainroomError) as refused:
        parse_joint(_file(feedback), "joint.yaml")
    assert str(refused.value).splitlines() == [f"joint.yaml: {problem}"]


def test_a_file_names_the_gains_of_its_type() -> None:
    cascade: Any = parse_joint(_file("{kp: link, kv: motor}", "ppi", "kv: 25.0, ki: 1.0").replace("300.0", "12.0"), "joint.yaml")
    assert (cascade.control.feedback.position, cascade.control.feedback.velocity) == ("link", "motor")
    integral: Any = parse_joint(_file("{kp: link, ki: link, kd: motor}", "pid", "ki: 100.0, kd: 25.0"), "joint.yaml")
    assert integral.control.feedback == Feedback.of(LINK_MOTOR)
    assert str(integral.control.feedback) == "kp link, kd motor"


def test_a_path_of_its_own_for_kd_goes_with_one_side() -> None:
    text = _file("{kp: link, kd: motor}", "pd", "kd: 25.0, kd_path: {delay_ms: 0.1, sample_rate_hz: 10000}")
    with pytest.raises(GainroomError, match=r"joint.yaml: control.kd_path is not for gains that measure both sides"):
        parse_joint(text, "joint.yaml", two_paths=True)


@pytest.mark.parametrize("given", [{"kp": "link"}, {"kp": "link", "kd": "far"}, {"kp": "link", "kd": "motor", "x": "link"}, "far", 3, None])
def test_build_loop_refuses_other_sides(given: Any) -> None:
    with pytest.raises(GainroomError, match="feedback"):
        gr.build_loop(STABLE[0].joint, STABLE[0].drive, gr.PD(1.0, 1.0), feedback=given)


def test_several_joints_have_one_side() -> None:
    plant = gr.Plant(np.eye(2), np.ones(2), np.full(2, 100.0))
    with pytest.raises(GainroomError, match="must be motor or link: feedback per gain is for single joints, not for 2"):
        gr.build_loop(plant, gr.Drive(1000.0), gr.PD(1.0, 1.0), feedback=LINK_MOTOR)


def test_a_robot_has_one_side(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["example", "biped"]) == 0
    text = capsys.readouterr().out
    path = tmp_path / "biped.yaml"
    path.write_text(text.replace("feedback: motor ", "feedback: {kp: link, kd: motor} ", 1))
    assert main(["robot", str(path)]) == 2
    error = "control.feedback: {'kp': 'link', 'kd': 'motor'} must be motor or link: feedback per gain is for single joints"
    assert error in " ".join(capsys.readouterr().err.split())


def test_a_recording_is_not_judged_with_both_sides(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, log = tmp_path / "joint.yaml", tmp_path / "run.csv"
    path.write_text(_file("{kp: link, kd: motor}") + "scenario: {duration: 0.5, reference: {type: step, by: 0.1}}\n")
    assert main(["simulate", str(path), "--log", str(log)]) == 0
    assert "encoders on both sides (kp link, kd motor)" in capsys.readouterr().out
    assert main(["diagnose", str(log), "--joint", str(path)]) == 2
    assert "is not known where gains measure both sides (kp link, kd motor): give motor or link" in capsys.readouterr().err


@pytest.mark.slow
def test_every_answer_of_the_joint_command_is_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, page = tmp_path / "joint.yaml", tmp_path / "page.html"
    path.write_text(_file("{kp: link, kd: motor}"))
    assert main(["joint", str(path), "--json", "--report", str(page)]) == 0
    found = json.loads(capsys.readouterr().out)
    # At rest the motor turns until the link's encoder reads what is asked: the gearbox gives nothing away, and kp is all there is.
    assert found["dynamic_stiffness"] == pytest.approx(300.0, rel=1e-6)
    assert found["recommended"]["kp"] > 300
    assert "both sides of the gearbox: kp link, kd motor" in page.read_text("utf-8")
