"""TorchScript actors: the file is the program, scaled where limits are given; other .pt files say what they are."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

import torch  # only where it is installed
from torch import Tensor, nn

from viatool.errors import PolicyError
from viatool.importing import ImportRequest, import_policy


class Pair(nn.Module):
    """An action and a value."""

    def forward(self, observed: Tensor) -> tuple[Tensor, Tensor]:
        return observed[:, :2], observed[:, 2:]


def actor(size: int = 24) -> nn.Sequential:
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(size, 16), nn.ReLU(), nn.Linear(16, 2), nn.Tanh())


def script(module: nn.Module, path: Path, size: int | None = None) -> Path:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        saved = torch.jit.script(module) if size is None else torch.jit.trace(module, torch.zeros(1, size))
        saved.save(str(path))
    return path


@pytest.mark.parametrize("size", [None, 24], ids=["scripted", "traced"])
def test_the_file_is_the_program(size: int | None, tmp_path: Path) -> None:
    module = actor()
    path = script(module, tmp_path / "actor.pt", size)
    imported = import_policy(ImportRequest(path), tmp_path / "policy.onnx")
    rows = np.random.default_rng(0).normal(size=(50, 24)).astype(np.float32)
    expected = module(torch.as_tensor(rows)).detach().numpy()
    np.testing.assert_allclose(imported.policy.run(rows), expected, atol=1e-6)
    assert "add --low and --high" in " ".join(imported.inside)

    limits = ((0.0, 0.5), (-2.0, 2.0))
    scaled = import_policy(ImportRequest(path, limits=limits), tmp_path / "scaled.onnx")
    np.testing.assert_allclose(scaled.policy.run(rows), expected * [0.25, 2.0] + [0.25, 0.0], atol=1e-6)
    assert scaled.proposal is not None
    assert [action["upper"] for action in scaled.proposal.action] == [0.5, 2.0]


def test_the_length_of_the_observation_can_be_said(tmp_path: Path) -> None:
    path = script(nn.Tanh(), tmp_path / "actor.pt")
    with pytest.raises(PolicyError, match="no layer that tells the length") as refusal:
        import_policy(ImportRequest(path), tmp_path / "policy.onnx")
    assert "--input-size" in refusal.value.hint
    imported = import_policy(ImportRequest(path, input_size=3), tmp_path / "policy.onnx")
    assert imported.policy.output_size == 3
    wrong = script(actor(), tmp_path / "wrong.pt")
    with pytest.raises(PolicyError, match="does not run with an observation of 3 numbers"):
        import_policy(ImportRequest(wrong, input_size=3), tmp_path / "policy.onnx")


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="gives a tuple for one observation"):
        import_policy(
            ImportRequest(script(Pair(), tmp_path / "pair.pt"), input_size=4), tmp_path / "policy.onnx"
        )
    path = script(actor(), tmp_path / "actor.pt")
    with pytest.raises(PolicyError, match="gives 2 numbers, but 3 limits"):
        import_policy(ImportRequest(path, limits=((0.0, 1.0),) * 3), tmp_path / "policy.onnx")


def test_weights_and_pickled_modules_say_what_they_are(tmp_path: Path) -> None:
    for content in (actor().state_dict(), actor()):
        torch.save(content, tmp_path / "weights.pt")
        with pytest.raises(PolicyError, match=r"was written by torch.save") as refusal:
            import_policy(ImportRequest(tmp_path / "weights.pt"), tmp_path / "policy.onnx")
        assert "torch.jit.trace" in refusal.value.hint


class Writes(nn.Module):
    """Writes a file when it is run, and when it is read."""

    def __init__(self, path: str) -> None:
        super().__init__()
        self.path = path

    def forward(self, observed: Tensor) -> Tensor:
        torch.save(observed, self.path)
        return observed

    @torch.jit.export
    def __getstate__(self) -> tuple[str, bool]:
        return self.path, self.training

    @torch.jit.export
    def __setstate__(self, state: tuple[str, bool]) -> None:
        self.path = state[0]
        self.training = state[1]
        torch.save(torch.zeros(1), self.path)


class Reads(nn.Module):
    """Takes numbers of a file."""

    def forward(self, observed: Tensor) -> Tensor:
        return observed + torch.from_file("/etc/hostname", size=1, dtype=torch.float32)


def test_a_program_that_touches_files_is_not_even_read(tmp_path: Path) -> None:
    touched = tmp_path / "touched"
    path = script(Writes(str(touched)), tmp_path / "writes.pt")
    with pytest.raises(PolicyError, match=r"calls 'torch.save', where arithmetic is expected"):
        import_policy(ImportRequest(path, input_size=2), tmp_path / "policy.onnx")
    assert not touched.exists()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.jit.load(str(path))
    assert touched.exists()  # so it would have been written
    with pytest.raises(PolicyError, match=r"calls 'torch.from_file'"):
        import_policy(
            ImportRequest(script(Reads(), tmp_path / "reads.pt"), input_size=1), tmp_path / "policy.onnx"
        )
