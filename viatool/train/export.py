"""From trained weights to ``policy.onnx``: normaliser, squash and scaling inside, checked against torch."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from viatool.arrays import Floats
from viatool.errors import ConfigurationError, SelfCheckError
from viatool.policy import Activation, Affine, Input, Network, Policy, PolicySpecification, load_policy
from viatool.policy.activations import activation
from viatool.policy.network import Node
from viatool.policy.specified import specification_of
from viatool.policy.writer import write_onnx
from viatool.train.configuration import TrainingConfiguration
from viatool.train.evaluation import actor_command
from viatool.train.maps import load_maps
from viatool.train.networks import HiddenActivation, Weights
from viatool.train.observation import UnitScaling, make_scaling, make_specification
from viatool.train.records import load_checkpoint
from viatool.world import WorldMap

CHECKED_OBSERVATIONS = 4096
TOLERANCE = 1e-4  # of the action range; float32 rounding stays about a hundred times below

_ACTIVATIONS: dict[HiddenActivation, str] = {
    "relu": "Relu",
    "elu": "Elu",
    "tanh": "Tanh",
    "sigmoid": "Sigmoid",
    "softplus": "Softplus",
    "silu": "Silu",
    "gelu": "Gelu",
}


def actor_network(actor: Weights, scaling: UnitScaling) -> Network:
    """Build the exported program of one seed.

    Parameters
    ----------
    actor : Weights
        Of one seed, see `Weights.one`.
    scaling : UnitScaling
        Becomes the first and the last affine node.

    Returns
    -------
    Network
        From the raw physical observation ``(B, n)``, budget included, to physical commands ``(B, A)``.
    """
    nodes: list[Node] = [Input(actor.sizes[0])]

    def affine(weight: Floats, bias: Floats) -> None:
        nodes.append(Affine((len(nodes) - 1,), (_float32(weight),), _float32(bias)))

    def elementwise(name: str) -> None:
        nodes.append(Activation(len(nodes) - 1, activation(name), nodes[-1].size))

    factor, offset, ceiling = (
        part[scaling.seen] for part in (scaling.factor, scaling.offset, scaling.ceiling)
    )
    nodes += _cut_off(nodes[0].size, ceiling, scaling.layout.height)
    affine(np.diag(factor), -offset * factor)
    for index in range(0, len(actor.layers), 2):
        weight, bias = (
            layer.detach()[0].numpy().astype(np.float64) for layer in actor.layers[index : index + 2]
        )
        affine(weight.T, bias[0])
        elementwise("Tanh" if index == len(actor.layers) - 2 else _ACTIVATIONS[actor.activation])
    affine(np.diag(scaling.action_factor), scaling.action_offset)
    return Network(tuple(nodes))


def _cut_off(size: int, ceiling: Floats, height: float | None) -> list[Node]:
    """Return nodes that let no input (size,) be more than its ceiling: taken apart, clipped, and put together again.

    With a `height`, the clipped ones are bent: ``height * tanh(x / height)``.
    """
    nodes: list[Node] = []
    every = np.eye(size)
    parts: list[tuple[int, Floats]] = []
    for limit in np.unique(ceiling):
        chosen = every[ceiling == limit]
        if np.isinf(limit):
            parts.append((0, chosen.T @ chosen))
            continue
        nodes.append(Affine((0,), (chosen,), np.zeros(len(chosen))))
        nodes.append(Activation(len(nodes), activation("Clip", max=float(np.float32(limit))), len(chosen)))
        if height is None:
            parts.append((len(nodes), chosen.T))
            continue
        steepness = _float32(np.eye(len(chosen)) / height)
        nodes.append(Affine((len(nodes),), (steepness,), np.zeros(len(chosen))))
        nodes.append(Activation(len(nodes), activation("Tanh"), len(chosen)))
        parts.append((len(nodes), _float32(height * chosen.T)))
    if nodes:
        sources, chosen_by = zip(*parts, strict=True)
        nodes.append(Affine(tuple(sources), chosen_by, np.zeros(size)))
    return nodes


def _float32(values: Floats) -> Floats:
    """Round to what the file stores."""
    return values.astype(np.float32).astype(np.float64)


def export_actor(
    actor: Weights, scaling: UnitScaling, specification: PolicySpecification, path: str | os.PathLike[str]
) -> Policy:
    """Write the policy of one seed and check the file against torch.

    Parameters
    ----------
    actor : Weights
        Of one seed.
    scaling : UnitScaling
        Of the robot that it was trained for.
    specification : PolicySpecification
        Goes into the metadata.
    path : path
        The ONNX file, written whole or not at all.

    Returns
    -------
    Policy
        The written file, loaded.

    Raises
    ------
    SelfCheckError
        If onnxruntime and torch disagree by more than rounding; the file is removed then.
    """
    path = Path(path)
    write_onnx(actor_network(actor, scaling), specification, path)
    try:
        policy = load_policy(path)
        check_against_torch(policy, actor, scaling)
    except Exception:
        path.unlink(missing_ok=True)
        raise
    return policy


def training_record(configuration: TrainingConfiguration, seed: int, epoch: int) -> dict[str, Any]:
    """Return what the specification tells about the origin of a policy."""
    return {
        "method": configuration.method,
        "seed": seed,
        "epoch": epoch,
        "configuration": configuration.model_dump(mode="json"),
    }


def export_checkpoint(
    checkpoint: str | os.PathLike[str],
    path: str | os.PathLike[str],
    *,
    seed: int | None = None,
    map_path: str | Path | WorldMap | None = None,
) -> Policy:
    """Make a policy of a checkpoint.

    Parameters
    ----------
    checkpoint : path
        A ``.pt`` file from the ``checkpoints`` folder of a run.
    path : path
        The ONNX file to write.
    seed : int, optional
        Which of the seeds; by default the one with the best validation at that epoch, or 0 without one.
    map_path : path or WorldMap, optional
        A map of the training, or where one stands now if not where the configuration says; its robot is used.

    Returns
    -------
    Policy
        The written file, loaded.

    Raises
    ------
    ConfigurationError
        If the checkpoint cannot be read or has no such seed.
    SelfCheckError
        If the written program disagrees with the checkpoint.
    """
    content = load_checkpoint(Path(checkpoint))
    configuration = TrainingConfiguration.model_validate_json(content["configuration"])
    robot = (
        map_path.robot
        if isinstance(map_path, WorldMap)
        else load_maps(_elsewhere(configuration, map_path)).robot
    )
    scaling = make_scaling(robot, configuration.budget_limit, configuration.layout)
    if seed is None:
        success = np.nan_to_num(np.asarray(content["validation_success"]), nan=-1.0)
        seed = int(success.argmax())
    if not 0 <= seed < configuration.seeds:
        raise ConfigurationError(
            f"{checkpoint} has no seed {seed}", f"choose one of 0 to {configuration.seeds - 1}"
        )
    every = scaling.actor(configuration.actor_hidden, configuration.seeds, configuration.actor_activation)
    every.flat.copy_(content["networks"]["actor"]["target"])
    training = training_record(configuration, seed, content["epoch"])
    specification = make_specification(robot, float(content["var"][seed]), training, configuration.layout)
    return export_actor(every.one(seed), scaling, specification, path)


def _elsewhere(
    configuration: TrainingConfiguration, map_path: str | os.PathLike[str] | None
) -> TrainingConfiguration:
    """Return a configuration whose map stands elsewhere now."""
    if map_path is None:
        return configuration
    return configuration.model_copy(update={"map": os.fspath(map_path)})


def check_against_torch(policy: Policy, actor: Weights, scaling: UnitScaling) -> float:
    """Compare the exported program with the trained network; return the largest difference found.

    Raises
    ------
    SelfCheckError
        If an action differs by more than `TOLERANCE` of its range.
    """
    rng = np.random.default_rng(0)
    normalised = rng.uniform(-1.5, 2.5, (CHECKED_OBSERVATIONS, len(scaling.offset)))
    observation = (normalised / scaling.factor + scaling.offset).astype(np.float32).astype(np.float64)
    budget = float(specification_of(policy).channel("budget").value or 0.0)
    observation[:, -1] = np.float32(budget)
    expected = actor_command(actor, scaling, budget)(observation[:, :-1])
    difference = np.abs(policy.run(observation[:, scaling.seen]) - expected) / scaling.action_factor
    worst = float(difference.max())
    if not worst <= TOLERANCE:
        raise SelfCheckError(
            f"{policy.path}: onnxruntime and torch differ by {worst:.2e} of the action range, "
            f"expected at most {TOLERANCE:.0e}",
            "report this as a bug, with the checkpoint",
        )
    return worst
