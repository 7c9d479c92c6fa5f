"""The command line: one short file for each command, no logic."""

from __future__ import annotations

from viatool.cli.main import main

__all__ = ["main"]
