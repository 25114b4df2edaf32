"""Sectors of boxes against the return ratio of single joints, from the equations of motion, and the core's boxes against hostile input."""

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import pytest

import gainroom as gr
from draws import log_uniform
from gainroom.analysis.box_loops import QUANTITIES, BoxLoop
from gainroom.native import _core
from gainroom.system.linear.transfer_function import Factored
from independent.joint import PDJoint
from independent.margins import sampled_plant
from independent.sampled import state_space

KINDS = ["rigid", "locked", "elastic", "friction on the motor", "friction on the link", "friction", "link side", "link side, friction"]
LAWS = ["PD", "PID, filtered", "PPI, filtered", "PD, notch", "delayed lead"]
TICKS = [None, 5e-4]


@dataclass(frozen=True)
class Law:
    """A controller as gainroom has it, and its response at ω (k,), written out."""

    kind: str
    tick: float | None
    kp: float
    kd: float

    @property
    def low_pass(self) -> gr.LowPass | None:
        return gr.LowPass(1500.0, 2, 0.7) if "filtered" in self.kind else None

    @property
    def controller(self) -> Any:
        kp, kd, filtered = self.kp, self.kd, {"velocity_filter": self.low_pass}
        if self.kind.startswith("PPI"):
            return gr.PPI(kp / kd, kd, 0.3 * kp, **filtered)
        if self.kind.startswith("PID"):
            return gr.PID(kp, 0.1 * kp, kd, **filtered)
        if self.kind.startswith("PD"):
            return gr.PD(kp, kd, notches=(gr.Notch(300.0, 0.4, 0.2),) if "notch" in self.kind else ())
        zero, pole = np.array([-kp / kd + 0j]), np.array([-900.0 + 0j])
        return gr.Compensator(Factored(zero, pole, kd, 4 * (self.tick or 3e-4), self.tick))

    def response(self, omega: np.ndarray) -> np.ndarray:
        """Backward differences; filters by Tustin's rule, exact at their own frequency."""
        s, tick, kp, kd = 1j * omega, self.tick, self.kp, self.kd
        rate = s if tick is None else (1 - np.exp(-s * tick)) / tick
        w, filtered = 1500.0, 1.0
        if self.low_pass:
            v = self.tustin(omega, w)
            filtered = w * w / (v * v + 2 * 0.7 * w * v + w * w)
        if self.kind.startswith("PPI"):
            return (kd + 0.3 * kp / rate) * (kp / kd + rate * filtered)
        if self.kind.startswith("PID"):
            return kp + 0.1 * kp / rate + kd * rate * filtered
        if self.kind.startswith("PD"):
            v, w = self.tustin(omega, 300.0), 300.0
            notch = (v * v + 0.08 * w * v + w * w) / (v * v + 0.4 * w * v + w * w) if "notch" in self.kind else 1.0
            return (kp + kd * rate) * notch
        v = s if tick is None else (np.exp(s * tick) - 1) / tick
        return kd * (v + kp / kd) / (v + 900.0) * np.exp(-s * 4 * (tick or 3e-4))

    def tustin(self, omega: np.ndarray, own: float) -> np.ndarray:
        return 1j * omega if self.tick is None else 1j * own / math.tan(own * self.tick / 2) * np.tan(omega * self.tick / 2)


@dataclass(frozen=True)
class Case:
    """A joint over ranges, in gainroom's words and in those of the independent checks."""

    joint: gr.ElasticJoint
    drive: gr.Drive
    ranges: dict[str, tuple[float, float]]
    law: Law
    feedback: str
    tick: float | None

    def loop(self) -> BoxLoop:
        return BoxLoop(self.joint, self.drive, gr.Uncertainty(**self.ranges), self.law.controller, self.feedback, self.tick)

    def resonance(self, values: dict[str, float]) -> float:
        own = {name: values.get(name, getattr(self.joint, name)) for name in ("stiffness", "motor_inertia", "link_inertia")}
        return math.sqrt(own["stiffness"] * (1 / own["motor_inertia"] + 1 / own["link_inertia"]))

    def response(self, omega: float, values: dict[str, float]) -> complex:
        """L at ω of the joint with these values: by the states of motor, link and current loop. An output that is locked has no states
        that change: the link's inertia is infinite."""
        joint, drive = self.joint, self.drive
        own = {"delay": drive.delay, **{name: getattr(joint, name) for name in QUANTITIES if name != "delay"}, **values}
        described = PDJoint(
            own["motor_inertia"], own["link_inertia"], own["stiffness"], own["damping"], 1.0, 0.0, own["delay"], drive.bandwidth,
            drive.damping_ratio, joint.motor_viscous, joint.link_viscous, self.feedback,
        )  # fmt: skip
        place = np.array([omega])
        if self.tick is not None:
            plant = sampled_plant(described, np.exp(1j * place * self.tick), self.tick)
        else:
            a, b, c = state_space(described)
            plant = c @ np.linalg.solve(1j * omega * np.eye(len(a)) - a, b) * np.exp(-1j * place * own["delay"])
        return complex((plant * self.law.response(place))[0])

    def at(self, point: np.ndarray, names: tuple[str, ...], scaled: bool) -> tuple[float, complex]:
        """ω and L at a point (ω or ν, then the quantities of these names)."""
        values = dict(zip(names, point[1:].tolist(), strict=True))
        omega = float(point[0]) * (self.resonance(values) if scaled else 1.0)
        return omega, self.response(omega, values)


def draw(rng: np.random.Generator, kind: str, law: str, tick: float | None) -> Case:
    """Resonance 10 to 100 Hz, damping ratio about 0.1 to 5 %; one to all quantities uncertain by up to a factor of 2."""
    motor, link = log_uniform(rng, 0.1, 2.0), log_uniform(rng, 0.1, 20.0)
    stiffness = motor * (2 * math.pi * log_uniform(rng, 10, 100)) ** 2
    damping = stiffness * log_uniform(rng, 1e-5, 5e-4)
    names = list(QUANTITIES)
    if kind == "rigid":
        stiffness, damping, names = math.inf, 0.0, ["delay", "link_inertia", "motor_inertia"]
    if kind == "locked":
        link = math.inf
        names.remove("link_inertia")
    drags = [log_uniform(rng, 0.1, 5.0) * (kind.endswith(("friction", f"friction on the {side}"))) for side in ("motor", "link")]
    if kind in ("rigid", "locked") and rng.random() < 0.5:
        drags[0] = 2.0
    joint = gr.ElasticJoint(motor, link, stiffness, damping, *drags)
    delay = log_uniform(rng, 0.5e-3, 5e-3)
    drive = gr.Drive(math.inf if rng.random() < 0.2 else log_uniform(rng, 800, 5000), float(rng.uniform(0.5, 1.1)), delay)
    chosen = rng.choice(names, int(rng.integers(1, len(names) + 1)), replace=False)
    ranges = {}
    for name in chosen.tolist():
        value = delay if name == "delay" else getattr(joint, name)
        ranges[name] = (value / log_uniform(rng, 1.01, 1.5), value * log_uniform(rng, 1.01, 1.5))
    inertia = motor + (0.0 if math.isinf(link) else link)
    crossover = 0.1 / delay * log_uniform(rng, 0.5, 2.0)
    side = "link" if kind.startswith("link side") else "motor"
    return Case(joint, drive, ranges, Law(law, tick, inertia * crossover**2, inertia * crossover), side, tick)


def boxes(
    loop: BoxLoop, rng: np.random.Generator, scaled: bool, width: float, count: int, span: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Random boxes of `width` relative to the ranges, and of `span` in frequency."""
    span = width if span is None else span
    low = loop.low + (loop.high - loop.low) * rng.random((count, len(loop.names))) * (1 - width)
    top = loop.nyquist or 3e3
    start = np.exp(rng.uniform(*np.log((0.2, 2.5) if scaled else (1e-2 * top, top / (1 + span))), count))
    return np.column_stack([start, low]), np.column_stack([start * (1 + span), low + (loop.high - loop.low) * width])


def tolerance(omega: float, tick: float | None) -> float:
    """Round-off of the states' solution, and of z − 1 with its double pole there."""
    return 1e-9 if tick is None else 1e-9 + 1e-14 / (omega * tick) ** 2


@pytest.mark.slow
@pytest.mark.parametrize("tick", TICKS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("law", LAWS)
def test_sectors_contain_the_joints_of_a_box(kind: str, law: str, tick: float | None):
    """At corners and inside, in boxes from a hundred-thousandth of the ranges to the whole, and in boxes wide in frequency alone."""
    rng = np.random.default_rng([3, KINDS.index(kind), LAWS.index(law), TICKS.index(tick)])
    judged = known = 0
    for width, span in ((1e-5, 1e-5), (1e-3, 1e-3), (0.03, 0.03), (1.0, 1.0), (1e-3, 1.0)):
        case = draw(rng, kind, law, tick)
        loop = case.loop()
        assert loop.boundable
        for scaled in (False,) if kind == "rigid" else (False, True):
            low, high = boxes(loop, rng, scaled, width, 4, span)
            sectors = loop.at(low, high, scaled)
            for k, inside in product(range(len(low)), range(6)):
                shares = rng.random(low.shape[1]) if inside % 2 else rng.integers(0, 2, low.shape[1])
                omega, value = case.at(low[k] + shares * (high[k] - low[k]), loop.names, scaled)
                if omega > (loop.nyquist or math.inf):
                    continue
                size, missed = math.log(abs(value)), tolerance(omega, tick)
                assert sectors.log_low[k] - missed <= size <= sectors.log_high[k] + missed
                middle, reach = (sectors.phase_low[k] + sectors.phase_high[k]) / 2, (sectors.phase_high[k] - sectors.phase_low[k]) / 2
                assert abs(np.angle(value * np.exp(-1j * middle))) <= reach + missed
                judged += 1
                known += span < 0.01 and sectors.log_high[k] - sectors.log_low[k] < 0.3
    assert judged > 60
    assert known > 20  # narrow boxes have narrow sectors, but for some at an undamped resonance


@pytest.mark.parametrize("kind", KINDS)
def test_sectors_of_narrow_boxes_are_no_wider_than_the_joints_in_them(kind: str):
    """Continuous: to first order log|L| and arg L are extreme in corners, all slopes of one sign; the second is below 1 % of that."""
    rng = np.random.default_rng([4, KINDS.index(kind)])
    for law in LAWS:
        case = draw(rng, kind, law, None)
        loop = case.loop()
        low, high = boxes(loop, rng, False, 1e-5, 3)
        sectors = loop.at(low, high, False)
        for k in range(len(low)):
            corners = [np.where(take, low[k], high[k]) for take in product((False, True), repeat=low.shape[1])]
            center = case.at((low[k] + high[k]) / 2, loop.names, False)[1]
            assert sectors.center[k] == pytest.approx(center, rel=1e-9)
            turns = np.log(np.array([case.at(corner, loop.names, False)[1] for corner in corners]) / center)
            reach = (sectors.log_high[k] - sectors.log_low[k]) / 2, (sectors.phase_high[k] - sectors.phase_low[k]) / 2
            # beside a hundredth: the round-off of L, 1e-12, and what sectors grant for theirs, 1e-11
            assert reach[0] <= 1.01 * turns.real.max() + 1e-10
            assert reach[1] <= 1.01 * turns.imag.max() + 1e-10


def test_scores_say_which_parameter_moves_l():
    """Times the half width: |d log L| from a difference quotient."""
    case = draw(np.random.default_rng(9), "friction", "PD", None)
    case = replace(case, ranges={name: (0.9 * value, 1.1 * value) for name, value in case.loop().nominal.items()})
    loop = case.loop()
    middle = np.append(40.0, 0.5 * (loop.low + loop.high))
    half = 1e-6 * middle
    (score,) = loop.at((middle - half)[None], (middle + half)[None], False).score
    for k in range(len(middle)):
        step = np.where(np.arange(len(middle)) == k, half, 0.0)
        first, last = (case.at(middle + sign * step, loop.names, False)[1] for sign in (-1, 1))
        # the quotient's round-off: 1e-12 of 1e-6
        assert score[k] == pytest.approx(abs(np.log(last / first)) / 2, rel=1e-4)


GIVEN: dict[str, Any] = {
    "values": np.array([2e-3, 1e4, 0.8, 0.2, 1.0, 0.1, 0.2]),
    "columns": np.array([1, 2, 3, 0, 0]),
    "motor_side": True,
    "current_poles": np.array([-3000 + 1000j, -3000 - 1000j]),
    "current_gain": 1e7,
    "zeros": np.array([-20.0 + 0j]),
    "poles": np.array([-2000.0 + 0j]),
    "gain": 1e5,
    "control_delay": 0.0,
    "sample_time": 5e-4,
    "aliases": 3,
    "rest": 1e-9,
}
LOW = np.array([[50.0, 1.9e-3, 9e3, 0.7]])
HIGH = np.array([[50.5, 1.91e-3, 9.01e3, 0.701]])


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"values": np.ones(6)}, "values"),
        ({"columns": np.zeros(4, dtype=int)}, "columns"),
        ({"columns": np.array([1, 1, 0, 0, 0])}, "columns"),
        ({"columns": np.array([1, 3, 0, 0, 0])}, "columns"),
        ({"columns": np.array([-1, 0, 0, 0, 0])}, "columns"),
        ({"columns": np.array([6, 1, 2, 3, 4])}, "columns"),
        ({"aliases": -1}, "aliases"),
        ({"aliases": _core.MOST_ALIASES + 1}, "aliases"),
    ],
)
def test_loops_that_do_not_fit_are_refused(wrong: dict[str, Any], said: str):
    with pytest.raises(ValueError, match=said):
        _core.BoxLoop(**{**GIVEN, **wrong})


def test_boxes_that_do_not_fit_are_refused():
    loop = _core.BoxLoop(**GIVEN)
    for low, high in ((LOW[:, :3], HIGH[:, :3]), (LOW, HIGH[:, :3]), (LOW, np.vstack([HIGH, HIGH])), (np.ones((1, 7)), np.ones((1, 7)))):
        with pytest.raises(ValueError, match="low and high"):
            loop.at(low, high, False)


def test_no_boxes_have_no_sectors():
    bounds, centers, scores = _core.BoxLoop(**GIVEN).at(np.zeros((0, 4)), np.zeros((0, 4)), True)
    assert (bounds.shape, centers.shape, scores.shape) == ((4, 0), (1, 0), (0, 4))


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300, 1e150])
@pytest.mark.parametrize("sample_time", [0.0, 5e-4])
def test_of_a_box_without_end_the_phase_is_not_known(sample_time: float, value: float):
    """One that reaches to no number, or so far that squares overflow. How large L is depends on the delay only where it is sampled."""
    loop = _core.BoxLoop(**{**GIVEN, "sample_time": sample_time})
    for scaled, column in product((False, True), range(4)):
        high = HIGH.copy()
        high[0, column] = value
        ((log_low,), (log_high,), (phase_low,), (phase_high,)), _, _ = loop.at(LOW, high, scaled)
        assert phase_high - phase_low >= 2 * math.pi
        assert column == 1 or (log_low, log_high) == (-math.inf, math.inf)
