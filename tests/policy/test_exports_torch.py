"""Real exports of torch, by both exporters: read, checked, and enclosed around what onnxruntime computes."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from viatool.policy import Policy, load_policy
from viatool.taylor import reach

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")
nn = torch.nn

SIZE, HIDDEN, ACTIONS = 6, 8, 2


def export(module: torch.nn.Module, path: Path, *, dynamo: bool, **options: object) -> Path:
    """Write an eager module with one of torch's exporters."""
    module.eval()
    quiet = logging.getLogger("torch.onnx")
    level = quiet.level
    quiet.setLevel(logging.CRITICAL)
    try:
        with (
            warnings.catch_warnings(),
            contextlib.redirect_stdout(io.StringIO()),
            contextlib.redirect_stderr(io.StringIO()),
        ):
            warnings.simplefilter("ignore")
            torch.onnx.export(module, (torch.zeros(1, SIZE),), str(path), dynamo=dynamo, **options)
    finally:
        quiet.setLevel(level)
    return path


def assert_enclosed(policy: Policy, samples: int = 100_000, eps: float = 0.02) -> None:
    """Reachable sets contain what onnxruntime computes on random observations of each box."""
    states = 20
    generator = np.random.default_rng(0)
    centres = generator.normal(size=(states, policy.input_size)).astype(np.float32).astype(np.float64)
    sets = reach(policy, centres, eps)
    for _ in range(samples // (states * 250)):
        offsets = generator.uniform(-eps, eps, (250, *centres.shape))
        offsets[:50] = eps * np.sign(offsets[:50])
        inside = np.clip(
            (centres + offsets).astype(np.float32).astype(np.float64), centres - eps, centres + eps
        )
        inside = np.where(np.float32(inside) == inside, inside, np.float32(centres))
        actions = policy.run(inside.reshape(-1, policy.input_size)).reshape(250, states, -1)
        assert (sets.lower <= actions).all()
        assert (actions <= sets.upper).all()


class Residual(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.inner = nn.Sequential(nn.Linear(SIZE, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, SIZE))
        self.head = nn.Linear(SIZE, ACTIONS)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return torch.tanh(self.head(x + self.inner(x)))


class Dueling(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.body = nn.Sequential(nn.Linear(SIZE, HIDDEN), nn.ReLU())
        self.value = nn.Linear(HIDDEN, 1)
        self.advantage = nn.Linear(HIDDEN, 3)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        h = self.body(x)
        advantage = self.advantage(h)
        return self.value(h) + advantage - advantage.mean(dim=-1, keepdim=True)


class Normalised(nn.Module):
    """A running normaliser before and a physical scaling after, as RSL-RL and CleanRL have them."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("mean", torch.linspace(-1, 1, SIZE))
        self.register_buffer("variance", torch.linspace(0.5, 2, SIZE))
        self.register_buffer("scale", torch.tensor([0.25, 1.0]))
        self.net = nn.Sequential(nn.Linear(SIZE, HIDDEN), nn.ELU(), nn.Linear(HIDDEN, ACTIONS))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        normal = torch.clamp((x - self.mean) / torch.sqrt(self.variance + 1e-8), -5.0, 5.0)
        return torch.tanh(self.net(normal)) * self.scale + 0.25


class Chunked(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.net = nn.Linear(SIZE, 2 * ACTIONS)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        mean, log_std = self.net(x).chunk(2, dim=-1)
        return torch.tanh(mean) * torch.sigmoid(log_std)


class Lidar(nn.Module):
    """A one-dimensional convolution over the rays, and the rest of the observation beside it."""

    def __init__(self) -> None:
        super().__init__()
        self.conv = nn.Sequential(nn.Conv1d(1, 2, 3, padding=1), nn.ReLU(), nn.MaxPool1d(2))
        self.head = nn.Linear(6, ACTIONS)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        rays, rest = x[:, None, :4], x[:, 4:]
        features = self.conv(rays).flatten(1)
        return torch.tanh(self.head(torch.cat([features, rest], dim=1)))


class Attention(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.gate, self.value, self.head = nn.Linear(SIZE, 4), nn.Linear(SIZE, 4), nn.Linear(4, ACTIONS)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.head(torch.softmax(self.gate(x), dim=-1) * self.value(x))


def mlp(activation: Callable[[], nn.Module]) -> nn.Module:
    return nn.Sequential(nn.Linear(SIZE, HIDDEN), activation(), nn.Linear(HIDDEN, ACTIONS))


ACTIVATIONS: dict[str, Callable[[], nn.Module]] = {
    name: getattr(nn, name)
    for name in (
        "CELU", "ELU", "GELU", "Hardsigmoid", "Hardswish", "Hardtanh", "LeakyReLU", "LogSigmoid", "Mish", "ReLU",
        "ReLU6", "SELU", "SiLU", "Sigmoid", "Softplus", "Softshrink", "Softsign", "Tanh", "Tanhshrink",
    )
}  # fmt: skip
ACTIVATIONS |= {
    "GELU tanh": lambda: nn.GELU(approximate="tanh"),
    "PReLU by neuron": lambda: nn.PReLU(HIDDEN),
    "Softplus steep": lambda: nn.Softplus(beta=2.0, threshold=10.0),
    "LayerNorm": lambda: nn.Sequential(nn.LayerNorm(HIDDEN), nn.ReLU()),
    "BatchNorm": lambda: nn.Sequential(nn.BatchNorm1d(HIDDEN), nn.ReLU()),
    "Dropout": lambda: nn.Sequential(nn.Dropout(0.5), nn.Tanh()),
}
MODULES: dict[str, Callable[[], nn.Module]] = {
    **{name: (lambda make=make: mlp(make)) for name, make in ACTIVATIONS.items()},
    **{c.__name__: c for c in (Residual, Dueling, Normalised, Chunked, Lidar, Attention)},
}


@pytest.mark.parametrize("dynamo", [False, True], ids=["legacy", "dynamo"])
@pytest.mark.parametrize("name", MODULES)
def test_an_export_is_read_and_enclosed(name: str, dynamo: bool, tmp_path: Path) -> None:
    torch.manual_seed(1)
    module = MODULES[name]()
    policy = load_policy(export(module, tmp_path / "policy.onnx", dynamo=dynamo))

    observations = torch.randn(200, SIZE)
    with torch.no_grad():
        expected = np.concatenate([module(row[None]).numpy() for row in observations])
    np.testing.assert_allclose(policy(observations.numpy()), expected, rtol=1e-4, atol=2e-5)
    assert_enclosed(policy)


@pytest.mark.parametrize("dynamo", [False, True], ids=["legacy", "dynamo"])
def test_a_free_batch_axis(dynamo: bool, tmp_path: Path) -> None:
    options = {"dynamic_shapes": ({0: torch.export.Dim("batch")},)} if dynamo else {
        "input_names": ["x"], "dynamic_axes": {"x": {0: "batch"}}}  # fmt: skip
    policy = load_policy(export(Residual(), tmp_path / "policy.onnx", dynamo=dynamo, **options))
    assert policy.port.batched
    assert policy.runtime.batches


def test_weights_beside_the_model(tmp_path: Path) -> None:
    path = export(mlp(nn.ReLU), tmp_path / "policy.onnx", dynamo=True, external_data=True)
    assert (tmp_path / "policy.onnx.data").exists()
    policy = load_policy(path)
    inline = load_policy(export(mlp(nn.ReLU), tmp_path / "inline.onnx", dynamo=True, external_data=False))
    assert policy.input_size == inline.input_size == SIZE


@pytest.mark.parametrize("opset", [9, 11, 13, 17])
@pytest.mark.parametrize("name", ["Normalised", "LayerNorm", "GELU", "Chunked", "Hardswish", "Mish"])
def test_older_opsets_of_the_legacy_exporter(name: str, opset: int, tmp_path: Path) -> None:
    torch.manual_seed(1)
    module = MODULES[name]()
    policy = load_policy(export(module, tmp_path / "policy.onnx", dynamo=False, opset_version=opset))
    assert_enclosed(policy, samples=10_000)
