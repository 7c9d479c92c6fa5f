"""What is measured of a policy: the columns of all tables, read from the record of its evaluation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

Evaluation = Mapping[str, Any]


@dataclass(frozen=True)
class Metric:
    """One number of a policy.

    Parameters
    ----------
    name, title : str
        In data files and in tables.
    better : int
        +1 if more is better, -1 if less is.
    read : callable
        From the result of `EvaluateSeed` to the number; None where there is none, such as the safety of
        collision episodes without a collision.
    margin : float
        Two methods that differ by less are as good as each other in practice.
    episodes : str, optional
        Of which scenarios it is a share, "fixed" or "held_out"; None for what is no share of episodes.
    digits : int
        After the point.
    scale : float
        100 for shares, which are shown in per cent.
    """

    name: str
    title: str
    better: int
    read: Callable[[Evaluation], float | None]
    margin: float
    episodes: str | None = None
    digits: int = 1
    scale: float = 100.0


def _task(scenarios: str, rate: str) -> Callable[[Evaluation], float | None]:
    return lambda found: _number(found[scenarios]["task"][rate])


def _rate(
    rate: str, outcome: str = "overall", scenarios: str = "held_out"
) -> Callable[[Evaluation], float | None]:
    return lambda found: _number(found[scenarios][rate][outcome]["rate"])


def _width(action: str) -> Callable[[Evaluation], float | None]:
    return lambda found: _number(found["fixed"]["reachable_width"][action]["mean"])


def _cvar(alpha: str) -> Callable[[Evaluation], float | None]:
    return lambda found: _number(found["held_out"]["cvar"][alpha])


def _number(value: Any) -> float | None:
    return None if value is None else float(value)


TASK = (
    Metric("fixed_success", "Success", +1, _task("fixed", "success_rate"), 0.05, "fixed"),
    Metric("fixed_collision", "Collision", -1, _task("fixed", "collision_rate"), 0.05, "fixed"),
    Metric("success", "Success", +1, _task("held_out", "success_rate"), 0.01, "held_out"),
    Metric("collision", "Collision", -1, _task("held_out", "collision_rate"), 0.005, "held_out", 2),
    Metric("timeout", "Timeout", -1, _task("held_out", "timeout_rate"), 0.01, "held_out", 2),
)
COST = (
    Metric("fixed_cost", "Cost", -1, _task("fixed", "average_cost"), 0.5, None, 2, 1.0),
    Metric("cost", "Cost", -1, _task("held_out", "average_cost"), 0.1, None, 2, 1.0),
    Metric("cvar_0.9", "CVaR 0.9", -1, _cvar("0.9"), 1.0, None, 2, 1.0),
    Metric("cvar_0.5", "CVaR 0.5", -1, _cvar("0.5"), 0.2, None, 2, 1.0),
    Metric("cvar_0.1", "CVaR 0.1", -1, _cvar("0.1"), 0.1, None, 2, 1.0),
)
SAFETY = (
    Metric("safety_success", "Safety (Succ.)", +1, _rate("safety_rate", "success"), 1e-4, None, 3),
    Metric("safety_collision", "Safety (Coll.)", +1, _rate("safety_rate", "collision"), 0.005, None, 2),
    Metric("safety", "Overall", +1, _rate("safety_rate"), 1e-4, None, 3),
    Metric("sampled_success", "Sampled (Succ.)", +1, _rate("sampled_safety_rate", "success"), 1e-4, None, 3),
    Metric(
        "sampled_collision", "Sampled (Coll.)", +1, _rate("sampled_safety_rate", "collision"), 0.005, None, 2
    ),
    Metric("sampled", "Sampled overall", +1, _rate("sampled_safety_rate"), 1e-4, None, 3),
    Metric("danger", "At d_danger", +1, _rate("danger_rate"), 0.001, None, 2),
    Metric("contested", "Contested", +1, _rate("contested_rate"), 0.05, None, 1),
    Metric(
        "fixed_success_safety",
        "Safety (Succ.)",
        +1,
        _rate("sampled_safety_rate", "success", "fixed"),
        0.001,
        None,
        2,
    ),
    Metric(
        "fixed_collision_safety",
        "Safety (Coll.)",
        +1,
        _rate("sampled_safety_rate", "collision", "fixed"),
        0.01,
        None,
        2,
    ),
    Metric(
        "fixed_safety", "Overall Safety", +1, _rate("sampled_safety_rate", "overall", "fixed"), 0.001, None, 2
    ),
    Metric("fixed_proved", "Overall, proved", +1, _rate("safety_rate", "overall", "fixed"), 0.001, None, 2),
)
WIDTH = (
    Metric("width_v", "Width of v [m/s]", -1, _width("v"), 0.002, None, 4, 1.0),
    Metric("width_omega", "Width of omega [rad/s]", -1, _width("omega"), 0.02, None, 3, 1.0),
)
METRICS = {metric.name: metric for metric in (*TASK, *COST, *SAFETY, *WIDTH)}


def values_of(evaluations: list[Evaluation]) -> dict[str, list[float | None]]:
    """Return every metric of every seed."""
    return {name: [metric.read(one) for one in evaluations] for name, metric in METRICS.items()}
