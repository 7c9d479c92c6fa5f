"""Reading error models: ``--errors robot-errors.yaml``."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any

from viatool.errors import ConfigurationError, MapError
from viatool.samples import ERRORS
from viatool.uncertainty.error_model import ErrorModel
from viatool.world.complaints import validated, wrong
from viatool.world.yaml_text import YamlDocument, read_yaml

_log = logging.getLogger(__name__)

_HINT = "correct the named terms, in m, s, rad and shares of 1; docs/errors.md lists them"


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
            raise ConfigurationError(
                f"{path}: is empty, so it states no error at all", "state a term, or leave --errors out"
            )
        _refuse_forgotten(document, document.content)
        found = validated(document, ErrorModel, _HINT)
    except MapError as error:
        raise ConfigurationError(error.message, error.hint) from error
    _log.info(
        "error model %s read: %s", path, "; ".join(f"{place} {words}" for place, words in found.premises())
    )
    return found.model_copy(update={"source": str(path)})


def as_error_model(given: ErrorModel | str | os.PathLike[str] | None) -> ErrorModel:
    """Return an error model that was given as such, as a file, or not at all."""
    if given is None:
        return ErrorModel()
    if isinstance(given, ErrorModel):
        return given
    if not isinstance(given, str | os.PathLike):
        raise ConfigurationError(
            f"errors is of type {type(given).__name__}, expected a viatool.ErrorModel, or the path of a file",
            "write viatool.ErrorModel(pose={'x': 0.02}), or give the file",
        )
    return load_errors(given)


def _refuse_forgotten(document: YamlDocument, content: Any, location: tuple[str, ...] = ()) -> None:
    """Refuse a term without a number, which would be none at all; a section may be left empty."""
    for key, value in content.items() if isinstance(content, dict) else ():
        place = (*location, str(key))
        if value is None and location:
            raise wrong(document, place, "has no number", "give it one, or take the line out")
        _refuse_forgotten(document, value, place)
