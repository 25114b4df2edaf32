"""The return ratio of every loop of coupled ones, the other loops closed, along the stability boundary; their peaks and phases.

Found between samples that are refined until neighbours differ little; then polished.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gainroom.analysis.stability_boundary import in_blocks
from gainroom.system.linear.arrays import Booleans, Complexes, Floats, Integers
from gainroom.system.loop import Loop

from .loci import Sweep
from .resolution import LOCI
from .sampled_curves import height, meets_circle, on_axis, passed_unseen, peaks, polished_peaks, refined

CLOSE = 0.05
"""Relative: phases and peaks whose interpolated values are that near the least or the highest one are polished."""
SLACK = 0.01
"""[rad] the same, of phases so small that interpolation is off by more than that part of them."""
Within = Callable[[Floats], Booleans]
"""Tells which frequencies [rad/s] count."""


def everywhere(omega: Floats) -> Booleans:
    """True at every frequency."""
    return np.ones(np.shape(omega), dtype=bool)


@dataclass(frozen=True)
class Curves:
    """m scalar curves: `values` (k, m) at `omega` (k,), and how to find more."""

    omega: Floats
    values: Complexes
    at: Callable[[Floats], Complexes]

    def on_axis(self, rows: Integers, joints: Integers, bent: Callable[[Complexes], Complexes] = lambda value: value) -> Complexes:
        """Where `bent` of curves `joints` crosses the real axis between samples `rows` and the next."""
        low, high = ((self.omega[at], bent(self.values[at, joints])) for at in (rows, rows + 1))
        return on_axis(lambda omega: bent(self.at(omega)), joints, low, high)[1]


class Peak(NamedTuple):
    """The largest |S_ii|, or what is asked for, and where [rad/s]."""

    height: float
    omega: float


@dataclass(frozen=True)
class Sampled:
    """A loop along the stability boundary: its loci, each return ratio ℓ_i with the other loops closed, and S_ii (k, n) at the same ω."""

    sweep: Sweep
    single: Curves
    sensitivity: Complexes
    sensitivity_at: Callable[[Floats], Complexes]

    @classmethod
    def of(cls, sweep: Sweep) -> "Sampled":
        """From the samples of its loci, refined around peaks of S_ii. Raises LinAlgError where I + L is singular at a sample."""

        def sensitivity(omega: Floats) -> Complexes:
            return in_blocks(lambda part: _own_sensitivity(sweep.loop, part), omega, sweep.loop.size)

        def rough(omega: Floats, values: Complexes) -> Booleans:
            return np.abs(np.diff(values, axis=0)).max(axis=1) > 0.1

        def unseen(omega: Floats, values: Complexes) -> Booleans:
            return passed_unseen(omega, _return_ratio(values), height)

        omega, values = refined(sweep.omega, sensitivity(sweep.omega), sensitivity, rough, 10, LOCI.most, closest=1e-7)
        omega, values = refined(omega, values, sensitivity, unseen, 60, LOCI.most)
        return cls(sweep, Curves(omega, _return_ratio(values), lambda omega: _return_ratio(sensitivity(omega))), values, sensitivity)

    def own_peaks(self, slope: float = 1.0, offset: float = 0.0, within: Within = everywhere) -> list[Peak]:
        """The largest |slope S_ii + offset| of each loop, of frequencies `within`."""
        omega = self.single.omega
        sizes = np.abs(slope * self.sensitivity + offset) * within(omega)[:, None]
        highest = sizes.max(axis=0)
        rows, joints = peaks(sizes, (1 - CLOSE) * highest)

        def at(omega: Floats, joints: Integers) -> Floats:
            return np.abs(slope * self.sensitivity_at(omega)[np.arange(len(omega)), joints] + offset)

        place, height = polished_peaks(omega, sizes, rows, joints, at)
        found = [Peak(*one) for one in zip(highest.tolist(), omega[np.argmax(sizes, axis=0)].tolist(), strict=True)]
        for joint, one in zip(joints.tolist(), map(Peak, height.tolist(), place.tolist()), strict=True):
            if within(np.array(one.omega)):
                found[joint] = max(found[joint], one)
        return found


def _own_sensitivity(loop: Loop, omega: Floats) -> Complexes:
    """The diagonal of (I + L)⁻¹ (k, n)."""
    response = loop.response(omega).reshape(len(omega), loop.size, loop.size)
    return np.diagonal(np.linalg.inv(np.eye(loop.size) + response), axis1=1, axis2=2)


def _return_ratio(sensitivity: Complexes) -> Complexes:
    """ℓ_i of loop i with the other loops closed: 1 + ℓ_i = 1/S_ii."""
    return 1 / np.where(sensitivity == 0, 1e-300, sensitivity) - 1


def own_phases(single: Curves, within: Within = everywhere) -> Floats:
    """(n,) the smallest phase [rad] at which each loop vibrates, at frequencies `within`."""
    rows, joints, _, lag = meets_circle(single.values[:-1], single.values[1:])
    counted = within(single.omega[rows]) | within(single.omega[rows + 1])
    rows, joints, lag = rows[counted], joints[counted], lag[counted]
    least = np.full(single.values.shape[1], math.inf)
    np.minimum.at(least, joints, np.abs(lag))
    chosen = np.abs(lag) <= least[joints] * (1 + CLOSE) + SLACK

    def bent(value: Complexes) -> Complexes:
        """On the real axis, at its lag, where the value is on the unit circle."""
        return np.angle(-value) + 1j * height(value)

    least[:] = math.inf
    np.minimum.at(least, joints[chosen], np.abs(single.on_axis(rows[chosen], joints[chosen], bent).real))
    return least
