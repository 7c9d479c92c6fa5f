"""The JSON Schema of a project file, with the options of the commands where they may stand: for editors."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import click

from viatool.projects.file import ProjectFile
from viatool.projects.options import Catalogue, options_of


def project_schema(catalogue: Catalogue) -> dict[str, Any]:
    """Return the schema; keys that it does not know are refused, as `load_project` and `expand` do."""
    schema = ProjectFile.model_json_schema(by_alias=True)
    options = {
        name: option
        for command in catalogue.commands.values()
        for name, option in options_of(command).items()
    }
    gate = _properties({name: option for name, option in options.items() if name in catalogue.gate})
    all_of_them = _properties(options)
    parts, top = schema["$defs"], schema["properties"]
    parts["CheckTable"]["properties"]["kind"]["enum"] = list(catalogue.commands)
    parts["CheckTable"]["properties"]["gate"] |= {"properties": gate, "additionalProperties": False}
    axes = {name: {"type": "array", "minItems": 1} for name in all_of_them}
    parts["CheckTable"]["properties"]["matrix"] |= {"properties": axes, "additionalProperties": False}
    for name in ("CheckTable", "FileEntry"):
        parts[name]["properties"] |= all_of_them
        parts[name]["additionalProperties"] = False
    gates = {"gate": {"type": "object", "properties": gate, "additionalProperties": False}}
    top["defaults"] |= {"properties": all_of_them | gates, "additionalProperties": False}
    return schema


def _properties(options: dict[str, click.Option]) -> dict[str, Any]:
    return {
        name: {"type": list(_types(option)), "description": " ".join((option.help or "").split())}
        for name, option in options.items()
    }


def _types(option: click.Option) -> Iterable[str]:
    if option.is_flag:
        return ("boolean",)
    tables = ("object",) if option.multiple else ()
    return ("string", "number", "array", *tables)
