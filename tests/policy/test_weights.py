"""Large weights that are nearly all zero are kept as sparse matrices, and mean what dense ones mean."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest

from tests.policy.enclosure import escapes
from tests.policy.models import model_of, node, save, weights
from viatool.policy import Policy, load_policy, write_onnx
from viatool.policy import weights as matrices
from viatool.policy.network import Affine
from viatool.policy.weights import Sparse
from viatool.taylor import reach


def pair(seed: int = 0, size: tuple[int, int] = (7, 12), *, copies: bool = False) -> tuple[Any, Any]:
    """The same matrix, dense and sparse; its second row is empty."""
    generator = np.random.default_rng(seed)
    dense = np.where(generator.random(size) < 0.3, generator.normal(size=size), 0.0)
    if copies:
        dense = np.eye(*size, 2)
    dense[1] = 0.0
    rows, columns = np.nonzero(dense)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matrices, "LARGEST_DENSE", 0)
        patch.setattr(matrices, "_SPARSE", 1.0)
        sparse = matrices.placed(rows, columns, dense[rows, columns], size)
    assert isinstance(sparse, Sparse)
    return dense, sparse


@pytest.mark.parametrize("seed", range(5))
def test_a_sparse_matrix_is_its_dense_one(seed: int) -> None:
    dense, sparse = pair(seed)
    other_dense, other_sparse = pair(seed + 100)
    generator = np.random.default_rng(seed)
    for rows in (generator.normal(size=(1, 12)), generator.normal(size=(3, 5, 12)), np.zeros((0, 12))):
        np.testing.assert_allclose(rows @ sparse.T, rows @ dense.T, atol=1e-14)
        np.testing.assert_allclose(rows @ abs(sparse).T, rows @ np.abs(dense).T, atol=1e-14)
    adjoint = generator.normal(size=(4, 7))
    np.testing.assert_allclose(adjoint @ sparse, adjoint @ dense, atol=1e-14)
    np.testing.assert_array_equal(matrices.dense(sparse), dense)
    assert sparse.shape == dense.shape
    assert sparse.size == np.count_nonzero(dense)
    np.testing.assert_array_equal(matrices.terms(sparse), matrices.terms(dense))
    np.testing.assert_array_equal(matrices.copies(sparse), matrices.copies(dense))
    for columns in (generator.random(12) < 0.8, np.ones(12, bool)):
        for a, b in ((sparse, dense), (abs(sparse), np.abs(dense))):
            np.testing.assert_array_equal(matrices.positive_in(a, columns), matrices.positive_in(b, columns))
    total = matrices.dense(matrices.added(sparse, other_sparse))
    np.testing.assert_array_equal(total, dense + other_dense)
    assert matrices.overlap(sparse, other_sparse) == matrices.overlap(dense, other_dense)
    assert matrices.same(sparse, sparse)
    assert matrices.same(sparse, dense)
    assert not matrices.same(sparse, other_sparse)
    assert matrices.digest(sparse) != matrices.digest(other_sparse)
    assert matrices.digest(sparse) == matrices.digest(pair(seed)[1])
    assert not matrices.is_zero(sparse)
    assert matrices.is_zero(matrices.added(sparse, Sparse(-sparse.array)))


def test_copies_and_scalings_are_seen_in_both_kinds() -> None:
    dense, sparse = pair(copies=True)
    np.testing.assert_array_equal(matrices.copies(sparse), matrices.copies(dense))
    assert matrices.copies(sparse).all()
    square, kept = pair(size=(7, 7))
    assert matrices.scale_of(kept) is None is matrices.scale_of(square)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matrices, "LARGEST_DENSE", 0)
        patch.setattr(matrices, "_SPARSE", 1.0)
        scaling = matrices.diagonal(np.full(7, -2.0))
    assert isinstance(scaling, Sparse)
    assert matrices.is_scaling(scaling, -2.0)
    assert not matrices.is_scaling(scaling)


def convolutions(rays: int = 24, channels: int = 4) -> onnx.ModelProto:
    """Two convolutions over three scans, joined with four other numbers, as published for crowds."""
    first = (rays + 2 - 5) // 2 + 1
    second = (first + 2 - 3) // 2 + 1
    flat = channels * second
    nodes = [
        node("Slice", ["x", "zero", "scans", "axis"], ["s"]),
        node("Slice", ["x", "scans", "all", "axis"], ["rest"]),
        node("Reshape", ["s", "shape"], ["image"]),
        node("Conv", ["image", "k1", "b1"], ["c1"], strides=[2], pads=[1, 1]),
        node("Relu", ["c1"], ["r1"]),
        node("Conv", ["r1", "k2", "b2"], ["c2"], strides=[2], pads=[1, 1]),
        node("Relu", ["c2"], ["r2"]),
        node("Flatten", ["r2"], ["f"]),
        node("Gemm", ["f", "w3", "b3"], ["h"], transB=1),
        node("Relu", ["h"], ["r3"]),
        node("Concat", ["r3", "rest"], ["j"], axis=1),
        node("Gemm", ["j", "w4", "b4"], ["g"], transB=1),
        node("Tanh", ["g"], ["y"]),
    ]
    ints = {"zero": [0], "scans": [3 * rays], "all": [3 * rays + 4], "axis": [1]}
    constants: dict[str, Any] = {name: np.array(value, np.int64) for name, value in ints.items()}
    constants |= {
        "shape": np.array([1, 3, rays], np.int64),
        "k1": weights(1, channels, 3, 5, scale=0.25), "b1": weights(2, channels, scale=0.2),
        "k2": weights(3, channels, channels, 3, scale=0.6 / np.sqrt(channels)),
        "b2": weights(4, channels, scale=0.2),
        "w3": weights(5, 8, flat, scale=1 / np.sqrt(flat)), "b3": weights(6, 8, scale=0.2),
        "w4": weights(7, 2, 12, scale=0.3), "b4": weights(8, 2, scale=0.2),
    }  # fmt: skip
    return model_of(nodes, constants, shape=(1, 3 * rays + 4))


def sparse_nodes(policy: Policy) -> int:
    affine = [n for n in policy.network.nodes if isinstance(n, Affine)]
    return sum(isinstance(weight, Sparse) for n in affine for weight in n.weights)


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[Policy, Policy]:
    """The same small network with dense and with sparse weights."""
    path = save(convolutions(), tmp_path_factory.mktemp("both"))
    dense = load_policy(path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matrices, "LARGEST_DENSE", 200)
        patch.setattr(matrices, "_SPARSE", 0.5)
        sparse = load_policy(path)
    return dense, sparse


@pytest.mark.parametrize("refine", ["none", "monotone", "split"])
def test_bounds_of_sparse_weights_are_those_of_dense_ones(
    both: tuple[Policy, Policy], refine: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VIATOOL_ENGINE", "numpy")  # the compiled engine leaves sparse weights to numpy
    dense, sparse = both
    assert sparse_nodes(dense) == 0
    assert sparse_nodes(sparse) >= 3
    rows = np.random.default_rng(0).uniform(-0.5, 0.5, (3, dense.input_size))
    np.testing.assert_allclose(sparse(rows), dense(rows), atol=1e-14)
    ours, theirs = (reach(policy, rows, 0.02, refine=refine) for policy in both)
    np.testing.assert_allclose(theirs.lower, ours.lower, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(theirs.upper, ours.upper, rtol=1e-12, atol=1e-12)


def test_sparse_weights_are_enclosed_and_written(both: tuple[Policy, Policy], tmp_path: Path) -> None:
    _, sparse = both
    assert escapes(sparse, samples=4000, states=4) == 0
    path = tmp_path / "again.onnx"
    write_onnx(sparse.network, None, path)
    rows = np.random.default_rng(0).normal(size=(5, sparse.input_size))
    np.testing.assert_allclose(load_policy(path)(rows), sparse(rows), atol=1e-12)


@pytest.mark.slow
def test_convolutions_over_full_scans_are_bounded(tmp_path: Path) -> None:
    policy = load_policy(save(convolutions(512, 32), tmp_path))
    affine = [n for n in policy.network.nodes if isinstance(n, Affine)]
    assert max(n.size for n in affine) == 8160
    assert sum(weight.size for n in affine for weight in n.weights) < 2**21
    assert escapes(policy, samples=200, states=1, eps=0.005) == 0
