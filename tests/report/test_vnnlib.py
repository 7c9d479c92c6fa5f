"""Queries for other verifiers: the same box and bounds, to the last digit, and no sample satisfies them."""

from __future__ import annotations

import csv
import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from click.testing import CliRunner

import viatool
from tests.hall import write_policy
from viatool.cli import main
from viatool.errors import ConfigurationError
from viatool.report.vnnlib import decimal, query

EPS = 0.03


class Query:
    """A query as another program reads it: exact ends of the inputs, and what an output has to reach."""

    def __init__(self, text: str) -> None:
        text = "\n".join(line for line in text.splitlines() if not line.startswith(";"))
        self.inputs = len(re.findall(r"\(declare-const X_\d+ Real\)", text))
        self.outputs = len(re.findall(r"\(declare-const Y_\d+ Real\)", text))
        box, _, escape = text.partition("(assert (or")
        terms = r"\((<=|>=) ([XY])_(\d+) (-?\d+(?:\.\d+)?)\)"
        self.box = {(sign, int(index)): Fraction(end) for sign, _, index, end in re.findall(terms, box)}
        self.escape = [(sign, int(index), Fraction(end)) for sign, _, index, end in re.findall(terms, escape)]
        assert len(self.box) == 2 * self.inputs
        assert len(self.escape) == 2 * self.outputs
        assert text.count("(") == text.count(")")

    def holds(self, point: np.ndarray, output: np.ndarray) -> bool:
        inside = all(
            Fraction(float(point[index])) <= end if sign == "<=" else Fraction(float(point[index])) >= end
            for (sign, index), end in self.box.items()
        )
        return inside and any(
            Fraction(float(output[index])) <= end if sign == "<=" else Fraction(float(output[index])) >= end
            for sign, index, end in self.escape
        )


@pytest.fixture(scope="module")
def observations() -> np.ndarray:
    rng = np.random.default_rng(3)
    rows = np.column_stack([rng.uniform(0.3, 6.0, (3, 20)), rng.uniform(-0.6, 0.6, (3, 6))])
    return rows.astype(np.float32).astype(np.float64)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, observations: np.ndarray) -> Path:
    path = tmp_path_factory.mktemp("queries")
    write_policy(path / "policy.onnx", specification=False)
    np.save(path / "rows.npy", observations)
    arguments = ["bounds", str(path / "policy.onnx"), str(path / "rows.npy"), "--eps", str(EPS), "-q"]
    done = CliRunner().invoke(
        main, [*arguments, "-o", f"vnnlib:{path / 'q'}", "-o", str(path / "bounds.npz")]
    )
    assert done.exit_code == 0, done.output
    return path


def test_the_box_holds_the_one_that_was_bounded_and_the_bounds_are_the_same(
    folder: Path, observations: np.ndarray
) -> None:
    bounds = np.load(folder / "bounds.npz")
    for row, seen in enumerate(observations):
        asked = Query((folder / "q" / f"row-{row}.vnnlib").read_text())
        for index, number in enumerate(seen):
            low, high = (Fraction(float(number)) + side * Fraction(EPS) for side in (-1, 1))
            assert asked.box[">=", index] <= low < high <= asked.box["<=", index]
            assert asked.box["<=", index] - asked.box[">=", index] < 2 * Fraction(EPS) + Fraction(1, 10**12)
        for index in range(2):
            ends = {sign: end for sign, output, end in asked.escape if output == index}
            assert ends["<="] == Fraction(float(np.nextafter(bounds["lower"][row, index], -np.inf)))
            assert ends[">="] == Fraction(float(np.nextafter(bounds["upper"][row, index], np.inf)))


def test_no_sample_of_the_model_in_the_folder_satisfies_its_query(folder: Path) -> None:
    with (folder / "q" / "instances.csv").open() as stream:
        given = list(csv.reader(stream))
    assert [row[:2] for row in given] == [["policy.onnx", f"row-{row}.vnnlib"] for row in range(3)]
    session = onnxruntime.InferenceSession(folder / "q" / "policy.onnx", providers=["CPUExecutionProvider"])
    (port,), rng = session.get_inputs(), np.random.default_rng(0)
    for _, name, _ in given:
        asked = Query((folder / "q" / name).read_text())
        ends = np.array([[float(asked.box[sign, index]) for index in range(26)] for sign in (">=", "<=")])
        corners = rng.integers(0, 2, (150, 26))
        shares = np.concatenate([corners, rng.random((50, 26))])
        points = (ends[0] + shares * (ends[1] - ends[0])).astype(np.float32)
        sent = session.run(None, {port.name: points})[0]
        assert not any(asked.holds(point, output) for point, output in zip(points, sent, strict=True))


def test_a_query_about_bounds_that_are_too_narrow_is_satisfied(
    folder: Path, observations: np.ndarray
) -> None:
    policy = viatool.load_policy(folder / "policy.onnx")
    (sent,) = policy.run(observations[:1])
    box = observations[0] - EPS, observations[0] + EPS
    narrow = Query(query(box, (sent + 0.01, sent + 0.02), "narrow"))
    right = Query(query(box, (sent - 0.01, sent + 0.01), "right"))
    assert narrow.holds(observations[0], sent)
    assert not right.holds(observations[0], sent)


def test_an_output_on_its_bound_is_no_counterexample() -> None:
    exact = Query(query((np.zeros(1), np.ones(1)), (np.array([0.25]), np.array([0.5])), "tight"))
    assert not exact.holds(np.zeros(1), np.array([0.25]))
    assert not exact.holds(np.zeros(1), np.array([0.5]))
    assert exact.holds(np.zeros(1), np.array([np.nextafter(0.5, 1.0)]))


@pytest.mark.parametrize("number", [0.1, -1e-9, 5e-324, 1e22, 0.0, -0.0, 1 / 3])
def test_numbers_are_written_exactly_and_without_an_exponent(number: float) -> None:
    assert re.fullmatch(r"-?\d+(\.\d+)?", decimal(number))
    assert Fraction(decimal(number)) == Fraction(number)


def test_what_is_not_finite_is_no_query() -> None:
    with pytest.raises(ConfigurationError, match="a bound is not finite"):
        query((np.zeros(1), np.ones(1)), (np.array([-np.inf]), np.array([1.0])), "wide")


def test_a_policy_of_which_the_model_is_a_part_alone_is_refused_by_name(tmp_path: Path) -> None:
    write_policy(tmp_path / "policy.onnx", specification=False)
    (tmp_path / "spec.yaml").write_text(
        "schema_version: 2\nobservation: [{name: all, size: 26, kind: other}]\n"
        "action:\n- {name: v, kind: linear, lower: 0, upper: 0.5, scale: 0.5}\n"
        "- {name: omega, kind: angular, lower: -1, upper: 1}\n"
    )
    np.save(tmp_path / "rows.npy", np.ones((1, 26)))
    arguments = ["bounds", "policy.onnx", "rows.npy", "--eps", "0.1", "--spec", "spec.yaml", "-o", "vnnlib:q"]
    runner = CliRunner()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        done = runner.invoke(main, arguments)
    assert done.exit_code == 2
    assert "scales or clips the outputs" in done.output
    assert not (tmp_path / "q").exists()


@pytest.mark.parametrize(
    ("text", "told"), [("vnnlib:", "names no folder"), ("bounds.txt", "or write vnnlib:DIRECTORY")]
)
def test_an_output_of_bounds_that_is_neither_is_refused(tmp_path: Path, text: str, told: str) -> None:
    write_policy(tmp_path / "policy.onnx", specification=False)
    np.save(tmp_path / "rows.npy", np.ones((1, 26)))
    policy, rows = str(tmp_path / "policy.onnx"), str(tmp_path / "rows.npy")
    done = CliRunner().invoke(main, ["bounds", policy, rows, "--eps", "0.1", "-o", text])
    assert done.exit_code == 2
    assert told in done.output
