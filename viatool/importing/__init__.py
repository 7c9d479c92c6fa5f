"""Models that were saved by other frameworks: read without running their pickles, written as ONNX."""

from __future__ import annotations

from viatool.importing.importer import Imported, ImportRequest, import_policy

__all__ = ["ImportRequest", "Imported", "import_policy"]
