"""Project files: policies x maps x what is asked of them, all of it run by one command.

The room knows no command: those that a project may ask for, and who carries one out, are given to it.
"""

from __future__ import annotations

from viatool.projects.file import Project, ProjectFile, find_project, load_project
from viatool.projects.matrix import ProjectCell, expand
from viatool.projects.options import Catalogue, read_overrides
from viatool.projects.records import ProjectSummary, worst
from viatool.projects.robot_files import RobotFacts, load_environment, load_nav2, load_scanner
from viatool.projects.run import Request, choose_cells, run_cells
from viatool.projects.schema import project_schema
from viatool.projects.selection import Selection
from viatool.projects.site import Preferences, states_its_robot
from viatool.projects.start import begin, described, read_model, require_readable, write_beginning
from viatool.projects.tables import print_cells, print_summary

__all__ = [
    "Catalogue",
    "Preferences",
    "Project",
    "ProjectCell",
    "ProjectFile",
    "ProjectSummary",
    "Request",
    "RobotFacts",
    "Selection",
    "begin",
    "choose_cells",
    "described",
    "expand",
    "find_project",
    "load_environment",
    "load_nav2",
    "load_project",
    "load_scanner",
    "print_cells",
    "print_summary",
    "project_schema",
    "read_model",
    "read_overrides",
    "require_readable",
    "run_cells",
    "states_its_robot",
    "worst",
    "write_beginning",
]
