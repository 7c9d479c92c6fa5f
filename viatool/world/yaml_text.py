"""YAML with line numbers: read a document, and find the line on which a field of it stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from viatool.errors import MapError

_IMAGES = (b"\x89PNG", b"\xff\xd8\xff", b"P5", b"P6", b"BM", b"GIF8", b"II*\x00", b"MM\x00*")
"""How files of images begin: PNG, JPEG, binary PGM and PPM, BMP, GIF, TIFF."""


@dataclass(frozen=True, eq=False)
class YamlDocument:
    """A parsed file.

    Parameters
    ----------
    path : Path
        Where it was read.
    content : object
        What it holds.
    root : yaml.Node, optional
        The same with the places in the text.
    """

    path: Path
    content: Any
    root: yaml.Node | None

    def place(self, location: Sequence[str | int]) -> str:
        """Return "file:line" of a field, or of the innermost mapping around it that exists."""
        node = self.root
        if node is None:
            return str(self.path)
        line = node.start_mark.line
        for step in location:
            found = _child(node, step)
            if found is not None:  # steps that only name a variant of a model are not in the file
                line, node = found
        return f"{self.path}:{line + 1}"


def read_yaml(path: Path, text: bytes) -> YamlDocument:
    """Parse one YAML document.

    Raises
    ------
    MapError
        If it is not UTF-8 text, not YAML, or says the same key twice in a mapping.
    """
    try:
        loader = yaml.SafeLoader(text.decode("utf-8"))
    except (UnicodeDecodeError, yaml.reader.ReaderError) as error:
        if text.startswith(_IMAGES):
            raise MapError(
                f"{path}: is an image, not the YAML of a map",
                "give the YAML that map_server wrote beside it, or make one with viatool init --map IMAGE "
                "--resolution METRES",
            ) from error
        raise MapError(f"{path}: is not a UTF-8 text file ({error})", "save it as YAML in UTF-8") from error
    try:
        root = loader.get_single_node()
        if root is None:
            return YamlDocument(path, None, None)
        _refuse_repeated_keys(path, root)
        return YamlDocument(path, loader.construct_document(root), root)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{path}:{mark.line + 1}" if mark else str(path)
        tab = "'\\t'" in (error.problem or "")
        hint = (
            "indent with spaces, not with tabs"
            if tab
            else "correct the syntax of this line or of those before it"
        )
        raise MapError(f"{place}: is not YAML: {error.problem}", hint) from error
    except (ValueError, TypeError, RecursionError) as error:
        raise MapError(f"{path}: is not YAML: {error}", "correct the syntax of the file") from error
    finally:
        loader.dispose()


def _child(node: yaml.Node, step: str | int) -> tuple[int, yaml.Node] | None:
    """Return the line and the node of a key or an index."""
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if key.value == step:
                return key.start_mark.line, value
    if isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
        value = node.value[step]
        return value.start_mark.line, value
    return None


def _refuse_repeated_keys(path: Path, root: yaml.Node) -> None:
    """Refuse mappings that say a key twice, of which YAML would silently keep the last."""
    pending, seen = [root], set()
    while pending:
        node = pending.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        if isinstance(node, yaml.SequenceNode):
            pending.extend(node.value)
        elif isinstance(node, yaml.MappingNode):
            keys: set[str] = set()
            for key, value in node.value:
                if isinstance(key, yaml.ScalarNode) and key.value in keys:
                    raise MapError(
                        f"{path}:{key.start_mark.line + 1}: '{key.value}' appears twice in one mapping",
                        "remove one of them",
                    )
                keys.add(str(key.value))
                pending.append(value)
