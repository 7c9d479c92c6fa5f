"""A specification for a policy without one: from what its exporter states, else from its sizes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from viatool.errors import PolicyError
from viatool.policy import Activation, Inspection, Network
from viatool.policy.maps import trailing_steps
from viatool.policy.model_file import open_model
from viatool.policy.policy import load_actor
from viatool.policy.specification_file import specification_from_json
from viatool.proposals.by_size import propose_by_size
from viatool.proposals.by_terms import kind_of_term, propose_by_terms
from viatool.proposals.parameters import with_parameters
from viatool.proposals.proposal import PolicyFacts, Proposal
from viatool.proposals.terms import CONTRACT, ObservationTerm, Stated, stated_in_contract, stated_in_metadata

_UNBOUNDED = 1e12
"""Stands for what no function bounds."""

_DIGITS = 7
"""Of limits, about as many as float32 has."""


def specification_text(found: Inspection, parameters: Path | None = None) -> str:
    """Return the YAML of a sidecar: the policy's own specification, or a proposal with comments on what was guessed.

    Parameters
    ----------
    found : Inspection
        What the model file holds.
    parameters : Path, optional
        A parameter file of a ROS package, or a ``policy_contract.json``.

    Raises
    ------
    PolicyError
        If the policy cannot be read, so that its sizes are not known, or if what its exporter states contradicts it.
    """
    if found.specification is not None:
        return found.specification.to_yaml()
    return propose(found, parameters).to_yaml()


def propose(found: Inspection, parameters: Path | None = None) -> Proposal:
    """Return a specification for a policy that has none; parameters and errors as `specification_text`."""
    if found.ports is None or not found.layers:
        raise found.failure or PolicyError(
            f"{found.path} cannot be read, so its sizes are not known", "fix what `viatool inspect` reports"
        )
    model = open_model(found.path)
    squashed, limits = _range_of_outputs(load_actor(model, found.ports.names, found.action, found.memory)[0])
    sensed = [port for port in found.ports.each if port.name not in found.memory]
    facts = PolicyFacts(
        sum(port.size for port in sensed),
        found.layers[-1].size,
        squashed=squashed,
        limits=limits,
        ports=tuple((port.name, port.size) for port in sensed) if len(sensed) > 1 else (),
        output=found.action if len(found.outputs) > 1 else None,
        memory=tuple(found.memory.items()),
    )
    contract = parameters if parameters is not None and parameters.suffix == ".json" else None
    entries = {entry.key: entry.value for entry in model.proto.metadata_props}
    stated = stated_in_contract(contract or model.path.parent / CONTRACT)
    if stated is None and contract is not None:
        raise PolicyError(f"cannot read {contract}: there is no such file", "give a JSON file")
    stated = stated or stated_in_metadata(entries, model.path) or _stated_by_inputs(facts)
    proposal = propose_by_size(facts) if stated is None else propose_by_terms(stated, facts)
    proposal = replace(proposal, guesses=(*facts.guesses, *proposal.guesses))
    if parameters is not None and contract is None:
        proposal = with_parameters(proposal, parameters)
    if proposal.is_complete:  # what is stated may be no specification, such as a scale of 0
        specification_from_json(
            json.dumps(proposal.document), f"{model.path}: proposed from {proposal.source}"
        )
    return proposal


def _stated_by_inputs(facts: PolicyFacts) -> Stated | None:
    """Return what the names of several inputs tell; None where one of them tells nothing."""
    terms = tuple(ObservationTerm(name, size) for name, size in facts.ports)
    if not terms or any(kind_of_term(term.name) == "other" for term in terms):
        return None
    return Stated("the names of its inputs", terms)


def _range_of_outputs(network: Network) -> tuple[bool, tuple[tuple[float, float], ...] | None]:
    """Return whether the outputs are in [-1, 1], and else the ends of each where its last functions bound it."""
    ends = np.array([[-_UNBOUNDED], [_UNBOUNDED]]) * np.ones(network.output_size)
    for step in trailing_steps(network):  # none of them falls, but for scalings
        ends = step.function(ends) if isinstance(step, Activation) else step.factor * ends + step.offset
        ends = np.sort(ends, axis=0)
    if not (np.abs(ends) < np.sqrt(_UNBOUNDED)).all():
        return False, None
    if (ends == [[-1.0], [1.0]]).all():
        return True, None
    lower, upper = ends.round(_DIGITS).tolist()
    return False, tuple(zip(lower, upper, strict=True))
