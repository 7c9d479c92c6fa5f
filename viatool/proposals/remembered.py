"""Memory that is proposed: inputs of a graph that seem to take what an output gave in the step before."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from itertools import product

from viatool.policy import Inspection, describe
from viatool.policy.inspection import Value

_DIRECTIONS = {
    "in", "out", "input", "output", "prev", "previous", "next", "new", "old", "past", "present", "last", "n", "t",
}  # fmt: skip
"""Words that tell the two sides of a memory apart."""

_STATES = {
    "h",
    "c",
    "hx",
    "cx",
    "hidden",
    "cell",
    "state",
    "states",
    "rnn",
    "lstm",
    "gru",
    "memory",
    "recurrent",
}
"""Words of which one stands in the name of a memory."""

_ACTIONS = {"action", "actions", "act", "command", "commands", "cmd", "mean", "mu", "obs", "observation"}
"""Words that stand in no name of a memory."""


def describe_with_memory(
    path: str | os.PathLike[str],
    spec: str | os.PathLike[str] | None = None,
    *,
    input_name: str | Sequence[str] | None = None,
    output_name: str | None = None,
) -> Inspection:
    """Look into a model file as `describe`, of one without a specification with the memory that its names suggest."""
    found = describe(path, spec, input_name=input_name, output_name=output_name)
    memory = {} if found.specification is not None else suggested_memory(found.inputs, found.outputs)
    memory = {taken: given for taken, given in memory.items() if given != output_name}
    if not memory:
        return found
    return describe(path, spec, input_name=input_name, output_name=output_name, memory=memory)


def suggested_memory(inputs: Sequence[Value], outputs: Sequence[Value]) -> dict[str, str]:
    """Return which inputs seem to take which outputs of the step before.

    Parameters
    ----------
    inputs, outputs : sequence of Value
        Of a graph.

    Returns
    -------
    dict
        Input to output of the same shape, whose names differ in a direction (``h`` and ``h_out``, ``state_in_0`` and
        ``state_out_0``) or both speak of a state, with no other of which that could be said; empty where no input that
        is observed or no output that acts would be left.
    """
    used = {name for value in outputs for name in value.depends_on}
    taking = [value for value in inputs if value.name in used and _may_be_memory(value)]
    giving = [value for value in outputs if value.depends_on and _may_be_memory(value)]
    found: dict[str, str] = {}
    for rule in (_same_name, _same_word, _both_states):
        left = [value for value in taking if value.name not in found]
        open_ = [value for value in giving if value.name not in found.values()]
        fits = [(a, b) for a, b in product(left, open_) if rule(a.name, b.name) and _same_shape(a, b)]
        found |= {a.name: b.name for a, b in fits if sum(a is c or b is d for c, d in fits) == 1}
    acting = [value for value in outputs if value.depends_on and value.name not in found.values()]
    observed = used - set(found)
    return (
        {value.name: found[value.name] for value in taking if value.name in found}
        if acting and observed
        else {}
    )


def _words(name: str) -> list[str]:
    """Return the words of a name, and the numbers in it, without those of a direction; ``h0`` and ``hn`` are ``h``."""
    apart = re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower()
    words = [re.sub(r"^([hc])[0nt]$", r"\1", word) for word in re.split(r"[^a-z0-9]+", apart) if word]
    return [word for word in words if word not in _DIRECTIONS]


def _may_be_memory(value: Value) -> bool:
    return not _ACTIONS & set(_words(value.name))


def _same_name(taken: str, given: str) -> bool:
    words = _words(taken)
    return bool(words) and words == _words(given)


def _same_word(taken: str, given: str) -> bool:
    """Tell whether names differ in numbers alone, as ``h_0`` and ``h_n`` do."""
    first, second = ([word for word in _words(name) if not word.isdigit()] for name in (taken, given))
    return bool(first) and first == second


def _both_states(taken: str, given: str) -> bool:
    return all(_STATES & set(_words(name)) for name in (taken, given))


def _same_shape(taken: Value, given: Value) -> bool:
    """Tell whether shapes agree as far as they are known, an axis for a batch apart."""
    if taken.dtype != given.dtype or len(taken.shape) != len(given.shape):
        return False
    pairs = zip(taken.shape, given.shape, strict=True)
    return all(a == b or isinstance(a, str) or isinstance(b, str) for a, b in pairs)
