"""The robots of all maps, which learn as one: those of each seed are shared out among the maps."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from viatool.arrays import Floats
from viatool.train.collection import Collector, Episodes
from viatool.train.configuration import TrainingConfiguration
from viatool.train.feedback import Feedback
from viatool.train.maps import TrainingMaps
from viatool.train.methods import Method
from viatool.train.networks import Weights
from viatool.train.observation import UnitScaling
from viatool.train.returns import Transition


class Fleet:
    """Collectors, one for each map, whose robots are beside each other in transitions.

    Parameters
    ----------
    configuration, scaling, method, var, epoch
        As for `Collector`; every map gets its share of the robots.
    maps : TrainingMaps
        Where they drive.
    feedback : sequence of Feedback, optional
        For each map, where a share of the episodes begins again.
    """

    def __init__(
        self,
        configuration: TrainingConfiguration,
        maps: TrainingMaps,
        scaling: UnitScaling,
        method: Method,
        var: Floats,
        epoch: int,
        feedback: Sequence[Feedback] | None = None,
    ) -> None:
        self.collectors = [
            Collector(
                configuration.model_copy(update={"robots": robots}),
                world_map,
                scaling,
                method,
                var,
                epoch,
                None if feedback is None else feedback[number],
                number,
            )
            for number, (world_map, robots) in enumerate(
                zip(maps.maps, maps.shares(configuration.robots), strict=True)
            )
        ]

    @property
    def start_observation(self) -> Tensor:
        """Return the observations with which the latest episodes began, (S, E, n)."""
        return torch.cat([collector.start_observation for collector in self.collectors], dim=1)

    def step(self, actor: Weights, var: Floats) -> tuple[Transition, Episodes]:
        """Drive every robot for one control interval, see `Collector.step`."""
        steps = [collector.step(actor, var) for collector in self.collectors]
        transitions = zip(*(transition for transition, _ in steps), strict=True)
        joined = Transition(*(torch.cat(parts, dim=1) for parts in transitions))
        return joined, Episodes.joined([episodes for _, episodes in steps])

    def feed_back(self, feedback: Sequence[Feedback]) -> None:
        """Let a share of the coming episodes begin again, see `Collector.feed_back`."""
        for collector, found in zip(self.collectors, feedback, strict=True):
            collector.feed_back(found)

    def limit_goal_distance(self, largest: float) -> None:
        """Draw goals of the coming episodes within this distance of their start, in metres."""
        for collector in self.collectors:
            collector.limit_goal_distance(largest)

    def close(self) -> None:
        """Take the robots away."""
        for collector in self.collectors:
            collector.simulator.close()
