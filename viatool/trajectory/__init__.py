"""Recorded states: the poses, observations and outcomes that a verification runs over."""

from __future__ import annotations

from viatool.trajectory.bag import Topics, is_bag
from viatool.trajectory.columns import action_columns, observation_columns
from viatool.trajectory.files import load_trajectory, write_trajectory
from viatool.trajectory.recording import BagSettings
from viatool.trajectory.scenario_text import read_scenario, write_scenario
from viatool.trajectory.trajectory import OUTCOMES, Trajectory
from viatool.whole_file import whole_file

__all__ = [
    "OUTCOMES",
    "BagSettings",
    "Topics",
    "Trajectory",
    "action_columns",
    "is_bag",
    "load_trajectory",
    "observation_columns",
    "read_scenario",
    "whole_file",
    "write_scenario",
    "write_trajectory",
]
