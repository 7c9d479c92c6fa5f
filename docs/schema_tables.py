"""Turn a JSON Schema into tables: one for each mapping, with the type, the default and the meaning of its fields."""

from __future__ import annotations

import json
from typing import Any

Schema = dict[str, Any]
_HEAD = ("field", "type", "default", "meaning")
_FEW = 12
"""Fields that a line names, where none has a meaning of its own."""


def schema_tables(schema: Schema, title: str) -> str:
    """Return a section of Markdown: the whole document first, then every part that it is made of."""
    parts = {title: schema, **schema.get("$defs", {})}
    return "\n".join(
        _table(name, part, 2 if part is schema else 3) for name, part in parts.items() if "properties" in part
    )


def _table(title: str, part: Schema, level: int) -> str:
    """Return a table; a line that names the fields, where they are few and have no meaning of their own."""
    rows = []
    for field, about in part["properties"].items():
        star = "\\*" if field in part.get("required", []) else ""
        rows.append((f"`{field}`{star}", _type(about), _default(about), about.get("description", "")))
    lines = [f"{'#' * level} {title}", "", *_summary(part)]
    if len(rows) <= _FEW and not any(meaning for *_, meaning in rows):
        told = (f"{name} {kind}{default and f' = {default}'}" for name, kind, default, _ in rows)
        return "\n".join([*lines, f"{'; '.join(told)}."]) + "\n"
    columns = [column for column in zip(_HEAD, *rows, strict=True) if any(column[1:])]
    head, *body = zip(*columns, strict=True)
    table = [head, ["---"] * len(columns), *body]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in table)]) + "\n"


def _summary(part: Schema) -> list[str]:
    text = part.get("description", "").partition("\n\n")[0]
    return [" ".join(text.split()), ""] if text else []


def _default(about: Schema) -> str:
    value = about.get("default")
    if isinstance(value, dict):
        value = {name: part for name, part in value.items() if part is not None}
    return "" if value is None or value in ({}, []) else f"`{json.dumps(value)}`"


def _type(about: Schema) -> str:
    """Return a type in words."""
    if "$ref" in about:
        return about["$ref"].rpartition("/")[2]
    for choice in ("anyOf", "oneOf"):
        if choice in about:
            options = [_type(option) for option in about[choice] if option.get("type") != "null"]
            return " or ".join(dict.fromkeys(options))
    if "const" in about:
        return f"`{about['const']}`"
    if "enum" in about:
        return ", ".join(f"`{value}`" for value in about["enum"])
    if about.get("type") == "array":
        return _array(about)
    if about.get("type") == "object":
        values = about.get("additionalProperties")
        return f"mapping to {_type(values)}" if isinstance(values, dict) else "mapping"
    return f"{about.get('type', 'anything')}{_limits(about)}"


def _array(about: Schema) -> str:
    if "prefixItems" in about:
        return f"[{', '.join(_type(item) for item in about['prefixItems'])}]"
    least = f", at least {about['minItems']}" if "minItems" in about else ""
    return f"list of {_type(about.get('items', {}))}{least}"


def _limits(about: Schema) -> str:
    words = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    found = [f"{sign} {about[key]:g}" for key, sign in words.items() if key in about]
    return f" {', '.join(found)}" if found else ""
