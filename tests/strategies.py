"""Hypothesis strategies shared by the rooms. Append only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from viatool.policy.activations import ActivationFunction, activation
from viatool.policy.network import Activation, Affine, Input, Maximum, Minimum, Network, Node, Product

Floats = NDArray[np.float64]

# --- networks --------------------------------------------------------------------------------------------


def _float32(value: float) -> float:
    return float(np.float32(value))


ACTIVATIONS: tuple[ActivationFunction, ...] = (
    activation("Abs"),
    activation("Celu", alpha=1.5),
    activation("Clip", min=-0.75, max=1.25),
    activation("Elu"),
    activation("Erf"),
    activation("ErfGate", slope=_float32(0.7071067811865475)),
    activation("Exp"),
    activation("Gelu"),
    activation("GeluTanh"),
    activation("Guard"),
    activation("HardShrink"),
    activation("HardSigmoid", alpha=_float32(0.2)),
    activation("HardSigmoidGate", alpha=_float32(1 / 6)),
    activation("HardSwish"),
    activation("Known"),
    activation("LeakyRelu", alpha=_float32(0.01)),
    activation("Log"),
    activation("LogSoftmax"),
    activation("Logistic"),
    activation("Mish"),
    activation("Pow", exponent=2.0),
    activation("Pow", exponent=3.0),
    activation("Reciprocal"),
    activation("Relu"),
    activation("RecurrentSigmoid"),
    activation("RecurrentTanh"),
    activation("Selu"),
    activation("Sigmoid"),
    activation("Sign"),
    activation("Silu"),
    activation("SoftShrink"),
    activation("Softmax"),
    activation("Softplus"),
    activation("SoftplusThreshold", threshold=3.0),
    activation("Softsign"),
    activation("SpelledSigmoid"),
    activation("SpelledTanh"),
    activation("Sqrt"),
    activation("Swish", slope=_float32(1.702)),
    activation("Tanh"),
    activation("TanhGate", slope=_float32(0.7978845608028654), cubic=_float32(0.044715)),
    activation("Threshold", threshold=0.5, value=-0.25),
    activation("ThresholdedRelu", alpha=0.25),
)
"""Every declared activation, with parameters that float32 holds exactly."""

_POSITIVE_ONLY = frozenset({"Log", "Reciprocal", "Sqrt"})
TOPOLOGIES = ("chain", "residual", "gated", "maximum", "minimum", "dueling")
SCALES = ("plain", "wide", "huge", "tiny", "cancelling", "sparse")


@dataclass(frozen=True)
class NetworkPlan:
    """What kind of random network to build; its weights follow from the seed."""

    seed: int
    inputs: int
    width: int
    actions: int
    activations: tuple[ActivationFunction, ...]
    topology: str = "chain"
    scale: str = "plain"

    def build(self) -> Network:
        """Return the network; every weight is a float32 number."""
        return _Builder(self).build()


class _Builder:
    def __init__(self, plan: NetworkPlan) -> None:
        self.plan = plan
        self.rng = np.random.default_rng([plan.seed, 7])
        self.nodes: list[Node] = [Input(plan.inputs)]

    def add(self, node: Node) -> int:
        self.nodes.append(node)
        return len(self.nodes) - 1

    def weight(self, rows: int, columns: int) -> Floats:
        plain = self.rng.normal(size=(rows, columns)) * np.sqrt(1.5 / columns)
        match self.plan.scale:
            case "wide":
                plain = plain * 3
            case "huge":
                plain = plain * 10.0 ** self.rng.integers(0, 4, size=plain.shape)
            case "tiny":
                plain = plain * 10.0 ** -self.rng.integers(0, 12, size=plain.shape)
            case "sparse":
                plain = plain * (self.rng.uniform(size=plain.shape) < 0.3)
            case "cancelling" if columns > 1:
                plain[:, 1] = 2.0**12 - plain[:, 0]
                plain[:, 0] = -(2.0**12)
        return plain.astype(np.float32).astype(np.float64)

    def bias(self, rows: int) -> Floats:
        return (0.3 * self.rng.normal(size=rows)).astype(np.float32).astype(np.float64)

    def affine(self, source: int, rows: int) -> int:
        return self.add(Affine((source,), (self.weight(rows, self.nodes[source].size),), self.bias(rows)))

    def activated(self, source: int, function: ActivationFunction) -> int:
        size = self.nodes[source].size
        if function.name in _POSITIVE_ONLY:  # of |x| + 1/2
            magnitude = self.add(Activation(source, activation("Abs"), size))
            source = self.add(Affine((magnitude,), (np.eye(size),), np.full(size, 0.5)))
        elif function.name == "Exp":  # of -|x|, so that it does not grow without limit
            magnitude = self.add(Activation(source, activation("Abs"), size))
            source = self.add(Affine((magnitude,), (-np.eye(size),), np.zeros(size)))
        elif function.name == "Pow":  # of a bounded value
            source = self.add(Activation(source, activation("Clip", min=-2.0, max=2.0), size))
        return self.add(Activation(source, function, size))

    def build(self) -> Network:
        plan = self.plan
        last = 0
        for function in plan.activations:
            before = last
            last = self.activated(self.affine(before, plan.width), function)
            if plan.topology == "residual" and self.nodes[before].size == plan.width:
                eye = np.eye(plan.width)
                last = self.add(Affine((before, last), (eye, eye), np.zeros(plan.width)))
            elif plan.topology == "gated":
                gate = self.activated(self.affine(before, plan.width), activation("Sigmoid"))
                last = self.add(Product(last, gate, plan.width))
            elif plan.topology in ("maximum", "minimum"):
                other = self.affine(before, plan.width)
                kind = Maximum if plan.topology == "maximum" else Minimum
                last = self.add(kind(last, other, plan.width))
        if plan.topology == "dueling":
            self._head(last)
        else:
            self.affine(last, plan.actions)
        return Network(tuple(self.nodes))

    def _head(self, last: int) -> None:
        """Add a value and mean-free advantages of two branches, as dueling networks have."""
        actions = self.plan.actions
        value, advantage = self.affine(last, 1), self.affine(last, actions)
        mean = np.eye(actions) - np.float64(np.float32(1 / actions))
        self.add(Affine((value, advantage), (np.ones((actions, 1)), mean), np.zeros(actions)))


def network_plans(
    *,
    activations: tuple[ActivationFunction, ...] = ACTIVATIONS,
    topologies: tuple[str, ...] = TOPOLOGIES,
    scales: tuple[str, ...] = SCALES,
    most_inputs: int = 6,
    most_layers: int = 6,
    most_width: int = 64,
) -> st.SearchStrategy[NetworkPlan]:
    """Draw plans of random networks: depth 1 to 6, width 1 to 64, every activation and topology."""
    widths = st.one_of(st.integers(1, min(8, most_width)), st.integers(1, most_width))
    return st.builds(
        NetworkPlan,
        seed=st.integers(0, 2**20),
        inputs=st.integers(1, most_inputs),
        width=widths,
        actions=st.integers(1, 3),
        activations=st.lists(st.sampled_from(activations), min_size=1, max_size=most_layers).map(tuple),
        topology=st.sampled_from(topologies),
        scale=st.sampled_from(scales),
    )


@dataclass(frozen=True)
class BoxPlan:
    """What kind of random boxes to draw around random observations."""

    seed: int
    batch: int
    radius: float
    spread: float
    fixed: bool

    def build(self, inputs: int) -> tuple[Floats, Floats]:
        """Return observations and radii, ``(B, n)`` each."""
        rng = np.random.default_rng([self.seed, 11])
        centre = self.spread * rng.normal(size=(self.batch, inputs))
        eps = self.radius * rng.uniform(0.2, 1.0, size=centre.shape)
        if self.fixed:
            eps = eps * (rng.uniform(size=centre.shape) < 0.5)
        return centre, eps


def box_plans(*, most_radius: float = 2.0, most_batch: int = 4) -> st.SearchStrategy[BoxPlan]:
    """Draw plans of boxes, from points through a rounding error to wide ones."""
    radii = (0.0, 5e-324, 1e-300, 1e-15, 1e-8, 1e-3, 0.01, 0.1, 0.5, 2.0, 20.0)
    return st.builds(
        BoxPlan,
        seed=st.integers(0, 2**20),
        batch=st.integers(1, most_batch),
        radius=st.sampled_from([radius for radius in radii if radius <= most_radius]),
        spread=st.sampled_from([0.0, 1e-310, 0.01, 1.0, 10.0]),
        fixed=st.booleans(),
    )


def network_and_boxes(**options: Any) -> st.SearchStrategy[tuple[NetworkPlan, BoxPlan]]:
    """Draw a network and boxes for it."""
    return st.tuples(network_plans(**options), box_plans())
