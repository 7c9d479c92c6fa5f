"""The memory of a policy among the channels of its observation: which they are, and what they begin with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from viatool.arrays import Floats
from viatool.channels.channel import Channel, Frames
from viatool.channels.quantity import Part, Quantity, observes, refuse_lidar
from viatool.errors import PolicyError


@observes("memory")
class Memory(Quantity):
    """What the program itself gave in the step before, to be taken again: the hidden state of a recurrent policy.

    It is known of states that a program was driven to, or that were recorded, and of no others: the kind has no part.
    """

    @classmethod
    def check(cls, channel: Channel) -> None:
        """Accept any size; the numbers are taken as they are."""
        refuse_lidar(channel)
        told = {"value": channel.value, "frames": channel.frames, "scale": channel.encoding or None}
        for key in (key for key, given in told.items() if given is not None):
            raise ValueError(
                f"channel '{channel.name}' of kind 'memory' has `{key}`, but its numbers are taken as they were given"
            )
        if isinstance(channel.initial, tuple) and len(channel.initial) != channel.size:
            raise ValueError(
                f"channel '{channel.name}' has size {channel.size} and {len(channel.initial)} initial numbers"
            )

    def lacks(self, part: Part) -> PolicyError:
        """Return the refusal of a part, none of which the kind has."""
        return PolicyError(
            f"{self.channel} holds what the policy remembers, which depends on how it got there: it is not known of "
            "poses that it was not driven to, nor after the next step",
            "verify recorded or simulated states, each by itself",
        )


def check_memory(
    memory: Mapping[str, str], channels: Sequence[Channel], frames: Frames | None, action: str | None
) -> None:
    """Refuse a memory that contradicts the rest of a specification.

    Parameters
    ----------
    memory : mapping
        Inputs that take what an output gave in the step before.
    channels : sequence of Channel
        The observation.
    frames : Frames or None
        Of whole observations.
    action : str or None
        The output that is the action, where it is named.

    Raises
    ------
    ValueError
        Names what is wrong.
    """
    given = list(memory.values())
    for source, made in memory.items():
        if made == action:
            raise ValueError(
                f"memory.{source}: the output '{made}' is the action, and cannot be memory as well"
            )
        if given.count(made) > 1:
            raise ValueError(f"memory.{source}: the output '{made}' is remembered twice")
    if memory and frames is not None and frames.count > 1:
        raise ValueError("whole observations are not stacked beside a memory: give `frames` to each channel")
    kept = [channel.name for channel in channels if channel.kind == "memory"]
    for channel in channels:
        if channel.kind == "memory" and channel.name not in memory:
            raise ValueError(
                f"channel '{channel.name}' is of kind 'memory', but `memory` names no such input: "
                f"add `{channel.name}: OUTPUT` to it"
            )
        if channel.kind != "memory" and channel.name in memory:
            raise ValueError(
                f"channel '{channel.name}' is of kind '{channel.kind}', but `memory` says that the input of this name "
                "takes what the policy gave: make it of kind 'memory', or give it another name"
            )
    behind = [channel.name for channel in channels][len(channels) - len(kept) :]
    if kept != behind or kept != [name for name in memory if name in kept]:
        raise ValueError(
            f"channels of kind 'memory' stand behind all others, in the order of `memory` "
            f"({', '.join(memory)}), not as {', '.join(channel.name for channel in channels)}"
        )


def first_numbers(channels: Sequence[Channel]) -> Floats:
    """Return what channels of kind `memory` begin an episode with, (M,)."""
    each = [np.broadcast_to(np.array(c.initial or 0.0, dtype=np.float64), (c.size,)) for c in channels]
    return np.concatenate([np.zeros(0), *each])
