"""Gain matrices that couple joints, written as gains along directions: G_t = X diag(g_t) Y with one X and one Y for all terms t.

Then det(I + P c(s) Σ h_t G_t) = det(I + Y P X diag(c_i)), c_i = c Σ h_t g_t,i: r loops as those of joints, behind Y P X. Symmetric gains
have X = Yᵀ, and Y P Yᵀ is symmetric as P is. Tasks have Y = Eᵀ and X = E Λ.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..system.linear.arrays import Floats

NONE, SOME = 1e-11, 1e-8  # relative to the largest singular value: up to NONE there is no gain, from SOME on there is; between, unknown
EXACT = 1e-11  # largest relative difference between the gain matrices and their product X diag(g) Y
SYMMETRIC = 1e-12  # relative
SAME = 1e-6  # relative distance of ratios of gains that are as good as equal


class Directions(NamedTuple):
    """Factors of gain matrices: torque X (n, r), measured Y (r, n), and gains (r,) of each term."""

    torque: Floats
    measured: Floats
    gains: dict[tuple[int, int], Floats]
    symmetric: bool


def gain_directions(terms: Mapping[tuple[int, int], Floats], unit: Floats) -> Directions | None:
    """Directions X, Y and gains along them of gain matrices (n, n), one per term; None where no common directions exist, or none are known.

    unit   (n,) in which joints are alike (Plant.units), as else round-off of one's gains hides another's
    """
    alike = _directions({powers: gain / (unit[:, None] * unit) for powers, gain in terms.items()})
    return alike and alike._replace(torque=unit[:, None] * alike.torque, measured=alike.measured * unit)


def _directions(terms: Mapping[tuple[int, int], Floats]) -> Directions | None:
    sizes = {powers: size for powers, gain in terms.items() if (size := float(np.linalg.norm(gain)))}
    if not sizes:
        return None
    units = [terms[powers] / size for powers, size in sizes.items()]
    symmetric = all(np.abs(unit - unit.T).max() <= SYMMETRIC for unit in units)
    outer, inner = _span(np.hstack(units)), _span(np.hstack([unit.T for unit in units]))
    if outer is None or inner is None or outer.shape != inner.shape:
        return None
    inner = outer if symmetric else inner
    inside = [outer.T @ unit @ inner for unit in units]
    whole = np.sum(inside, axis=0)
    other = np.einsum("t,tij->ij", np.sqrt([2.0, 3.0, 5.0, 7.0])[: len(inside)], inside)
    try:
        torque, measured = _symmetric(whole, other) if symmetric else _any(whole, other)
    except np.linalg.LinAlgError:
        return None
    torque, measured = outer @ torque, measured @ inner.T
    balance = np.sqrt(np.linalg.norm(measured, axis=1) / np.linalg.norm(torque, axis=0))
    torque, measured = torque * balance, measured / balance[:, None]
    left, right = np.linalg.pinv(torque), np.linalg.pinv(measured)
    gains = {powers: np.einsum("in,nm,mi->i", left, gain, right) for powers, gain in terms.items()}
    products = {powers: torque @ (gains[powers][:, None] * measured) for powers in sizes}
    off = [float(np.linalg.norm(products[powers] - terms[powers])) / size for powers, size in sizes.items()]
    return Directions(torque, measured, gains, symmetric) if max(off) <= EXACT else None


def _span(columns: Floats) -> Floats | None:
    """(n, r) orthonormal; None where round-off hides how many."""
    left, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    if np.any((sizes > NONE * sizes[0]) & (sizes < SOME * sizes[0])):
        return None
    return left[:, sizes >= SOME * sizes[0]]


def _symmetric(whole: Floats, other: Floats) -> tuple[Floats, Floats]:
    """X and Y = Xᵀ of two symmetric matrices (r, r), the first definite; raises LinAlgError where it is not."""
    root = np.linalg.cholesky((whole + whole.T) / 2)
    half = np.linalg.solve(root, (other + other.T) / 2)
    axes = np.linalg.eigh(np.linalg.solve(root, half.T))[1]
    torque = root @ axes
    return torque, torque.T


def _any(whole: Floats, other: Floats) -> tuple[Floats, Floats]:
    """X and Y of two matrices (r, r) with real ratios in some directions; raises LinAlgError where the first is singular."""
    ratios = np.linalg.solve(whole, other)
    values = np.sort(np.linalg.eigvals(ratios).real)
    size, axes, start = np.abs(values).max(), [], 0
    while start < len(values):  # equal ratios leave the axes free: orthogonal ones are taken
        end = start + 1
        while end < len(values) and values[end] - values[end - 1] <= SAME * size:
            end += 1
        axes.append(np.linalg.svd(ratios - values[start:end].mean() * np.eye(len(values)))[2][len(values) - (end - start) :].T)
        start = end
    right = np.hstack(axes)
    return whole @ right, np.linalg.inv(right)
