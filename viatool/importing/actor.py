"""An actor with all that its software does around it: the normaliser before, the scaling or the clip after."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from viatool.arrays import Floats
from viatool.errors import PolicyError
from viatool.importing.inert import TRUST
from viatool.importing.normaliser import Normaliser
from viatool.importing.spaces import BoxSpace, DiscreteSpace

_LARGEST = float(np.finfo(np.float32).max)


@dataclass(frozen=True, eq=False)
class ImportedActor:
    """What a training framework has saved of a policy.

    Parameters
    ----------
    body : Module
        From observations (B, n) to outputs (B, A), or (B, K) of a choice; squashed outputs are in [-1, 1].
    observation : BoxSpace
        The observation that the framework gives it, before its normaliser.
    action : BoxSpace, DiscreteSpace or None
        What the outputs become; None where the file does not say.
    squashed : bool
        Whether -1 and 1 stand for the ends of the action's box; else outputs are clipped to it.
    origin : str
        The framework and the policy, for reports.
    """

    body: nn.Module
    observation: BoxSpace
    action: BoxSpace | DiscreteSpace | None
    squashed: bool
    origin: str

    def check_sizes(self, path: Path, takes: int, gives: int) -> None:
        """Refuse weights that do not belong to the spaces.

        Raises
        ------
        PolicyError
            Names the field and both sizes.
        """
        expected = {"observation_space": (takes, self.observation.size)}
        if isinstance(self.action, BoxSpace):
            expected["action_space"] = (gives, self.action.size)
        elif isinstance(self.action, DiscreteSpace):
            expected["action_space"] = (gives, self.action.choices)
        for field, (layers, space) in expected.items():
            if layers != space:
                raise PolicyError(
                    f"{path}: data: {field} has {space} numbers, but the layers in policy.pth have {layers}",
                    TRUST,
                )
        if self.squashed and not (isinstance(self.action, BoxSpace) and self.action.is_bounded):
            raise PolicyError(
                f"{path}: data: action_space is not a Box with finite limits, to which a squashed action is scaled",
                TRUST,
            )


class WholePolicy(nn.Module):
    """The deterministic policy: raw observation in; physical command, or a number for each choice, out."""

    mean: Tensor
    deviation: Tensor
    low: Tensor
    high: Tensor

    def __init__(self, actor: ImportedActor, normaliser: Normaliser | None = None) -> None:
        super().__init__()
        self.body = actor.body.eval()
        self.clip = normaliser.clip if normaliser is not None else None
        if normaliser is not None:
            self.register_buffer("mean", _tensor(normaliser.mean))
            self.register_buffer("deviation", _tensor(normaliser.deviation))
        self.limited = isinstance(actor.action, BoxSpace) and bool(
            np.isfinite(actor.action.lower).any() or np.isfinite(actor.action.upper).any()
        )
        self.squashed = actor.squashed
        if isinstance(actor.action, BoxSpace):
            self.register_buffer("low", _tensor(np.clip(actor.action.lower, -_LARGEST, _LARGEST)))
            self.register_buffer("high", _tensor(np.clip(actor.action.upper, -_LARGEST, _LARGEST)))

    def forward(self, observation: Tensor) -> Tensor:
        """Return the actions (B, A) of observations (B, n)."""
        if self.clip is not None:
            normalised = (observation - self.mean) / self.deviation
            observation = torch.clamp(normalised, -self.clip, self.clip)
        action: Tensor = self.body(observation)
        if self.squashed:
            return self.low + 0.5 * (action + 1.0) * (self.high - self.low)
        if self.limited:
            return torch.clamp(action, self.low, self.high)
        return action


def write_program(policy: nn.Module, size: int, path: Path, output: Path, *, scripted: bool = False) -> None:
    """Write a policy as ONNX.

    Parameters
    ----------
    policy : Module
        From (B, size) to (B, A).
    size : int
        Length of the observation.
    path, output : Path
        What is imported, for messages, and what is written.
    scripted : bool
        Whether a part is TorchScript. The first axis is fixed then, for a traced program may hold for one observation
        at a time.

    Raises
    ------
    PolicyError
        If torch cannot export it.
    """
    axes = None if scripted else {"observation": {0: "batch"}, "action": {0: "batch"}}
    try:
        with warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("ignore")
            example = torch.zeros(1, size)
            program = policy.eval()
            if scripted:
                program = torch.jit.trace(program, example)  # type: ignore[no-untyped-call]
            torch.onnx.export(
                program,
                (example,),
                output,
                input_names=["observation"],
                output_names=["action"],
                dynamic_axes=axes,
                dynamo=False,
            )
    except Exception as error:  # torch names no class of errors for what it cannot export
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise PolicyError(
            f"{path}: torch cannot write it as ONNX: {reason}",
            "export the actor alone, see docs/exporting.md",
        ) from error


def _tensor(values: Floats) -> Tensor:
    return torch.as_tensor(values, dtype=torch.float32)
