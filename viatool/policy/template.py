"""A sidecar specification to fill in, for policies that were exported without one."""

from __future__ import annotations

import math

from viatool.errors import PolicyError
from viatool.policy.inspection import Inspection
from viatool.policy.policy import Policy
from viatool.policy.specification import ActionChannel, ObservationChannel, PolicySpecification

_TEMPLATE_HEAD = """\
# Specification of a policy: fill in what stands in the observation, in its order, and what actions mean.
# Split `observation` into channels whose sizes add up to the size of the input. For each channel:
#   kind   lidar, goal_distance, goal_cosine, goal_sine, previous_linear, previous_angular, budget, other
#   value  a number, if the channel is a constant        eps  the radius of its error, in its unit
#   lidar  {field_of_view: rad, rays: 180, bins: 20, minimum_range: m, maximum_range: m}   (kind lidar)
# For each action: kind linear (m/s), angular (rad/s) or other, and the limits of the robot.
"""

_TEMPLATE_MAP = """\
# If the model gives normalised actions (Stable-Baselines3: -1 to 1), say what the robot does with them:
# action_map:
#   scale: [0.25, 1.0]     # action = scale * output + offset
#   offset: [0.25, 0.0]
#   clip: true             # then clip to lower and upper
"""


def specification_template(policy: Policy | Inspection) -> str:
    """Return the YAML of a sidecar to fill in, with comments on what each entry means.

    Parameters
    ----------
    policy : Policy or Inspection
        Gives the sizes; a specification that it has is written out instead of placeholders.
    """
    spec = policy.spec if isinstance(policy, Policy) else policy.specification
    if spec is None:
        spec = _placeholder(policy)
    return _TEMPLATE_HEAD + spec.to_yaml() + ("" if spec.action_map else _TEMPLATE_MAP)


def _placeholder(policy: Policy | Inspection) -> PolicySpecification:
    inputs, outputs = _sizes(policy)
    return PolicySpecification(
        observation=[ObservationChannel(name="observation", size=inputs, unit="?", kind="other")],
        action=[
            ActionChannel(name=f"action_{index}", unit="?", lower=-1.0, upper=1.0) for index in range(outputs)
        ],
        robot="?",
    )


def _sizes(policy: Policy | Inspection) -> tuple[int, int]:
    if isinstance(policy, Policy):
        return policy.input_size, policy.output_size
    if policy.port is None or not policy.layers:
        raise PolicyError(
            f"{policy.path} cannot be read, so its sizes are not known",
            "mend what `viatool inspect` reports first",
        )
    return math.prod(policy.port.shape), policy.layers[-1].size
