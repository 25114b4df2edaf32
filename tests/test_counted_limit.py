"""Limits that are proved on from the gains themselves: integrators, gravity, gain matrices. Parts and answers against other truths."""

import math
from collections.abc import Callable

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.gain_directions import gain_directions
from gainroom.analysis.low_frequency_proof import MOST, _lowest_corner, low_frequency_proof
from gainroom.analysis.modal_loop import ModalLoop
from gainroom.analysis.proved_limit import _quiet, _unstable_roots, proved_limit
from independent.delay_roots import count_unstable
from independent.joint import PDJoint
from independent.loci.limit import coupled_limit
from independent.loci.loci import Sweep
from independent.machine import unstable
from machines import Pair, chain, directed, hard, holding
from test_coupled_population import Found, look_at_limit

POPULATION, SHARE, SEED = 1000, 6, 515
DRAWS = (holding, directed, hard, chain)
Draw = Callable[[int, int], Pair]


def judged(pair: Pair, wrong: list[str]) -> bool | None:
    """Roots counted on both sides of both ends; whether a limit was proved, None of loops that are not stable, or no proof is known for.

    Limbs that hang, damped by nothing but gearboxes that hardly turn, to a ratio below 1e-6, are mostly left to loci.
    """
    found, limit = Found(), proved_limit(pair.loop)
    if limit is None:
        modal = ModalLoop.of(pair.loop)
        undamped = modal is not None and np.any(np.abs(modal.modes.poles.real) < 1e-6 * np.abs(modal.modes.poles))
        return None if modal is None or undamped or unstable(pair.machine) else False
    if not limit.stable or unstable(pair.machine):
        wrong.append(f"{pair.kind}: not stable")
    look_at_limit(pair, limit, found)
    if limit.gain == math.inf and any(unstable(pair.machine.scaled(factor)) for factor in (3.0, 30.0, 900.0)):
        found.wrong.append("no upper limit: there is one")
    wrong += [f"{pair.kind}: {text}" for text in found.wrong]
    return True


@pytest.mark.parametrize("number", range(SHARE))
@pytest.mark.parametrize("draw", DRAWS)
def test_limits(draw: Draw, number: int):
    wrong: list[str] = []
    judged(draw(SEED, number), wrong)
    assert not wrong


@pytest.mark.population
@pytest.mark.parametrize("draw", DRAWS)
def test_limits_of_the_population(draw: Draw):
    """None is wrong, and 9 of 10 are proved, 7 of 10 where gearboxes hardly damp; loci decide the others."""
    wrong: list[str] = []
    known = [judged(draw(SEED, number), wrong) for number in range(POPULATION)]
    proved = [one for one in known if one is not None]
    print(f"\n{draw.__name__}: {sum(proved)} of {len(proved)} proved, {len(wrong)} wrong")
    assert not wrong, "\n".join(wrong)
    assert np.mean(proved) > (0.7 if draw is hard else 0.9)


@pytest.mark.slow
@pytest.mark.parametrize("draw", DRAWS)
def test_they_are_the_limits_from_loci(draw: Draw):
    """To 1e-7, as in test_proved_limit.py, where loci have not taken the next crossing, which may be as far as roots are counted: 1e-6.

    Limits at rest to 1e-6, too: loci read them off at a low frequency.
    """
    compared = 0
    for number in range(16):
        loop = draw(SEED + 1, number).loop
        found = proved_limit(loop)
        if found is None:
            continue
        compared += 1
        limit = coupled_limit(Sweep(loop, 1e3, for_limit=True))
        assert found.stable
        assert limit.stable
        assert found.gain == limit.gain or -1e-6 < found.gain / limit.gain - 1 < 1e-7
        assert (
            found.lower_gain == limit.lower_gain
            or -(1e-6 if found.lower_frequency == 0 else 1e-7) < found.lower_gain / limit.lower_gain - 1 < 1e-6
        )
    assert compared > 2


@pytest.mark.slow
@pytest.mark.parametrize("draw", DRAWS)
def test_modes_are_eigenvectors(draw: Draw):
    """L m = −m/g at the limit, of all n joints, also where channels are directions: to 1e-8 of m."""
    seen = 0
    for number in range(16):
        loop = draw(SEED + 2, number).loop
        found = proved_limit(loop)
        if found is not None and math.isfinite(found.gain) and found.frequency > 0:
            seen += 1
            response = loop.scaled(found.gain).response(np.array([found.frequency]))[0]
            assert np.linalg.norm(response @ found.mode + found.mode) < 1e-8 * np.linalg.norm(found.mode)
    assert seen > 2


@pytest.mark.slow
@pytest.mark.parametrize("count", [30, pytest.param(60, marks=pytest.mark.population)])
@pytest.mark.parametrize("draw", DRAWS)
def test_the_turns_of_the_determinant_count_the_unstable_roots(draw: Draw, count: int):
    """Also of loops that have some: from gains that are up to 10 times too high or too low."""
    counts = []
    for number in range(count):
        pair = draw(SEED + 3, number).scaled(float(np.exp(np.random.default_rng(number).uniform(-2.3, 2.3))))
        modal = ModalLoop.of(pair.loop)
        rest = None if modal is None else low_frequency_proof(modal, 1.001)
        if modal is None or rest is None or rest.static is not None:
            continue
        high = _quiet(modal, 1.001)
        found = None if high is None else modal.crossings(1.0, 1.001, rest.low, high, counting=True)
        if found is not None:
            counts.append(_unstable_roots(modal, found, rest, pair.loop.unstable_poles))
            assert counts[-1] == unstable(pair.machine)
    assert len(counts) > count / 4
    assert len(set(counts)) > 2


@pytest.mark.slow
@pytest.mark.parametrize("draw", DRAWS)
def test_at_rest(draw: Draw):
    """Below `low` no factor on the way puts a root at jω, and det F turns as is said, up to 2 % for what lies below the first sample."""
    seen = 0
    for number in range(24):
        modal = ModalLoop.of(draw(SEED + 4, number).loop)
        for stop in (10.0, 0.1):
            rest = None if modal is None else low_frequency_proof(modal, stop)
            if modal is None or rest is None:
                continue
            seen += 1
            stop = stop if rest.static is None else rest.static.gain
            omega = rest.low * np.geomspace(1e-3, 1.0, 200)
            mobility, laws = modal.response(omega)
            factors = 1 / np.geomspace(1.0, stop * (1 - 1e-3 if stop > 1 else 1 + 1e-3), 40)
            scale = 1 / np.sqrt(np.abs(laws[:, :, None] * laws[:, None]))
            forms = scale * mobility
            # a root on the boundary is an eigenvalue −1/u of D^½ Q D^½, real and between
            values = np.linalg.eigvals(forms * (scale * np.sqrt(laws[:, :, None] * laws[:, None])).conj())
            near = np.abs(values[:, :, None] + factors)
            assert np.all(near.min(axis=2) > 1e-9 * np.abs(values))
            own = laws * np.diagonal(scale, axis1=1, axis2=2)
            signs = np.linalg.slogdet(forms + np.einsum("ki,ij->kij", own, np.eye(laws.shape[1])))[0]
            turned = np.angle(signs[1:] * signs[:-1].conj()).sum() / modal.folds
            if np.linalg.cond(modal.modes.rigid) < 1e6:  # else what springs hold is drowned in round-off there
                assert turned == pytest.approx(rest.turned, rel=0.03, abs=1e-5)
    assert seen > 10


def held(numerator: float, poles: list[complex], late: float, step: float, z: np.ndarray) -> np.ndarray:
    """numerator/Π (s − p), torque held and `late`, by less than a tick, at z: its sampled step response (Åström and Wittenmark 2.3)."""
    total = np.zeros_like(z)
    for k, pole in enumerate([0.0, *poles]):
        weight = numerator / np.prod([pole - other for m, other in enumerate([0.0, *poles]) if m != k])
        total += weight * np.exp(pole * (step - late)) / (z - np.exp(pole * step))
    return (1 - 1 / z) * total


@pytest.mark.slow
@pytest.mark.parametrize("draw", [holding, directed, hard])
def test_nothing_grows_about_rest_by_more_than_is_said(draw: Draw):
    """On the circle |s| = R/2, where analytic functions are largest: every mode's response and every 1/c, against MOST of those at 0."""
    grown = []
    for number in range(24):
        loop = draw(SEED + 6, number).loop
        modal = ModalLoop.of(loop)
        if modal is None or np.any(modal.laws.at_rest()[1] > 1):
            continue
        corner, drive, step = _lowest_corner(modal), loop.parts.drives[0], loop.sample_time
        s = 0.5 * corner * np.exp(2j * np.pi * np.arange(64) / 64)
        v = s if step is None else np.expm1(s * step) / step
        partners = modal.modes.partners if len(modal.modes.partners) else [None] * len(modal.modes.poles)
        still = modal.modes.at_rest
        for pole, partner, at_0 in zip(modal.modes.poles, partners, still, strict=True):
            poles = [pole] if partner is None else [pole, partner]
            if step is None:
                values = 1 / np.prod([s - one for one in poles], axis=0)
            else:
                wide, ratio = drive.bandwidth, drive.damping_ratio
                fast = [] if math.isinf(wide) else [wide * (-ratio + way * np.emath.sqrt(ratio**2 - 1)) for way in (1, -1)]
                values = held(wide**2 if fast else 1.0, poles + fast, math.fmod(drive.delay, step), step, 1 + v * step)
            grown.append(float(np.abs(values / at_0).max()))
        at, orders = modal.laws.at_rest()
        ends = np.cumsum(modal.laws.counts, axis=0)
        for i, (gain, counts) in enumerate(zip(modal.laws.gains, modal.laws.counts, strict=True)):
            zeros, poles = (
                all_[end - count : end] for all_, end, count in zip((modal.laws.zeros, modal.laws.poles), ends[i], counts, strict=True)
            )
            law = gain * np.prod(v[:, None] - zeros, axis=1) / np.prod(v[:, None] - poles, axis=1) * np.exp(-s * modal.late[i])
            grown.append(float(np.abs(at[i] / law).max()) / (corner if orders[i] else 1.0))
    assert len(grown) > 100
    assert 1 < max(grown) < MOST


def test_laws_turn_as_their_arguments_do():
    """Σ of terms against unwrapped samples of c: zeros and poles on either side, integrators, delays are not in it."""
    for number in range(12):
        modal = ModalLoop.of(holding(SEED + 5, number).loop)
        if modal is None:
            continue
        omega = np.geomspace(1e-3, modal.last or 1e4, 4000)
        weight = omega**2 if modal.last is None else (2 * modal.last / np.pi * np.sin(0.5 * np.pi * omega / modal.last)) ** 2
        laws = weight[:, None] / modal.core.responses(omega)[1] * np.exp(1j * omega[:, None] * modal.late)
        step = None if modal.last is None else np.pi / modal.last
        turned = np.unwrap(np.angle(laws), axis=0)
        assert np.allclose(turned[-1] - turned[0], modal.laws.turned(omega[-1], step) - modal.laws.turned(omega[0], step), atol=1e-9)


@pytest.mark.parametrize("symmetric", [True, False])
def test_gain_matrices_have_directions(symmetric: bool):
    """Random X and Y of all ranks, some gains in equal ratios: the product is the matrix again, and D for D the roots are the same."""
    for seed in range(40):
        rng = np.random.default_rng([SEED, seed])
        size = int(rng.integers(2, 9))
        rank = int(rng.integers(1, size + 1))
        torque = rng.normal(size=(size, rank))
        measured = torque.T if symmetric else rng.normal(size=(rank, size))
        unit = 10 ** rng.uniform(-5, 5, size)  # of each joint
        torque, measured = unit[:, None] * torque, measured * unit
        terms = {}
        for powers in ((0, 0), (1, 0), (0, 1))[: 2 + seed % 2]:
            gains = rng.uniform(0.5, 2.0, rank)
            gains[: rank // 2] = gains[0]
            terms[powers] = torque @ (gains[:, None] * measured)
        found = gain_directions(terms, unit)
        assert found is not None
        assert found.symmetric == (symmetric or size == 1)
        assert found.torque.shape == (size, rank)
        for powers, gain in terms.items():
            product = found.torque @ (found.gains[powers][:, None] * found.measured)
            alike, right = (each / (unit[:, None] * unit) for each in (product, gain))
            assert np.allclose(alike, right, atol=1e-10 * np.abs(right).max())


def test_gain_matrices_without_common_directions_have_none():
    rng = np.random.default_rng(SEED)
    one, two, three = (root @ root.T for root in rng.normal(size=(3, 4, 4)))
    assert gain_directions({(0, 0): one, (1, 0): two}, np.ones(4)) is not None
    assert gain_directions({(0, 0): one, (1, 0): two, (0, 1): three}, np.ones(4)) is None
    turning = np.array([[1.0, -1.0], [1.0, 1.0]])
    assert gain_directions({(0, 0): turning, (1, 0): np.eye(2)}, np.ones(2)) is None
    idle = gain_directions({(0, 0): one, (1, 0): two, (0, 1): np.zeros_like(one)}, np.ones(4))  # as a P/PI cascade without ki has it
    assert idle is not None
    assert not idle.gains[0, 1].any()
    assert gain_directions({(0, 0): np.zeros_like(one)}, np.ones(4)) is None


@pytest.mark.parametrize("sample_time", [None, 1e-3])
@pytest.mark.parametrize("rank", [2, 4])
@pytest.mark.parametrize("symmetric", [True, False])
def test_gain_matrices_in_any_units(symmetric: bool, rank: int, sample_time: float | None):
    """The same robot with joints in units that are up to 1e4 apart has the same limit and verdict; tasks of fewer directions, too."""
    for seed in range(4):
        rng = np.random.default_rng([SEED, seed])
        root, task = rng.normal(size=(2, 4, 4))
        torque = task[:, :rank]
        measured = torque.T if symmetric else torque.T + 0.1 * rng.normal(size=(rank, 4))
        kd = torque @ np.diag(rng.uniform(5.0, 15.0, rank)) @ measured
        kp = 10 * torque @ np.diag(rng.uniform(5.0, 15.0, rank)) @ measured
        own = np.linalg.inv(root @ root.T / 4 + np.eye(4)), rng.uniform(0.5, 2.0, 4), rng.uniform(7e3, 15e3, 4), rng.uniform(1.0, 2.0, 4)
        limits = []
        for unit in (np.ones(4), 10 ** rng.uniform(-2, 2, 4)):
            inverse, *diagonal = own
            plant = gr.Plant(inverse / (unit[:, None] * unit), *(unit**2 * one for one in diagonal))
            controller = gr.PD(kp * (unit[:, None] * unit), kd * (unit[:, None] * unit))
            limits.append(gr.gain_limit(gr.build_loop(plant, gr.Drive(4000.0, 0.9, 1.5e-3), controller, sample_time=sample_time)))
        assert limits[1].stable == limits[0].stable
        assert limits[1].gain == pytest.approx(limits[0].gain, rel=1e-8)
        assert limits[1].frequency == pytest.approx(limits[0].frequency, rel=1e-8, nan_ok=True)


def test_gain_matrices_of_joints_too_far_apart_are_refused():
    """Their limits were certified, and wrong by up to a fifth; each joint's own gains in any units are fine."""
    unit = np.array([1.0, 3e6])
    plant = gr.Plant(np.eye(2) / unit**2, 0.5 * unit**2, 1e4 * unit**2, 2.0 * unit**2)
    coupled = np.array([[2.0, 0.5], [0.5, 2.0]]) * (unit[:, None] * unit)
    drive = gr.Drive(4000.0, 0.9, 2e-3)
    with pytest.raises(gr.GainroomError, match=r"gain matrices: joints with inertias from 0\.5 to 4\.5e\+12 .* at most 1e\+10 apart"):
        gr.build_loop(plant, drive, gr.PD(100 * coupled, 10 * coupled))
    own = gr.gain_limit(gr.build_loop(plant, drive, gr.PD(200 * unit**2, 20 * unit**2)))
    alike = gr.Plant(np.eye(2), np.full(2, 0.5), np.full(2, 1e4), np.full(2, 2.0))
    assert own.gain == pytest.approx(gr.gain_limit(gr.build_loop(alike, drive, gr.PD(200.0, 20.0))).gain, rel=1e-9)


def test_a_pendulum_that_topples():
    """Two joints upright, of gravity stiffness −g each, held by kp through a rigid gearbox: below γ kp = g both fall, exactly there."""
    plant = gr.Plant(np.diag([1.0, 0.5]), np.array([0.3, 0.2]), np.inf, gravity_stiffness=np.diag([-40.0, -30.0]))
    loop = gr.build_loop(plant, gr.Drive(4000.0, 0.9, 1e-3), gr.PD(np.array([100.0, 90.0]), np.array([10.0, 8.0])))
    found = proved_limit(loop)
    assert found is not None
    assert found.lower_gain == pytest.approx(0.4, rel=1e-12)
    assert found.lower_frequency == 0
    assert np.abs(found.mode[0]) <= 1
    assert found.certified


def test_an_integral_needs_gains():
    """A rigid inertia J under PID, little delay: J s³ + γ (kd s² + kp s + ki) is stable above γ = J ki/(kd kp) (Routh)."""
    inertia, kp, ki, kd = np.array([2.0, 3.0]), 200.0, 400.0, 20.0
    plant = gr.Plant(np.diag(1 / (inertia - 0.5)), np.full(2, 0.5))
    found = proved_limit(gr.build_loop(plant, gr.Drive(delay=1e-9), gr.PID(kp, ki, kd)))
    assert found is not None
    assert found.lower_gain == pytest.approx(3.0 * ki / (kd * kp), rel=1e-6)  # what 1e-9 s change at 4 rad/s
    assert found.lower_frequency == pytest.approx(math.sqrt(ki / kd), rel=1e-6)


@pytest.mark.parametrize("gain", [6.5, 14.0, 30.0, 139.0])
@pytest.mark.parametrize("count", [3, 6])
def test_joints_that_do_not_feel_each_other_have_each_ones_roots(gain: float, count: int):
    """So many times the roots of one joint at the whole delay, counted in exact fractions; half of it comes on top of the loop's own.

    Where the sweep ends the loci have up to half the size at which one could reach −1, and what is left of their turns adds up.
    """
    plant = gr.Plant(np.eye(count) / 0.8, np.full(count, 0.2), np.full(count, 1e4), np.full(count, 1.0))
    loop = gr.build_loop(plant, gr.Drive(delay=1e-3), gr.PD(1000.0, 20.0))
    alone = count_unstable(PDJoint(0.2, 0.8, 1e4, 1.0, 1000.0 * gain, 20.0 * gain, 2e-3))
    assert Sweep(loop, highest=gain).unstable(gain, delay=1e-3) == count * alone
