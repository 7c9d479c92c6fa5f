"""Reading specifications: YAML or JSON sidecars, and the JSON in the metadata of a model.

A mistake is named with its file, its line and its field.
"""

from __future__ import annotations

import json
import os
import re
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from viatool.channels import Frames, LidarSpecification
from viatool.errors import PolicyError
from viatool.policy.action_channels import ActionChannel, ActionMap, Bound, Override
from viatool.policy.specification import ObservationChannel, PolicySpecification
from viatool.world.complaints import shortened
from viatool.world.fields import place_of

_SPEC_HINT = (
    "see docs/specification.md for the layout, or write a template with `viatool inspect --write-spec`"
)

_OF_TRAININGS = {"epochs", "epoch_steps", "robots", "seeds", "horizon", "replay_capacity"}

_TYPE = re.compile(
    r"float|int|str|bool|[a-z-]+\[.*\]"
)  # what pydantic puts behind a place, of a field of several types
_TYPES = {
    "float": "a number",
    "int": "a whole number",
    "string": "text",
    "bool": "true or false",
    "list": "a list",
    "tuple": "a list",
    "dict": "a mapping",
    "model": "a mapping",
    "model_attributes": "a mapping",
}
_TAKEN = {
    "finite_number": "a finite number",
    "int_from_float": "a whole number",
    "greater_than": "more than {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "less than {lt}",
    "less_than_equal": "at most {le}",
    "too_short": "at least {min_length} in the list",
    "too_long": "at most {max_length} in the list",
    "string_too_short": "text",
}


def specification_from_json(text: str, where: str) -> PolicySpecification:
    """Read the JSON of a model's metadata.

    Raises
    ------
    PolicyError
        Names `where`, the field and what was expected.
    """
    try:
        return PolicySpecification.model_validate_json(text)
    except ValidationError as error:
        raise PolicyError(f"{where}: {_findings(error)}", _SPEC_HINT) from error


def load_specification(path: str | os.PathLike[str]) -> PolicySpecification:
    """Read a sidecar specification, YAML or JSON.

    Raises
    ------
    PolicyError
        If the file is missing, is not YAML, or does not describe a policy; names the file, line and field.
    """
    import yaml

    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not a text file"
        raise PolicyError(f"cannot read the specification {path}: {reason}", _SPEC_HINT) from error
    try:
        content = yaml.safe_load(text)
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except (yaml.YAMLError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or "it is not valid YAML"
        raise PolicyError(f"{path}{line}: {problem}", _SPEC_HINT) from error
    try:
        return PolicySpecification.model_validate(content)
    except ValidationError as error:
        if isinstance(content, dict) and "observation" not in content and content.keys() & _OF_TRAININGS:
            raise PolicyError(
                f"{path}: this is a training configuration, not a specification", _SPEC_HINT
            ) from error
        raise PolicyError(_findings(error, path, root), _SPEC_HINT) from error


def _findings(error: ValidationError, path: Path | None = None, root: Any = None) -> str:
    found: dict[tuple[str | int, ...], list[ErrorDetails]] = {}
    for finding in error.errors():
        found.setdefault(_field_of(finding), []).append(finding)
    lines = []
    for where, findings in found.items():
        field = ".".join(map(str, where)) or "the document"
        place = f"{path}:{_line(root, where)}: " if path is not None else ""
        lines.append(f"{place}{field}: {_said(findings)}")
    return "\n".join(lines)


def _field_of(finding: ErrorDetails) -> tuple[str | int, ...]:
    """Return where a finding stands, without the name of a type at the end, of several that a field may have."""
    where = place_of(finding)
    while where and _TYPE.fullmatch(str(where[-1])) and isinstance(where[-1], str):
        where = where[:-1]
    return where


def _said(findings: list[ErrorDetails]) -> str:
    """Return what is wrong with one field; of a key that does not exist, the nearest that does."""
    finding = findings[0]
    kind = finding["type"]
    if kind == "value_error":
        return finding["msg"].removeprefix("Value error, ")
    if kind == "missing":
        of_list = isinstance(finding["loc"][-1], int)
        return "a number is missing" if of_list else f"the key '{finding['loc'][-1]}' is missing"
    if kind != "extra_forbidden":
        expected = " or ".join(dict.fromkeys(map(_expected, findings)))
        return f"expected {expected}, not {shortened(finding['input'])}"
    key, keys = str(finding["loc"][-1]), list(_model_at(finding["loc"]).model_fields)
    nearest = get_close_matches(key, keys, n=1, cutoff=0.0)[0]
    return f"there is no key '{key}', nearest is '{nearest}'; known here: {', '.join(keys)}"


def _expected(finding: ErrorDetails) -> str:
    """Return what a field takes, in words of the file."""
    context = finding.get("ctx", {}).items()
    told = {name: f"{value:g}" if isinstance(value, float) else value for name, value in context}
    kind = finding["type"]
    if kind in _TAKEN:
        return _TAKEN[kind].format(**told)
    if kind.endswith(("_type", "_parsing")) and kind.rsplit("_", 1)[0] in _TYPES:
        return _TYPES[kind.rsplit("_", 1)[0]]
    return finding["msg"].removeprefix("Input should be ")


def _model_at(location: tuple[int | str, ...]) -> type[BaseModel]:
    """Return the model in which a key stands."""
    models: dict[int | str, type[BaseModel]] = {
        "observation": ObservationChannel,
        "action": ActionChannel,
        "action_map": ActionMap,
        "lidar": LidarSpecification,
        "frames": Frames,
        "overrides": Override,
        "when": Bound,
    }
    around = [models[part] for part in location[:-1] if part in models]
    return around[-1] if around else PolicySpecification


def _line(node: Any, location: tuple[int | str, ...]) -> int:
    """Return the 1-based line on which the deepest part of a field's location stands."""
    import yaml

    line = 1 if node is None else node.start_mark.line + 1
    for part in location:
        if isinstance(node, yaml.MappingNode):
            found = [(key, value) for key, value in node.value if key.value == str(part)]
            if not found:
                break
            key, node = found[0]
            line = key.start_mark.line + 1
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            node = node.value[part]
            line = node.start_mark.line + 1
        else:
            break
    return int(line)


def schema_json() -> str:
    """Return the JSON Schema of a specification, for editors."""
    return json.dumps(PolicySpecification.model_json_schema(), indent=2) + "\n"
