"""The report as JSON, for other programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from viatool.report.files import write_text

if TYPE_CHECKING:
    from viatool.safety import Result

SUFFIXES = ()


def write(result: Result, path: Path) -> None:
    """Write the report document of a result."""
    write_text(path, json.dumps(result.to_json(), indent=2, allow_nan=False) + "\n")
