"""Random graphs: a function of a seed and a number, over every operator that is read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import onnx

from tests.attack.building import MOST_ELEMENTS, NEWEST_OPSET, OLDEST_OPSET, Builder, Unfit, Value
from tests.attack.constants import constant
from tests.attack.idioms import IDIOMS
from tests.attack.pieces import PIECES, linear, scaled_down

OPERATORS = sorted(PIECES)
_TRIES = 40
_LARGE = 160
"""Elements of one value in a few graphs, beyond which the engine takes another way."""


@dataclass(frozen=True)
class Gate:
    """Where a part of the graph is open: beyond a threshold of one input."""

    channel: int
    threshold: float
    """Open above it if it is positive, below it otherwise."""


@dataclass(frozen=True, eq=False)
class RandomGraph:
    """A model and what an attack should know of it.

    Parameters
    ----------
    number, seed : int
        Which graph it is.
    model : onnx.ModelProto
        One input x, one output.
    batched : bool
        Whether its first axis is a batch.
    gates : list of Gate
        Parts that are closed near zero, where a loaded policy is compared with the program.
    """

    number: int
    seed: int
    kind: str
    model: onnx.ModelProto
    batched: bool
    gates: list[Gate] = field(default_factory=list)

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the shape of one observation, batch size 1."""
        dims = self.model.graph.input[0].type.tensor_type.shape.dim
        return tuple(dim.dim_value or 1 for dim in dims)

    @property
    def operators(self) -> list[str]:
        return sorted({node.op_type for node in self.model.graph.node})

    @property
    def opset(self) -> int:
        return int(self.model.opset_import[0].version)


def random_graph(number: int, seed: int) -> RandomGraph:
    """Return one graph; the operators take turns, so that a run of them has each."""
    rng = np.random.default_rng((seed, number))
    first = OPERATORS[number % len(OPERATORS)]
    kind = str(rng.choice(["float16", "float32", "float64"], p=[0.28, 0.44, 0.28]))
    opset = int(rng.integers(OLDEST_OPSET, NEWEST_OPSET + 1))
    for attempt in range(_TRIES):
        if attempt == 5:  # the operator may be too new, or without a kernel of this type
            kind, opset = "float32", NEWEST_OPSET
        builder = Builder(
            rng,
            opset,
            kind,
            _input_shape(rng),
            batched=bool(rng.random() < 0.75),
            wild=bool(rng.random() < 0.12),
            most=_LARGE if rng.random() < 0.06 else MOST_ELEMENTS,
        )
        try:
            output, gates = _grown(builder, first)
        except Unfit:
            continue
        return RandomGraph(number, seed, kind, builder.model(output), builder.batched, gates)
    raise AssertionError(f"graph {number} of seed {seed}: no way to write {first}")


def _input_shape(rng: np.random.Generator) -> tuple[int, ...]:
    return ((1, int(rng.integers(1, 9))), (1, int(rng.integers(2, 7))), (1, 2, 3), (1, 1, 6), (1, 2, 2, 2))[
        int(rng.choice(5, p=[0.5, 0.3, 0.08, 0.06, 0.06]))
    ]


def _grown(g: Builder, first: str) -> tuple[Value, list[Gate]]:
    gates = _planned_gates(g)
    x = g.input()
    pool = [x]
    for _ in range(g.between(0, 2)):
        _extend(g, pool, _drawn_piece(g))
    if gates and g.chance(0.7):  # the operator whose turn it is hides behind the gate
        if len(pool) == 1:
            _extend(g, pool, _drawn_piece(g))
        return _finished(g, _behind_gate(g, pool, gates[0], PIECES[first])), gates
    pool.append(PIECES[first](g, pool[-1]))
    for _ in range(g.between(0, 4)):
        _extend(g, pool, _drawn_piece(g))
    if gates:
        pool.append(_behind_gate(g, pool, gates[0], _drawn_piece(g)))
    if len(pool) > 3 and g.chance(0.3):
        pool.append(_joined(g, pool[-1], g.pick(pool[1:-1])))
    return _finished(g, pool[-1]), gates


Piece = Callable[[Builder, Value], Value]


def _drawn_piece(g: Builder) -> Piece:
    return g.pick(IDIOMS) if g.chance(0.45) else PIECES[g.pick(OPERATORS)]


def _extend(g: Builder, pool: list[Value], piece: Piece) -> None:
    """Append what a piece makes of one of the last values, if it fits."""
    before = len(g.nodes), len(g.initializers)
    source = pool[-1] if g.chance(0.8) else g.pick(pool)
    try:
        pool.append(piece(g, source))
    except Unfit:
        del g.nodes[before[0] :], g.initializers[before[1] :]


def _joined(g: Builder, left: Value, right: Value) -> Value:
    """Combine two values of any shapes."""
    left = linear(g, left, g.between(1, 4))
    return g.call(g.pick(["Add", "Mul", "Sub", "Max", "Min"]), left, linear(g, right, left.shape[1]))


def _finished(g: Builder, value: Value) -> Value:
    """Bring a value to a few actions."""
    if value.size > 3 or g.chance(0.3):
        value = linear(g, value, g.between(1, 3))
    elif len(value.shape) != 2 and g.chance(0.7):
        value = g.ranked(value, 2)
    if g.chance(0.2):
        value = g.call(g.pick(["Tanh", "Sigmoid"]), value)
    if value.constant or value.name == "x":
        raise Unfit("nothing was computed")
    return value


# --- gates -----------------------------------------------------------------------------------------------


def _planned_gates(g: Builder) -> list[Gate]:
    """Draw a gate for some graphs, and add probes where it is open."""
    if not g.chance(0.35):
        return []
    size = int(np.prod(g.shape))
    gate = Gate(g.between(0, size - 1), float(g.pick([50.0, 60.0, -55.0, 120.0])))
    for scale in (1.0, 3.0):
        probe = scale * g.rng.normal(size=g.shape)
        probe.ravel()[gate.channel] = gate.threshold + np.sign(gate.threshold) * (2.0 + scale)
        g.probes.append(g.typed(probe).astype(np.float64))
    return [gate]


def _behind_gate(g: Builder, pool: list[Value], gate: Gate, piece: Piece) -> Value:
    """Add ``gate * part`` to the last value: the part is multiplied by 0 until one input is far from 0."""
    x = g.input()
    flat = g.reshaped(x, 1, x.size)
    chosen = g.call("Gather", flat, g.stored(np.array([gate.channel])), axis=1)
    far = g.call("Sub", chosen, g.stored(g.typed(gate.threshold)))
    if gate.threshold < 0:
        far = g.call("Neg", far)
    opened = g.call("Clip", far, g.stored(g.typed(0.0)), g.stored(g.typed(1.0)))
    offset = np.zeros(x.size)
    offset[gate.channel] = gate.threshold
    near = g.call("Sub", flat, constant(g, offset, chained=0.0))
    source = near if g.chance(0.6) else pool[-1]
    if source is not near and g.chance(0.5):
        source = scaled_down(g, source)
    part = piece(g, source)
    last = linear(g, pool[-1], g.between(1, 3)) if pool[-1] is not x else flat
    return g.call("Add", last, g.call("Mul", opened, linear(g, part, last.shape[1])))
