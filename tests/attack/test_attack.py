"""A short run of the attack; docs/results/attack.md has the figures of a long one."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from tests.attack import boxes
from tests.attack.building import NEWEST_OPSET, OLDEST_OPSET
from tests.attack.campaign import Campaign, attacked
from tests.attack.constants import CHAINS
from tests.attack.graphs import OPERATORS, RandomGraph, random_graph
from tests.attack.interpreter import EXACT, FLOATING, PRECISE, Interpreter
from tests.attack.interpreter import OPERATORS as INTERPRETED
from tests.attack.minimise import minimised
from tests.attack.program import Program
from tests.attack.strike import Effort, strike_in_memory
from tests.policy.models import model_of, node
from tests.policy.operator_cases import CASES
from viatool.policy.folding import FOLDED
from viatool.policy.operators import registered
from viatool.taylor import reach

SHORT = Effort(boxes=3, samples=60, steps=2, exact=4)


HOLDING_GRAPHS = {"If", "Loop", "Scan"}
"""What they hold is read as it stands; tests/policy/test_control_flow.py attacks them."""


def attack_many(numbers: range, seed: int, effort: Effort) -> tuple[Counter[str], list[str]]:
    """Attack some graphs; return how they ended and what was found."""
    tally: Counter[str] = Counter()
    found = []
    for number in numbers:
        outcome = attacked(number, seed, effort)
        tally[outcome["ended"]] += 1
        tally["points"] += outcome["points"]
        tally["exact"] += outcome["exact"]
        found += [
            f"--graph {number} --seed {seed}: {finding['kind']}, by {finding['excess']:.3g}: {finding['detail']}"
            for finding in outcome["findings"]
        ]
    return tally, found


def test_no_value_of_a_random_graph_leaves_its_bounds() -> None:
    tally, found = attack_many(range(20), 2026, SHORT)
    assert not found, "\n".join(found)
    assert tally["attacked"] >= 14
    assert tally["points"] > 3_000
    assert tally["exact"] > 30


@pytest.mark.slow
def test_no_value_of_many_random_graphs_leaves_its_bounds() -> None:
    tally, found = attack_many(range(60), 2027, Effort(samples=100, exact=10))
    assert not found, "\n".join(found)
    assert tally["attacked"] >= 48
    assert tally["points"] > 45_000


def test_every_operator_that_is_read_is_written_behind_gates_and_in_the_open() -> None:
    graphs = [random_graph(number, 5) for number in range(3 * len(OPERATORS))]
    read = {operator for operator, _ in registered()} - HOLDING_GRAPHS
    assert read <= {name for graph in graphs for name in graph.operators}
    assert read <= {*OPERATORS}
    assert {graph.kind for graph in graphs} == {"float16", "float32", "float64"}
    assert {graph.opset for graph in graphs} == {*range(OLDEST_OPSET, NEWEST_OPSET + 1)}
    assert sum(bool(graph.gates) for graph in graphs) > len(graphs) / 5
    assert {operator for operators, _ in CHAINS for operator in operators} >= FOLDED - {"Constant"}


def test_a_graph_is_a_function_of_its_number_and_seed() -> None:
    first, second = (random_graph(12, 3).model.SerializeToString() for _ in range(2))
    assert first == second


def test_a_gated_part_is_closed_where_a_policy_is_checked_and_open_where_it_is_attacked() -> None:
    graph = next(g for number in range(100) if (g := random_graph(number, 5)).gates)
    gate = graph.gates[0]
    assert abs(gate.threshold) >= 50  # the self-check looks at most about 40 from 0
    centres, _ = boxes.draw_boxes(graph, 60, np.random.default_rng(0))
    beyond = (centres[:, gate.channel] - gate.threshold) * np.sign(gate.threshold)
    assert (beyond > 0).sum() > 10


@pytest.mark.parametrize("operator", sorted(set(CASES) & set(INTERPRETED)))
def test_the_interpreter_agrees_with_onnxruntime(operator: str) -> None:
    """In 240 bits up to the rounding of the program; what it calls rational is so."""
    newest = max(v for name, v in registered() if name == operator and v <= NEWEST_OPSET)
    for case in CASES[operator](newest):
        model = case.model(max(newest, OLDEST_OPSET))
        graph = RandomGraph(0, 0, "float32", model, batched=False)
        if operator == "Swish":
            continue  # onnxruntime has no kernel
        program, interpreter = Program(graph), Interpreter(model)
        for scale in (1.0, 3.0):
            point = (scale * np.random.default_rng(1).normal(size=graph.shape)).astype(np.float32)
            expected = program.one_by_one(point.reshape(1, -1).astype(np.float64), "off")[0]
            for arithmetic in (PRECISE, FLOATING, *([EXACT] if interpreter.is_rational else [])):
                values = np.array([float(value) for value in interpreter(point, arithmetic)])
                np.testing.assert_allclose(
                    values, expected, rtol=2e-3 if "16" in case.name else 2e-5, atol=1e-5
                )


def test_a_batch_of_a_random_graph_is_its_observations_one_by_one() -> None:
    """Else the attack would blame the bounds for an operator that mixes the batch."""
    compared = 0
    for number in range(60):
        graph = random_graph(number, 6)
        try:
            program = Program(graph)
        except Exception:  # onnxruntime has no kernel
            continue
        if not graph.batched or graph.kind == "float16":
            continue
        points = np.random.default_rng(number).uniform(-1, 1, (3, program.size))
        alone, together = program.one_by_one(points, "off"), program.together(points, "off")
        compared += 1
        np.testing.assert_allclose(together, alone, rtol=0.05, atol=1e-2 * (1 + np.abs(alone).max()))
    assert compared > 20


def broken(monkeypatch: pytest.MonkeyPatch, **wrong: float) -> None:
    """Let the engine give bounds that are too narrow by a share of their width."""

    def narrow(*given: object, **options: object) -> object:
        sets = reach(*given, **options)  # type: ignore[arg-type]
        from dataclasses import replace

        by = wrong["share"] * (sets.upper - sets.lower)
        return replace(sets, lower=sets.lower + by, upper=sets.upper - by)

    monkeypatch.setattr("tests.attack.strike.reach", narrow)


def steep_graph() -> RandomGraph:
    """Three nodes more than are needed for a value to escape."""
    scale, shift = np.float32([2.0, -3.0]), np.float32([0.5, 0.25])
    nodes = [
        node("Mul", ["x", "scale"], ["a"]),
        node("Tanh", ["a"], ["b"]),
        node("Add", ["b", "shift"], ["c"]),
        node("Relu", ["c"], ["y"]),
    ]
    model = model_of(nodes, {"scale": scale, "shift": shift}, shape=("batch", 2))
    return RandomGraph(0, 1, "float32", model, batched=True)


def test_bounds_that_are_too_narrow_are_found_in_the_program_and_in_exact_arithmetic(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    graph = steep_graph()
    assert strike_in_memory(graph, SHORT).findings == []
    broken(monkeypatch, share=0.2)
    kinds = {finding.kind for finding in strike_in_memory(graph, Effort()).findings}
    assert kinds == {"escape", "escape (real)"}


def test_a_finding_is_minimised(monkeypatch: pytest.MonkeyPatch) -> None:
    broken(monkeypatch, share=0.2)
    graph = steep_graph()
    smaller = minimised(graph, strike_in_memory(graph, Effort()))
    assert len(smaller.model.graph.node) == 1


def test_an_exception_of_the_engine_is_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*given: object, **options: object) -> object:
        raise IndexError("inside")

    monkeypatch.setattr("tests.attack.strike.reach", fail)
    (finding,) = strike_in_memory(steep_graph(), SHORT).findings
    assert finding.kind == "exception"
    assert "inside" in finding.detail


def test_a_campaign_goes_on_after_what_its_journal_holds(tmp_path: Path) -> None:
    journal = tmp_path / "attack.jsonl"
    effort = Effort(boxes=2, samples=10, steps=1, exact=0)
    first = list(Campaign(8, effort, 2, 1, journal).run())
    again = list(Campaign(8, effort, 3, 1, journal).run())
    assert [outcome["number"] for outcome in again][: len(first)] == [outcome["number"] for outcome in first]
    assert sum(outcome["ended"] == "attacked" for outcome in again) == 3
    assert len(again) == len({outcome["number"] for outcome in again})
