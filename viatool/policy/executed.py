"""The networks that the installed onnxruntime really runs, read from the models that it writes itself.

Before it runs a model, onnxruntime rewrites it: constants are folded, nodes are joined, and patterns are replaced by
operators of its own, some of them where constants or exponents are only near those of the pattern. A proof about the
file alone would then be one about another program. So the model that is executed, at each level of optimisation, is
read like the file. Where it is the same network nothing more is to be done; where it is not, bounds have to hold for
both; where it cannot be read, the policy is refused.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, get_args

import numpy as np

from viatool.errors import PolicyError
from viatool.policy.graph import live, read_graph
from viatool.policy.model_file import ModelFile
from viatool.policy.network import Activation, Affine, Cast, Input, Maximum, Minimum, Network, Node, Product
from viatool.policy.reader import Reading, UnreadableNode, read_network
from viatool.policy.runtime import Optimisation, Runtime

Executed = Mapping[Optimisation, Network]
"""For each level of optimisation the network that runs; the file's own where they are the same."""


def executed_networks(model: ModelFile, network: Network, runtime: Runtime) -> Executed:
    """Return what onnxruntime runs at each of its levels of optimisation.

    Parameters
    ----------
    model : ModelFile
        The policy's file.
    network : Network
        As read from it.
    runtime : Runtime
        Its program.

    Returns
    -------
    dict
        Networks that differ are different objects; each that is the same as one before it is that one.

    Raises
    ------
    PolicyError
        If onnxruntime cannot load the model, does not write what it runs, or runs nodes that cannot be read.
    """
    found: dict[Optimisation, Network] = {}
    known = [network]
    read: dict[bytes, Network] = {}
    for level in get_args(Optimisation):
        proto = runtime.at(level).executed_model()
        content = proto.graph.SerializeToString(deterministic=True)
        if content not in read:
            graph = live(read_graph(proto, model.folder), proto.graph.output[0].name)
            port = runtime.port
            reading = read_network(graph, port.name, port.shape, port.precision, model.folder)
            if reading.network is None:
                raise _unreadable(model, level, reading)
            executed = reading.network
            read[content] = next((other for other in known if is_same(other, executed)), executed)
            known.append(read[content])
        found[level] = read[content]
    return found


def rewritten(network: Network, executed: Executed) -> tuple[Network, ...]:
    """Return the networks that run in place of a file's own, each once."""
    return tuple(dict.fromkeys(other for other in executed.values() if other is not network))


def is_same(first: Network, second: Network) -> bool:
    """Whether two networks are one: the same operations on the same numbers, bit for bit.

    Returns
    -------
    bool
        True only if both outputs come from the same kinds of nodes with the same numbers in all fields (weights,
        parameters, precisions, counts of roundings), applied to the same sources. In what order nodes stand, and in
        what order a sum, product, minimum or maximum names its sources, makes no difference: neither does it in
        the bounds.
    """
    numbers: dict[object, int] = {}
    return _number_of(first, numbers) == _number_of(second, numbers)


def _number_of(network: Network, numbers: dict[object, int]) -> int:
    """Return the number of the output, where equal nodes of whatever network have one number."""
    own: list[int] = []
    for node in network.nodes:
        own.append(numbers.setdefault(_identity(node, own), len(numbers)))
    return own[-1]


_WIRING = frozenset(("source", "sources", "left", "right", "weights", "merged_weights"))
"""Fields that name sources, or have an entry for each."""


def _identity(node: Node, own: list[int]) -> object:
    """Return all that makes a node what it is, given the numbers of those before it.

    Every field counts that does not name sources, whatever fields a kind of node may be given one day.
    """
    parameters = tuple(
        _plain(getattr(node, entry.name)) for entry in fields(node) if entry.name not in _WIRING
    )
    wiring: tuple[object, ...]
    match node:
        case Affine():
            terms = zip(node.sources, node.weights, node.magnitudes, strict=True)
            wiring = tuple(
                sorted((own[source], _plain(weight), _plain(size)) for source, weight, size in terms)
            )
        case Product() | Maximum() | Minimum():
            wiring = tuple(sorted((own[node.left], own[node.right])))
        case Input() | Activation() | Cast():
            wiring = tuple(own[source] for source in node.sources)
    return type(node), parameters, wiring


def _plain(value: Any) -> Any:
    """Return a value that compares equal to another if both are the same, bit for bit."""
    if isinstance(value, np.ndarray):
        return value.shape, hashlib.sha256(value.tobytes()).hexdigest()
    return value


def _unreadable(model: ModelFile, level: Optimisation, reading: Reading) -> PolicyError:
    lines = "".join(f"\n  - {finding}" for finding in reading.findings)
    return PolicyError(
        f"{model.path}: at its level of optimisation '{level}' onnxruntime does not run these nodes of the file but "
        f"others, which are not read:{lines}",
        _hint(reading.findings),
    )


def _hint(findings: tuple[UnreadableNode, ...]) -> str:
    return "; ".join(dict.fromkeys(finding.hint for finding in findings if finding.hint))
