"""Is a specification right? The policy is read in other plausible ways, and driven or compared with a recording."""

from __future__ import annotations

from viatool.doctor import commands, scales, scans  # noqa: F401  # registered by being imported
