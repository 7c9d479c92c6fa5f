"""What has to be written in a specification so that it says something else, key by key."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from viatool.policy import PolicySpecification

_NAMED = ("observation", "action")
"""Lists whose entries have names."""


@dataclass(frozen=True)
class Edit:
    """One key of a specification.

    Parameters
    ----------
    key : str
        Its path, channels by their names: ``observation.lidar.lidar.order``.
    now : str
        What to write, as YAML; empty where the key is to be left out.
    was : str
        What stands there; empty where nothing does.
    """

    key: str
    now: str
    was: str

    def __str__(self) -> str:
        """Return the edit in words."""
        if not self.now:
            return f"leave out {self.key} (was {self.was})"
        return f"{self.key}: {self.now}" + (f" (was {self.was})" if self.was else "")


def edits(before: PolicySpecification, after: PolicySpecification) -> tuple[Edit, ...]:
    """Return what has to be changed in one specification so that it says what another one does."""
    was, now = _keys(before), _keys(_as_old_as(before, after))
    return tuple(
        Edit(key, now.get(key, ""), was.get(key, ""))
        for key in dict.fromkeys([*now, *was])
        if now.get(key) != was.get(key)
    )


def _as_old_as(before: PolicySpecification, after: PolicySpecification) -> PolicySpecification:
    """Return the second specification in the version of the first, if that can say it."""
    if before.schema_version == after.schema_version or before.action_map is not None:
        return after
    try:
        return PolicySpecification.model_validate(
            {**after.model_dump(mode="json", exclude_none=True), "schema_version": before.schema_version}
        )
    except ValidationError:
        return after


def _keys(spec: PolicySpecification) -> dict[str, str]:
    content = spec.model_dump(mode="json", exclude_none=True)
    found = {"schema_version": str(content["schema_version"])}
    for name in _NAMED:
        entries = content.pop(name)
        found[f"{name} (order)"] = ", ".join(entry["name"] for entry in entries)
        for entry in entries:
            found |= dict(_flat(f"{name}.{entry.pop('name')}", entry))
    return found | dict(_flat("", content))


def _flat(path: str, content: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for key, value in content.items():
        full = f"{path}.{key}" if path else key
        if isinstance(value, Mapping):
            yield from _flat(full, value)
        else:
            yield full, _yaml(value)


def _yaml(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.9g}"
    if isinstance(value, list):
        return f"[{', '.join(map(_yaml, value))}]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_yaml(part)}" for key, part in value.items()) + "}"
    return str(value)
