"""The versions on which a result depends, read from the installed packages without importing them."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

import viatool
from viatool.engine import chosen_engine

NEEDED = ("numpy", "onnx", "onnxruntime")
OPTIONAL = ("torch", "pybullet", "gymnasium", "rosbags")


def result_versions() -> dict[str, str]:
    """Return the versions that the repetition of a verification would need, and which engine runs."""
    libraries = {name: version(name) for name in NEEDED}
    python = platform.python_version()
    return {"viatool": viatool.__version__, "engine": chosen_engine(), "python": python, **libraries}


def installed_versions() -> dict[str, str]:
    """Return these, and the versions of the optional packages or that they are not installed."""
    return result_versions() | {name: version_of(name) for name in OPTIONAL}


def version_of(name: str) -> str:
    """Return the version of a package, or that it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
