"""Reports of a simulation: what was driven, never mixed with what is proved."""

from __future__ import annotations

from viatool.report.simulation.console import print_simulation

SIMULATION_REPORTERS = {
    "json": "viatool.report.simulation.document",
    "figure": "viatool.report.simulation.figure",
    "trajectory": "viatool.report.simulation.table",
}
"""Format name to the module that renders it, as `viatool.report.outputs.REPORTERS` has it for results."""

__all__ = ["SIMULATION_REPORTERS", "print_simulation"]
