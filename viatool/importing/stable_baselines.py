"""The zip that Stable-Baselines3 saves: layers rebuilt from the weights, nothing run of its pickles."""

from __future__ import annotations

import base64
import io
import json
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from viatool.errors import PolicyError
from viatool.importing.actor import ImportedActor
from viatool.importing.inert import TRUST, origin_of, read_inert
from viatool.importing.spaces import BoxSpace, box_of, is_space, space_of

_MAX_BYTES = 2**30
_NO_MODEL = "give the zip that model.save() of Stable-Baselines3 wrote"

_FLATTEN = "stable_baselines3.common.torch_layers.FlattenExtractor"

_Weights = Mapping[str, Tensor]
_Bend = Callable[[], nn.Module]

ACTIVATIONS: dict[str, _Bend] = {
    kind.__name__: kind
    for kind in (
        nn.ReLU,
        nn.Tanh,
        nn.ELU,
        nn.LeakyReLU,
        nn.GELU,
        nn.SiLU,
        nn.Mish,
        nn.Sigmoid,
        nn.Softplus,
        nn.Softsign,
        nn.SELU,
        nn.CELU,
        nn.Hardtanh,
        nn.Hardswish,
        nn.Hardsigmoid,
        nn.ReLU6,
        nn.Identity,
    )
}
"""Activation functions that `policy_kwargs.activation_fn` may name, with their default parameters."""


def is_stable_baselines(names: list[str]) -> bool:
    """Tell whether the names in a zip are those of a saved model."""
    return "data" in names and "policy.pth" in names


def read_model(path: Path, activation: str | None = None) -> ImportedActor:
    """Read a saved model of TD3, DDPG, SAC, PPO, A2C or DQN without running its pickles.

    Parameters
    ----------
    path : Path
        The zip.
    activation : str, optional
        A name of `ACTIVATIONS`, where the file's own cannot be read.

    Raises
    ------
    PolicyError
        If it is no such model, or needs classes of its own: names the file, the field, what is there and what was
        expected.
    """
    data = read_data(path)
    name = policy_class(data, path)
    if name not in _FAMILIES:
        known = ", ".join(_FAMILIES)
        raise PolicyError(f"{path}: data: policy_class is '{name}', where one of {known} is expected", TRUST)
    default, layers, squashes = _FAMILIES[name]
    settings = _settings(data, path)
    observation = box_of(_inert(data, "observation_space", path), f"{path}: data: observation_space")
    action = space_of(_inert(data, "action_space", path), f"{path}: data: action_space")
    bend = _activation(settings, default, activation, path)
    squashed = squashes or bool(settings.get("squash_output", False))
    weights = _Taken(read_weights(path), path)
    body = nn.Sequential(*layers(weights, bend, settings))
    weights.require_all(name)
    if squashed and isinstance(action, BoxSpace):
        body.append(nn.Tanh())
    actor = ImportedActor(body, observation, action, squashed, f"Stable-Baselines3 {name}")
    actor.check_sizes(path, _first(body), _last(body))
    return actor


def read_data(path: Path) -> dict[str, Any]:
    """Return the JSON of the model's parameters; pickles in it stay text.

    Raises
    ------
    PolicyError
        If there is none.
    """
    try:
        data = json.loads(_member(path, "data"))
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        raise PolicyError(f"{path}: data is not JSON: {error}", _NO_MODEL) from error
    if not isinstance(data, dict) or "policy_class" not in data:
        raise PolicyError(f"{path}: data has no policy_class, so this is not a saved model", _NO_MODEL)
    return data


def policy_class(data: Mapping[str, Any], path: Path) -> str:
    """Return the name of the policy's class, with its module unless that is one of Stable-Baselines3."""
    origin = origin_of(_inert(data, "policy_class", path)) or "not a class"
    return origin.rpartition(".")[2] if origin.startswith("stable_baselines3.") else origin


def pickled(data: Mapping[str, Any], field: str, path: Path) -> bytes:
    """Return the pickle of a field.

    Raises
    ------
    PolicyError
        If the field holds none.
    """
    value = data.get(field)
    text = value.get(":serialized:") if isinstance(value, dict) else None
    try:
        return base64.b64decode(text or "", validate=True) if text else b""
    except (TypeError, ValueError) as error:
        raise PolicyError(f"{path}: data: {field} is not base64", _NO_MODEL) from error


def read_weights(path: Path) -> dict[str, Tensor]:
    """Return the weights of the policy, read as numbers alone.

    Raises
    ------
    PolicyError
        If the file holds anything else.
    """
    try:
        weights = torch.load(io.BytesIO(_member(path, "policy.pth")), map_location="cpu", weights_only=True)
    except Exception as error:  # torch names no class of errors for what it refuses
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise PolicyError(f"{path}: policy.pth holds more than weights: {reason[:300]}", _NO_MODEL) from error
    if not isinstance(weights, dict) or not all(isinstance(each, Tensor) for each in weights.values()):
        raise PolicyError(f"{path}: policy.pth holds no weights by name", _NO_MODEL)
    return weights


def _member(path: Path, name: str) -> bytes:
    try:
        with zipfile.ZipFile(path) as archive:
            info = archive.getinfo(name)
            if info.file_size > _MAX_BYTES:
                raise PolicyError(
                    f"{path}: {name} has {info.file_size / 2**20:.0f} MiB, far more than a policy needs",
                    _NO_MODEL,
                )
            return archive.read(info)
    except (OSError, KeyError, zipfile.BadZipFile, RuntimeError, NotImplementedError) as error:
        raise PolicyError(f"{path}: '{name}' cannot be read: {error}", _NO_MODEL) from error


def _inert(data: Mapping[str, Any], field: str, path: Path) -> Any:
    where = f"{path}: data: {field}"
    content = pickled(data, field, path)
    if not content:
        raise PolicyError(f"{where} is missing, where a pickle is expected", _NO_MODEL)
    return read_inert(content, where, is_space if field.endswith("_space") else lambda origin: True)


def _settings(data: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return policy_kwargs, refusing what makes a policy of one's own."""
    settings = data.get("policy_kwargs") or {}
    if isinstance(settings, dict) and ":serialized:" in settings:
        settings = _inert(data, "policy_kwargs", path)
    if not isinstance(settings, dict):
        raise PolicyError(f"{path}: data: policy_kwargs is no dictionary", _NO_MODEL)
    extractor = origin_of(settings.get("features_extractor_class"))
    if extractor and extractor != _FLATTEN:
        raise PolicyError(
            f"{path}: data: policy_kwargs.features_extractor_class is '{extractor}', "
            "where FlattenExtractor is expected",
            TRUST,
        )
    return settings


def _activation(settings: Mapping[str, Any], default: _Bend, asked: str | None, path: Path) -> _Bend:
    if asked is not None:
        if asked not in ACTIVATIONS:
            raise PolicyError(f"there is no activation '{asked}'", f"choose one of {', '.join(ACTIVATIONS)}")
        return ACTIVATIONS[asked]
    if "activation_fn" not in settings:
        return default
    origin = origin_of(settings["activation_fn"])
    name = origin.rpartition(".")[2]
    if not isinstance(settings["activation_fn"], type) or not origin.startswith("torch.nn."):
        name = ""
    if name not in ACTIVATIONS:
        raise PolicyError(
            f"{path}: data: policy_kwargs.activation_fn is '{origin or settings['activation_fn']}', "
            f"where a class of torch.nn is expected: {', '.join(ACTIVATIONS)}",
            "say which it is with --activation NAME",
        )
    return ACTIVATIONS[name]


class _Taken:
    """Weights by name, of which each is taken once; what nothing takes is part of a network that is not known."""

    def __init__(self, weights: _Weights, path: Path) -> None:
        self.weights = dict(weights)
        self.path = path

    def linear(self, prefix: str) -> nn.Linear:
        """Take one layer."""
        weight = self.weights.pop(f"{prefix}weight", None)
        bias = self.weights.pop(f"{prefix}bias", None)
        if weight is None or weight.ndim != 2 or (bias is not None and bias.shape != weight.shape[:1]):
            shape = "missing" if weight is None else f"of shape {list(weight.shape)}"
            raise PolicyError(
                f"{self.path}: policy.pth: '{prefix}weight' is {shape}, where a matrix and its bias are expected",
                TRUST,
            )
        layer = nn.Linear(weight.shape[1], weight.shape[0], bias=bias is not None)
        layer.load_state_dict({"weight": weight} if bias is None else {"weight": weight, "bias": bias})
        return layer

    def stack(self, prefix: str) -> list[nn.Linear]:
        """Take the layers that are numbered 0, 2, 4, ...: the numbers between are activations."""
        layers: list[nn.Linear] = []
        while f"{prefix}{2 * len(layers)}.weight" in self.weights:
            layers.append(self.linear(f"{prefix}{2 * len(layers)}."))
        return layers

    def drop(self, *prefixes: str) -> None:
        """Leave out what the actor does not use."""
        self.weights = {k: each for k, each in self.weights.items() if not k.startswith(prefixes)}

    def require_all(self, name: str) -> None:
        """Refuse weights that were not taken."""
        if self.weights:
            left = next(iter(self.weights))
            raise PolicyError(
                f"{self.path}: policy.pth: '{left}' of shape {list(self.weights[left].shape)} is no part of "
                f"{name} as it comes with Stable-Baselines3",
                TRUST,
            )


def _between(layers: list[nn.Linear], bend: _Bend) -> list[nn.Module]:
    """Return layers with an activation between each two."""
    return _after(layers, bend)[:-1]


def _after(layers: list[nn.Linear], bend: _Bend) -> list[nn.Module]:
    """Return layers with an activation after each."""
    return [module for layer in layers for module in (layer, bend())]


def _td3(weights: _Taken, bend: _Bend, settings: Mapping[str, Any]) -> list[nn.Module]:
    weights.drop("actor_target.", "critic.", "critic_target.")
    return _between(weights.stack("actor.mu."), bend)


def _sac(weights: _Taken, bend: _Bend, settings: Mapping[str, Any]) -> list[nn.Module]:
    weights.drop("actor.log_std", "critic.", "critic_target.")
    hidden = _after(weights.stack("actor.latent_pi."), bend)
    if "actor.mu.weight" in weights.weights:
        return [*hidden, weights.linear("actor.mu.")]
    limit = float(settings.get("clip_mean", 2.0))  # state-dependent exploration clips the mean
    return [*hidden, weights.linear("actor.mu.0."), nn.Hardtanh(-limit, limit)]


def _actor_critic(weights: _Taken, bend: _Bend, settings: Mapping[str, Any]) -> list[nn.Module]:
    weights.drop("log_std", "mlp_extractor.value_net.", "value_net.")
    hidden = [*weights.stack("mlp_extractor.shared_net."), *weights.stack("mlp_extractor.policy_net.")]
    return [*_after(hidden, bend), weights.linear("action_net.")]


def _dqn(weights: _Taken, bend: _Bend, settings: Mapping[str, Any]) -> list[nn.Module]:
    weights.drop("q_net_target.")
    return _between(weights.stack("q_net.q_net."), bend)


_FAMILIES: dict[str, tuple[_Bend, Callable[[_Taken, _Bend, Mapping[str, Any]], list[nn.Module]], bool]] = {
    "TD3Policy": (nn.ReLU, _td3, True),
    "SACPolicy": (nn.ReLU, _sac, True),
    "ActorCriticPolicy": (nn.Tanh, _actor_critic, False),
    "DQNPolicy": (nn.ReLU, _dqn, False),
}


def _first(body: nn.Sequential) -> int:
    return next((layer.in_features for layer in body if isinstance(layer, nn.Linear)), 0)


def _last(body: nn.Sequential) -> int:
    return next((layer.out_features for layer in reversed(body) if isinstance(layer, nn.Linear)), 0)
