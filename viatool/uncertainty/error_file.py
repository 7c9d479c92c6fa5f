"""Reading error models: ``--errors robot-errors.yaml``."""

from __future__ import annotations

import os
from pathlib import Path

from viatool.errors import ConfigurationError, MapError
from viatool.samples import ERRORS
from viatool.uncertainty.error_model import ErrorModel
from viatool.world.complaints import validated
from viatool.world.yaml_text import read_yaml

_HINT = "see docs/errors.md for the layout"


def load_errors(path: str | os.PathLike[str]) -> ErrorModel:
    """Read an error model (YAML), or that of a robot by its name, and check it.

    Raises
    ------
    ConfigurationError
        If the file cannot be read, or has an unknown or impossible value; names file, line and field.
    """
    path = Path(path)
    try:
        text = ERRORS.find(path).read_bytes()
    except OSError as error:
        raise ConfigurationError(
            f"the error model '{path}' cannot be read: {error.strerror or error}",
            f"check the path, or name a robot whose data sheet is known: {', '.join(ERRORS.names())}",
        ) from error
    try:
        document = read_yaml(path, text)
        if document.content is None:
            return ErrorModel(source=str(path))
        found = validated(document, ErrorModel)
    except MapError as error:
        raise ConfigurationError(error.message, _HINT) from error
    return found.model_copy(update={"source": str(path)})


def as_error_model(given: ErrorModel | str | os.PathLike[str] | None) -> ErrorModel:
    """Return an error model that was given as such, as a file, or not at all."""
    if given is None:
        return ErrorModel()
    return given if isinstance(given, ErrorModel) else load_errors(given)
