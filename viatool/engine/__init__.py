"""The compiled engine, where it is there: a small library without Python in it, and the choice between it and numpy.

It is built from the C files of this folder when viatool is installed, or by ``python hatch_build.py`` in a checkout.
One that was built from other sources than those beside it is not used. The environment's `VIATOOL_ENGINE=numpy` leaves
it out, `VIATOOL_ENGINE=compiled` insists on it. What it computes, and why that is sound, stands in docs/kernel.md;
`taylor.kernel` calls it.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from viatool.errors import ConfigurationError

Engine = Literal["compiled", "numpy"]

VARIABLE = "VIATOOL_ENGINE"

_FOLDER = Path(__file__).parent
_LIBRARY = _FOLDER / ("_kernel.dll" if sys.platform == "win32" else "_kernel.so")


def chosen_engine() -> Engine:
    """Return which engine this process runs wherever both could.

    Raises
    ------
    ConfigurationError
        If the environment asks for one that does not exist, or for the compiled one where it is not built.
    """
    wish = os.environ.get(VARIABLE, "")
    if wish not in ("", "compiled", "numpy"):
        raise ConfigurationError(f"{VARIABLE} is '{wish}', expected compiled or numpy", "leave it out")
    if wish == "numpy":
        return "numpy"
    if library() is not None:
        return "compiled"
    if wish == "compiled":
        raise ConfigurationError(
            f"{VARIABLE} is compiled, but the compiled engine is not built",
            "install viatool where there is a C compiler, or run `python hatch_build.py` in a checkout",
        )
    return "numpy"


@lru_cache(maxsize=1)
def library() -> Any:
    """Load the library; None where it is not built, or built from other sources."""
    try:
        loaded = ctypes.CDLL(str(_LIBRARY))
        loaded.viatool_digest.restype = ctypes.c_char_p
        return loaded if loaded.viatool_digest().decode() == _digest() else None
    except (OSError, AttributeError):
        return None


def _digest() -> str:
    """Return what tells one state of the sources from another, as hatch_build.py does."""
    sources = sorted(path for path in _FOLDER.iterdir() if path.suffix in (".c", ".h"))
    return hashlib.sha256(b"".join(path.read_bytes().replace(b"\r\n", b"\n") for path in sources)).hexdigest()
