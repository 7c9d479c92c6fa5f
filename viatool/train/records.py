"""What a run leaves behind: metrics, TensorBoard events, versions, checkpoints, all written whole."""

from __future__ import annotations

import csv
import json
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import torch

from viatool.errors import ConfigurationError
from viatool.whole_file import whole_file

METRICS = "metrics.csv"
PACKAGES = ("viatool", "numpy", "torch", "onnx", "onnxruntime")


class MetricsLog:
    """Writes ``metrics.csv``, one row for each epoch and seed, and the same as TensorBoard events.

    Parameters
    ----------
    directory : Path
        Of the run.
    tensorboard : bool
        Also write events.
    finished : int
        Epochs that a resumed run has behind it; later events of its interrupted part are hidden.
    """

    def __init__(self, directory: Path, tensorboard: bool, finished: int = 0) -> None:
        self.path = directory / METRICS
        self._events: Any = None
        if tensorboard:
            from torch.utils.tensorboard import SummaryWriter

            self._events = SummaryWriter(str(directory / "tensorboard"), purge_step=finished + 1)

    def write(self, rows: Sequence[Mapping[str, float]], fresh: int) -> None:
        """Write the table whole; the last `fresh` rows become events.

        Columns are those of all rows, in order of appearance.
        """
        columns = list(dict.fromkeys(name for row in rows for name in row))
        with whole_file(self.path) as draft, draft.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, columns, restval="")
            writer.writeheader()
            writer.writerows({name: _text(value) for name, value in row.items()} for row in rows)
        if self._events is not None:
            for row in rows[-fresh:]:
                for name, value in row.items():
                    if name not in ("epoch", "seed"):
                        self._events.add_scalar(f"{name}/seed_{row['seed']}", value, row["epoch"])
            self._events.flush()

    def close(self) -> None:
        """Release the event file."""
        if self._events is not None:
            self._events.close()


def _text(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.8g}"


def installed_versions() -> dict[str, str]:
    """Return the versions on which a repeated run depends."""
    versions = {"python": platform.python_version(), "platform": platform.machine()}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed as a package"
    return versions


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON whole or not at all."""
    write_text(path, json.dumps(content, indent=2) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text whole or not at all."""
    with whole_file(path) as draft:
        draft.write_bytes(text.encode("utf-8"))


def write_checkpoint(path: Path, content: Mapping[str, Any]) -> None:
    """Write tensors and plain values whole or not at all."""
    with whole_file(path) as draft:
        torch.save(dict(content), draft)


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Read what `write_checkpoint` wrote; no code of the file is run.

    Raises
    ------
    ConfigurationError
        If it is not a checkpoint of this trainer.
    """
    try:
        content = torch.load(path, weights_only=True)
    except Exception as error:  # torch raises many kinds for a foreign file
        raise ConfigurationError(
            f"cannot read the checkpoint {path}: {next(iter(str(error).splitlines()), type(error).__name__)}",
            "give a .pt file from the checkpoints folder of a training run",
        ) from error
    if not isinstance(content, dict) or "configuration" not in content:
        raise ConfigurationError(
            f"{path} is not a checkpoint of viatool", "give a .pt file from a training run"
        )
    return content
