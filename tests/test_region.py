"""The PD region: closed forms, the verdict and the margins of single loops, and boundaries that lie where they claim."""

from dataclasses import replace
from itertools import pairwise
from math import atan, cos, inf, pi, sin, sqrt, tan

import numpy as np
import pytest
from scipy.optimize import brentq

import gainroom as gr
from draws import Setup, draw_setup, seeds
from gainroom.analysis.stability import scan_loop, unstable_roots
from refusals import assert_refused

REQUIREMENTS = {
    "stable": {},
    "gain margin": {"gain_margin": 2.0},
    "phase margin": {"phase_margin": 0.5},
    "sensitivity": {"peak_sensitivity": 2.0},
    "all": {"gain_margin": 1.8, "phase_margin": 0.45, "peak_sensitivity": 2.2},
}


def kept(setup: Setup, kp: float, kd: float, asked: dict[str, float], slack: float) -> bool:
    """Whether one loop is stable and keeps every margin, each made harder (slack > 0) or easier by that share."""
    loop = replace(setup, controller=replace(setup.controller, **gains_in_plane(setup.controller, kp, kd))).loop()
    if kp == 0 and kd == 0:
        return False
    harder = 1 + slack
    gain_margin, phase_margin, peak = (asked.get(name) for name in ("gain_margin", "phase_margin", "peak_sensitivity"))
    scan = scan_loop(loop, with_peaks=peak is not None)
    if unstable_roots(loop, scan):
        return False
    factors = np.exp(np.abs(np.log(np.maximum(scan.phases[:, 1], 1e-300))))  # up or down to L = −1
    turns = np.abs(np.remainder(scan.gains[:, 1], 2 * pi) - pi)
    keeps = gain_margin is None or np.all(factors >= gain_margin * harder)
    keeps &= phase_margin is None or np.all(turns >= phase_margin * harder)
    return bool(keeps and (peak is None or harder / scan.peaks[0, 1] <= peak))


def gains_in_plane(controller, kp: float, kd: float) -> dict[str, float]:
    """The controller's own gains at a point of the plane: ki/kp of a PID and ki/kv of a PPI are held."""
    if isinstance(controller, gr.PD):
        return {"kp": kp, "kd": kd}
    if isinstance(controller, gr.PID):
        return {"kp": kp, "kd": kd, "ki": controller.ki / controller.kp * kp}
    return {"kp": kp / kd, "kv": kd, "ki": controller.ki / controller.kv * kd}


def region_of(setup: Setup, asked: dict[str, float]) -> gr.PDRegion:
    return gr.pd_region(
        setup.joint, setup.drive, feedback=setup.feedback, sample_time=setup.sample_time, controller=setup.controller, **asked
    )


def window(region: gr.PDRegion) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the region's boundary, or of the stable one where the requirements leave nothing."""
    corners = np.vstack(region.boundary)
    return corners.min(axis=0), corners.max(axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("asked", REQUIREMENTS.values(), ids=REQUIREMENTS.keys())
@pytest.mark.parametrize("sampled", [False, True], ids=["continuous", "sampled"])
@pytest.mark.parametrize("kind", ["PD", "PID", "PPI"])
@pytest.mark.parametrize("seed", seeds(1, 2))
def test_membership_is_the_verdict_on_the_loop(seed, kind, sampled, asked):
    """Random gains in and around the region; both answers are exact, so only a hair's breadth at the boundary may differ."""
    rng = np.random.default_rng([1, seed, sampled])
    setup = draw_setup(rng, sampled, controller=kind, feedback="motor")
    stable = region_of(setup, {})
    assert stable.boundary
    low, high = window(stable)
    region = region_of(setup, asked)
    points = rng.uniform(low - 0.1 * (high - low), high + 0.1 * (high - low), size=(12, 2))
    answers = region.contains(points[:, 0], points[:, 1])
    for (kp, kd), inside in zip(points.tolist(), answers.tolist(), strict=True):
        if inside:
            assert kept(setup, kp, kd, asked, -1e-6), (kp, kd)
        else:
            assert not kept(setup, kp, kd, asked, 1e-6), (kp, kd)


@pytest.mark.slow
@pytest.mark.parametrize("asked", REQUIREMENTS.values(), ids=REQUIREMENTS.keys())
@pytest.mark.parametrize("sampled", [False, True], ids=["continuous", "sampled"])
@pytest.mark.parametrize("seed", seeds(2, 3))
def test_boundary_points_lie_on_the_boundary(seed, sampled, asked):
    """Just inside every vertex the requirements hold, just outside along kd they do not: 1e-6 of the region's height to either side."""
    setup = draw_setup(np.random.default_rng([2, seed, sampled]), sampled, controller="PD", feedback="motor")
    region = region_of(setup, asked)
    whole = max((np.ptp(line[:, 1]) for line in region.boundary), default=0.0)
    for line in region.boundary:
        assert line[0] == pytest.approx(line[-1], rel=1e-12)
        height = np.ptp(line[:, 1])
        assert height > 1e-6 * whole  # no slivers
        vertices = line[1:-1:41]
        sides = region.contains(vertices[:, :1], vertices[:, 1:] + 1e-6 * height * np.array([1.0, -1.0]))
        for (kp, kd), (above, below) in zip(vertices, sides, strict=True):
            assert (
                above != below
                or abs(kp - line[:, 0].min()) < 1e-6 * np.ptp(line[:, 0])
                or abs(kp - line[:, 0].max()) < 1e-6 * np.ptp(line[:, 0])
            )
            inward = 1e-6 * height if above else -1e-6 * height
            if above != below:
                assert kept(setup, kp, kd + inward, asked, -1e-9)
                assert not kept(setup, kp, kd - inward, asked, 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("requirement", ["gain_margin", "phase_margin", "peak_sensitivity"])
@pytest.mark.parametrize("sample_time", [None, 5e-4])
def test_on_the_boundary_the_margin_is_the_requirement(requirement, sample_time):
    asked = {requirement: {"gain_margin": 2.0, "phase_margin": 0.5, "peak_sensitivity": 2.0}[requirement]}
    joint, drive = gr.ElasticJoint(1.0, 16.0, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3)
    region = gr.pd_region(joint, drive, sample_time=sample_time, **asked)
    for kp in np.linspace(0.1, 0.9, 5) * region.max_kp():
        found = gr.margins(gr.build_loop(joint, drive, gr.PD(kp, region.max_kd(kp) * (1 - 1e-12)), sample_time=sample_time))
        reached = {
            "gain_margin": min(found.gain_margin, 1 / max(found.lower_gain_margin, 1e-300)),
            "phase_margin": abs(found.phase_margin),
            "peak_sensitivity": found.peak_sensitivity,
        }[requirement]
        assert reached == pytest.approx(asked[requirement], rel=1e-6)


# --- closed forms -----------------------------------------------------------------------------------------------------


def rigid(delay: float, inertia: float = 1.7) -> gr.PDRegion:
    return gr.pd_region(gr.ElasticJoint(0.3 * inertia, 0.7 * inertia), gr.Drive(delay=delay))


@pytest.mark.parametrize("delay", [1e-5, 3e-3, 0.5])
@pytest.mark.parametrize("angle", [1.08, 1.2, 1.4, 1.57])
def test_max_kd_of_a_rigid_joint(delay, angle):
    """kp = Jω² cos ωT, kd = Jω sin ωT; beyond ωT = 1.0769 it is the upper branch."""
    kp, kd = (1.7 * (angle / delay) ** 2 * cos(angle), 1.7 * angle / delay * sin(angle))
    assert rigid(delay).max_kd(kp) == pytest.approx(kd, rel=1e-10)


@pytest.mark.parametrize("delay", [1e-5, 3e-3, 0.5])
def test_max_kp_of_a_rigid_joint(delay):
    angle = brentq(lambda x: x * np.tan(x) - 2, 0.5, 1.5, xtol=1e-15)
    assert rigid(delay).max_kp() == pytest.approx(1.7 * (angle / delay) ** 2 * cos(angle), rel=1e-10)


def test_gain_margin_of_a_rigid_joint():
    """A gain margin g shrinks the upper branch by g: the boundary of L = −1/g."""
    delay, margin = 3e-3, 2.0
    region = gr.pd_region(gr.ElasticJoint(0.51, 1.19), gr.Drive(delay=delay), gain_margin=margin)
    for angle in (1.2, 1.4, 1.55):
        kp, kd = 1.7 * (angle / delay) ** 2 * cos(angle) / margin, 1.7 * angle / delay * sin(angle) / margin
        assert region.max_kd(kp) == pytest.approx(kd, rel=1e-9)


def test_rigid_joint_without_delay_takes_everything():
    region = gr.pd_region(gr.ElasticJoint(0.5, 0.5), gr.Drive())
    assert region.contains([1e-6, 1.0, 1e9], [1e-6, 3.0, 1e6]).tolist() == [True] * 3
    assert not np.any(region.contains([-1.0, 1.0, 0.0, 1.0], [1.0, -1.0, 1.0, 0.0]))
    assert region.max_kd(10.0) == inf
    assert region.max_kp() == inf


def test_rigid_joint_with_a_current_loop():
    """J s² (s² + 2ζω s + ω²)/ω² + kd s + kp, Routh: kd < 2ζωJ, kp < kd (2ζωJ − kd) ω/(2ζ)² /(Jω) …"""
    inertia, bandwidth, zeta = 1.0, 200.0, 0.9
    region = gr.pd_region(gr.ElasticJoint(0.4, 0.6), gr.Drive(bandwidth, zeta))
    # s⁴ + a s³ + b s² + b kd s + b kp with a = 2ζω, b = ω² (J = 1): stable for a b · b kd > (b kd)² + a² b kp
    a, b = 2 * zeta * bandwidth, bandwidth**2
    for kp in (1.0, 500.0, 5000.0):
        largest = (a * inertia + sqrt(a * a - 4 * a * a * kp / b)) / 2
        assert region.max_kd(kp) == pytest.approx(largest, rel=1e-10)
    assert region.max_kp() == pytest.approx(b / 4, rel=1e-9)


def test_sampled_rigid_joint_without_delay():
    """J = 1, hold, backward difference: z (z − 1)² + (T²/2)(z + 1)(kp z + (kd/T)(z − 1)); the limit by Jury's test."""
    step = 1e-2
    region = gr.pd_region(gr.ElasticJoint(0.4, 0.6), gr.Drive(), sample_time=step)
    kp = 50.0

    def radius(kd: float) -> float:
        closed = np.polyadd([1.0, -2.0, 1.0, 0.0], step**2 / 2 * np.polymul([1.0, 1.0], [kp + kd / step, -kd / step]))
        return np.abs(np.roots(closed)).max() - 1

    largest = brentq(radius, 60.0, 400.0, xtol=1e-13)
    assert region.max_kd(kp) == pytest.approx(largest, rel=1e-9)


def test_contains_broadcasts():
    region = rigid(3e-3)
    kp, kd = np.linspace(-50, 2e5, 7)[:, None], np.linspace(-10, 900, 5)
    answers = region.contains(kp, kd)
    assert answers.shape == (7, 5)
    assert answers[3, 2] == region.contains(float(kp[3, 0]), float(kd[2]))
    assert np.ndim(region.max_kd(10.0)) == 0
    assert region.max_kd([10.0, 20.0]).shape == (2,)
    assert np.isnan(region.max_kd(-10.0))


@pytest.mark.parametrize("requirement", ["gain_margin", "phase_margin", "peak_sensitivity"])
def test_stricter_is_smaller(requirement):
    joint, drive = gr.ElasticJoint(0.2, 0.8, 1e4, 1.0), gr.Drive(4000.0, 0.9, 2e-3)
    values = {"gain_margin": [1.2, 2.0, 4.0], "phase_margin": [0.1, 0.5, 0.9], "peak_sensitivity": [4.0, 2.0, 1.5]}[requirement]
    regions = [gr.pd_region(joint, drive, **{requirement: value}) for value in values]
    kp, kd = np.meshgrid(np.linspace(1, 4000, 60), np.linspace(1, 100, 60))
    inside = [region.contains(kp, kd) for region in (gr.pd_region(joint, drive), *regions)]
    for larger, smaller in pairwise(inside):
        assert not np.any(smaller & ~larger)


def test_nothing_meets_the_impossible():
    """Link-side feedback around an undamped spring, no delay: the resonance is driven whatever the gains."""
    region = gr.pd_region(gr.ElasticJoint(0.2, 0.8, 1e4, 0.0), gr.Drive(), feedback="link")
    assert region.boundary == ()
    assert np.isnan(region.max_kp())
    assert np.isnan(region.max_kd(10.0))
    assert not region.contains(10.0, 1.0)


def test_delay_opens_a_window_for_link_side_feedback():
    """The delay must turn the PD's lead into lag at the resonance ω but not at low frequency: T < kd/kp < tan(ωT)/ω for small gains."""
    delay, resonance, kp = 1e-3, 250.0, 1.0
    joint = gr.ElasticJoint(0.2, 0.8, 1e4, 0.0)
    region = gr.pd_region(joint, gr.Drive(delay=delay), feedback="link")
    (low, high), *others = region.columns(kp)[0]
    assert not others
    # kp/K = 1e-4 shifts both resonances by about as much
    assert (low / kp, high / kp) == (pytest.approx(delay, rel=1e-4), pytest.approx(tan(resonance * delay) / resonance, rel=1e-3))
    assert len(region.boundary) == 1


HARD = [52, 55, 57, 59]  # narrow resonances, zeros of B on the boundary, sets crossed between two samples


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*HARD, *range(200, 206)])
@pytest.mark.parametrize("peak", [1.3, 2.0, 30.0])
def test_sensitivity_is_forbidden_where_a_fine_grid_says_so(seed, peak):
    """Every kp the boundary knows, |1 + L| over 100 000 frequencies and finer still around the least of them."""
    rng = np.random.default_rng([77, seed])
    setup = draw_setup(rng, seed % 2 == 1)
    region = region_of(setup, {"peak_sensitivity": peak})
    kps = region.ladder[region.ladder > 0][rng.integers(0, 115, 4)]
    high = 2e4 if setup.sample_time is None else pi / setup.sample_time
    omega = np.sort(np.concatenate([np.geomspace(1e-12, high, 60_000), np.linspace(1e-12, high, 40_000)]))
    unit, rate = region.scalar(1.0, 0.0).response(omega), region.scalar(0.0, 1.0).response(omega)

    def least(kp: float, kd: float) -> float:
        k = int(np.abs(1 + kp * unit + kd * rate).argmin())
        near = np.linspace(omega[max(k - 1, 0)], omega[min(k + 1, len(omega) - 1)], 500)
        return float(np.abs(1 + region.scalar(kp, kd).response(near)).min())

    for kp, stable, allowed in zip(kps, region_of(setup, {}).columns(kps), region.columns(kps), strict=True):
        for a, b in np.clip(stable, -1e6, 1e6):
            for kd in a + (b - a) * np.append(rng.random(5), [1e-3, 0.999]):
                seen = least(kp, kd) * peak
                if abs(seen - 1) > 1e-3:
                    assert bool(np.any((allowed[:, 0] < kd) & (kd < allowed[:, 1]))) == (seen > 1), (kp, kd, seen)


def test_phase_margin_of_a_rigid_joint_without_delay():
    """Phase margin φ: atan(kd ω/kp) at |L| = 1; kp = kd² cos φ/(J sin² φ)."""
    margin, kd = 0.7, 4.0
    region = gr.pd_region(gr.ElasticJoint(0.4, 0.6), gr.Drive(), phase_margin=margin)
    # kp + j ω kd = −e^{−j(π−φ)} (−ω²)… = ω² e^{jφ}: kp = ω² cos φ, kd = ω sin φ
    omega = kd / sin(margin)
    largest = omega**2 * cos(margin)
    assert region.contains(largest * (1 - 1e-9), kd)
    assert not region.contains(largest * (1 + 1e-9), kd)
    assert atan(kd * omega / largest) == pytest.approx(margin)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: rigid(1e-3).contains(float("nan"), 1.0), ["kp", "nan", "finite"]),
        (lambda: gr.pd_region(gr.ElasticJoint(1, 1), gr.Drive(), gain_margin=0.9), ["gain_margin", "0.9", "> 1"]),
        (lambda: gr.pd_region(gr.ElasticJoint(1, 1), gr.Drive(), phase_margin=0.0), ["phase_margin", "0.0", "> 0"]),
        (lambda: gr.pd_region(gr.ElasticJoint(1, 1), gr.Drive(), phase_margin=pi), ["phase_margin", "3.14", "< 3.14"]),
        (lambda: gr.pd_region(gr.ElasticJoint(1, 1), gr.Drive(), peak_sensitivity=1.0), ["peak_sensitivity", "1.0", "> 1"]),
        (lambda: gr.pd_region(gr.ElasticJoint(1, 1), gr.Drive(), peak_sensitivity=float("nan")), ["peak_sensitivity", "nan"]),
        (lambda: gr.pd_region(gr.Plant(np.eye(2), 0.5), gr.Drive()), ["one joint", "2"]),
        (lambda: gr.pd_region(gr.ElasticJoint(1, 1), gr.Drive(), controller="pd"), ["controller", "str", "PD, PID or PPI"]),
    ],
)
def test_errors(make, words):
    assert_refused(make, words)
