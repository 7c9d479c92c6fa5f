"""The networks that the installed onnxruntime really runs, read from the models that it writes itself.

Before it runs a model, onnxruntime rewrites it: constants are folded, nodes are joined, and patterns are replaced by
operators of its own, some of them where constants or exponents are only near those of the pattern. A proof about the
file alone would then be one about another program. So the model that is executed, at each level of optimisation, is
read like the file. Where it is the same network nothing more is to be done; where it is not, bounds have to hold for
both; where it cannot be read, the policy is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import get_args

import onnx

from viatool.errors import PolicyError
from viatool.policy.graph import live, read_graph
from viatool.policy.identity import is_same
from viatool.policy.model_file import ModelFile, Ports
from viatool.policy.network import Network
from viatool.policy.reader import read_network, unsupported
from viatool.policy.runtime import Optimisation, Runtime, runtime_of


@dataclass(frozen=True, eq=False)
class Executed:
    """What runs of a file.

    Parameters
    ----------
    at : dict
        The network of its program at each level of optimisation; the file's own where they are the same.
    rewritten : tuple of Network
        All that run in place of the file's own, each once.
    """

    at: Mapping[Optimisation, Network]
    rewritten: tuple[Network, ...]


def executed_networks(model: ModelFile, network: Network, runtime: Runtime) -> Executed:
    """Return what onnxruntime runs at each of its levels of optimisation.

    Parameters
    ----------
    model : ModelFile
        The policy's file.
    network : Network
        As read from it.
    runtime : Runtime
        Its program: what the output needs, which is what is run here.

    Returns
    -------
    Executed
        Where a file has other outputs, also what of the whole file is run for this one: what one output shares with
        another may be rewritten otherwise, or not at all.

    Raises
    ------
    PolicyError
        If onnxruntime cannot load the program, does not write what it runs, or runs nodes that cannot be read.
    """
    collected = _Collected(model, runtime.ports, runtime.outputs[0], [network])
    at = {level: collected.add(runtime.at(level).executed_model(), level) for level in get_args(Optimisation)}
    for level, proto in _executed_for_all_outputs(model, runtime.ports):
        collected.add(proto, level)
    return Executed(at, tuple(collected.networks[1:]))


def _executed_for_all_outputs(model: ModelFile, ports: Ports) -> list[tuple[Optimisation, onnx.ModelProto]]:
    """Return what runs of a file with several outputs; nothing where they cannot be run together."""
    graph = read_graph(model.proto, model.folder)
    if len(graph.outputs) == 1:
        return []
    try:
        runtime = runtime_of(model, live(graph, *graph.outputs), ports)
        return [(level, runtime.at(level).executed_model()) for level in get_args(Optimisation)]
    except PolicyError:
        return []


@dataclass
class _Collected:
    """Networks that differ, the file's own first, and of which content each was read."""

    model: ModelFile
    ports: Ports
    output: str
    networks: list[Network]
    read: dict[bytes, Network] = field(default_factory=dict)

    def add(self, proto: onnx.ModelProto, level: Optimisation) -> Network:
        """Return the network of a model that is executed: one that is there, where it is the same."""
        content = proto.graph.SerializeToString(deterministic=True)
        if content not in self.read:
            self.read[content] = self._known(self._network(proto, level))
        return self.read[content]

    def _known(self, network: Network) -> Network:
        for other in self.networks:
            if is_same(other, network):
                return other
        self.networks.append(network)
        return network

    def _network(self, proto: onnx.ModelProto, level: Optimisation) -> Network:
        folder = self.model.folder
        graph = live(read_graph(proto, folder), self.output)
        reading = read_network(graph, self.ports, folder)
        if reading.network is None:
            what = f"{self.model.path}, as onnxruntime runs it at its level of optimisation '{level}'"
            raise unsupported(what, reading.findings)
        return reading.network
