"""Memory is proposed where names and shapes of inputs and outputs pair, and is said to be guessed."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from tests.policy.models import model_of, node, save
from viatool.cli import main
from viatool.policy import PolicySpecification, load_policy
from viatool.policy.inspection import Value
from viatool.proposals import PolicyFacts, describe_with_memory, propose, propose_by_size
from viatool.proposals.remembered import suggested_memory

RECURRENT = "examples/zoo/sb3_recurrent/policy.onnx"


def _suggested(inputs: dict[str, tuple], outputs: dict[str, tuple]) -> dict[str, str]:
    return suggested_memory(
        [Value(name, "float", shape) for name, shape in inputs.items()],
        [Value(name, "float", shape, tuple(inputs)) for name, shape in outputs.items()],
    )


@pytest.mark.parametrize(
    ("taken", "given"),
    [
        (["h"], ["h_out"]),
        (["h", "c"], ["h_out", "c_out"]),
        (["h0", "c0"], ["hn", "cn"]),
        (["h_0", "c_0"], ["h_n", "c_n"]),
        (["state_in_0", "state_in_1"], ["state_out_0", "state_out_1"]),
        (["hiddenIn"], ["hiddenOut"]),
        (["memory"], ["new_memory"]),
        (["lstm_hidden"], ["state"]),
    ],
)
def test_names_that_pair(taken: list[str], given: list[str]) -> None:
    shape = (1, "batch", 64)
    inputs = {"obs": ("batch", 28), **dict.fromkeys(taken, shape)}
    outputs = {"action": ("batch", 2), "value": ("batch", 1), **dict.fromkeys(given, (1, "axis", 64))}
    assert _suggested(inputs, outputs) == dict(zip(taken, given, strict=True))


@pytest.mark.parametrize(
    ("inputs", "outputs"),
    [
        ({"obs": ("b", 2)}, {"action": ("b", 2)}),
        ({"obs": ("b", 9), "prev_action": ("b", 2)}, {"action": ("b", 2), "value": ("b", 1)}),
        ({"obs": ("b", 9), "goal": ("b", 2)}, {"action": ("b", 2), "value": ("b", 1)}),
        ({"obs": ("b", 9), "h": (1, "b", 64)}, {"action": ("b", 2), "h_out": (1, "b", 32)}),
        ({"h": (1, "b", 64)}, {"action": ("b", 2), "h_out": (1, "b", 64)}),  # nothing would be observed
        ({"obs": ("b", 9), "h": (1, "b", 64)}, {"h_out": (1, "b", 64)}),  # and nothing would act
        ({"obs": ("b", 9), "state": ("b", 8), "cell": ("b", 8)}, {"act": ("b", 2), "rnn": ("b", 8)}),  # which of both
    ],
)  # fmt: skip
def test_nothing_is_suggested_that_is_not_told(inputs: dict[str, tuple], outputs: dict[str, tuple]) -> None:
    assert _suggested(inputs, outputs) == {}


def test_what_no_output_depends_on_is_no_memory() -> None:
    inputs = [Value("obs", "float", (1, 9)), Value("h", "float", (1, 8))]
    outputs = [Value("action", "float", (1, 2), ("obs",)), Value("h_out", "float", (1, 8), ("obs",))]
    assert suggested_memory(inputs, outputs) == {}


def test_a_recurrent_policy_gets_a_proposal_that_loads_and_says_what_was_guessed(tmp_path: Path) -> None:
    sidecar = tmp_path / "robot.yaml"
    ran = CliRunner().invoke(main, ["inspect", RECURRENT, "--write-spec", str(sidecar)])
    assert ran.exit_code == 0, ran.output
    assert "guessed from its name" in " ".join(ran.output.split())
    text = sidecar.read_text(encoding="utf-8")
    comments = " ".join(line for line in text.splitlines() if line.startswith("#"))
    for pair in ("'h_out' is a memory that the input 'h'", "'c_out' is a memory that the input 'c'"):
        assert pair in comments
    assert yaml.safe_load(text)["memory"] == {"h": "h_out", "c": "c_out"}
    policy = load_policy(RECURRENT, sidecar)
    assert policy.input_size == 28 + 2 * 64
    assert policy.memory is not None
    given = load_policy(RECURRENT, "examples/zoo/sb3_recurrent/specification.yaml")
    assert policy.spec is not None
    assert given.spec is not None
    assert policy.spec.memory == given.spec.memory


def test_a_specification_that_is_there_says_all(tmp_path: Path) -> None:
    found = describe_with_memory(RECURRENT, output_name="action")
    assert found.memory == {"h": "h_out", "c": "c_out"}
    assert describe_with_memory(RECURRENT, output_name="h_out").memory == {"c": "c_out"}
    graph = model_of([node("Tanh", ["x"], ["y"])])
    assert describe_with_memory(save(graph, tmp_path)).memory == {}


def test_a_memory_stands_beside_what_sizes_tell() -> None:
    proposal = propose_by_size(PolicyFacts(28, 2, squashed=True, memory=(("h", "h_out"),)))
    spec = PolicySpecification.model_validate(proposal.document)
    assert spec.memory == {"h": "h_out"}
    assert propose(describe_with_memory(RECURRENT)).document["memory"] == {"h": "h_out", "c": "c_out"}
