"""Proofs, counterexamples and safety rates for learned navigation policies under bounded sensor error."""

from __future__ import annotations

from typing import TYPE_CHECKING

from viatool.lazy_names import lazily

if TYPE_CHECKING:
    from viatool.margins import margin
    from viatool.missions import mission
    from viatool.monitoring import Decision, Monitor
    from viatool.places import certify
    from viatool.policy import Policy, load_policy
    from viatool.report.map_figure import draw_map
    from viatool.report.states.figure import draw_result
    from viatool.simulate.roll_out import roll_out
    from viatool.taylor import ReachableSet, reach
    from viatool.trajectory import Trajectory, load_trajectory
    from viatool.uncertainty import ErrorModel, load_errors
    from viatool.verification import verify
    from viatool.verification.result import Result
    from viatool.verification.verifier import StateVerdict, Verifier
    from viatool.world import WorldMap, load_map

__version__ = "0.1.0"

_ROOM_OF = {
    "Decision": "viatool.monitoring",
    "ErrorModel": "viatool.uncertainty",
    "Monitor": "viatool.monitoring",
    "Policy": "viatool.policy",
    "ReachableSet": "viatool.taylor",
    "Result": "viatool.verification.result",
    "StateVerdict": "viatool.verification.verifier",
    "Trajectory": "viatool.trajectory",
    "Verifier": "viatool.verification.verifier",
    "WorldMap": "viatool.world",
    "certify": "viatool.places",
    "draw_map": "viatool.report.map_figure",
    "draw_result": "viatool.report.states.figure",
    "load_errors": "viatool.uncertainty",
    "load_map": "viatool.world",
    "load_policy": "viatool.policy",
    "load_trajectory": "viatool.trajectory",
    "margin": "viatool.margins",
    "mission": "viatool.missions",
    "reach": "viatool.taylor",
    "roll_out": "viatool.simulate",
    "verify": "viatool.verification",
}

__all__ = [
    "Decision",
    "ErrorModel",
    "Monitor",
    "Policy",
    "ReachableSet",
    "Result",
    "StateVerdict",
    "Trajectory",
    "Verifier",
    "WorldMap",
    "__version__",
    "certify",
    "draw_map",
    "draw_result",
    "load_errors",
    "load_map",
    "load_policy",
    "load_trajectory",
    "margin",
    "mission",
    "reach",
    "roll_out",
    "verify",
]

__getattr__, __dir__ = lazily(__name__, _ROOM_OF)
