"""``python -m viatool`` is the command line."""

from __future__ import annotations

from viatool.cli import main

main()
