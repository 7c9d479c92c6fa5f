"""What exporters write beside a network: the terms of its observation and the joints of its action.

Isaac Lab and mjlab write lists into the metadata of the ONNX file, comma-separated; projects of one's own write them as
JSON into ``policy_contract.json`` beside it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viatool.errors import PolicyError

CONTRACT = "policy_contract.json"

_LARGEST = 1e300

_CHANGE = "export the policy again, or write its specification by hand, see docs/specification.md"


@dataclass(frozen=True)
class ObservationTerm:
    """One part of an observation.

    Parameters
    ----------
    name : str
        As the exporter writes it.
    size : int or None
        Of one frame; None where nothing says it.
    scale : float
        With which its numbers are multiplied.
    clip : tuple of float, optional
        To which they are clipped, before they are scaled.
    history : int
        Frames of it; 1 for the present alone.
    """

    name: str
    size: int | None = None
    scale: float = 1.0
    clip: tuple[float, float] | None = None
    history: int = 1


@dataclass(frozen=True)
class Stated:
    """What an exporter states of a policy.

    Parameters
    ----------
    where : str
        The file, and the entry of it, for messages.
    terms : tuple of ObservationTerm
        Of the observation, in order.
    actions : tuple of mapping
        What is stated of each output: name, scale, offset, lower, upper.
    joints : tuple of str
        Names of what is moved.
    interval : float, optional
        Seconds between two actions.
    """

    where: str
    terms: tuple[ObservationTerm, ...]
    actions: tuple[Mapping[str, Any], ...] = ()
    joints: tuple[str, ...] = ()
    interval: float | None = None


def stated_in_metadata(entries: Mapping[str, str], path: Path) -> Stated | None:
    """Return what the metadata of an ONNX file state; None where it names no terms.

    Raises
    ------
    PolicyError
        If its lists contradict each other.
    """
    if "observation_names" not in entries:
        return None
    where = f"{path}: metadata"
    names = _list(entries["observation_names"])
    scales = _numbers(entries, "observation_terms_scale", "observation_terms_scales", where=where)
    history = _numbers(entries, "observation_terms_history_length", where=where)
    clips = [_clip(text, where) for text in _list(entries.get("observation_terms_clip", ""))]
    for key, values in (
        ("observation_terms_scale", scales),
        ("observation_terms_history_length", history),
        ("observation_terms_clip", clips),
    ):
        if values and len(values) != len(names):
            raise PolicyError(
                f"{where}: observation_names has {len(names)} terms, but {key} has {len(values)}", _CHANGE
            )
    terms = tuple(
        ObservationTerm(
            name,
            scale=scales[index] if scales else 1.0,
            clip=clips[index] if clips else None,
            history=max(1, int(history[index])) if history else 1,
        )
        for index, name in enumerate(names)
    )
    joints = _list(entries.get("joint_names", ""))
    scale = _numbers(entries, "action_scale", where=where)
    count = len(joints) if len(scale) == 1 else len(scale)
    if joints and count not in (0, len(joints)):
        raise PolicyError(
            f"{where}: joint_names has {len(joints)} names, but action_scale has {len(scale)} numbers",
            _CHANGE,
        )
    actions: list[dict[str, Any]] = [{"name": name} for name in joints] or [{} for _ in range(count)]
    for index, action in enumerate(actions):
        if scale:
            action["scale"] = scale[0] if len(scale) == 1 else scale[index]
    return Stated(where, terms, tuple(actions), tuple(joints))


def stated_in_contract(path: Path) -> Stated | None:
    """Return what a ``policy_contract.json`` states; None where there is none.

    Raises
    ------
    PolicyError
        If it is no JSON object, or lists no observation.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError) as error:
        raise PolicyError(f"cannot read {path}: {error}", "give a JSON file") from error
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise PolicyError(f"{path} is not JSON: {error}", "correct it, or move it away") from error
    if not isinstance(content, dict):
        raise PolicyError(f"{path} holds a {type(content).__name__}, where an object is expected", _CHANGE)
    if "observation_names" in content:  # the lists of the metadata, as JSON
        lists = {
            key: ",".join(map(_text, value)) if isinstance(value, list) else str(value)
            for key, value in content.items()
        }
        return stated_in_metadata(lists, path)
    parts = _entry(content, "observations", "observation")
    if not isinstance(parts, list) or not all(isinstance(part, dict) for part in parts) or not parts:
        raise PolicyError(
            f"{path}: 'observations' is missing, where a list of objects with `name` and `size` is expected",
            _CHANGE,
        )
    actions = _entry(content, "actions", "action") or []
    if not isinstance(actions, list) or not all(isinstance(action, dict) for action in actions):
        raise PolicyError(f"{path}: 'actions' is no list of objects with `name` and `scale`", _CHANGE)
    interval = _entry(content, "control_interval", "control_dt", "dt")
    return Stated(
        str(path),
        tuple(_term(part, path) for part in parts),
        tuple(actions),
        interval=float(interval) if is_number(interval) and interval > 0 else None,
    )


def _term(part: Mapping[str, Any], path: Path) -> ObservationTerm:
    name = part.get("name")
    size, history = _entry(part, "size", "dim", "shape"), _entry(part, "history_length", "history") or 1
    size = math.prod(size) if isinstance(size, list) and all(isinstance(n, int) for n in size) else size
    scale, clip = part.get("scale", 1.0), part.get("clip")
    fits = (
        isinstance(name, str)
        and (size is None or (isinstance(size, int) and size > 0))
        and isinstance(history, int)
        and is_number(scale)
        and (clip is None or (isinstance(clip, list) and len(clip) == 2 and all(map(is_number, clip))))
    )
    if not fits:
        raise PolicyError(
            f"{path}: observations: {json.dumps(dict(part))[:200]} is no term: "
            "`name`, `size`, a number as `scale`, [low, high] as `clip`, `history_length` are expected",
            _CHANGE,
        )
    return ObservationTerm(
        str(name), size, float(scale), None if clip is None else (clip[0], clip[1]), max(1, history)
    )


def is_number(value: Any) -> bool:
    """Tell whether a value of a file is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _LARGEST


def _text(value: Any) -> str:
    return ";".join(map(str, value)) if isinstance(value, list) else str(value)


def _entry(content: Mapping[str, Any], *names: str) -> Any:
    return next((content[name] for name in names if name in content), None)


def _list(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _numbers(entries: Mapping[str, str], *keys: str, where: str) -> list[float]:
    key = next((key for key in keys if key in entries), None)
    if key is None:
        return []
    try:
        numbers = [float(part) for part in _list(entries[key])]
    except ValueError:
        numbers = [math.nan]
    if not all(map(is_number, numbers)):
        raise PolicyError(
            f"{where}: {key} is '{entries[key][:100]}', where finite numbers between commas are expected",
            _CHANGE,
        )
    return numbers


def _clip(text: str, where: str) -> tuple[float, float] | None:
    try:
        low, high = (float(part) for part in text.split(";"))
    except ValueError as error:
        raise PolicyError(
            f"{where}: observation_terms_clip holds '{text}', where low;high is expected", _CHANGE
        ) from error
    return None if math.isinf(low) and math.isinf(high) else (low, high)
