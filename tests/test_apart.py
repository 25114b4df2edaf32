"""Inverses and eigenvectors block by block are those of the whole, wherever the blocks' rows lie."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from gainroom.system.linear.apart import eigensystem, inverses, parts_of

SIZES = [(), (1,), (5,), (1, 1, 1), (3, 1, 4, 3), (6, 6, 17)]


def drawn(sizes: tuple[int, ...], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Matrices (k, n, n) that fall apart into blocks of these sizes in a drawn order of rows; and which block each row is of."""
    draw, owner = np.random.default_rng(len(sizes)), np.repeat(np.arange(len(sizes)), sizes)
    owner = draw.permutation(owner)
    size = len(owner)
    matrices = draw.normal(size=(count, size, size)) + 1j * draw.normal(size=(count, size, size))
    return np.where(owner[:, None] == owner, matrices, 0), owner


@pytest.mark.parametrize("sizes", SIZES)
def test_inverses(sizes):
    matrices, owner = drawn(sizes, 4)
    found = [part.tolist() for group in parts_of(np.any(matrices != 0, axis=0)) for part in group]
    assert sorted(found) == sorted(np.flatnonzero(owner == k).tolist() for k in range(len(sizes)))
    assert_allclose(inverses(matrices) @ matrices, np.broadcast_to(np.eye(len(owner)), matrices.shape), atol=1e-10)


@pytest.mark.parametrize("sizes", SIZES)
def test_symmetric_ones_have_vectors_of_one_block_each(sizes):
    matrices, owner = drawn(sizes, 1)
    matrix = (matrices[0] + matrices[0].T).real
    values, vectors = eigensystem(matrix)
    assert (np.diff(values) >= 0).all()
    assert_allclose(matrix @ vectors, vectors * values, atol=1e-12 * max(1, len(owner)))
    assert_allclose(vectors.T @ vectors, np.eye(len(owner)), atol=1e-13 * max(1, len(owner)))
    assert all(len(set(owner[np.flatnonzero(vector)])) == 1 for vector in vectors.T)


def test_a_chain_is_one_part():
    pattern = np.eye(9, k=1, dtype=bool)
    assert [group.tolist() for group in parts_of(pattern)] == [[list(range(9))]]
