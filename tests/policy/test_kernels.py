"""Kernels of the installed onnxruntime that reduce or normalise stay within what the rounding model allows them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest

from tests.kernels import EPSILON, KERNELS, Kernel, question, scale, shift_of

LEVELS = ("ORT_DISABLE_ALL", "ORT_ENABLE_ALL")


def given(kernel: Kernel, model: bytes, points: Any, level: str) -> Any:
    """Return what onnxruntime makes of points (P, n): (P, outputs)."""
    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = getattr(onnxruntime.GraphOptimizationLevel, level)
    options.log_severity_level = 4
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    shape = kernel.shape(points.shape[1])
    rows = [
        session.run(None, {"x": point.reshape(shape).astype(kernel.dtype)})[0].ravel() for point in points
    ]
    return np.array(rows, dtype=np.float64)


@pytest.mark.parametrize("size", [2, 17])
@pytest.mark.parametrize("name", KERNELS)
def test_a_kernel_strays_no_farther_than_it_is_allowed(name: str, size: int, tmp_path: Path) -> None:
    kernel = KERNELS[name]
    asked = question(kernel, min(size, kernel.largest), tmp_path)
    assert np.isfinite(asked.allowed).all(axis=1).any()
    for level in LEVELS:
        actions = given(kernel, asked.model.SerializeToString(), asked.points, level)
        assert asked.used(actions) < 1


def float32_layer(x: Any, *, one_pass: bool) -> Any:
    x = x.astype(np.float32)
    mean = x.mean(axis=1, keepdims=True, dtype=np.float32)
    variance = (x * x).mean(axis=1, keepdims=True, dtype=np.float32) - mean * mean
    if not one_pass:
        variance = ((x - mean) ** 2).mean(axis=1, keepdims=True, dtype=np.float32)
    with np.errstate(invalid="ignore"):
        spread = np.sqrt(variance + np.float32(EPSILON))
    return (x - mean) / spread * scale(x.shape[1]) + shift_of(x.shape[1])


def test_a_program_in_one_pass_is_told_from_one_in_two(tmp_path: Path) -> None:
    asked = question(KERNELS["LayerNormalization"], 16, tmp_path)
    one, two = (float32_layer(asked.points, one_pass=flag).astype(np.float64) for flag in (True, False))
    assert asked.used(one) < 1
    assert asked.used(two) < 1
    assert asked.takes_one_pass(one)
    assert not asked.takes_one_pass(two)


def test_a_result_that_is_no_number_is_beyond_all_that_is_allowed(tmp_path: Path) -> None:
    asked = question(KERNELS["ReduceMean"], 3, tmp_path)
    assert asked.used(np.full_like(asked.allowed, np.nan)) == np.inf
