"""The region of gains against the rigid joint's closed form, and against the independent checks at random gains."""

from dataclasses import replace
from math import inf, pi, radians, tan

import numpy as np
import pytest
from scipy.optimize import brentq

import gainroom as gr
from draws import seeds
from independent import margins
from independent.joint import random_joint
from joint_truths import RIGID, is_stable, parts, rigid_boundary, stable_draw


def test_rigid_delay_region():
    region = gr.pd_region(*parts(RIGID))
    for angle in np.linspace(1.1, 1.55, 7):  # kp falls beyond tan x = 2/x, x = 1.0769: the upper branch
        kp, kd = rigid_boundary(angle / RIGID.delay)
        assert region.max_kd(kp) == pytest.approx(kd, rel=1e-10)
    best = brentq(lambda x: x * tan(x) - 2, 0.5, 1.5, xtol=1e-15)
    assert region.max_kp() == pytest.approx(rigid_boundary(best / RIGID.delay)[0], rel=1e-10)


def test_rigid_delay_polyline():
    region = gr.pd_region(*parts(RIGID))
    (line,) = region.boundary
    kp, kd = line[:, 0], line[:, 1]
    top = pi / (2 * RIGID.delay)  # where the curve meets kp = 0; kd = Jω there
    curved = np.abs(kp) > 1e-9 * top**2
    omega = np.sqrt((kd**2 + np.sqrt(kd**4 + 4 * kp**2)) / 2)  # kp² + ω² kd² = J² ω⁴
    assert curved.sum() > 50
    assert kp[curved] == pytest.approx((omega**2 * np.cos(omega * RIGID.delay))[curved], rel=1e-10, abs=1e-10 * top**2)
    assert kd[curved] == pytest.approx((omega * np.sin(omega * RIGID.delay))[curved], rel=1e-10)
    assert kd.min() >= -1e-9 * top
    assert kd.max() == pytest.approx(top, rel=1e-3)  # the polyline ends within a step of the corner


def region_points(region, rng, number: int) -> np.ndarray:
    """Random gains over the region's bounding box, enlarged by a third on every side."""
    corners = np.vstack(region.boundary)
    low, high = corners.min(axis=0), corners.max(axis=0)
    return rng.uniform(low - 0.3 * (high - low), high + 0.3 * (high - low), size=(number, 2))


@pytest.mark.slow
@pytest.mark.parametrize("sample_time", [None, 1e-3], ids=["continuous", "sampled"])
@pytest.mark.parametrize("seed", seeds(5, 12))
def test_region_is_where_the_loop_is_stable(seed, sample_time):
    rng = np.random.default_rng([23, seed])
    joint = random_joint(rng)
    region = gr.pd_region(*parts(joint), feedback=joint.feedback, sample_time=sample_time)
    if not region.boundary:
        sizes = 10.0 ** rng.uniform(-4, 1, size=(40, 1))
        points = rng.uniform(-1, 1, size=(40, 2)) * (abs(joint.kp), abs(joint.kd)) * sizes
    else:
        points = region_points(region, rng, 40)
    inside = region.contains(points[:, 0], points[:, 1])
    expected = [is_stable(replace(joint, kp=float(kp), kd=float(kd)), sample_time) for kp, kd in points]
    assert inside.tolist() == expected


def inside_polygons(polygons, points: np.ndarray) -> np.ndarray:
    """Even-odd rule over closed polylines (m, 2), for points (k, 2)."""
    crossings = np.zeros(len(points), dtype=int)
    for polygon in polygons:
        start, end = polygon, np.roll(polygon, -1, axis=0)
        for (x0, y0), (x1, y1) in zip(start, end, strict=True):
            spans = (x0 > points[:, 0]) != (x1 > points[:, 0])
            if spans.any():
                height = y0 + (points[:, 0] - x0) / (x1 - x0 if x1 != x0 else 1.0) * (y1 - y0)
                crossings += spans & (points[:, 1] < height)
    return crossings % 2 == 1


@pytest.mark.slow
@pytest.mark.parametrize("wanted", [{}, {"gain_margin": 1.8, "phase_margin": radians(25), "peak_sensitivity": 2.5}])
@pytest.mark.parametrize("sample_time", [None, 1e-3], ids=["continuous", "sampled"])
@pytest.mark.parametrize("seed", seeds(2, 3))
def test_boundary_encloses_what_the_region_contains(seed, sample_time, wanted):
    """The polyline is drawn, the membership is exact: they may differ in a sliver along the line only."""
    joint, _ = stable_draw(2 * seed + 1)
    region = gr.pd_region(*parts(joint), feedback=joint.feedback, sample_time=sample_time, **wanted)
    assert region.boundary  # some gains meet this
    points = region_points(region, np.random.default_rng([26, seed]), 500)
    differ = inside_polygons(region.boundary, points) != region.contains(points[:, 0], points[:, 1])
    assert differ.mean() < 5e-3  # two points; a polyline of a few hundred is within 1e-3 of the curve


@pytest.mark.slow
@pytest.mark.parametrize("sample_time", [None, 1e-3], ids=["continuous", "sampled"])
@pytest.mark.parametrize("seed", seeds(3, 6))
def test_region_beside_its_edges(seed, sample_time):
    """Tiny kp of either sign, and kd far outside: where a count of roots is most easily confused."""
    joint, _ = stable_draw(2 * seed + 1)
    region = gr.pd_region(*parts(joint), feedback=joint.feedback, sample_time=sample_time)
    most_kp, most_kd = abs(joint.kp), abs(joint.kd)
    assert not region.contains(np.zeros(3), np.array([-0.1, 0.1, 10.0]) * most_kd).any()  # a root at zero: no spring
    kp = np.repeat([-1e-3, -1e-9, 1e-12, 1e-9, 1e-6, 1e-3, 1.0], 9) * most_kp
    kd = np.tile([-1e3, -10.0, -1.0, -1e-3, 1e-6, 1e-2, 0.3, 10.0, 1e3], 7) * most_kd
    expected = [is_stable(replace(joint, kp=float(p), kd=float(d)), sample_time) for p, d in zip(kp, kd, strict=True)]
    assert region.contains(kp, kd).tolist() == expected


@pytest.mark.slow
@pytest.mark.parametrize("sample_time", [None, 1e-3], ids=["continuous", "sampled"])
@pytest.mark.parametrize("seed", seeds(4, 8))
def test_region_maxima(seed, sample_time):
    """Just inside the largest gains is stable, just outside is not; nothing sampled lies beyond them."""
    joint, _ = stable_draw(2 * seed + 1)
    region = gr.pd_region(*parts(joint), feedback=joint.feedback, sample_time=sample_time)
    largest = region.max_kp()
    if largest > 0:
        kp = 0.4 * largest
        kd = region.max_kd(kp)
        if np.isfinite(kd):
            assert is_stable(replace(joint, kp=kp, kd=kd * (1 - 1e-8)), sample_time)
            assert not is_stable(replace(joint, kp=kp, kd=kd * (1 + 1e-8)), sample_time)
        rng = np.random.default_rng([24, seed])
        widest = 2 * np.vstack(region.boundary)[:, 1].max()
        for kd in rng.uniform(0, widest, size=20):
            assert not is_stable(replace(joint, kp=largest * (1 + 1e-6), kd=kd), sample_time)


REQUIREMENTS = {
    "gain": {"gain_margin": 2.0},
    "phase": {"phase_margin": radians(30)},
    "peak": {"peak_sensitivity": 2.0},
    "all": {"gain_margin": 1.8, "phase_margin": radians(25), "peak_sensitivity": 2.5},
}


@pytest.mark.slow
@pytest.mark.parametrize("sample_time", [None, 1e-3], ids=["continuous", "sampled"])
@pytest.mark.parametrize("wanted", REQUIREMENTS.values(), ids=REQUIREMENTS.keys())
@pytest.mark.parametrize("seed", seeds(2, 3))
def test_required_region_is_where_the_margins_hold(seed, wanted, sample_time):
    joint, _ = stable_draw(2 * seed + 1)
    region = gr.pd_region(*parts(joint), feedback=joint.feedback, sample_time=sample_time, **wanted)
    assert region.boundary  # some gains meet this
    points = region_points(region, np.random.default_rng([25, seed]), 20)
    inside = region.contains(points[:, 0], points[:, 1])
    widest = replace(joint, kp=np.abs(points[:, 0]).min(), kd=np.abs(points[:, 1]).max())  # whose grid covers those of all others
    omega = margins.frequency_grid(widest, sample_time, points=15_000)
    spring, damper = (margins.response(replace(joint, kp=p, kd=d), omega, sample_time) for p, d in ((1.0, 0.0), (0.0, 1.0)))
    near = 0
    for (kp, kd), claimed in zip(points, inside, strict=True):
        case = replace(joint, kp=float(kp), kd=float(kd))
        if not is_stable(case, sample_time):
            assert not claimed
            continue
        seen = margins.margins_on_grid(kp * spring + kd * damper)
        room = [  # > 1: the requirement holds
            seen.gain_margin / wanted.get("gain_margin", 1e-9),
            seen.phase_margin / wanted.get("phase_margin", 1e-9),
            wanted.get("peak_sensitivity", inf) / seen.peak_sensitivity,
        ]
        if abs(min(room) - 1) < 2e-3:  # the grid is good to about 1e-4; these cannot be judged by it
            near += 1
        else:
            assert claimed == (min(room) > 1), (case, seen)
    assert near <= 4  # most of the points must have been judged
