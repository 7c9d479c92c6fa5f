"""Studies: the paper's experiments as resumable tasks, their results as data, and pages written from the data.

A study is a module of this room with a `STUDY`; its name stands in `STUDIES`. Modules are imported when they
are asked for, so that the command line stays quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from viatool.studies.study import Study

STUDIES = ("table1", "table2", "mean-limit", "figures", "transfer")
"""Names of all studies, in the order in which ``all`` runs them."""

__all__ = ["STUDIES", "study_named"]


def study_named(name: str) -> Study:
    """Return the study of a name in `STUDIES`."""
    study: Study = import_module(f"viatool.studies.{name.replace('-', '_')}").STUDY
    return study
