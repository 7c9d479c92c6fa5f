"""The command group."""

from __future__ import annotations

import click


@click.group()
def main() -> None:
    """Prove how safe an exported navigation policy drives."""
