"""The report on a simulation while it is at hand: its content, its picture, and its states."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from viatool.report.document import Drawn, Recorded
from viatool.report.simulations.document import SimulationDocument
from viatool.simulate.statistics import Proportion, Spread, episode_steps, path_ratios
from viatool.versions import installed_versions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from viatool.simulate import Simulation
    from viatool.simulate.simulation import MonitoredDrive

SCHEMA_VERSION = 1


class SimulationRun(SimulationDocument, Drawn, Recorded):
    """The report of a simulation."""

    def __init__(self, simulation: Simulation) -> None:
        super().__init__(_content(simulation))
        self.simulation = simulation

    def draw(self) -> Figure:
        """Return all paths by outcome, clearances, and times to the goal."""
        from viatool.report.simulations.figure import draw_simulation

        return draw_simulation(self.simulation)

    def write_trajectory(self, path: Path) -> None:
        """Write the driven states."""
        from viatool.trajectory import write_trajectory

        write_trajectory(path, self.simulation.drive.trajectory, self.simulation.policy.spec)


def _content(simulation: Simulation) -> dict[str, Any]:
    """Return a simulation as JSON values; docs/simulators.md names the fields."""
    found, robot = simulation.statistics, simulation.world_map.robot
    return {
        "schema_version": SCHEMA_VERSION,
        "policy": {"path": str(simulation.policy.path), "sha256": simulation.policy.sha256},
        "map": {"path": str(simulation.world_map.path), "sha256": simulation.world_map.sha256},
        "engine": simulation.engine,
        "lidar": simulation.lidar,
        "robot": {
            "name": robot.name,
            "min_linear": robot.min_linear,
            "max_linear": robot.max_linear,
            "max_angular": robot.max_angular,
            "speeds": robot.speeds,
        },
        "conditions": asdict(simulation.conditions),
        **({"errors": _errors(simulation)} if simulation.setting.uncertainty else {}),
        "seed": simulation.seed,
        "success": _share(found.success),
        "collision": _share(found.collision),
        "timeout": _share(found.timeout),
        "average_cost": found.average_cost,
        "clearance": {
            "collision": simulation.world_map.clearance.collision,
            "danger": simulation.world_map.clearance.danger,
            "least_of_an_episode": _spread(found.least_clearance),
            "histogram": {
                "edges": np.round(found.clearance_edges, 9).tolist(),
                "counts": found.clearance_counts.tolist(),
            },
        },
        "time_to_goal": _spread(found.time_to_goal),
        "path_length_ratio": _spread(found.path_ratio),
        "clipped_commands": {"count": found.clipped.count, "total": found.clipped.total},
        "beyond_limits": simulation.beyond_limits(),
        "episodes": _episodes(simulation),
        **({} if simulation.monitored is None else {"monitor": _monitored(simulation, simulation.monitored)}),
        "seconds": round(simulation.seconds, 3),
        "versions": installed_versions(),
        "premises": [premise.to_json() for premise in simulation.premises],
    }


def _monitored(simulation: Simulation, found: MonitoredDrive) -> dict[str, Any]:
    """Return what the monitor did, and what came of it."""
    without, under, statistics = simulation.drive.trajectory.outcomes, found.outcomes, found.statistics
    return {
        "intervals": found.intervals,
        "interventions": int(found.interventions.sum()),
        "intervened_episodes": int((found.interventions > 0).sum()),
        "unproved": int(found.unproved.sum()),
        "success": _share(statistics.success),
        "collision": _share(statistics.collision),
        "timeout": _share(statistics.timeout),
        "lost_success": int(((without == "success") & (under != "success")).sum()),
        "gained_success": int(((without != "success") & (under == "success")).sum()),
        "prevented_collisions": int(((without == "collision") & (under != "collision")).sum()),
        "least_clearance": round(float(found.least_clearance.min()), 6),
        "time_to_goal": _spread(statistics.time_to_goal),
        "seconds": round(found.seconds, 3),
    }


def _errors(simulation: Simulation) -> dict[str, Any]:
    """Return the error model, and who chose the errors within it."""
    model = simulation.setting.uncertainty
    return {
        "source": model.source,
        "chosen_by": "an adversary" if simulation.adversary else "chance",
        "terms": dict(model.premises()),
    }


def _episodes(simulation: Simulation) -> list[dict[str, Any]]:
    """Return one entry for each episode."""
    drive = simulation.drive
    trajectory = drive.trajectory
    seconds = episode_steps(trajectory) * simulation.world_map.robot.control_interval
    columns = zip(
        trajectory.scenarios,
        trajectory.outcomes.tolist(),
        trajectory.costs.tolist(),
        seconds.tolist(),
        drive.least_clearance.tolist(),
        path_ratios(drive).tolist(),
        strict=True,
    )
    return [
        {
            "scenario": "" if scenario is None else scenario.name,
            "outcome": outcome,
            "cost": cost,
            "seconds": round(duration, 6),
            "least_clearance": round(least, 6),
            "path_length_ratio": round(ratio, 6),
        }
        for scenario, outcome, cost, duration, least, ratio in columns
    ]


def _share(share: Proportion) -> dict[str, Any]:
    low, high = share.interval
    return {"count": share.count, "total": share.total, "rate": share.rate, "interval": [low, high]}


def _spread(spread: Spread) -> dict[str, Any]:
    return {name: None if math.isnan(value) else value for name, value in asdict(spread).items()}
