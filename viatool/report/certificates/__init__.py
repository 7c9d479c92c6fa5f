"""Reports of certified places: one certificate, many reporters."""

from __future__ import annotations

CERTIFICATE_REPORTERS = {
    name: f"viatool.report.certificates.{name}"
    for name in (
        "json",
        "figure",
        "html",
        "csv",
        "cells",
        "witnesses",
        "markdown",
        "junit",
        "sarif",
        "github",
    )
}
"""Format name to the module that renders it; imported when it is asked for."""
