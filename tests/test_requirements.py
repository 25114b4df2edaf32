"""Requirements one by one: what each excludes, against margins that are read off a dense grid of frequencies; and how each is judged."""

import pickle
from dataclasses import dataclass, replace
from math import inf, log, nan, pi
from typing import Any

import numpy as np
import pytest

import gainroom as gr
from gainroom.system.excluded_sets import Arc, Disk, ExcludedSet, Segment
from gainroom.system.requirement import Requirement
from gainroom.system.requirements import REQUIREMENTS, Requirements, SensitivityBound
from independent import margins as grid
from independent.joint import PDJoint
from refusals import assert_refused

JOINT = PDJoint(1.0, 16.0, 1e4, 1.0, 0.0, 0.0, delay=2e-3, bandwidth=4000.0)
COMPLEMENTARY = SensitivityBound("peak_complementary", "peak complementary sensitivity", "peak_complementary", slope=-1.0, offset=1.0)
DELAY = Requirement("delay_margin", "delay margin", "delay_margin_ms", "ms", 1e3)


@dataclass(frozen=True)
class DiskMargin(Requirement):
    """α = min 2 |1 + L|/|1 − L| = 2/max |2 S − 1|."""

    high: float = 2.0

    def excluded(self, needed: float) -> ExcludedSet:
        return Disk.of_ceiling(2 / needed, 2.0, -1.0)


DISK = DiskMargin("disk_margin", "disk margin", "disk_margin")
ASKED = {
    "gain_margin": 2.0,
    "phase_margin": 0.5,
    "peak_sensitivity": 2.0,
    "peak_complementary": 1.6,
    "disk_margin": 0.7,
    "delay_margin": 4e-3,
}
SAMPLED = [name for name in ASKED if name != "delay_margin"]  # a fraction of a tick costs nearly, not quite, the phase ωT


@pytest.fixture(autouse=True)
def further(monkeypatch: pytest.MonkeyPatch):
    """Three that the package does not have: two with an excluded set, one without."""
    for one in (COMPLEMENTARY, DISK, DELAY):
        monkeypatch.setitem(REQUIREMENTS, one.name, one)


def reached(name: str, omega: np.ndarray, loop: np.ndarray) -> float:
    """The margin of that name of a stable loop, to about four digits: from L at some 40 000 frequencies."""
    seen = grid.margins_on_grid(loop)
    if name == "gain_margin":
        return min(seen.gain_margin, 1 / max(seen.lower_gain_margin, 1e-300))
    if name in ("phase_margin", "peak_sensitivity"):
        return getattr(seen, name)
    if name == "peak_complementary":
        return float(np.max(np.abs(loop / (1 + loop))))
    if name == "disk_margin":
        return float(np.min(2 * np.abs(1 + loop) / np.abs(1 - loop)))
    size = np.log(np.abs(loop))
    k = np.flatnonzero(np.sign(size[1:]) != np.sign(size[:-1]))
    share = size[k] / (size[k] - size[k + 1])
    at, value = omega[k] * (omega[k + 1] / omega[k]) ** share, loop[k] * (loop[k + 1] / loop[k]) ** share
    return float(np.min(np.angle(-value) % (2 * pi) / at, initial=inf))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "sample_time"), [*((name, None) for name in ASKED), *((name, 5e-4) for name in SAMPLED)])
def test_a_region_is_where_the_margin_holds(name: str, sample_time: float | None):
    """On a few lines kp = const, kd over all that is stable; beside an end that was reported it is met on one side only."""
    joint, drive = gr.ElasticJoint(1.0, 16.0, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3)
    one, needed = REQUIREMENTS[name], ASKED[name]
    stable = gr.pd_region(joint, drive, sample_time=sample_time)
    limits: dict[str, Any] = {name: needed}
    region = gr.pd_region(joint, drive, sample_time=sample_time, **limits)
    judged = []
    lines = [0.1] if one.excluded(needed) is None else [1e-3, 0.1, 0.5]  # sampled, gain by gain
    for kp in np.array(lines) * stable.max_kp():
        (whole,), (allowed,) = stable.columns(kp), region.columns(kp)
        ends = [end for end in allowed.ravel().tolist() if np.isfinite(end) and not np.any(np.isclose(end, whole, rtol=1e-9))]
        trials = [*np.linspace(whole[0, 0], whole[-1, 1], 15)[1:-1], *(end * (1 + side) for end in ends for side in (-2e-3, 2e-3))]
        inside = region.contains(kp, trials)
        omega = grid.frequency_grid(
            replace(JOINT, kp=float(kp), kd=float(np.max(np.abs(trials)))), sample_time
        )  # covers those of the others
        spring, damper = (grid.response(replace(JOINT, kp=p, kd=d), omega, sample_time) for p, d in ((1.0, 0.0), (0.0, 1.0)))
        for kd, claimed in zip(trials, inside.tolist(), strict=True):
            if not stable.contains(kp, kd):
                assert not claimed
                continue
            value = reached(name, omega, kp * spring + kd * damper)
            if abs(one.shortfall(needed, value)) > 3e-4:  # the grid is good to about 1e-4
                assert claimed == one.met(needed, value), (kp, kd, value)
                judged.append(claimed)
    assert True in judged
    assert False in judged


@pytest.mark.parametrize("name", ASKED)
def test_judged_alike(name: str):
    """Met, by how much missed, and tightened: of one mind, whichever way the margin is bounded."""
    one, needed = REQUIREMENTS[name], ASKED[name]
    better = -1.0 if one.at_most else 1.0
    values = [needed * (1 + better * step) for step in (-0.1, -0.01, 0.0, 0.01, 0.1)]
    short = [one.shortfall(needed, value) for value in values]
    assert short == sorted(short, reverse=True)
    assert short[2] == pytest.approx(0, abs=1e-15)
    assert [one.met(needed, value) for value in values] == [False, False, True, True, True]
    assert not one.met(needed, nan)
    assert one.shortfall(needed, nan) == inf
    harder = one.tightened(needed, 0.02)
    one.check(harder)
    assert one.shortfall(harder, needed) > 0
    assert one.in_si(one.in_unit(needed)) == pytest.approx(needed, rel=1e-15)


@pytest.mark.parametrize("shape", [Segment(2.0), Arc(0.5), Disk.of_ceiling(2.0, 1.0, 0.0), Disk.of_ceiling(1.6, -1.0, 1.0)], ids=str)
def test_what_is_clear_of_a_set_is_outside_it(shape: ExcludedSet):
    """Boxes of ln|L| and arg L: none is clear that holds a point of the set, and nothing smaller than `smallest` is in it."""
    rng = np.random.default_rng(7)
    log_low, phase_low = rng.uniform(-2, 1.5, 4000), rng.uniform(-7, 7, 4000)
    boxes = Boxes(log_low, log_low + rng.uniform(0, 0.6, 4000), phase_low, phase_low + rng.uniform(0, 0.8, 4000))
    clear = shape.clear(boxes)
    points = [
        np.exp(low + x * (high - low) + 1j * (first + y * (last - first)))
        for low, high, first, last in (np.stack([boxes.log_low, boxes.log_high, boxes.phase_low, boxes.phase_high], axis=1))
        for x, y in ((0.0, 0.0), (0.5, 0.5), (1.0, 0.2), (0.3, 1.0))
    ]
    least = shape.distance(np.array(points)).reshape(-1, 4).min(axis=1)
    assert np.all(least[clear] > -1e-6)
    assert 0.2 < clear.mean() < 0.99
    assert shape.distance(np.array([-0.999 * shape.smallest + 0j]))[0] > 0
    assert shape.distance(np.array([-1 + 0j]))[0] <= 0


@dataclass(frozen=True)
class Boxes:
    log_low: np.ndarray
    log_high: np.ndarray
    phase_low: np.ndarray
    phase_high: np.ndarray

    def apart(self) -> np.ndarray:
        turns = np.array([-3, -1, 1, 3])[:, None] * pi
        return np.maximum(0.0, np.maximum(self.phase_low - turns, turns - self.phase_high)).min(axis=0)


def test_a_disk_is_where_the_ceiling_is_broken():
    """Apollonius: on its edge |a S + b| is the ceiling."""
    for ceiling, slope, offset in ((2.0, 1.0, 0.0), (1.3, -1.0, 1.0), (2.5, 2.0, -1.0)):
        disk = Disk.of_ceiling(ceiling, slope, offset)
        edge = disk.center + disk.radius * np.exp(1j * np.linspace(0, 6, 9))
        assert np.abs(slope / (1 + edge) + offset) == pytest.approx(np.full(9, ceiling), rel=1e-12)


def test_a_set_of_requirements():
    usual = Requirements.usual()
    assert str(usual) == "gain margin ≥ 6 dB, phase margin ≥ 30°, Ms ≤ 2"
    assert usual == Requirements(usual.gain_margin, usual.phase_margin, usual.peak_sensitivity)
    assert usual != Requirements()
    more = Requirements(peak_sensitivity=1.8, delay_margin=4e-3)
    assert more.asked == ("peak_sensitivity", "delay_margin")
    assert more.gain_margin is None
    assert more.delay_margin == 4e-3
    assert pickle.loads(pickle.dumps(more)) == more
    assert more.only("delay_margin").needed == {"delay_margin": 4e-3}
    assert more.tightened(0.01).delay_margin == pytest.approx(4.04e-3)
    with pytest.raises(AttributeError):
        more.rise_time  # noqa: B018
    with pytest.raises(gr.GainroomError, match="rise_time is unknown; there are gain_margin"):
        Requirements(rise_time=0.1)
    with pytest.raises(gr.GainroomError, match="delay_margin -1 must be > 0"):
        Requirements(delay_margin=-1)
    assert log(2) == pytest.approx(Requirements(peak_sensitivity=2.0).shortfall(found(peak_sensitivity=4.0)))


@pytest.mark.parametrize(("ki", "way"), [(20_000.0, -1), (100.0, 1)])
def test_the_frequency_of_a_gain_margin_is_that_of_its_nearer_end(ki: float, way: int):
    """There L is real and −1/g, g the factor that is shown: below 1 where, with integral gain, lower gains are unstable sooner."""
    loop = gr.build_loop(gr.ElasticJoint(1.0, 16.0, 1e4, 1.0), gr.Drive(4000.0, 0.9, 1e-3), gr.PID(1600.0, ki, 300.0))
    found, one = gr.margins(loop), REQUIREMENTS["gain_margin"]
    assert one.value(found) == pytest.approx({1: found.gain_margin, -1: 1 / found.lower_gain_margin}[way])
    assert loop.response(one.frequency(found))[0] == pytest.approx(-(one.value(found) ** -way), rel=1e-6)
    alone = replace(found.one_loop, gain_margin=np.array([1.01]))
    assert np.isnan(one.frequency(replace(found, one_loop=alone)))  # of one loop by itself none is known


def found(**values: float) -> Any:
    """Margins that tell these alone."""
    return type("Found", (), {"stable": True, **values})()


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"phase_margin": 30}, ["phase_margin 30", "> 0 and < 3.142 rad", "numpy.radians(30) is 30°"]),
        ({"gain_margin": 0.5}, ["gain_margin 0.5", "> 1, a factor", "10**(6 / 20) is 6 dB"]),
        ({"delay_margin": 0.0}, ["delay_margin 0.0", "> 0 s"]),
    ],
)
def test_a_value_that_cannot_be_asked_for_is_told_in_its_unit(asked: dict[str, float], words: list[str]):
    assert_refused(lambda: gr.Requirements(**asked), words)
    for name in (*asked, "factor", "[rad]", "[s]"):
        assert name in (gr.Requirements.__doc__ or "")
