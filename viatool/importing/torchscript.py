"""TorchScript: an actor that was saved as a program of tensors."""

from __future__ import annotations

import re
import warnings
import zipfile
from pathlib import Path

import numpy as np
import torch
from torch import nn

from viatool.errors import PolicyError
from viatool.importing.actor import ImportedActor
from viatool.importing.spaces import BoxSpace

_SCRIPT = (
    "save it with `torch.jit.trace(actor, example).save(FILE)`, or export it by hand, see docs/exporting.md"
)
_TOUCHES_FILES = re.compile(rb"\b(?:torch|ops\.aten)\.(?:save|from_file)\b|\bops\.(?!aten\b|prim\b)\w+")
"""In the text of a program, before it is read: reading one may run a part of it."""

_MAX_CODE = 2**24


def is_torchscript(names: list[str]) -> bool:
    """Tell whether the names in a zip are those of a TorchScript archive."""
    return any("/code/" in name for name in names)


def read_script(path: Path, size: int | None, action: BoxSpace | None) -> ImportedActor:
    """Read a TorchScript actor.

    Parameters
    ----------
    path : Path
        The archive; it holds a program of tensor operations, of which those that touch files are refused.
    size : int, optional
        Length of the observation; by default what the first matrix takes, if the actor runs with that.
    action : BoxSpace, optional
        The limits to which outputs in [-1, 1] are scaled; None where the outputs are commands.

    Raises
    ------
    PolicyError
        If it cannot be read, or does not map one vector to one vector.
    """
    body = _loaded(path)
    size = size or _first_size(body, path)
    outputs = _outputs(body, size, path)
    if action is not None and action.size != outputs:
        raise PolicyError(
            f"{path} gives {outputs} numbers, but {action.size} limits are given",
            f"give --low and --high {outputs} numbers each",
        )
    unlimited = BoxSpace(np.full(size, -np.inf), np.full(size, np.inf), (size,))
    return ImportedActor(body, unlimited, action, action is not None, "TorchScript")


def _loaded(path: Path) -> nn.Module:
    _refuse_files(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            body = torch.jit.load(str(path), map_location="cpu")  # type: ignore[no-untyped-call]
    except Exception as error:  # torch names no class of errors for what it cannot read
        raise PolicyError(
            f"{path} is not TorchScript that torch {torch.__version__} reads", _SCRIPT
        ) from error
    loaded: nn.Module = body.eval()
    return loaded


def _refuse_files(path: Path) -> None:
    """Refuse a program that reads or writes files, or calls operators that torch does not bring."""
    with zipfile.ZipFile(path) as archive:
        for info in archive.infolist():
            if "/code/" not in info.filename or not info.filename.endswith(".py"):
                continue
            if info.file_size > _MAX_CODE:
                raise PolicyError(f"{path}: {info.filename} is far longer than a policy needs", _SCRIPT)
            found = _TOUCHES_FILES.search(archive.read(info))
            if found is not None:
                raise PolicyError(
                    f"{path}: {info.filename} calls '{found[0].decode()}', where arithmetic is expected",
                    _SCRIPT,
                )


def _first_size(body: nn.Module, path: Path) -> int:
    matrices = [each for each in (*body.parameters(), *body.buffers()) if each.ndim == 2]
    if not matrices:
        raise PolicyError(
            f"{path} has no layer that tells the length of the observation", "give it with --input-size N"
        )
    return int(matrices[0].shape[1])


def _outputs(body: nn.Module, size: int, path: Path) -> int:
    try:
        with torch.no_grad():
            found = body(torch.zeros(1, size))
    except Exception as error:  # a program may fail in any way
        raise PolicyError(
            f"{path} does not run with an observation of {size} numbers",
            "give its length with --input-size N",
        ) from error
    if not isinstance(found, torch.Tensor) or found.ndim != 2 or found.shape[0] != 1:
        what = (
            f"shape {list(found.shape)}" if isinstance(found, torch.Tensor) else f"a {type(found).__name__}"
        )
        raise PolicyError(
            f"{path} gives {what} for one observation, where [1, actions] is expected",
            "script a module that returns the deterministic action alone",
        )
    return int(found.shape[1])
