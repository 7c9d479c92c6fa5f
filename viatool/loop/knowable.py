"""What a policy may observe of which it is known what it is anywhere in a set of poses."""

from __future__ import annotations

from viatool.channels import Quantities
from viatool.channels.velocities import MeasuredVelocity
from viatool.errors import PolicyError
from viatool.setting.rules import Rules
from viatool.setting.setting import Setting


def require_known_over_poses(setting: Setting) -> Quantities:
    """Return what a policy observes, refusing by name what is not known over a set of poses.

    Raises
    ------
    PolicyError
        Names the channel.
    """
    spec = setting.spec
    observed = Quantities.of(spec.observation, setting.robot, spec.frames).require("measure", "enclose")
    _check_velocities(observed, setting.rules)
    return observed


def _check_velocities(observed: Quantities, rules: Rules) -> None:
    """Refuse a measured velocity where motors take time or commands act late: it is not that of the command before."""
    measured = [quantity for quantity in observed if isinstance(quantity, MeasuredVelocity)]
    if rules.command_errors is not None:
        for quantity in measured:
            if not quantity.held and quantity.limits != (0.0, 0.0):
                raise PolicyError(
                    f"{quantity.channel} is not known over a set of poses when what acts differs from the command",
                    "leave out the section actuation",
                )
    late = [quantity.channel for quantity in measured]
    if not late or (rules.delay == 0.0 and rules.machine is None):
        return
    if rules.machine is None:
        raise PolicyError(
            f"{late[0]} is not known over a set of poses when commands act {rules.delay:g} s late",
            "leave out --delay, or verify recorded states alone",
        )
    raise PolicyError(
        f"{late[0]} is not known over a set of poses when motors and timing are those of an error model",
        "leave out the sections actuation and timing, or verify recorded states alone",
    )
