"""Recurrent layers over a set within one observation: read as their unrolled gates, or refused by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest

from tests.policy.enclosure import escapes
from tests.policy.models import model_of, node, save, weights
from tests.policy.test_exports_torch import export
from viatool.errors import PolicyError
from viatool.policy import load_policy
from viatool.policy.activations import activation

torch = pytest.importorskip("torch")
nn = torch.nn

NEIGHBOURS, FEATURES, OWN = 4, 3, 2


class OverNeighbours(nn.Module):  # type: ignore[name-defined,misc]
    """An actor that reads its neighbours one after another, beside what it knows of itself."""

    def __init__(self, kind: str, **options: Any) -> None:
        super().__init__()
        torch.manual_seed(1)
        self.layer = getattr(nn, kind)(FEATURES, 5, batch_first=True, **options)
        self.head = nn.Linear(5 * (1 + self.layer.bidirectional) + OWN, 2)

    def forward(self, x: Any) -> Any:
        neighbours = x[:, OWN:].reshape(-1, NEIGHBOURS, FEATURES)
        last = self.layer(neighbours)[1]
        last = last[0] if isinstance(last, tuple) else last
        ways = [last[-2], last[-1]] if self.layer.bidirectional else [last[-1]]
        return torch.tanh(self.head(torch.cat([x[:, :OWN], *ways], dim=1)))


class EveryState(OverNeighbours):
    """The mean of all states instead of the last one."""

    def forward(self, x: Any) -> Any:
        states = self.layer(x[:, OWN:].reshape(-1, NEIGHBOURS, FEATURES))[0]
        return self.head(torch.cat([x[:, :OWN], states.mean(dim=1)], dim=1))


@pytest.mark.parametrize("dynamo", [False, True], ids=["legacy", "dynamo"])
@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("GRU", {}),
        ("GRU", {"bidirectional": True}),
        ("LSTM", {"bidirectional": True}),
        ("LSTM", {"num_layers": 2}),
        ("RNN", {"nonlinearity": "relu"}),
    ],
)
def test_an_actor_over_its_neighbours_is_enclosed(
    kind: str, options: dict[str, Any], dynamo: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if dynamo:
        pytest.importorskip("onnxscript")
    monkeypatch.setattr("tests.policy.test_exports_torch.SIZE", OWN + NEIGHBOURS * FEATURES)
    actor = OverNeighbours(kind, **options)
    policy = load_policy(export(actor, tmp_path / "policy.onnx", dynamo=dynamo))
    rows = np.random.default_rng(0).normal(size=(20, policy.input_size)).astype(np.float32)
    np.testing.assert_allclose(policy(rows), actor(torch.tensor(rows)).detach().numpy(), atol=1e-6)
    assert escapes(policy, samples=4000, states=4) == 0


@pytest.mark.parametrize("kind", ["GRU", "LSTM"])
def test_all_states_of_a_layer_are_read(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.policy.test_exports_torch.SIZE", OWN + NEIGHBOURS * FEATURES)
    policy = load_policy(export(EveryState(kind), tmp_path / "policy.onnx", dynamo=False))
    assert escapes(policy, samples=4000, states=4) == 0


@pytest.mark.parametrize(("gate", "name"), [(0, "RecurrentSigmoid"), (2, "RecurrentTanh")])
def test_the_gates_of_a_gru_err_by_no_more_than_half_of_what_is_allowed_them(gate: int, name: str) -> None:
    """One step over one number, whose output is 1 - z of it, or the candidate."""
    sweep = np.concatenate([np.linspace(-12, 12, 200_001), [-1e10, -80.0, 0.0, 80.0, 1e10]]).astype(
        np.float32
    )
    w, b = np.zeros((1, 3, 1), np.float32), np.zeros((1, 6), np.float32)
    w[0, gate] = 1
    b[0, 0 if gate else 2] = -100 if gate else 100
    call = node("GRU", ["x", "w", "r", "b"], ["", "y"], hidden_size=1)
    model = model_of([call], {"w": w, "r": np.zeros((1, 3, 1), np.float32), "b": b}, shape=(1, len(sweep), 1))
    session = onnxruntime.InferenceSession(model.SerializeToString())
    given = session.run(None, {"x": sweep[None, :, None]})[0].ravel().astype(np.float64)
    function = activation(name)
    value = function(sweep.astype(np.float64))
    error = np.abs(given - (value if gate else 1 - value)) / 2.0**-24
    assert 1 < error.max() <= function.error.units / 2


def layer(
    operator: str = "GRU", inputs: tuple[str, ...] = ("b",), features: int = 2, **attributes: Any
) -> onnx.ModelProto:
    gates = {"RNN": 1, "GRU": 3, "LSTM": 4}[operator]
    constants = {
        "w": weights(1, 1, gates * 3, 2), "r": weights(2, 1, gates * 3, 3), "b": weights(3, 1, gates * 6),
        "length": np.array([2], np.int32),
    }  # fmt: skip
    call = node(operator, ["x", "w", "r", *inputs], ["", "y"], hidden_size=3, name="memory", **attributes)
    return model_of([call], constants, shape=(4, 1, features))


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (layer(clip=1.0), r"'memory' \(GRU\) clips its gates at 1.0"),
        (layer("LSTM", ("b", "length")), r"'memory' \(LSTM\) reads less than all of its 4 steps"),
        (layer("RNN", activations=["Affine"]), r"'memory' \(RNN\) has the activation 'Affine'"),
        (layer(direction="sideways"), "direction 'sideways'"),
        (layer("LSTM", features=3), "do not map 3 numbers to 4 gates of 3"),
    ],
)
def test_what_is_not_unrolled_is_refused_by_name(model: onnx.ModelProto, words: str, tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match=words):
        load_policy(save(model, tmp_path))


def test_a_layer_with_the_batch_in_front_is_one_with_the_steps_in_front(tmp_path: Path) -> None:
    """Which onnxruntime does not run on a CPU, so that the policy is refused, but as one that it cannot load."""
    from viatool.policy.model_file import actor_graph, open_model
    from viatool.policy.reader import read_network

    def network(batch_first: bool) -> Any:
        constants = {"w": weights(1, 1, 9, 2), "r": weights(2, 1, 9, 3), "b": weights(3, 1, 18)}
        nodes = [
            node("GRU", ["x", "w", "r", "b"], ["y", ""], hidden_size=3, layout=int(batch_first)),
        ]
        shape = (1, 4, 2) if batch_first else (4, 1, 2)
        path = save(model_of(nodes, constants, shape=shape), tmp_path)
        model = open_model(path)
        graph, ports = actor_graph(model)
        if batch_first:
            with pytest.raises(PolicyError, match="onnxruntime cannot load"):
                load_policy(path)
        return read_network(graph, ports, model.folder).network

    rows = np.random.default_rng(0).normal(size=(5, 8))
    np.testing.assert_array_equal(network(True)(rows), network(False)(rows))
