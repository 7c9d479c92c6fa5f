"""A simulation on the console."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

from viatool.report.numbers import count, counted, percentage, significant
from viatool.report.summaries import print_facts

if TYPE_CHECKING:
    from viatool.simulate import Simulation, Spread, Statistics

_BAR = 40


def print_simulation(simulation: Simulation, console: Console) -> None:
    """Print how the episodes ended, with 95 % intervals, and what they were like."""
    found, world_map = simulation.statistics, simulation.world_map
    trajectory = simulation.drive.trajectory
    facts = [("engine", _engine(simulation)), ("states", count(len(trajectory)))]
    for name in ("success", "collision", "timeout"):
        share = getattr(found, name)
        low, high = (f"{100.0 * end:.1f}" for end in share.interval)
        rate = percentage(share.count, share.total)
        facts.append((name, f"{count(share.count)} ({rate}; 95 % interval {low} to {high} %)"))
    facts += [
        ("average cost", f"{significant(found.average_cost)} steps in danger"),
        ("time to goal", _spread(found.time_to_goal, "s")),
        ("path length ratio", f"{_spread(found.path_ratio, '')} (1 is straight)"),
        ("least clearance", _spread(found.least_clearance, "m")),
    ]
    told = simulation.beyond_limits()
    if told:
        facts.append(("beyond the robot", f"the policy asks for {'; '.join(told)}"))
        facts.append(("", f"clipped {percentage(found.clipped.count, found.clipped.total)} of its commands"))
    title = f"{counted(trajectory.episodes, 'episode')} on {world_map.name}, driven and not proved"
    print_facts(title, facts, console)
    _print_histogram(found, world_map.clearance.collision, world_map.clearance.danger, console)


def _engine(simulation: Simulation) -> str:
    words = [f"{simulation.engine}, {simulation.world_map.robot.name}", *simulation.conditions.words()]
    if simulation.engine == "bullet":
        words.insert(1, "LiDAR by ray tests" if simulation.lidar == "rays" else "analytic LiDAR")
    return ", ".join(words)


def _spread(spread: Spread, unit: str) -> str:
    if not spread.count:
        return "n/a"
    space = f" {unit}" if unit else ""
    return (
        f"{significant(spread.mean)}{space} on average, {significant(spread.median)} in the median, "
        f"{significant(spread.least)} to {significant(spread.largest)}"
    )


def _print_histogram(found: Statistics, collision: float, danger: float, console: Console) -> None:
    """Draw the clearances as bars, in steps of half a metre and finer near obstacles."""
    edges, counts = found.clearance_edges, found.clearance_counts
    console.print(Text("clearance after each step", style="bold"))
    total = max(int(counts.sum()), 1)
    groups = [*range(10), *range(10, len(edges), 5)]
    merged = [
        int(part.sum()) for part in (counts[a:b] for a, b in zip(groups, [*groups[1:], None], strict=True))
    ]
    for first, following, number in zip(groups, [*groups[1:], None], merged, strict=True):
        if number == 0:
            continue
        low = edges[first]
        mark = "collision" if low + 1e-9 < collision else "danger" if low + 1e-9 < danger else ""
        bar = "█" * max(1, round(_BAR * number / max(merged)))
        high = f"to {edges[following]:3.1f} m" if following is not None else "m and more"
        line = f"  {low:3.1f} {high:<10} {percentage(number, total):>8} {bar} {mark}"
        console.print(Text(line.rstrip()), highlight=False)
