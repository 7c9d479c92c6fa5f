"""TOML files as typed models: what is wrong is told with file, line and field."""

from __future__ import annotations

from typing import TypeVar

from pydantic import BaseModel, ValidationError

from viatool.errors import ConfigurationError
from viatool.toml_text import Place, TomlDocument

Model = TypeVar("Model", bound=BaseModel)

_SHOWN = 8
"""Problems that are listed; the rest is counted."""


def validated_toml(document: TomlDocument, model: type[Model], below: Place = ()) -> Model:
    """Return a document, or the table `below` some keys of it, as a typed model.

    Raises
    ------
    ConfigurationError
        One line for each of the first problems, with file, line and field.
    """
    content = document.content
    for step in below:
        content = content[step]  # type: ignore[index]  # tables alone lead to tables
    try:
        return model.model_validate(content)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        lines = [
            _line(document, below, problem["loc"], problem["type"], problem["msg"]) for problem in problems
        ]
        more = [f"and {len(lines) - _SHOWN} more"] if len(lines) > _SHOWN else []
        raise ConfigurationError("\n".join([*lines[:_SHOWN], *more]), "correct the named fields") from error


def field_words(place: Place) -> str:
    """Return "check[2].eps" for ("check", 2, "eps")."""
    text = ""
    for step in place:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else step
    return text


def _line(document: TomlDocument, below: Place, location: Place, kind: str, message: str) -> str:
    what = message.removeprefix("Value error, ")
    if kind == "extra_forbidden":
        what = "is not a known key"
    told = field_words(location)
    return ": ".join(
        [document.place((*below, *location)), *([told] if told else []), what[0].lower() + what[1:]]
    )
