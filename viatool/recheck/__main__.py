"""``python -m viatool.recheck FOLDER``: the checker without the command line of viatool."""

from __future__ import annotations

import sys
from pathlib import Path

from viatool.recheck import UnreadableFolder, recheck
from viatool.recheck.outcome import UNREADABLE


def main(arguments: list[str]) -> int:
    """Recheck the folder that is named, and return the exit code."""
    if len(arguments) != 1:
        sys.stderr.write("usage: python -m viatool.recheck FOLDER\n")
        return UNREADABLE
    try:
        found = recheck(Path(arguments[0]))
    except UnreadableFolder as error:
        sys.stderr.write(f"error: {error}\n")
        return UNREADABLE
    sys.stdout.write("\n".join(found.lines()) + "\n")
    return found.code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
