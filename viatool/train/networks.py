"""Small multilayer perceptrons for S seeds at once: every weight has a leading seed dimension.

S seeds train in one run because their layers are multiplied in one batched product:
``(S, B, in) @ (S, in, out)``. All weights of one network live in one flat tensor, so that the optimiser and
the moving average of a target network are a handful of elementwise operations whatever the number of layers
and seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

HiddenActivation = Literal["relu", "elu", "tanh", "sigmoid", "softplus", "silu", "gelu"]

_ACTIVATIONS: dict[HiddenActivation, Callable[[Tensor], Tensor]] = {
    "relu": torch.relu_,
    "elu": functional.elu,
    "tanh": torch.tanh_,
    "sigmoid": torch.sigmoid,
    "softplus": functional.softplus,
    "silu": functional.silu,
    "gelu": functional.gelu,
}

ADAM_DECAY = (0.9, 0.999)
ADAM_EPSILON = 1e-8


@dataclass(frozen=True)
class Bend:
    """What a soft saturation makes of the first numbers that are seen: ``height * tanh(steepness * x + shift) + base``.

    Parameters
    ----------
    count : int
        Of how many numbers.
    steepness, shift, height, base : float
        In normalised units.
    """

    count: int
    steepness: float
    shift: float
    height: float
    base: float

    def __call__(self, seen: Tensor) -> Tensor:
        """Return numbers ``(..., k)``, the first of them bent."""
        bent = self.height * torch.tanh(self.steepness * seen[..., : self.count] + self.shift) + self.base
        return torch.cat([bent, seen[..., self.count :]], dim=-1)


@dataclass(frozen=True, eq=False)
class ActorView:
    """What actors see of an observation: some of its numbers, each up to a ceiling.

    Parameters
    ----------
    columns : Tensor
        ``(k,)`` which of the n numbers of an observation, ascending.
    ceiling : Tensor
        ``(k,)`` normalised; what is larger is seen as this. Infinite where nothing is cut off.
    bend : Bend, optional
        Of what is seen below the ceiling; it grows with that, nowhere faster.
    """

    columns: Tensor
    ceiling: Tensor
    bend: Bend | None = None

    def __call__(self, observation: Tensor) -> Tensor:
        """Return ``(..., k)`` of normalised observations ``(..., n)``."""
        seen = torch.minimum(observation.index_select(-1, self.columns), self.ceiling)
        return seen if self.bend is None else self.bend(seen)

    def box(self, observation: Tensor, radius: Tensor) -> tuple[Tensor, Tensor]:
        """Return middle and half-widths ``(..., k)`` of what is seen of boxes with half-widths ``(n,)``."""
        lower, upper = self(observation - radius), self(observation + radius)
        return 0.5 * (lower + upper), 0.5 * (upper - lower)


class Weights:
    """The weights of S perceptrons of one shape, in one flat tensor.

    Parameters
    ----------
    sizes : sequence of int
        Widths from the input to the output layer.
    seeds : int
        S, the leading dimension of every weight.
    activation : str
        Of the hidden layers; the output layer is linear.
    view : ActorView, optional
        What the first layer gets of the inputs; by default all.

    Attributes
    ----------
    flat : Tensor
        ``(P,)`` float32, every weight.
    layers : list of Tensor
        ``(S, in, out)``, ``(S, 1, out)``, ... alternately the matrix and the bias of each layer; leaves of
        autograd that share their memory with `flat`.
    """

    def __init__(
        self,
        sizes: Sequence[int],
        seeds: int,
        activation: HiddenActivation = "relu",
        view: ActorView | None = None,
    ) -> None:
        self.sizes = tuple(sizes)
        self.view = view
        self.seeds = seeds
        self.activation: HiddenActivation = activation
        shapes = [
            shape
            for fan_in, fan_out in pairwise(sizes)
            for shape in ((seeds, fan_in, fan_out), (seeds, 1, fan_out))
        ]
        counts = [torch.Size(shape).numel() for shape in shapes]
        self.flat = torch.zeros(sum(counts))
        self.layers = [
            part.view(shape).detach().requires_grad_()
            for part, shape in zip(torch.split(self.flat, counts), shapes, strict=True)
        ]

    def draw(self, generator: torch.Generator, output_scale: float = 1.0) -> Weights:
        """Draw every weight from U(-1/sqrt(in), 1/sqrt(in)), the output layer scaled; return self."""
        with torch.no_grad():
            for index in range(0, len(self.layers), 2):
                bound = self.sizes[index // 2] ** -0.5
                if index == len(self.layers) - 2:
                    bound *= output_scale
                for weight in self.layers[index : index + 2]:
                    weight.uniform_(-bound, bound, generator=generator)
        return self

    def copy(self) -> Weights:
        """Return equal weights in their own memory."""
        other = Weights(self.sizes, self.seeds, self.activation, self.view)
        other.flat.copy_(self.flat)
        return other

    def one(self, seed: int) -> Weights:
        """Return a copy of the network of one seed, with a leading dimension of 1."""
        single = Weights(self.sizes, 1, self.activation, self.view)
        for own, every in zip(single.layers, self.layers, strict=True):
            own.detach().copy_(every.detach()[seed : seed + 1])
        return single

    def __call__(self, inputs: Tensor) -> Tensor:
        """Evaluate the S perceptrons.

        Parameters
        ----------
        inputs : Tensor
            ``(S, B, sizes[0])``; with a view, what that is given.

        Returns
        -------
        Tensor
            ``(S, B, sizes[-1])``.
        """
        return self._evaluate(self.layers, inputs)

    def as_constants(self, inputs: Tensor) -> Tensor:
        """Evaluate the first S perceptrons so that gradients reach the inputs alone, ``(S, B, in)``."""
        return self._evaluate([layer.detach()[: inputs.shape[0]] for layer in self.layers], inputs)

    def _evaluate(self, layers: Sequence[Tensor], inputs: Tensor) -> Tensor:
        activate = _ACTIVATIONS[self.activation]
        hidden = inputs if self.view is None else self.view(inputs)
        for index in range(0, len(layers) - 2, 2):
            hidden = activate(torch.baddbmm(layers[index + 1], hidden, layers[index]))
        return torch.baddbmm(layers[-1], hidden, layers[-2])


class TrainedNetwork:
    """S perceptrons with their target networks and the moments of their Adam optimiser.

    Parameters
    ----------
    weights : Weights
        Initial weights; the target starts as their copy.
    """

    def __init__(self, weights: Weights) -> None:
        self.weights = weights
        self.target = weights.copy()
        self.first_moment = torch.zeros_like(weights.flat)
        self.second_moment = torch.zeros_like(weights.flat)
        self.steps = torch.tensor(0.0)

    def descend(self, gradients: Sequence[Tensor], learning_rate: float) -> None:
        """Take one Adam step along the gradients of `weights.layers`."""
        self.steps += 1
        torch._fused_adam_(  # what torch.optim.Adam(fused=True) calls, without its bookkeeping
            [self.weights.flat],
            [torch.cat([part.reshape(-1) for part in gradients])],
            [self.first_moment],
            [self.second_moment],
            [],
            [self.steps],
            lr=learning_rate,
            beta1=ADAM_DECAY[0],
            beta2=ADAM_DECAY[1],
            weight_decay=0.0,
            eps=ADAM_EPSILON,
            amsgrad=False,
            maximize=False,
        )

    def follow(self, rate: float) -> None:
        """Move the target by `rate` towards the weights (exponential moving average)."""
        self.target.flat.lerp_(self.weights.flat, rate)

    def state(self) -> dict[str, Tensor]:
        """Return all that a resumed run needs, as tensors by name (shared memory)."""
        return {
            "weights": self.weights.flat,
            "target": self.target.flat,
            "first_moment": self.first_moment,
            "second_moment": self.second_moment,
            "steps": self.steps,
        }

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take over what `state` returned in an earlier run."""
        self.weights.flat.copy_(state["weights"])
        self.target.flat.copy_(state["target"])
        self.first_moment.copy_(state["first_moment"])
        self.second_moment.copy_(state["second_moment"])
        self.steps.copy_(state["steps"])
