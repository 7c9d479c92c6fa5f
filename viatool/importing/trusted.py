"""A Stable-Baselines3 model with classes of its own, built as its pickles say: for files that are trusted."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

from torch import Tensor, nn

from viatool.errors import PolicyError
from viatool.importing.actor import ImportedActor
from viatool.importing.spaces import BoxSpace, DiscreteSpace, box_of, space_of
from viatool.importing.stable_baselines import pickled, read_data, read_weights


def run_model(path: Path) -> ImportedActor:
    """Build the policy of a saved model with the classes that its pickles name.

    Parameters
    ----------
    path : Path
        The zip. Its pickles are run.

    Raises
    ------
    PolicyError
        If a class is not installed, or the policy is none that gives one action for one vector.
    """
    data = read_data(path)
    try:
        kind, observation, action = (
            pickle.loads(pickled(data, field, path))
            for field in ("policy_class", "observation_space", "action_space")
        )
        settings = data.get("policy_kwargs") or {}
        if ":serialized:" in settings:
            settings = pickle.loads(pickled(data, "policy_kwargs", path))
        explores = {"use_sde": True} if data.get("use_sde") else {}
        policy = kind(observation, action, lambda _: 0.0, **{**explores, **settings})
    except PolicyError:
        raise
    except Exception as error:  # a pickle runs anything
        raise PolicyError(
            f"{path}: its policy cannot be built: {error}",
            "install stable-baselines3, and put the classes that the model was trained with on PYTHONPATH",
        ) from error
    policy.load_state_dict(read_weights(path))
    box = box_of(observation, f"{path}: data: observation_space")
    space = space_of(action, f"{path}: data: action_space")
    squashed = isinstance(space, BoxSpace) and bool(policy.squash_output)
    origin = f"Stable-Baselines3 {kind.__module__}.{kind.__qualname__}"
    return ImportedActor(_Deterministic(policy, box, space), box, space, squashed, origin)


class _Deterministic(nn.Module):
    """The deterministic action of a policy before its software scales or clips it; of a choice, its scores."""

    def __init__(self, policy: Any, observation: BoxSpace, action: BoxSpace | DiscreteSpace) -> None:
        super().__init__()
        self.policy = policy.eval()
        self.shape = observation.shape
        self.chooses = isinstance(action, DiscreteSpace)

    def forward(self, observation: Tensor) -> Tensor:
        observed = observation.reshape(-1, *self.shape)
        if not self.chooses:
            action: Tensor = self.policy._predict(observed, deterministic=True)
            return action
        if hasattr(self.policy, "q_net"):
            values: Tensor = self.policy.q_net(observed)
            return values
        from stable_baselines3.common.policies import BasePolicy

        features = BasePolicy.extract_features(self.policy, observed, self.policy.pi_features_extractor)
        scores: Tensor = self.policy.action_net(self.policy.mlp_extractor.forward_actor(features))
        return scores
