"""The documentation names every option, with its default and what the presets change."""

from __future__ import annotations

from pathlib import Path

import yaml

from viatool.train import PRESETS, TrainingConfiguration
from viatool.train.methods import METHODS


def option_table() -> str:
    """Return the table of docs/training.md; run this file to print it."""
    lines = ["| option | default | meaning |", "|---|---|---|"]
    for name, option in TrainingConfiguration.model_fields.items():
        changed = [
            f"{preset}: {plain(PRESETS[preset][name])}" for preset in PRESETS if name in PRESETS[preset]
        ]
        default = f"{plain(option.default)} ({', '.join(changed)})" if changed else plain(option.default)
        lines.append(f"| `{name}` | {default} | {option.description} |")
    return "\n".join(lines) + "\n"


def plain(value: object) -> str:
    text = yaml.safe_dump(list(value) if isinstance(value, tuple) else value, default_flow_style=True)
    return text.replace("...", "").strip()


def test_every_option_stands_in_the_documentation() -> None:
    assert option_table() in Path("docs/training.md").read_text(encoding="utf-8")


def test_every_method_has_its_section() -> None:
    page = Path("docs/methods.md").read_text(encoding="utf-8")
    for name in METHODS:
        assert f"\n## {name}\n" in page
        assert f"| `{name}` |" in page


if __name__ == "__main__":
    print(option_table(), end="")
