"""What the core sees of coupled loops at a glance (loop_samples.hpp, loop_curves.hpp), against counted roots, all margins, and differences.

A share of the machines of machines.py runs every time, all of them with `pytest -m population`; other draws: GAINROOM_SEED=7.
"""

import math
import os
from dataclasses import dataclass

import numpy as np
import pytest

import gainroom as gr
from gainroom.analysis.loop_samples import WHOLE, Reach, directed_loop, joint_loops, margins_of_samples, take_samples
from gainroom.native import _core
from gainroom.system.linear.arrays import Booleans, Floats
from independent.loci.coupled_margins import coupled_margins
from independent.machine import unstable
from machines import Pair, chain, limbs

SEED = int(os.environ.get("GAINROOM_SEED", "2017"))
SHARE, ALL, BATCHES = 16, 600, 12


@dataclass(frozen=True)
class Directed:
    """L = P X Δ E."""

    torque: Floats
    jacobian: Floats
    cascade: Booleans
    gains: Floats  # (3, m)

    def loop(self, pair: Pair) -> "_core.DirectedLoop":
        return directed_loop(pair.loop, self.torque, self.jacobian, self.cascade)


def directed(pair: Pair) -> Directed | None:
    """The directions along which the gains of a machine act; None for those of a PID, which the search for gains does not have."""
    gains, n = pair.machine.gains, pair.machine.size
    if pair.kind.startswith("pid"):
        return None
    kd = gains[1, 0]
    cascade = (0, 1) in gains
    if np.count_nonzero(kd - np.diag(np.diagonal(kd))):
        values, vectors = np.linalg.eigh(kd)
        kept = values > 1e-9 * values.max()
        torque, jacobian = vectors[:, kept] * values[kept], vectors[:, kept].T.copy()
    else:
        torque, jacobian = np.diag(np.diagonal(kd)), np.eye(n)
    scale = [float(np.trace(part) / np.trace(kd)) for part in (gains[0, 0], gains[(1, 1)] if cascade else 0 * kd)]
    count = torque.shape[1]
    if cascade or not np.allclose(gains[0, 0], scale[0] * kd):
        if not cascade:  # as joints, each with its own
            return Directed(
                np.eye(n), np.eye(n), np.zeros(n, dtype=bool), np.array([np.diagonal(gains[0, 0]), np.diagonal(kd), np.zeros(n)])
            )
        return Directed(torque, jacobian, np.ones(count, dtype=bool), np.outer([scale[0], 1.0, scale[1]], np.ones(count)))
    return Directed(torque, jacobian, np.zeros(count, dtype=bool), np.outer([scale[0], 1.0, 0.0], np.ones(count)))


def machine_of(draw, number: int) -> tuple[Pair, Directed]:
    """Nothing that the search has not: a PID becomes the next number."""
    while True:
        pair = draw(SEED, number)
        found = directed(pair)
        if found is not None:
            return pair, found
        number += 100_000


def scaled(gains: Floats, cascade: Booleans, factor: float) -> Floats:
    """L times `factor`."""
    return gains * np.array([np.where(cascade, 1.0, factor), np.full(len(cascade), factor), np.where(cascade, factor, 1.0)])


def confirm(draw, number: int) -> str:
    """What is wrong, or ""."""
    pair, along = machine_of(draw, number)
    loop = along.loop(pair)
    for factor in (1.0, 0.2, 3.0):
        count = unstable(pair.machine.scaled(factor))
        seen = take_samples(loop, scaled(along.gains, along.cascade, factor), Reach(3.0, 0.7))
        if not seen.followed:
            return "not followed"
        if (seen.unstable > 0) != (count > 0):
            return f"times {factor}: {seen.unstable} unstable roots, counted {count}"
    exact = coupled_margins(pair.loop)  # along loci in Python, not from the core
    if not exact.stable:
        return ""
    found = margins_of_samples(take_samples(loop, along.gains, WHOLE), pair.machine.size)
    narrow = margins_of_samples(take_samples(loop, along.gains, Reach(3.0, 0.7)), pair.machine.size)
    wrong = []

    def same(name: str, value: float, near: float, truth: float, reach: float, tolerance: float) -> None:
        if truth < reach and not math.isclose(value, truth, rel_tol=tolerance):
            wrong.append(f"{name} {value}, not {truth}")
        if truth < min(reach, 3.0 if "factor" in name else 0.7) and not math.isclose(near, truth, rel_tol=tolerance):
            wrong.append(f"{name} {near} seen near by, not {truth}")

    limit, alone = exact.limit, exact.one_loop
    lower = 1 / limit.lower_gain if limit.lower_gain else math.inf
    own = min(float(alone.gain_margin.min()), float((1 / np.maximum(alone.lower_gain_margin, 1e-300)).min()))
    # polished on both sides; curves that touch are known less well
    if limit.certified:
        same("factor", found.limit.gain, narrow.limit.gain, min(limit.gain, lower), 90.0, 1e-6)
    if alone.certified.all():
        same("one factor", found.one_loop.gain_margin[0], narrow.one_loop.gain_margin[0], own, 90.0, 1e-6)
    if exact.phase_certificate is not None and exact.phase_certificate.holds:
        same("phase", found.common_phase_margin, narrow.common_phase_margin, exact.common_phase_margin, 3.1, 1e-6)
    same("one phase", found.one_loop_phase_margin, narrow.one_loop_phase_margin, exact.one_loop_phase_margin, 3.1, 1e-6)
    # peaks of both are where samples told them to be
    if abs(found.peak_sensitivity / exact.peak_sensitivity - 1) > 1e-3:
        wrong.append(f"Ms {found.peak_sensitivity}, not {exact.peak_sensitivity}")
    return "; ".join(wrong)


@pytest.mark.slow
@pytest.mark.parametrize("draw", [limbs, chain])
@pytest.mark.parametrize("number", range(SHARE))
def test_share(draw, number):
    assert confirm(draw, number) == ""


@pytest.mark.parametrize(
    ("size", "own", "shared", "motor", "stiffness", "damping", "delay", "kp", "kd"),
    [
        (
            24,
            2.7454783541779797,
            0.37881070213828144,
            0.524219414,
            6371.7814652,
            0.0381886515,
            3.6114146999e-3,
            73.43671816576,
            22.22516758525,
        ),
        (
            16,
            6.206235125314911,
            -0.39881855428115087,
            0.127440466,
            6767.1010782,
            0.0273525456,
            2.8173546424e-3,
            43.37678316722,
            4.149561458306,
        ),
    ],
)
def test_a_locus_of_many_joints_is_followed_where_it_turns_towards_minus_one(size, own, shared, motor, stiffness, damping, delay, kp, kd):
    """One that all joints share hardly moves any S_ii: between two samples that were far enough from −1 it came nearer than was asked for.

    Against each motion alone, a joint with the load of one eigenvalue of W: those of equal joints that move together, and of all others.
    """
    drive, inverse = (
        gr.Drive(bandwidth=3000.0, damping_ratio=0.9, delay=delay),
        np.full((size, size), shared) + (own - shared) * np.eye(size),
    )
    loads = (own - shared, own + (size - 1) * shared)
    alone = [gr.build_loop(gr.ElasticJoint(motor, 1 / load, stiffness, damping), drive, gr.PD(kp, kd)) for load in loads]
    truth = min(abs(one.phase_margin) for loop in alone for one in gr.margins(loop).gain_crossings)
    plant = gr.Plant(inverse, *(np.full(size, value) for value in (motor, stiffness, damping)))
    gains, eye = np.array([np.full(size, kp), np.full(size, kd), np.zeros(size)]), np.eye(size)
    loop = directed_loop(gr.build_loop(plant, drive, gr.PD(gains[0], gains[1])), eye, eye, np.zeros(size, dtype=bool))
    found = margins_of_samples(take_samples(loop, gains, Reach(factor=1.5, phase=1.4 * truth)), size)
    assert found.stable
    assert found.phase_margin == pytest.approx(truth, rel=1e-6)  # polished to the last digits but for their number


def test_loci_of_nothing_but_round_off_are_not_told_apart():
    """More directions than motions: such loci turn at random, which took all the samples that there may be, and no limit was certified."""
    assert confirm(chain, 233) == ""


@pytest.mark.parametrize(("draw", "number"), [(chain, 308), (limbs, 368)])
def test_what_grows_alone_is_counted(draw, number):
    """Two sharp resonances side by side, without a sample between them: det(I + L) turns by one locus at either end, not by all alike."""
    assert confirm(draw, number) == ""


@pytest.mark.population
@pytest.mark.parametrize("batch", range(BATCHES))
@pytest.mark.parametrize("draw", [limbs, chain])
def test_population(draw, batch):
    wrong = {number: text for number in range(batch, ALL, BATCHES) if (text := confirm(draw, number))}
    print(f"\n{draw.__name__}: {len(wrong)} of {ALL // BATCHES} wrong: {wrong}")
    assert not wrong


def test_responses_are_those_of_the_loop():
    """Plant, drives, delays, contacts, gravity and hold in the core, against the package's own matrices."""
    for draw, number in ((limbs, 1), (limbs, 3), *((chain, number) for number in range(30))):
        pair, along = machine_of(draw, number)
        omega = np.geomspace(0.1, 0.9 * math.pi / (pair.machine.sample_time or 1e-4), 40)
        seen = along.loop(pair).response(omega).reshape(len(omega), -1)
        own = (along.jacobian @ pair.loop.actuated_at(1j * omega) @ along.torque).reshape(len(omega), -1)
        # sampled: both lose digits where integrators drift, and at zeros of the response; a margin of three digits needs no more
        off = np.abs(seen - own).max(axis=1) / np.abs(own).max(axis=1)
        assert off.max() < (1e-9 if pair.machine.sample_time is None else 1e-6), (draw.__name__, number)


@pytest.mark.parametrize("number", [0, 1, 2, 5, 7, 9, 10, 11, 12, 13])
def test_margins_move_as_they_are_said_to(number):
    """Every crossing and peak at gains a little larger and a little smaller, against its slope between."""
    pair, along = machine_of(chain, number)
    loop, size = along.loop(pair), len(along.cascade)
    seen = take_samples(loop, along.gains, WHOLE)
    assert seen.unstable == 0
    direction = np.random.default_rng(number).uniform(-1, 1, (2, size))

    def both(ask, step, relative, absolute):
        def moved(way):
            stiffer, damped = np.exp(way * step * direction)
            return along.gains * np.array([np.where(along.cascade, stiffer / damped, stiffer), damped, stiffer])

        (_, moves), (after, _), (before, _) = (ask(moved(way)) for way in (0, 1, -1))
        expected = step * (moves.reshape(len(moves), 2, size) * direction).sum(axis=(1, 2))
        assert 0.5 * (after - before)[:, 0] == pytest.approx(expected, rel=relative, abs=absolute)
        return len(moves)

    count = 0
    for locus in (True, False):
        for axis in (True, False):  # central differences: off by the square of the step, and by the digits to which crossings are polished
            count += both(lambda gains, locus=locus, axis=axis: seen.crossings(gains, locus, axis, 2.5), 1e-5, 2e-3, 2e-8)
        count += both(lambda gains, locus=locus: seen.ends(gains, locus, 2.5), 1e-5, 2e-3, 2e-8)

    def logarithms(gains):
        heights, moves = seen.peaks(gains, 1.05, 1.0, 0.0)
        return np.log(heights), moves

    assert count + both(logarithms, 1e-5, 0.05, 1.5e-6) > 0  # heights are found to about a millionth


@pytest.mark.parametrize("number", [0, 2, 7, 10, 13])
def test_the_first_that_is_broken_is_found_where_there_is_one(number):
    """What is asked to end with the first margin below a bound, or peak above it, against all of them, at gains a little further."""
    pair, along = machine_of(chain, number)
    seen = take_samples(along.loop(pair), along.gains, WHOLE)
    gains, count = along.gains * 1.02, 0
    for locus in (True, False):
        for axis in (True, False):
            every = np.abs(seen.crossings(gains, locus, axis, 2.5)[0][:, 0])
            for bound in (0.5 * every.min(initial=1.0), *np.sort(every)[:3] * 1.001):
                found = seen.crossings(gains, locus, axis, 2.5, bound)[0][:, 0]
                broken = bool(np.any(every < bound))
                assert (len(found) == 1 and abs(found[0]) < bound) if broken else len(found) == len(every)
                count += broken
    every = seen.peaks(gains, 1.05, 1.0, 0.0)[0][:, 0]
    for bound in (1.001 * every.max(initial=1.05), *np.sort(every)[-2:] * 0.999):
        found = seen.peaks(gains, 1.05, 1.0, 0.0, bound)[0][:, 0]
        assert (len(found) == 1 and found[0] > bound) if np.any(every > bound) else len(found) == len(every)
    assert count > 0


@pytest.mark.parametrize("number", range(20))
def test_crossings_of_nearly_equal_joints_are_all_found(number):
    """Each once, of gains a little further than those looked at: of joints that do not feel each other, by the scan of each alone.

    Loads differ by 1e-4 to 1 %, so that what is interpolated between samples lies nearer to another joint's crossing than to its own.
    """
    rng, size = np.random.default_rng(number), 4
    loads = 2.0 * (1 + 10 ** rng.uniform(-4, -2) * rng.uniform(-1, 1, size))
    drive, delay = gr.Drive(delay=2e-3), rng.uniform(1.5, 2.5)
    nothing, eye = np.zeros(size), np.eye(size)
    gains = np.array([np.full(size, 1500.0), np.full(size, 30.0 * delay), nothing])
    plant = gr.Plant(np.diag(1 / loads), np.full(size, 0.3), np.full(size, 8000.0), np.full(size, 2.0))
    core = directed_loop(gr.build_loop(plant, drive, gr.PD(gains[0], gains[1])), eye, eye, np.zeros(size, dtype=bool))
    seen = take_samples(core, gains, WHOLE)
    moved = gains * np.exp(0.03 * rng.uniform(-1, 1, gains.shape))
    truth = []
    for load, kp, kd in zip(loads, *moved[:2], strict=True):
        alone = gr.build_loop(gr.ElasticJoint(0.3, load, 8000.0, 2.0), drive, gr.PD(kp, kd))
        truth += [-math.log(one.gain) for one in gr.margins(alone).phase_crossings]
    found, reach = seen.crossings(moved, True, True, 3.0)[0][:, 0].tolist(), 2.5
    truth = sorted(one for one in truth if abs(one) < reach)
    assert len(truth) >= size
    assert sorted(one for one in found if abs(one) < reach) == pytest.approx(
        truth, rel=1e-5, abs=1e-5
    )  # crossings that are followed are polished to about a millionth


@pytest.mark.parametrize("size", [1, 2, 3, 6, 12, 32])
def test_eigenvalues(size):
    """Against LAPACK, for matrices of every kind of size and structure; sorted, as neighbours may change places."""
    rng = np.random.default_rng(size)
    shapes = [rng.normal(size=(size, size)) + 1j * rng.normal(size=(size, size)) for _ in range(5)]
    shapes += [
        np.zeros((size, size), complex),
        np.eye(size) * 1e200j,
        1e-200 * shapes[0],
        np.triu(shapes[1]),
        np.diag(10.0 ** np.arange(-8, size - 8)) @ shapes[2],
    ]
    symmetric = [matrix + matrix.T for matrix in shapes[:5]]
    units = np.exp(rng.normal(size=size) * 3 + 2j * rng.normal(size=size))
    passive = symmetric[0].real @ symmetric[0].real + 0.1j * np.diag(rng.uniform(size=size))  # as of joints: nearly real
    isotropic = passive.astype(complex)
    isotropic[0, 1:3] = isotropic[1:3, 0] = [1.0, 1.0j][: len(isotropic[0, 1:3])]  # xᵀx = 0 in its first row, and little else there
    isotropic[0, 3:] = isotropic[3:, 0] = 0.0
    shapes += [
        *symmetric,
        units[:, None] * symmetric[1] / units,  # symmetric in other units
        units[:, None] * passive / units,
        np.where(np.arange(size) == size // 2, 0.0, passive),  # a joint without gains
        np.kron(np.eye(2), passive)[:size, :size],  # limbs that do not feel each other
        passive[0, 0] * np.eye(size),
        np.tile(passive[:1, :1], (size, size)),  # of rank 1: 0 again and again
        isotropic,
        *(10.0**power * symmetric[2] for power in (-120, -30, 30, 120)),
    ]
    sizes = [np.abs(matrix).max() for matrix in shapes]
    for matrix, own, largest in zip(shapes, _core.eigenvalues(np.array(shapes)), sizes, strict=True):
        assert _apart(own, np.linalg.eigvals(matrix)) <= 1e-10 * largest * size
    count = 0
    for matrix, largest in zip(shapes, sizes, strict=True):
        error = max(3e-12 * largest, 1e-250)
        own = _core.symmetric_eigenvalues(matrix[None], error)[0]
        if not np.isnan(own).any():
            count += 1
            assert _apart(own, np.linalg.eigvals(matrix)) <= 10 * size * error  # sums of them are off by a third of `error`
        assert np.isnan(_core.symmetric_eigenvalues(matrix[None], 0.9e-13 * np.abs(np.linalg.eigvals(matrix)).max() / size)).all()
    assert count >= 6  # of 17 that are symmetric; large random ones lose digits


@pytest.mark.parametrize(
    "entries",
    [
        [[1e10, 2, -1, -2], [2, 1, 2, 0], [-1, 2, 1, -2], [-2, 0, -2, 1]],
        [[1e9, -1, -2, -1], [-1, 2, -2, 0], [-2, -2, 1, -1], [-1, 0, -1, 1]],
        [[1e8, 0, 0, 0], [0, 0, -2, 0], [0, 1, -2, -1], [0, 0, 2, 0]],
        [[1e13, -2, 1, 0], [-2, -2, 1, -2], [1, -2, 2, -1], [0, -1, -2, 2]],
    ],
)
def test_small_eigenvalues_beside_a_large_one_are_right_or_not_told(entries):
    """They do not show in sums of eigenvalues and of their squares: these came out wrong by their own size."""
    for largest in (1e3, 9e4):
        matrix = largest / entries[0][0] * np.array(entries, dtype=complex)
        own, right = _core.symmetric_eigenvalues(matrix[None], 1e-8)[0], np.linalg.eigvals(matrix)
        if not np.isnan(own).any():
            # ten times what is asked for, as that is estimated; less is told of those that no factor up to 1000 brings to −1
            allowed = 1e-7 / np.clip(np.abs(own), 1e-3, 1.0)
            assert np.all(np.abs(own[:, None] - right).min(axis=1) <= allowed)


@pytest.mark.parametrize("shape", [(0, 3, 3), (2, 0, 0), (1, 1, 1)])
def test_matrices_without_entries_have_no_eigenvalues(shape):
    found = _core.symmetric_eigenvalues(np.full(shape, 2.0 + 1.0j), 1e-8)
    assert found.shape == shape[:2]
    assert np.all(found == 2.0 + 1.0j)
    assert np.isnan(_core.symmetric_eigenvalues(np.full((2, 3, 3), np.nan + 0j), 1e-8)).all()


def _apart(own, right):
    pairs = np.abs(own[:, None] - right[None, :])
    return max(pairs.min(axis=1).max(), pairs.min(axis=0).max())


@pytest.mark.parametrize("factor", [1.0, 0.3, 0.1])
@pytest.mark.parametrize("draw", [limbs, chain])
@pytest.mark.parametrize("number", range(6))
def test_more_directions_than_motions(draw, number, factor):
    """Every direction three times, each with a part of its gains: the loci that are 0 but for round-off change no margin, and cost nothing.

    With softer gains all that crosses the axis where loci are followed may be round-off.
    """
    pair, along = machine_of(draw, number)
    gains, size, found = scaled(along.gains, along.cascade, factor), pair.machine.size, []
    parts, units = (0.31, 0.47, 0.22), (1.3, 0.21, 3.7)
    torque = np.hstack([part / unit * along.torque for part, unit in zip(parts, units, strict=True)])
    thrice = Directed(torque, np.vstack([unit * along.jacobian for unit in units]), np.tile(along.cascade, 3), np.tile(gains, 3))
    for one, own in ((along, gains), (thrice, thrice.gains)):
        seen = take_samples(one.loop(pair), own, Reach(1.5, 0.5))
        found.append((margins_of_samples(seen, size), seen.samples, seen.followed))
    (once, samples, _), (again, more, followed) = found
    assert followed
    assert more < 3 * samples + 300
    assert once.stable == again.stable
    if once.stable:
        assert again.peak_sensitivity == pytest.approx(once.peak_sensitivity, rel=1e-6)
        for value, truth, reach in ((again.limit.gain, once.limit.gain, 1.5), (again.phase_margin, once.phase_margin, 0.5)):
            assert value == pytest.approx(truth, rel=1e-6) if truth < reach else value >= reach


def test_what_is_lost_has_no_margins():
    """Whatever is asked of a look whose gains are no numbers: nothing is found, and nothing ends the process."""
    pair, along = machine_of(limbs, 0)
    lost = take_samples(along.loop(pair), np.full_like(along.gains, math.nan), WHOLE)
    assert not lost.followed
    asked = [lost.crossings(along.gains, locus, axis, 10.0) for locus in (True, False) for axis in (True, False)]
    asked += [lost.peaks(along.gains, 0.0, 1.0, 0.0), lost.ends(along.gains, True, 10.0)]
    assert all(len(found) == 0 for found, _ in asked)
    for _ in range(2):
        assert np.isnan(lost.least()).all()


def test_a_peak_that_is_steep_on_one_side_is_found():
    """A stiff gearbox that is held back by friction on its link: sensitivity falls steeply below its peak, and hardly above."""
    plant = gr.Plant(np.array([[1 / 1.32]]), 0.078, 3420.0, 7.3, link_viscous=0.79)
    loop = gr.build_loop(plant, gr.Drive(789.0, 0.79, 7.4e-3), gr.PD(0.15, 1.05))
    truth = gr.margins(loop)
    peak, _ = take_samples(joint_loops(loop), np.array([[0.15], [1.05], [0.0]]), Reach(2.0, 0.5)).peak(1.0, 0.0)
    assert peak == pytest.approx(truth.peak_sensitivity, rel=1e-8)
