"""Real exports of torch, by both exporters: read, checked, and enclosed around what onnxruntime computes."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from tests.policy.enclosure import escapes
from viatool.errors import PolicyError
from viatool.policy import Policy, load_policy

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


def assert_enclosed(policy: Policy, samples: int = 20_000) -> None:
    """Reachable sets contain what onnxruntime computes on observations of each box."""
    assert escapes(policy, samples=samples) == 0


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


class ActorCritic(nn.Module):
    """PPO's forward: the mean action, the value and the log-probability of the action."""

    def __init__(self) -> None:
        super().__init__()
        self.body = nn.Sequential(nn.Linear(SIZE, HIDDEN), nn.Tanh())
        self.mean, self.value = nn.Linear(HIDDEN, ACTIONS), nn.Linear(HIDDEN, 1)
        self.log_std = nn.Parameter(torch.zeros(ACTIONS))

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        features = self.body(x)
        mean = self.mean(features)
        spread = torch.ones_like(mean) * self.log_std.exp()
        return mean, self.value(features), torch.distributions.Normal(mean, spread).log_prob(mean).sum(dim=1)


class SquashedGaussian(nn.Module):
    """SAC's actor: the branch of the deviation is computed and not used."""

    def __init__(self) -> None:
        super().__init__()
        self.body = nn.Sequential(nn.Linear(SIZE, HIDDEN), nn.ReLU())
        self.mean, self.log_std = nn.Linear(HIDDEN, ACTIONS), nn.Linear(HIDDEN, ACTIONS)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        features = self.body(x)
        deviation = torch.clamp(self.log_std(features), -20, 2).exp()
        return torch.tanh(self.mean(features) + 0.0 * torch.zeros_like(deviation))


class ByHand(nn.Module):
    """An activation or a normalisation that is written out in elementary operations."""

    def __init__(self, function: Callable[[torch.Tensor], torch.Tensor]) -> None:
        super().__init__()
        self.inner, self.outer, self.function = nn.Linear(SIZE, HIDDEN), nn.Linear(HIDDEN, ACTIONS), function

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.outer(self.function(self.inner(x)))


class Beside(nn.Module):
    """Modules side by side, each with outputs of its own: one export of many."""

    def __init__(self, modules: Iterable[nn.Module]) -> None:
        super().__init__()
        self.parts = nn.ModuleList(modules)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return torch.cat([part(x) for part in self.parts], dim=-1)


def standardised(x: torch.Tensor) -> torch.Tensor:
    deviation = x - x.mean(dim=-1, keepdim=True)
    return deviation / torch.sqrt((deviation**2).mean(dim=-1, keepdim=True) + 1e-5)


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
    **{c.__name__: c for c in (Residual, Dueling, Normalised, Chunked, Lidar, Attention, SquashedGaussian)},
}


BY_HAND: dict[str, Callable[[torch.Tensor], torch.Tensor]] = {
    "Gelu": lambda x: 0.5 * x * (1.0 + torch.erf(x / 1.4142135)),
    "Gelu tanh": lambda x: 0.5 * x * (1.0 + torch.tanh(0.7978845608 * (x + 0.044715 * x**3))),
    "Silu": lambda x: x / (1.0 + torch.exp(-x)),
    "Mish": lambda x: x * torch.tanh(torch.log(1.0 + torch.exp(x))),
    "HardSwish": lambda x: x * nn.functional.relu6(x + 3.0) / 6.0,
    "Softplus": lambda x: torch.clamp(x, min=0.0) + torch.log(1.0 + torch.exp(-torch.abs(x))),
    "LeakyRelu": lambda x: torch.where(x > 0, x, 0.01 * x),
    "Elu": lambda x: torch.where(x > 0, x, 0.5 * (torch.exp(x) - 1.0)),
    "HardShrink": nn.functional.hardshrink,
    "LayerNorm": standardised,
    "RMSNorm": lambda x: x * torch.rsqrt(x.pow(2).mean(dim=-1, keepdim=True) + 1e-6),
    "unit length": lambda x: nn.functional.normalize(x, dim=-1),
    "simplex": lambda x: torch.softmax(x.view(1, -1, 4), dim=-1).view(1, -1),
    "gated": lambda x: torch.cat([nn.functional.glu(x)] * 2, dim=-1),
}
WRITTEN_OUT: dict[str, Callable[[], nn.Module]] = {
    f"{name} by hand": (lambda f=function: ByHand(f)) for name, function in BY_HAND.items()
}
CASES = [(name, False) for name in (*MODULES, *WRITTEN_OUT)]
CASES += [
    (name, True) for name in MODULES if name not in ACTIVATIONS
]  # written out: tests/benchmarks/exports.py


@pytest.mark.parametrize(
    ("name", "dynamo"), CASES, ids=[f"{name}-{'dynamo' if dynamo else 'legacy'}" for name, dynamo in CASES]
)
def test_an_export_is_read_and_enclosed(name: str, dynamo: bool, tmp_path: Path) -> None:
    torch.manual_seed(1)
    assert_read_and_enclosed((MODULES | WRITTEN_OUT)[name](), tmp_path / "policy.onnx", dynamo=dynamo)


def test_every_activation_of_the_dynamo_exporter_is_read_and_enclosed(tmp_path: Path) -> None:
    """In one export, as the exporter takes its time; every activation has outputs, and so bounds, of its own."""
    torch.manual_seed(1)
    module = Beside(mlp(make) for make in ACTIVATIONS.values())
    assert_read_and_enclosed(module, tmp_path / "policy.onnx", dynamo=True)


def assert_read_and_enclosed(module: nn.Module, path: Path, *, dynamo: bool) -> None:
    policy = load_policy(export(module, path, dynamo=dynamo))
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
    assert policy.ports.each[0].batched
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
    assert_enclosed(policy)


def test_one_output_of_several(tmp_path: Path) -> None:
    torch.manual_seed(1)
    names = ["action", "value", "log_probability"]
    path = export(ActorCritic(), tmp_path / "policy.onnx", dynamo=False, output_names=names)
    with pytest.raises(PolicyError, match=r"3 outputs .* action, value, log_probability"):
        load_policy(path)
    policy = load_policy(path, output_name="action")
    assert policy.output_size == ACTIONS
    assert_enclosed(policy)
