"""Colours of the verdicts: three that people with any colour vision tell apart (Okabe and Ito's set)."""

from __future__ import annotations

VERDICTS = ("safe", "unknown", "unsafe")
COLOUR = {"safe": "#0072B2", "unknown": "#E69F00", "unsafe": "#D55E00"}
STYLE = {"safe": "cyan", "unknown": "yellow", "unsafe": "red"}
"""Colours on a terminal, which may have 16 of its own choice."""

MEANING = {
    "safe": "proved",
    "unknown": "neither proved nor refuted",
    "unsafe": "a replayable counterexample exists",
}
