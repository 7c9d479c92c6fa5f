"""An exported policy: the network that is verified, the program that runs, and what its numbers mean."""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Floats
from viatool.errors import PolicyError, PolicyWarning
from viatool.policy.action_map import apply_action_map, with_action_map
from viatool.policy.command_map import CommandMap
from viatool.policy.entries import as_specified
from viatool.policy.executed import executed_networks
from viatool.policy.given import numbers
from viatool.policy.maps import Maps, maps_of
from viatool.policy.memory import memory_program, with_memory
from viatool.policy.model_file import ModelFile, Ports, actor_graph, open_model
from viatool.policy.network import Network
from viatool.policy.reader import read_network, unsupported
from viatool.policy.runtime import Runtime, runtime_of
from viatool.policy.self_check import SelfCheck, check_executed
from viatool.policy.specification import PolicySpecification
from viatool.policy.specification_file import load_specification

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Policy:
    """A loaded policy.

    Parameters
    ----------
    path : Path
        Where it was read from, or the name under which it comes with viatool.
    sha256 : str
        Of the file.
    network : Network
        What the file says, with the action map of the specification at its end.
    spec : PolicySpecification or None
        None for a foreign model without a sidecar.
    ports : Ports
        The graph's inputs.
    self_check : SelfCheck or None
        What the comparison with onnxruntime found; None where it was skipped.
    maps : Maps
        What is applied to the numbers before and after the network, in words.
    rewritten : tuple of Network
        What onnxruntime runs in the file's place at one of its levels of optimisation, where that is another network;
        with the action map as well. Bounds of the deployed program hold for each of them.
    command_map : CommandMap, optional
        What makes a command of the actions, where the policy gives commands: it stands at the end of the networks.
    own : tuple of Network
        The networks without the action map: what gives the outputs that a policy may observe in the next step.
    memory : Runtime, optional
        The program of what the policy remembers, where it does: the last part of the observation of the step after.
    """

    path: Path
    sha256: str
    network: Network
    spec: PolicySpecification | None
    ports: Ports
    runtime: Runtime = field(repr=False)
    self_check: SelfCheck | None = None
    maps: Maps = field(default_factory=Maps)
    rewritten: tuple[Network, ...] = ()
    command_map: CommandMap | None = None
    own: tuple[Network, ...] = ()
    memory: Runtime | None = field(default=None, repr=False)

    def commanding(self, command_map: CommandMap) -> Policy:
        """Return the same policy with the command of a robot as what it gives, in networks and runs alike."""
        if command_map.changes_nothing or command_map == self.command_map:
            return self
        return replace(
            self,
            network=command_map.follow(self.network),
            rewritten=tuple(command_map.follow(other) for other in self.rewritten),
            command_map=command_map,
        )

    @property
    def input_size(self) -> int:
        """Return the length of the observation vector."""
        return self.network.input_size

    @property
    def output_size(self) -> int:
        """Return the number of actions."""
        return self.network.output_size

    def __call__(self, observations: ArrayLike) -> Floats:
        """Evaluate the network in float64: ``(B, input_size)`` to ``(B, output_size)``.

        Raises
        ------
        PolicyError
            If the observations do not have the policy's size.
        """
        rows = self._rows(observations)
        with np.errstate(over="ignore", invalid="ignore"):  # a program overflows silently as well
            return self.network(rows)

    def run(self, observations: ArrayLike) -> Floats:
        """Run the deployed program: onnxruntime on one thread, then the action map of the specification.

        Parameters
        ----------
        observations : array_like
            ``(B, input_size)``; rounded to the input type of the model, mostly float32.

        Returns
        -------
        ndarray
            ``(B, output_size)``, float64 numbers as the program gives them.

        Raises
        ------
        PolicyError
            If the observations do not have the policy's size, or onnxruntime cannot run the model.

        Notes
        -----
        A single row is bit for bit what the robot computes; in a batch the last place may round differently.
        """
        actions = apply_action_map(self.outputs(observations), self.spec)
        return actions if self.command_map is None else self.command_map(actions)

    def outputs(self, observations: ArrayLike) -> Floats:
        """Run the deployed program as `run` does, and return what it gives before the action map, (B, O)."""
        rows = self._rows(observations)
        if len(rows):
            return self.runtime(rows)
        return np.zeros((0, self.output_size if self.command_map is None else self.command_map.actions))

    def remember(self, observations: ArrayLike) -> Floats:
        """Run the deployed program as `run` does, and return what it remembers: M numbers, as onnxruntime gives them.

        Parameters
        ----------
        observations : array_like
            ``(B, input_size)``, of which the last M numbers are the memory; `spec.initial_memory` at the beginning.

        Returns
        -------
        ndarray
            ``(B, M)``, the memory of the step after; M is 0 for a policy that remembers nothing.
        """
        rows = self._rows(observations)
        size = 0 if self.spec is None else len(self.spec.initial_memory)
        return np.zeros((len(rows), size)) if self.memory is None or not len(rows) else self.memory(rows)

    def _rows(self, observations: ArrayLike) -> Floats:
        rows = numbers("observations", observations)
        if rows.ndim != 2 or rows.shape[1] != self.input_size:
            raise PolicyError(
                f"observations have shape {list(rows.shape)}, the policy takes (states, {self.input_size})",
                "give one row of the policy's input size for each state",
            )
        return rows


def as_policy(
    given: Policy | str | os.PathLike[str], spec: str | os.PathLike[str] | PolicySpecification | None = None
) -> Policy:
    """Return a policy as it was given, or read it with `load_policy`."""
    return given if isinstance(given, Policy) else load_policy(given, spec)


def load_policy(
    path: str | os.PathLike[str],
    spec: str | os.PathLike[str] | PolicySpecification | None = None,
    *,
    self_check: bool = True,
    input_name: str | Sequence[str] | None = None,
    output_name: str | None = None,
) -> Policy:
    """Read an ONNX policy.

    Parameters
    ----------
    path : path or str
        The ONNX file, or the name of a policy that comes with viatool, such as "via".
    spec : path or PolicySpecification, optional
        A sidecar; it replaces the specification inside the file.
    self_check : bool
        Compare the network with onnxruntime before anything is built on it.
    input_name : str or sequence of str, optional
        The inputs of the graph that together are the observation, in its order; they override the specification's.
    output_name : str, optional
        Which of several outputs is the action; it overrides the specification's.

    Raises
    ------
    PolicyError
        If the file, or what onnxruntime runs in its place, cannot be read, is not supported, or contradicts its
        specification.
    SelfCheckError
        If a network and onnxruntime disagree.

    Warns
    -----
    PolicyWarning
        If rounding could explain nearly any difference, so that the comparison told nothing.
    """
    model, given = open_model(path), spec if isinstance(spec, str | os.PathLike) else None
    if isinstance(spec, (str, os.PathLike)):
        spec = load_specification(spec)
    if spec is None:
        spec = model.specification()
    output_name = output_name or (spec.output if spec else None)
    model, output_name = as_specified(model, spec, output_name)
    memory = None if spec is None else spec.memory
    network, runtime = load_actor(model, input_name or (spec.input if spec else None), output_name, memory)
    if spec is not None:
        spec = with_memory(model.path, spec, runtime.ports)
        check_inputs(model.path, runtime.ports, spec, named=bool(input_name))
        check_sizes(model.path, network, spec)
    executed = executed_networks(model, network, runtime)
    found = check_executed(executed, runtime, spec) if self_check else None
    if found is not None and not found.points:
        warnings.warn(f"{path}: {found.words}", PolicyWarning, stacklevel=2)
    _log.info("policy %s read from %s: sha256 %s", path, model.path, model.sha256[:12])
    _log.info(
        "policy: %d numbers to %d in %d nodes, %s; specification %s",
        network.input_size,
        network.output_size,
        len(network.nodes),
        runtime.words,
        "missing" if spec is None else "of the model" if given is None else f"given: {given}",
    )
    _log.info("policy: self-check %s", "left out" if found is None else found.words)
    return Policy(
        Path(path),
        model.sha256,
        with_action_map(network, spec),
        spec,
        runtime.ports,
        runtime,
        found,
        maps_of(network, spec, runtime.ports),
        tuple(with_action_map(other, spec) for other in executed.rewritten),
        own=(network, *executed.rewritten),
        memory=memory_program(model, spec, runtime.ports),
    )


def load_actor(
    model: ModelFile,
    input_name: str | Sequence[str] | None = None,
    output_name: str | None = None,
    memory: Mapping[str, str] | None = None,
) -> tuple[Network, Runtime]:
    """Return the network and the program of a parsed model.

    Raises
    ------
    PolicyError
        Lists every node that is not supported.
    """
    graph, ports = actor_graph(model, input_name, output_name, memory)
    reading = read_network(graph, ports, model.folder)
    if reading.network is None:
        raise unsupported(str(model.path), reading.findings)
    return reading.network, runtime_of(model, graph, ports)


def check_inputs(path: Path, ports: Ports, spec: PolicySpecification, *, named: bool = False) -> None:
    """Refuse a specification whose channels do not tell which of several inputs takes what.

    Parameters
    ----------
    path : Path
        Of the policy.
    ports : Ports
        Its inputs.
    spec : PolicySpecification
        What they mean.
    named : bool
        Whether the order of the inputs was given otherwise.

    Raises
    ------
    PolicyError
        If the inputs have no order, or one of them ends within a channel, naming each input with its size.
    """
    if len(ports.each) == 1:
        return
    takes = f"{path} takes several inputs ({ports.words})"
    sensed = [name for name in ports.names if name not in spec.memory]
    if spec.input is None and not named and len(sensed) > 1:
        raise PolicyError(
            f"{takes}, and its specification does not say in which order its channels describe them",
            f"name them in the order of the channels, as `input: [{', '.join(sensed)}]`",
        )
    if spec.frames is not None and spec.frames.count > 1:
        raise PolicyError(
            f"{takes}, so its observations are not stacked as a whole",
            "give `frames` to each channel that is stacked instead",
        )
    channels = spec.inputs.channel
    if len(channels) != ports.size:
        held = ", ".join(f"{c.name} {(channels == k).sum()}" for k, c in enumerate(spec.observation))
        raise PolicyError(
            f"{takes}, {ports.size} numbers together, its specification describes {len(channels)} ({held})",
            "correct the channels of the specification, or give the policy that belongs to it",
        )
    for name, place in list(ports.places.items())[1:]:
        if channels[place.start] == channels[place.start - 1]:
            channel = spec.observation[channels[place.start]].name
            raise PolicyError(
                f"{takes}, and the observation channel '{channel}' goes on where the input '{name}' begins",
                "describe each input by channels of its own, in the order of `input`",
            )


def check_sizes(path: Path, network: Network, spec: PolicySpecification) -> None:
    """Refuse a specification that describes another policy.

    Raises
    ------
    PolicyError
        Names both sizes, and what each channel takes of its own.
    """
    for what, found, expected, total in (
        ("observations", network.input_size, spec.observation_size, spec.observation_sum),
        ("actions", network.output_size, spec.action_size, spec.action_sum),
    ):
        if found != expected:
            raise PolicyError(
                f"{path} has {found} {what}, its specification describes {expected}: {total}, "
                f"but the model {'takes' if what == 'observations' else 'gives'} {found}",
                _remedy(what, found, expected),
            )


def _remedy(what: str, found: int, expected: int) -> str:
    """Return what to do about sizes that differ."""
    if what == "actions" and found == 2 * expected:
        return (
            "if the output holds a mean and a deviation for each action, as a Gaussian head gives, say which numbers "
            "are the actions (`entry: 0`, `entry: 1`, ...); else correct the actions of the specification"
        )
    described = "channels" if what == "observations" else "actions"
    return f"correct the {described} of the specification, or give the policy that belongs to it"
