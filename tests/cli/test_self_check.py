"""Planted faults of the reader end in exit code 3, before any bound or verdict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from click.testing import Result

from tests.policy.models import model_of, node, save, weights
from viatool.policy.operators import Call, Value, registry
from viatool.policy.operators.linear import weighted_sum
from viatool.policy.operators.matrix import matrix_product
from viatool.policy.operators.reduction import summed

Run = Callable[..., Result]
Reader = Callable[[Call], Sequence[Value]]


def wrong_operator(call: Call) -> Sequence[Value]:
    """Tanh instead of Erf."""
    return [call.assembly.activation(call.computed(0), "Tanh")]


def swapped_operand(call: Call) -> Sequence[Value]:
    return [weighted_sum(call, [call.value(1), call.value(0)], (1.0, -1.0))]


def dropped_bias(call: Call) -> Sequence[Value]:
    return [matrix_product(call, call.value(0), replace(call.value(1), array=call.value(1).array.T))]  # type: ignore[type-var,union-attr]


def wrong_axis(call: Call) -> Sequence[Value]:
    return [summed(call, call.computed(0), [2], keep=False, mean=True)]


def plant(monkeypatch: pytest.MonkeyPatch, operator: str, reader: Reader) -> None:
    for (name, version), entry in registry.registered().items():
        if name == operator:
            monkeypatch.setitem(registry._REGISTRY, (name, version), replace(entry, reader=reader))


def small_bias() -> onnx.ModelProto:
    """Three layers of 128 neurons; the last bias is one thousandth."""
    sizes = [(128, 4), (128, 128), (128, 128), (2, 128)]
    names = ["x", "h1", "h2", "h3", "y"]
    nodes, constants = [], {}
    for index, (rows, columns) in enumerate(sizes):
        w, b, out = f"w{index}", f"b{index}", names[index + 1]
        last = index == len(sizes) - 1
        constants[w] = weights(index, rows, columns, scale=(2 / columns) ** 0.5)
        constants[b] = np.full(rows, 1e-3 if last else 0.0, np.float32)
        nodes.append(node("Gemm", [names[index], w, b], [out if last else f"g{index}"], transB=1))
        if not last:
            nodes.append(node("Relu", [f"g{index}"], [out]))
    return model_of(nodes, constants)


def axes() -> onnx.ModelProto:
    nodes = [node("Reshape", ["x", "s"], ["r"]), node("ReduceMean", ["r"], ["y"], axes=[1], keepdims=0)]
    return model_of(nodes, {"s": np.array([1, 2, 2])})


FAULTS: dict[str, tuple[str, Reader, onnx.ModelProto]] = {
    "wrong operator": ("Erf", wrong_operator, model_of([node("Erf", ["x"], ["y"])])),
    "swapped operand": ("Sub", swapped_operand, model_of([node("Sub", ["c", "x"], ["y"])], {"c": weights(1, 4)})),
    "dropped bias": ("Gemm", dropped_bias, small_bias()),
    "wrong axis": ("ReduceMean", wrong_axis, axes()),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_gives_no_bounds(
    fault: str, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    operator, reader, model = FAULTS[fault]
    path = save(model, tmp_path)
    np.savetxt(tmp_path / "rows.csv", np.zeros((2, 4)), delimiter=",")
    arguments: tuple[Any, ...] = (
        "bounds",
        path,
        tmp_path / "rows.csv",
        "--eps",
        "0.01",
        "-o",
        tmp_path / "b.npz",
    )
    assert run(*arguments).exit_code == 0
    (tmp_path / "b.npz").unlink()
    plant(monkeypatch, operator, reader)

    for command in (arguments, ("inspect", path)):
        result = run(*command)
        assert result.exit_code == 3
        assert "disagree" in result.stderr
    assert not (tmp_path / "b.npz").exists()
    assert "width" not in result.stdout


def test_a_planted_fault_gives_no_verdict(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plant(monkeypatch, "Tanh", lambda call: [call.assembly.activation(call.computed(0), "Softsign")])
    report = tmp_path / "report.json"
    result = run(
        *("verify", "policy.onnx", "--map", "map.yaml", "--eps", "0.01", "--output", f"json:{report}")
    )
    assert result.exit_code == 3
    assert "disagree" in result.stderr
    assert not report.exists()
    assert "safe" not in result.stdout
