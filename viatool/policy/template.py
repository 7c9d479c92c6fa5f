"""A sidecar specification to fill in, for policies that were exported without one."""

from __future__ import annotations

from viatool.channels import kinds
from viatool.errors import PolicyError
from viatool.policy.action_channels import ActionChannel
from viatool.policy.inspection import Inspection
from viatool.policy.specification import ObservationChannel, PolicySpecification

_TEMPLATE_HEAD = f"""\
# Specification of a policy: fill in what the observation holds, in its order, and what the actions mean.
# Split `observation` into channels whose sizes add up to the size of the input. For each channel:
#   kind   {", ".join(kinds())}
#   value  a number, if the channel is a constant        eps  the radius of its error, in its unit
#   lidar  {{field_of_view: rad, rays: 180, bins: 20, minimum_range: m, maximum_range: m}}   (kind lidar)
# For each action: kind linear (m/s), angular (rad/s) or other, and the limits of the robot.
"""

_TEMPLATE_MAP = """\
# If the model gives normalised actions (Stable-Baselines3: -1 to 1), say what the robot does with them:
# action_map:
#   scale: [0.25, 1.0]     # action = scale * output + offset
#   offset: [0.25, 0.0]
#   clip: true             # then clip to lower and upper
"""


def specification_template(found: Inspection) -> str:
    """Return the YAML of a sidecar to fill in, with comments on what each entry means.

    Parameters
    ----------
    found : Inspection
        Gives the sizes; a specification that it has is written out instead of placeholders.

    Raises
    ------
    PolicyError
        If the policy cannot be read, so that its sizes are not known.
    """
    if found.specification is not None:
        return found.specification.to_yaml()
    if found.ports is None or not found.layers:
        raise found.failure or PolicyError(
            f"{found.path} cannot be read, so its sizes are not known", "fix what `viatool inspect` reports"
        )
    ports, outputs = found.ports.each, found.layers[-1].size
    names = [port.name for port in ports] if len(ports) > 1 else ["observation"]
    placeholder = PolicySpecification(
        schema_version=2 if len(ports) > 1 else 1,
        input=names if len(ports) > 1 else None,
        observation=[
            ObservationChannel(name=name, size=port.size, unit="?", kind="other")
            for name, port in zip(names, ports, strict=True)
        ],
        action=[
            ActionChannel(name=f"action_{index}", unit="?", lower=-1.0, upper=1.0) for index in range(outputs)
        ],
        output=found.action if len(found.outputs) > 1 else None,
        robot="?",
    )
    return _TEMPLATE_HEAD + placeholder.to_yaml() + _TEMPLATE_MAP
