"""How much error every contested state survives: the largest that is proved safe, the smallest that is refuted."""

from __future__ import annotations

from viatool.margins.job import margin

__all__ = ["margin"]
