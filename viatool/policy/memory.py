"""What a policy remembers from one step to the next: outputs of its graph that inputs take in the step after.

The bounds and verdicts of a policy are of its action as a function of the observation, of which the memory is the last
part. How the memory goes on is not bounded: it is computed, by onnxruntime, where a policy is driven or a recording
lacks it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.errors import PolicyError
from viatool.policy.graph import live, read_graph
from viatool.policy.model_file import ModelFile, Ports
from viatool.policy.runtime import Runtime, runtime_of
from viatool.policy.specification import ObservationChannel, PolicySpecification


class Remembering(Protocol):
    """A policy that remembers."""

    def remember(self, observations: Floats, /) -> Floats:
        """Return what the program keeps for the step after observations (B, n), (B, M)."""


class CarriedMemory:
    """What the programs of E robots remember; each begins an episode as the specification says.

    Parameters
    ----------
    spec : PolicySpecification
        M numbers of memory, behind the others of an observation.
    robots : int
        E.
    number : type
        The floating-point type in which the program receives its numbers.
    """

    def __init__(self, spec: PolicySpecification, robots: int, number: type = np.float32) -> None:
        self._initial = spec.initial_memory.astype(number).astype(np.float64)
        self._numbers = np.tile(self._initial, (robots, 1))

    def beside(self, sensed: Floats, which: Indices | slice = slice(None)) -> Floats:
        """Return the observations (E, n) of which (E, n - M) were sensed; of some robots where they are named."""
        return np.concatenate([sensed, self._numbers[which]], axis=1) if len(self._initial) else sensed

    def carry(self, policy: Remembering, observations: Floats, which: Indices | slice = slice(None)) -> None:
        """Go one step on after observations (E, n)."""
        if len(self._initial):
            self._numbers[which] = policy.remember(observations)

    def begin(self, which: Booleans) -> None:
        """Begin the episodes of some robots, (E,) bool."""
        self._numbers[which] = self._initial

    def keep(self, which: Booleans) -> None:
        """Go on with some robots alone, (E,) bool."""
        self._numbers = self._numbers[which]


def with_memory(path: Path, spec: PolicySpecification, ports: Ports) -> PolicySpecification:
    """Return a specification with a channel for each input that is memory, of the size that the graph gives it.

    Raises
    ------
    PolicyError
        If a channel has another size.
    """
    if not spec.memory:
        return spec
    sizes = {port.name: port.size for port in ports.each}
    told = {channel.name: channel for channel in spec.remembered}
    for name, channel in told.items():
        if channel.size != sizes[name] and "size" in channel.model_fields_set:
            raise PolicyError(
                f"{path}: the input '{name}' takes {sizes[name]} numbers, the channel of kind 'memory' of this name "
                f"has {channel.size}",
                "correct its `size`, or leave it out",
            )
    kept = [
        told[name].model_copy(update={"size": sizes[name]})
        if name in told
        else ObservationChannel(name=name, kind="memory", size=sizes[name])
        for name in spec.memory
    ]
    return spec.model_copy(update={"observation": [*spec.sensed, *kept]})


def memory_program(model: ModelFile, spec: PolicySpecification | None, ports: Ports) -> Runtime | None:
    """Return the program of what is remembered, of the inputs of a graph; None where nothing is.

    Raises
    ------
    PolicyError
        If an output gives other numbers than its input takes.
    """
    if spec is None or not spec.memory:
        return None
    start = np.zeros(ports.size)
    start[ports.size - len(spec.initial_memory) :] = spec.initial_memory
    return checked_memory(model, spec.memory, ports, start)


def checked_memory(model: ModelFile, memory: Mapping[str, str], ports: Ports, start: Floats) -> Runtime:
    """Return the program of the outputs that inputs take in the step after, run once from a `start`, (n,).

    Raises
    ------
    PolicyError
        As `memory_program`.
    """
    program = runtime_of(model, live(read_graph(model.proto, model.folder), *memory.values()), ports)
    _check_given(model.path, memory, ports, program.apart(start))
    return program


def _check_given(path: Path, memory: Mapping[str, str], ports: Ports, given: Mapping[str, Floats]) -> None:
    """Refuse outputs that their inputs could not take."""
    takes = {port.name: port for port in ports.each}
    for source, made in memory.items():
        numbers, port = given[made], takes[source]
        if numbers.size != port.size or str(numbers.dtype) != port.precision:
            raise PolicyError(
                f"{path}: memory.{source}: the input '{source}' takes {port.size} numbers of {port.precision}, and the "
                f"output '{made}' gives {numbers.size} of {numbers.dtype}",
                "name the output that belongs to the input",
            )
