"""What took effect, and where it came from: the premises on which every verdict rests."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Premise:
    """One value that took effect.

    Parameters
    ----------
    name : str
        What it is of, such as ``control interval``.
    value : str
        As a person reads it, with its unit.
    source : str
        Who said so: an option, a file, or a default.
    """

    name: str
    value: str
    source: str

    def to_json(self) -> dict[str, str]:
        """Return the form that a report JSON holds."""
        return {"name": self.name, "value": self.value, "source": self.source}
