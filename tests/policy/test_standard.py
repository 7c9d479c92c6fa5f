"""The whole ONNX standard: each operator is exactly one of exact, enclosed, folded and refused."""

from __future__ import annotations

from pathlib import Path

import onnx
import pytest
from onnx import helper

from tests.policy.models import model_of, node, save
from viatool.errors import PolicyError
from viatool.policy import load_policy
from viatool.policy.folding import FOLDED
from viatool.policy.operators import registered
from viatool.policy.operators.table import operator_table, treatment_of

OPSET = onnx.defs.onnx_opset_version()
OLDEST = 6


def definitions() -> dict[tuple[str, int], int]:
    """Every operator in every version that a model of opset 6 or newer can mean, with the newest such opset."""
    found: dict[tuple[str, int], int] = {}
    names = {schema.name for schema in onnx.defs.get_all_schemas_with_history() if schema.domain == ""}
    for opset in range(OLDEST, OPSET + 1):
        for name in names:
            try:
                schema = onnx.defs.get_schema(name, opset, "")
            except onnx.defs.SchemaError:
                continue  # younger than this opset
            found[name, schema.since_version] = opset
    return found


DEFINITIONS = definitions()
OPERATORS = sorted({name for name, _ in DEFINITIONS})
OTHER_DOMAINS = [schema for schema in onnx.defs.get_all_schemas() if schema.domain]


@pytest.mark.parametrize("operator", OPERATORS)
def test_every_version_of_every_operator_is_read_or_refused_by_name(operator: str, tmp_path: Path) -> None:
    for (name, version), opset in DEFINITIONS.items():
        if name != operator or treatment_of(name, version) in ("exact", "enclosed"):
            continue  # read: tests/policy/test_operators.py runs each against onnxruntime
        schema = onnx.defs.get_schema(name, opset, "")
        inputs = ["x"] * max(schema.min_input, 1)
        outputs = ["y", *(f"unused_{i}" for i in range(schema.min_output - 1))]
        model = model_of([helper.make_node(operator, inputs, outputs, name="culprit")], opset=opset)
        if operator in ("Shape", "Size", "Constant") or (operator, version) in registered():
            with pytest.raises(PolicyError):  # a constant, or half of a rectifier, is no action
                load_policy(save(model, tmp_path))
            continue

        with pytest.raises(PolicyError, match="culprit") as refusal:
            load_policy(save(model, tmp_path))

        assert f"({operator})" in refusal.value.message
        assert refusal.value.hint


def test_each_operator_has_exactly_one_treatment() -> None:
    read = {operator for operator, _ in registered()}
    assert not (read | FOLDED) - set(OPERATORS), "what is read is in the standard"
    versions = {pair for pair in registered() if pair[1] <= OPSET}
    assert versions <= DEFINITIONS.keys(), "every version that is read exists"
    verdicts = {pair: treatment_of(*pair) for pair in DEFINITIONS}
    assert set(verdicts.values()) == {"exact", "enclosed", "folded", "refused"}
    assert {name for name, _ in DEFINITIONS if treatment_of(name) == "folded"} - read == FOLDED - read
    for operator in read:
        treatments = {verdicts[pair] for pair in DEFINITIONS if pair in versions and pair[0] == operator}
        assert len(treatments) == 1, f"{operator} is {treatments}"


@pytest.mark.parametrize("schema", OTHER_DOMAINS, ids=lambda schema: f"{schema.domain}.{schema.name}")
def test_other_domains_are_refused_by_name(schema: onnx.defs.OpSchema, tmp_path: Path) -> None:
    call = helper.make_node(schema.name, ["x"], ["y"], name="culprit", domain=schema.domain)
    model = model_of([call], domains={schema.domain: schema.since_version}, opset=OPSET)

    with pytest.raises(PolicyError, match=rf"culprit.*{schema.domain}\.{schema.name}"):
        load_policy(save(model, tmp_path))


def test_every_unsupported_node_is_listed_at_once(tmp_path: Path) -> None:
    model = model_of(
        [
            node("Sin", ["x"], ["s"], name="first"),
            node("Relu", ["s"], ["r"], name="fine"),
            node("RandomNormalLike", ["r"], ["n"], name="second"),
            node("Add", ["n", "r"], ["a"], name="also fine"),
            node("Fancy", ["a"], ["f"], name="third", domain="com.example"),
            node("Floor", ["f"], ["y"], name="fourth"),
        ],
        domains={"com.example": 1},
    )

    with pytest.raises(PolicyError) as refusal:
        load_policy(save(model, tmp_path))

    named = [
        name
        for name in ("first", "second", "third", "fourth", "fine")
        if f"'{name}'" in refusal.value.message
    ]
    assert named == ["first", "second", "third", "fourth"]
    assert "deterministic" in refusal.value.hint


def test_an_operator_in_a_version_that_nobody_registered_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from viatool.policy.operators import registry

    monkeypatch.delitem(registry._REGISTRY, ("Relu", 14))

    with pytest.raises(PolicyError, match="not read in opset version 14"):
        load_policy(save(model_of([node("Relu", ["x"], ["y"])]), tmp_path))


def test_the_table_in_the_documentation_is_the_registry() -> None:
    written = Path(__file__).parents[2] / "docs" / "operators.md"
    assert written.read_text(encoding="utf-8") == operator_table()
