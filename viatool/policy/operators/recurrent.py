"""Recurrent layers over a sequence within one observation, unrolled: each step becomes the nodes of its gates.

The states before the first step are constants, or parts of the observation. A runtime may compute a gate's sums in any
order, and ``(1 - z) n + z h`` as it stands or as ``n + z (h - n)``: what is counted for the latter, which is bounded
more closely where n and h move together, covers the former.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.policy.assembly import Assembly, Computed, Refusal, Term
from viatool.policy.operators.registry import Call, Value, counted, reads
from viatool.policy.tensors import Constant

_FUNCTIONS = {"relu": "Relu", "sigmoid": "RecurrentSigmoid", "tanh": "RecurrentTanh"}
"""Activations that are read, by the names that a layer gives them, in lower case."""

_FORGOTTEN = "export the actor with a sequence of fixed length, all of it used"

State = tuple[Computed | None, ...]
"""What a step hands on, the output first; None for zeros."""


@dataclass(frozen=True, eq=False)
class _Cell:
    """One direction of a layer: G gates of H numbers, for B sequences at once.

    Parameters
    ----------
    call : Call
        What is read.
    batch : int
        B.
    input_weights, state_weights : ndarray
        ``(G, H, I)`` and ``(G, H, H)``.
    input_bias, state_bias : ndarray
        ``(G, H)``.
    peepholes : ndarray
        ``(3, H)`` weights of the cell in the gates of an LSTM, in the order input, output, forget.
    functions : tuple of str
        The activations: of the gates, then of the others.
    """

    call: Call
    batch: int
    input_weights: Floats
    state_weights: Floats
    input_bias: Floats
    state_bias: Floats
    peepholes: Floats
    functions: tuple[str, ...]

    @property
    def assembly(self) -> Assembly:
        """Return where nodes go."""
        return self.call.assembly

    def argument(
        self, gate: int, x: Computed, state: Computed | None, *others: Term, state_bias: bool = True
    ) -> Computed:
        """Add ``W x + R h + b`` of one gate, and other terms."""
        terms = [Term(x, self._of_all(self.input_weights[gate])), *others]
        if state is not None:
            terms.append(Term(state, self._of_all(self.state_weights[gate])))
        biases = [self.input_bias[gate], *([self.state_bias[gate]] if state_bias else [])]
        bias, magnitude = (
            np.tile(np.sum(parts, axis=0), self.batch) for parts in (biases, [np.abs(b) for b in biases])
        )
        shape = (self.batch, self.input_weights.shape[1])
        roundings = int(len([b for b in biases if b.any()]) > 1)
        return self.assembly.affine(terms, bias, shape, x.precision, roundings, bias_magnitude=magnitude)

    def of_state(self, gate: int, state: Computed) -> Computed:
        """Add ``R h + b`` of one gate."""
        term = Term(state, self._of_all(self.state_weights[gate]))
        bias = np.tile(self.state_bias[gate], self.batch)
        return self.assembly.affine([term], bias, state.shape, state.precision)

    def each(self, x: Computed, factors: Floats) -> Term:
        """Return the product of each of H numbers by its factor, as a term."""
        return Term(x, np.diag(np.tile(factors, self.batch)))

    def activated(self, number: int, x: Computed) -> Computed:
        """Add the activation of that number."""
        return self.assembly.activation(x, self.functions[number])

    def _of_all(self, weights: Floats) -> Floats:
        rows, columns = weights.shape
        self.assembly.reserve(self.batch * rows, self.batch * columns)
        if self.batch == 1:
            return weights
        return np.asarray(np.kron(np.eye(self.batch), weights), dtype=np.float64)


Step = Callable[[_Cell, Computed, State], State]


def _rnn_step(cell: _Cell, x: Computed, state: State) -> State:
    return (cell.activated(0, cell.argument(0, x, state[0])),)


def _gru_step(cell: _Cell, x: Computed, state: State) -> State:
    """Take one step of a GRU, whose gates are update, reset and candidate."""
    assembly, (h,) = cell.assembly, state
    update, reset = (cell.activated(0, cell.argument(gate, x, h)) for gate in (0, 1))
    if not cell.call.flag("linear_before_reset"):
        candidate = cell.argument(2, x, None if h is None else assembly.product(reset, h))
    elif h is None:
        candidate = cell.argument(2, x, None, cell.each(reset, cell.state_bias[2]), state_bias=False)
    else:
        kept = assembly.product(reset, cell.of_state(2, h))
        candidate = cell.argument(2, x, None, cell.each(kept, np.ones(kept.shape[1])), state_bias=False)
    new = cell.activated(1, candidate)
    return (_between(cell, new, h, update),)


def _between(cell: _Cell, new: Computed, old: Computed | None, share: Computed) -> Computed:
    """Add ``(1 - share) new + share old``, where no old is zero."""
    ones, none = np.ones(new.shape[1]), np.zeros(new.size)
    terms = [cell.each(new, -ones), *([] if old is None else [cell.each(old, ones)])]
    gap = cell.assembly.affine(terms, none, new.shape, new.precision, roundings=1)
    moved = cell.assembly.product(share, gap)
    return cell.assembly.affine(
        [cell.each(new, ones), cell.each(moved, ones)], none, new.shape, new.precision, roundings=1
    )


def _lstm_step(cell: _Cell, x: Computed, state: State) -> State:
    """Take one step of an LSTM, whose gates are input, output, forget and cell."""
    assembly, (h, c) = cell.assembly, state

    def gate(number: int, seen: Computed | None) -> Computed:
        weights = cell.peepholes[number]
        peeped = [cell.each(seen, weights)] if seen is not None and weights.any() else []
        return cell.activated(0, cell.argument(number, x, h, *peeped))

    let_in = gate(0, c)
    forget = assembly.scaled(let_in, -1.0, 1.0) if cell.call.flag("input_forget") else gate(2, c)
    inner = assembly.product(let_in, cell.activated(1, cell.argument(3, x, h)))
    if c is not None:
        ones = np.ones(inner.shape[1])
        terms = [cell.each(inner, ones), cell.each(assembly.product(forget, c), ones)]
        inner = assembly.affine(terms, np.zeros(inner.size), inner.shape, inner.precision)
    return assembly.product(gate(1, inner), cell.activated(2, inner)), inner


@reads("RNN", 7, 14, 22, treatment="enclosed", note="sequences of fixed length, all of it used")
def read_rnn(call: Call) -> Sequence[Value | None]:
    """Read a simple recurrent layer."""
    return _unrolled(call, _rnn_step, 1, ("Tanh",))


@reads("GRU", 7, 14, 22, treatment="enclosed", note="sequences of fixed length, all of it used")
def read_gru(call: Call) -> Sequence[Value | None]:
    """Read a layer of gated recurrent units."""
    return _unrolled(call, _gru_step, 3, ("Sigmoid", "Tanh"))


@reads("LSTM", 7, 14, 22, treatment="enclosed", note="sequences of fixed length, all of it used")
def read_lstm(call: Call) -> Sequence[Value | None]:
    """Read a layer of long short-term memory."""
    return _unrolled(call, _lstm_step, 4, ("Sigmoid", "Tanh", "Tanh"))


def _unrolled(call: Call, step: Step, gates: int, functions: tuple[str, ...]) -> Sequence[Value | None]:
    """Return the states of all steps, None where nobody reads them, and those after the last one."""
    x = call.computed(0)
    batch_first = call.flag("layout")
    if len(x.shape) != 3:
        raise Refusal(f"reads the shape {list(x.shape)}, where [steps, batch, features] is expected")
    numbers = np.arange(x.size).reshape(x.shape)
    numbers = numbers.swapaxes(0, 1) if batch_first else numbers  # (T, B, I)
    length, batch, features = numbers.shape
    _check_used(call, length, batch)
    cells = _cells(call, batch, features, gates, functions)
    places = 2 if gates == 4 else 1
    outputs: list[list[Computed]] = [[] for _ in range(length)]
    last: list[list[Computed]] = [[] for _ in range(places)]
    taken = [_taken(call, x, order) for order in numbers]
    for direction, (backwards, cell) in enumerate(cells):
        state: State = tuple(
            _initial(call, 5 + place, direction, cell, batch_first) for place in range(places)
        )
        for at in range(length)[:: -1 if backwards else 1]:
            state = step(cell, taken[at], state)
            assert state[0] is not None
            outputs[at].append(state[0])
        for place, value in enumerate(state):
            assert value is not None
            last[place].append(value)
    every = None
    if call.node.outputs and call.node.outputs[0]:
        every = _stacked(call, [h for row in outputs for h in row], (length, len(cells)), batch_first)
    return [every, *(_stacked(call, values, (len(cells),), batch_first) for values in last)]


def _check_used(call: Call, length: int, batch: int) -> None:
    """Refuse sequences of which a part is not used, and what no exporter writes."""
    if call.has(4) and (call.constant(4, "sequence lengths").array != length).any():
        raise Refusal(f"reads less than all of its {length} steps", _FORGOTTEN)
    if "clip" in call.attributes:
        raise Refusal(
            f"clips its gates at {call.attributes['clip']}, which is not read",
            "export the layer without clip",
        )


def _cells(
    call: Call, batch: int, features: int, gates: int, functions: tuple[str, ...]
) -> list[tuple[bool, _Cell]]:
    """Return the cell of each direction, and whether it goes backwards."""
    ways = {"forward": [False], "reverse": [True], "bidirectional": [False, True]}
    backwards = ways.get(str(call.attributes.get("direction", "forward")))
    if backwards is None:
        raise Refusal(f"has the direction '{call.attributes['direction']}', which is not known")
    named = _functions(call, functions, len(backwards))
    weights, recurrent = call.weights(1, "weight"), call.weights(2, "recurrent weight")
    if weights.ndim != 3 or recurrent.ndim != 3 or weights.shape[0] != len(backwards):
        raise Refusal(f"has weights {list(weights.shape)} for {len(backwards)} directions")
    hidden = recurrent.shape[2]
    if call.attributes.get("hidden_size", hidden) != hidden or recurrent.shape[1] != gates * hidden:
        raise Refusal(f"has recurrent weights {list(recurrent.shape)}, which do not fit its hidden size")
    if weights.shape[1:] != (gates * hidden, features):
        raise Refusal(
            f"has weights {list(weights.shape)}, which do not map {features} numbers to {gates} gates of {hidden}"
        )
    bias = call.weights(3, "bias") if call.has(3) else np.zeros((len(backwards), 2 * gates * hidden))
    peepholes = call.weights(7, "peephole weight") if call.has(7) else np.zeros((len(backwards), 3 * hidden))
    found = []
    for k, back in enumerate(backwards):
        input_bias, state_bias = bias[k].reshape(2, gates, hidden)
        own = (weights[k].reshape(gates, hidden, -1), recurrent[k].reshape(gates, hidden, hidden))
        cell = _Cell(call, batch, *own, input_bias, state_bias, peepholes[k].reshape(3, hidden), named[k])
        found.append((back, cell))
    return found


def _functions(call: Call, default: tuple[str, ...], directions: int) -> list[tuple[str, ...]]:
    """Return the activations of each direction."""
    given = call.node.attributes.get("activations") or default * directions  # the standard's default is not
    if directions == 1 and given == ("Tanh", "Tanh") and default == ("Tanh",):
        given = (
            default  # the standard's default for both directions, which onnxruntime writes for one as well
        )
    if not isinstance(given, tuple) or len(given) != len(default) * directions:
        raise Refusal(f"has the activations {given}, where {len(default)} for each direction are expected")
    unknown = [name for name in given if str(name).lower() not in _FUNCTIONS]
    if unknown:
        raise Refusal(
            f"has the activation '{unknown[0]}'; Relu, Sigmoid and Tanh are read", "use one of them"
        )
    known = [_FUNCTIONS[str(name).lower()] for name in given]
    return [tuple(known[k * len(default) : (k + 1) * len(default)]) for k in range(directions)]


def _initial(call: Call, index: int, direction: int, cell: _Cell, batch_first: bool) -> Computed | None:
    """Return a state before the first step, (B, H); None for zeros."""
    if not call.has(index):
        return None
    value = call.value(index)
    numbers = np.arange(np.prod(value.shape)).reshape(value.shape)
    own: Indices = numbers[:, direction] if batch_first else numbers[direction]
    if isinstance(value, Computed):
        return _taken(call, value, own)
    constant = counted(value, "initial state")
    if not constant.magnitudes.any():
        return None
    part = Constant(value.array.ravel()[own], value.dtype)
    return call.assembly.inexact(counted(part, "initial state"), call.computed(0).precision)


def _taken(call: Call, x: Computed, numbers: Indices) -> Computed:
    """Return some elements of a value."""
    return call.assembly.copies([(x, numbers.ravel())], np.zeros(numbers.size), numbers.shape, x.precision)


def _stacked(call: Call, values: Sequence[Computed], axes: tuple[int, ...], batch_first: bool) -> Computed:
    """Return values (B, H) along new axes in front, or behind the batch."""
    batch, hidden = values[0].shape
    size = len(values) * batch * hidden
    sources = np.arange(size).reshape(*axes, batch, hidden)
    order = np.moveaxis(sources, -2, 0) if batch_first else sources
    flat, own = order.ravel(), batch * hidden
    terms = [(value, np.where(flat // own == number, flat % own, -1)) for number, value in enumerate(values)]
    return call.assembly.copies(terms, np.zeros(size), order.shape, values[0].precision)
