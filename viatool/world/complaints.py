"""What is wrong with a file, in words: file, line, field, what was expected, what was found."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError

from viatool.errors import MapError, ViatoolError
from viatool.world.obstacle_shapes import SHAPES
from viatool.world.yaml_text import YamlDocument

Model = TypeVar("Model", bound=BaseModel)
Built = TypeVar("Built")

_SHOWN = 8  # errors that are listed; the rest is counted
# Steps in pydantic's locations that name a variant of a union instead of a key of the file.
_VARIANTS = (
    *SHAPES,
    "point",
    "str",
    "RobotFile",
    "place",
    "states",
    "outline",
    "corners",
    "one number",
    "two numbers",
)
# What pydantic says in terms of Python, in terms of the file.
_PLAINER = {
    "union_tag_not_found": "has no 'shape'",
    "model_type": "expected a mapping",
    "model_attributes_type": "expected a mapping",
    "dict_type": "expected a mapping",
    "mapping_type": "expected a mapping",
    "list_type": "expected a list",
    "tuple_type": "expected a list",
    "extra_forbidden": "is not a known field",
}


def validated(
    document: YamlDocument,
    model: type[Model],
    hint: str = "correct the named fields; lengths are metres, angles radians",
) -> Model:
    """Return a document as a typed model; `hint` says how to mend one that is wrong.

    Raises
    ------
    MapError
        One line for each of the first problems, with file, line and field.
    """
    try:
        return model.model_validate(document.content)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        lines = [_explain(document, problem, model) for problem in problems[:_SHOWN]]
        if len(problems) > _SHOWN:
            lines.append(f"and {len(problems) - _SHOWN} more")
        raise MapError("\n".join(lines), hint) from error


def wrong(document: YamlDocument, location: Sequence[str | int], what: str, hint: str) -> MapError:
    """Return an error that names file, line and field."""
    return MapError(f"{document.place(location)}: {field_name(location)}: {what}", hint)


def located(document: YamlDocument, location: Sequence[str | int], build: Callable[[], Built]) -> Built:
    """Return what `build` builds; its errors become map errors with a place."""
    try:
        return build()
    except ViatoolError as error:
        raise wrong(document, location, error.message, error.hint) from error


def field_name(location: Iterable[str | int]) -> str:
    """Return "obstacles[2].radius" for ("obstacles", 2, "radius")."""
    text = ""
    for step in location:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else step
    return text or "map"


def shortened(value: Any) -> str:
    """Return a value as it may stand in a message."""
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _explain(document: YamlDocument, problem: Any, model: type[BaseModel]) -> str:
    """Return one line for one problem that pydantic found."""
    location = [step for step in problem["loc"] if step not in _VARIANTS]
    kind, message, given = problem["type"], problem["msg"].removeprefix("Value error, "), problem["input"]
    what = _PLAINER.get(kind, message[0].lower() + message[1:])
    if kind == "extra_forbidden" and (known := _known_fields(model, location[:-1])):
        what += f", which are {', '.join(known)}"
    if kind not in ("missing", "extra_forbidden") and not isinstance(given, dict | list | bool):
        what += f", got {shortened(given)}"
    return ": ".join([document.place(location), *([field_name(location)] if location else []), what])


def _known_fields(model: type[BaseModel], location: Sequence[str | int]) -> tuple[str, ...]:
    """Return the fields of the model that stands at a place; none if it may be one of several."""
    annotation: Any = model
    for step in location:
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            field = annotation.model_fields.get(str(step))
            annotation = None if field is None else field.annotation
        elif get_origin(annotation) is Mapping:
            annotation = get_args(annotation)[1]
        else:
            return ()
    is_model = isinstance(annotation, type) and issubclass(annotation, BaseModel)
    return (
        tuple(name for name, field in annotation.model_fields.items() if not field.exclude)
        if is_model
        else ()
    )
