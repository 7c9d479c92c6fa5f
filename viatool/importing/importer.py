"""From a saved model to an ONNX file with everything inside, compared with the model, and its specification."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import helper

from viatool.errors import PolicyError, SelfCheckError, ViatoolError
from viatool.importing.actor import ImportedActor, WholePolicy, write_program
from viatool.importing.normaliser import Normaliser, load_normaliser
from viatool.importing.spaces import BoxSpace, DiscreteSpace
from viatool.importing.stable_baselines import is_stable_baselines, read_model
from viatool.importing.torchscript import is_torchscript, read_script
from viatool.importing.trusted import run_model
from viatool.policy import Policy, PolicySpecification, load_policy, load_specification
from viatool.policy.specification import METADATA_KEY
from viatool.proposals import PolicyFacts, Proposal, propose_by_size
from viatool.whole_file import whole_file

CHECKED_OBSERVATIONS = 256
TOLERANCE = 1e-3
"""Of the largest output, by which onnxruntime and torch may differ; rounding stays about a hundred times below."""

_NORMALISERS = ("vec_normalize.pkl", "vecnormalize.pkl")
"""As people name what VecNormalize.save writes."""


@dataclass(frozen=True)
class ImportRequest:
    """What is imported, and what the file does not say.

    Parameters
    ----------
    path : Path
        A zip of Stable-Baselines3 or a TorchScript archive.
    normaliser : Path, optional
        What VecNormalize.save wrote.
    specification : Path, optional
        A sidecar that goes into the metadata; without one a specification is proposed.
    activation : str, optional
        The torch.nn class between the layers, where the file's own cannot be read.
    limits : tuple of (float, float), optional
        Of each output of a TorchScript actor that gives numbers in [-1, 1].
    input_size : int, optional
        Length of the observation of a TorchScript actor.
    trust : bool
        Run the pickles in the files.
    """

    path: Path
    normaliser: Path | None = None
    specification: Path | None = None
    activation: str | None = None
    limits: tuple[tuple[float, float], ...] | None = None
    input_size: int | None = None
    trust: bool = False


@dataclass(frozen=True, eq=False)
class Imported:
    """What an import has written.

    Parameters
    ----------
    policy : Policy
        The written file, loaded.
    inside : tuple of str
        What was put into it besides the layers, in words.
    proposal : Proposal or None
        A specification to check; None where one was given.
    """

    policy: Policy
    inside: tuple[str, ...]
    proposal: Proposal | None


def import_policy(request: ImportRequest, output: Path) -> Imported:
    """Write the ONNX file of a saved model, whole or not at all.

    Parameters
    ----------
    request : ImportRequest
        The model and what goes with it.
    output : Path
        The ONNX file.

    Returns
    -------
    Imported
        The file has been compared with the model in torch on random observations.

    Raises
    ------
    PolicyError
        If a file cannot be read, is not supported, or contradicts another.
    SelfCheckError
        If onnxruntime and torch disagree by more than rounding; nothing is written then.
    """
    actor = _read(request)
    normaliser = None
    if request.normaliser is not None:
        normaliser = load_normaliser(request.normaliser, actor.observation.size, trust=request.trust)
    specification = None if request.specification is None else load_specification(request.specification)
    whole = WholePolicy(actor, normaliser)
    scripted = actor.origin == "TorchScript"
    with whole_file(output) as draft:
        write_program(whole, actor.observation.size, request.path, draft, scripted=scripted)
        if specification is not None:
            _put_inside(specification, draft)
        try:
            check_against_torch(load_policy(draft), whole, actor.observation)
        except ViatoolError as error:  # of the file that was to be, by its name
            raise type(error)(error.message.replace(str(draft), str(output)), error.hint) from error
    inside = _inside(actor, normaliser, request)
    proposal = _propose(actor, request) if specification is None else None
    return Imported(load_policy(output), inside, proposal)


def check_against_torch(policy: Policy, whole: torch.nn.Module, observation: BoxSpace) -> float:
    """Compare a written file with the model; return the largest difference, relative to the largest output.

    Raises
    ------
    SelfCheckError
        If it is more than `TOLERANCE`.
    """
    rng = np.random.default_rng(0)
    lower, upper = np.clip(observation.lower, -10.0, 10.0), np.clip(observation.upper, -10.0, 10.0)
    rows = rng.uniform(lower, np.maximum(upper, lower), (CHECKED_OBSERVATIONS, observation.size))
    rows = rows.astype(np.float32)
    with torch.no_grad():
        expected = np.concatenate([whole(torch.as_tensor(row[None])).numpy() for row in rows])
    found = policy.runtime(rows.astype(np.float64))
    worst = float(np.abs(found - expected).max() / max(1.0, float(np.abs(expected).max())))
    if not worst <= TOLERANCE:
        raise SelfCheckError(
            f"{policy.path}: onnxruntime and torch differ by {worst:.2e} of the largest output, "
            f"expected at most {TOLERANCE:.0e}",
            "report this as a bug, with the model",
        )
    return worst


def _read(request: ImportRequest) -> ImportedActor:
    names = _names(request.path)
    if is_stable_baselines(names):
        if request.limits is not None or request.input_size is not None:
            raise PolicyError(
                f"{request.path} is of Stable-Baselines3 and states its limits and sizes itself",
                "leave --low, --high and --input-size out",
            )
        return run_model(request.path) if request.trust else read_model(request.path, request.activation)
    if is_torchscript(names):
        action = None
        if request.limits is not None:
            lower, upper = (np.array(ends, np.float64) for ends in zip(*request.limits, strict=True))
            action = BoxSpace(lower, upper, lower.shape)
        return read_script(request.path, request.input_size, action)
    raise PolicyError(*_not_a_model(request.path, names))


def _names(path: Path) -> list[str]:
    try:
        with path.open("rb") as stream:
            if not zipfile.is_zipfile(stream):
                raise PolicyError(*_not_a_model(path, []))
        with zipfile.ZipFile(path) as archive:
            return archive.namelist()
    except (OSError, zipfile.BadZipFile) as error:
        raise PolicyError(f"cannot read the model {path}: {error}", "give a saved model") from error


def _not_a_model(path: Path, names: list[str]) -> tuple[str, str]:
    """Return why a file is no model, and what to do."""
    if any(name.endswith("data.pkl") for name in names):
        return (
            f"{path} was written by torch.save: it holds weights or a pickled module, no program",
            "save the actor with `torch.jit.trace(actor, example).save(FILE)`, and import that",
        )
    held = f"a zip of {', '.join(names[:5])}{', ...' if len(names) > 5 else ''}" if names else "no zip"
    return (
        f"{path} is {held}, where `data` and `policy.pth` of Stable-Baselines3, or TorchScript, are expected",
        "give the zip that model.save() wrote, or an actor saved with torch.jit.save",
    )


def _put_inside(specification: PolicySpecification, draft: Path) -> None:
    """Write a specification into the metadata of a file."""
    model = onnx.load_model(draft)
    helper.set_model_props(model, {METADATA_KEY: specification.to_json()})
    draft.write_bytes(model.SerializeToString(deterministic=True))


def _inside(actor: ImportedActor, normaliser: Normaliser | None, request: ImportRequest) -> tuple[str, ...]:
    """Return in words what stands in the file besides the layers, and what does not."""
    if normaliser is not None:
        before = f"the normaliser of {request.normaliser}, clipped to {normaliser.clip:g} deviations"
    elif request.normaliser is not None:
        before = f"no normaliser: {request.normaliser} has norm_obs off"
    else:
        beside = next(
            (f"{name} is beside it" for name in _NORMALISERS if (request.path.parent / name).exists()), ""
        )
        before = f"no normaliser: {beside or 'if the model was trained in a VecNormalize'}, add --vecnormalize FILE"
    if isinstance(actor.action, DiscreteSpace):
        after = f"the scores of {actor.action.choices} choices, of which the largest is taken"
    elif actor.action is None:
        after = "the outputs as they come: if they are in [-1, 1], add --low and --high"
    elif actor.squashed:
        after = f"outputs from [-1, 1] scaled to {_words(actor.action)}"
    else:
        after = f"the mean action, clipped to {_words(actor.action)}"
    return (f"{actor.origin}: {actor.observation.size} numbers in", before, after)


def _words(box: BoxSpace) -> str:
    pairs = zip(box.lower.tolist(), box.upper.tolist(), strict=True)
    return ", ".join(f"[{low:g}, {high:g}]" for low, high in pairs)


def _propose(actor: ImportedActor, request: ImportRequest) -> Proposal:
    """Propose a specification of commands, as the file gives them."""
    limits = None
    if isinstance(actor.action, BoxSpace) and actor.action.is_bounded:
        pairs = zip(actor.action.lower.tolist(), actor.action.upper.tolist(), strict=True)
        limits = tuple((round(low, 7), round(high, 7)) for low, high in pairs)
    ranges = None
    if actor.observation.is_bounded:
        pairs = zip(actor.observation.lower.tolist(), actor.observation.upper.tolist(), strict=True)
        ranges = tuple(pairs)
    chooses = None if actor.action is None else isinstance(actor.action, DiscreteSpace)
    outputs = _outputs(actor)
    proposal = propose_by_size(
        PolicyFacts(actor.observation.size, outputs, limits=limits, chooses=chooses, ranges=ranges)
    )
    training = {"imported": request.path.name, "policy": actor.origin}
    if request.normaliser is not None:
        training["normaliser"] = request.normaliser.name
    return replace(proposal, more={**(proposal.more or {}), "training": training})


def _outputs(actor: ImportedActor) -> int:
    if isinstance(actor.action, DiscreteSpace):
        return actor.action.choices
    if isinstance(actor.action, BoxSpace):
        return actor.action.size
    with torch.no_grad():
        return int(actor.body(torch.zeros(1, actor.observation.size)).shape[1])
