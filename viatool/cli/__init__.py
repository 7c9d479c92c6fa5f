"""The command line: one short file for each command, and no logic."""

from __future__ import annotations

from viatool.cli.group import main

__all__ = ["main"]
