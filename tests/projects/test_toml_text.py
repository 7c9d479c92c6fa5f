"""TOML files: lines of fields, and values that are read back as they were."""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from viatool.toml_text import read_toml, toml_key, toml_value

TEXT = """\
policies = ["a.onnx"]

[defaults]
eps = 0.01

[[check]]
name = "drive" # the first
[check.gate]
fail-under = 0.9

[[check]]
"name" = "other"
gate.max-unsafe = 0
"""


def test_fields_are_found_on_their_lines(tmp_path: Path) -> None:
    path = tmp_path / "viatool.toml"
    path.write_text(TEXT, encoding="utf-8")
    document = read_toml(path)
    lines = {
        ("policies",): 1,
        ("defaults", "eps"): 4,
        ("check", 0): 6,
        ("check", 0, "name"): 7,
        ("check", 0, "gate", "fail-under"): 9,
        ("check", 1, "name"): 12,
        ("check", 1, "gate", "max-unsafe"): 13,
        ("check", 1, "matrix", "eps"): 11,  # the table around what has no line
    }
    assert {place: document.place(place) for place in lines} == {
        place: f"{path}:{line}" for place, line in lines.items()
    }


TEXTS = st.text(st.characters(exclude_categories=["Cs"]))
VALUES = st.recursive(
    st.one_of(
        st.booleans(),
        st.integers(-(2**62), 2**62),
        st.floats(allow_nan=False),
        TEXTS,
        st.dates(min_value=date(1000, 1, 1)),
    ),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(TEXTS, inner, max_size=3)),
    max_leaves=6,
)


@settings(deadline=None)  # the first write of a busy machine takes long
@given(st.dictionaries(TEXTS, VALUES, max_size=3))
def test_what_is_written_is_read_back(tmp_path_factory: Any, content: dict[str, Any]) -> None:
    path = tmp_path_factory.getbasetemp() / "written.toml"
    text = "".join(f"{toml_key(name)} = {toml_value(value)}\n" for name, value in content.items())
    path.write_bytes(text.encode("utf-8"))
    assert read_toml(path).content == content
