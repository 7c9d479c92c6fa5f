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
from typing import get_args

import numpy as np

from viatool.arrays import Floats
from viatool.errors import PolicyError
from viatool.policy.graph import live, read_graph
from viatool.policy.model_file import ModelFile
from viatool.policy.network import Activation, Affine, Cast, Input, Maximum, Minimum, Network, Node, Product
from viatool.policy.reader import Finding, Reading, read_network
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
        True only if both outputs come from the same kinds of nodes with equal parameters, weights, precisions and counts
        of roundings, applied to the same sources. In what order nodes stand, and in what order a sum, product, minimum
        or maximum names its sources, makes no difference: neither does it in the bounds.
    """
    numbers: dict[object, int] = {}
    return _number_of(first, numbers) == _number_of(second, numbers)


def _number_of(network: Network, numbers: dict[object, int]) -> int:
    """Number the nodes of a network so that equal ones, of whatever network, have one number; return the output's."""
    own: list[int] = []
    for node in network.nodes:
        own.append(numbers.setdefault(_identity(node, own), len(numbers)))
    return own[-1]


def _identity(node: Node, own: list[int]) -> object:
    """Return all that makes a node what it is, given the numbers of those before it."""
    kind, precision = type(node), node.precision
    match node:
        case Input():
            return kind, precision, node.size
        case Affine():
            terms = sorted((own[s], _digest(w)) for s, w in zip(node.sources, node.weights, strict=True))
            return kind, precision, node.roundings, _digest(node.bias), tuple(terms)
        case Activation():
            return kind, precision, node.function, own[node.source]
        case Product() | Maximum() | Minimum():
            return kind, precision, *sorted((own[node.left], own[node.right]))
        case Cast():
            return kind, precision, own[node.source]


def _digest(values: Floats) -> tuple[tuple[int, ...], bytes]:
    return values.shape, hashlib.sha256(np.ascontiguousarray(values)).digest()


def _unreadable(model: ModelFile, level: Optimisation, reading: Reading) -> PolicyError:
    lines = "".join(f"\n  - {finding}" for finding in reading.findings)
    return PolicyError(
        f"{model.path}: at its level of optimisation '{level}' onnxruntime does not run these nodes of the file but "
        f"others, which are not read:{lines}",
        _hint(reading.findings),
    )


def _hint(findings: tuple[Finding, ...]) -> str:
    return "; ".join(dict.fromkeys(finding.hint for finding in findings if finding.hint))
