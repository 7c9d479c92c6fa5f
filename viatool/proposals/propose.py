"""A specification for a policy without one: from what its exporter states, else from its sizes."""

from __future__ import annotations

import json
from pathlib import Path

from viatool.errors import PolicyError
from viatool.policy import Inspection
from viatool.policy.model_file import open_model
from viatool.policy.specification_file import specification_from_json
from viatool.proposals.by_size import propose_by_size
from viatool.proposals.by_terms import kind_of_term, propose_by_terms
from viatool.proposals.parameters import with_parameters
from viatool.proposals.proposal import PolicyFacts, Proposal
from viatool.proposals.terms import CONTRACT, ObservationTerm, Stated, stated_in_contract, stated_in_metadata


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
    facts = PolicyFacts(
        found.ports.size,
        found.layers[-1].size,
        squashed=found.layers[-1].kind == "Tanh",
        ports=tuple((port.name, port.size) for port in found.ports.each) if len(found.ports.each) > 1 else (),
        output=found.action if len(found.outputs) > 1 else None,
    )
    contract = parameters if parameters is not None and parameters.suffix == ".json" else None
    model = open_model(found.path)
    entries = {entry.key: entry.value for entry in model.proto.metadata_props}
    stated = stated_in_contract(contract or model.path.parent / CONTRACT)
    if stated is None and contract is not None:
        raise PolicyError(f"cannot read {contract}: there is no such file", "give a JSON file")
    stated = stated or stated_in_metadata(entries, model.path) or _stated_by_inputs(facts)
    proposal = propose_by_size(facts) if stated is None else propose_by_terms(stated, facts)
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
