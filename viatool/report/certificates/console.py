"""A certificate on the console: what a person reads when the search ends."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from viatool.report.certificates.document import CertificateDocument, Share
from viatool.report.console import print_checks
from viatool.report.foreign import shown
from viatool.report.gate import Check
from viatool.report.numbers import count, percentage, seconds, significant
from viatool.report.palette import STYLE
from viatool.report.wording import describe_eps

_STYLES = {"certified": STYLE["safe"], "unknown": STYLE["unknown"], "refuted": STYLE["unsafe"]}
MEANING = {
    "uncontested": "no admissible command endangers a pose",
    "certified": "proved for every pose, observation and command before",
    "refuted": "holds a replayable counterexample",
    "unknown": "neither, at the smallest size",
}


def print_certificate(document: CertificateDocument, console: Console, checks: Sequence[Check] = ()) -> None:
    """Print a certificate and the decided conditions of its gate."""
    console.print(Text(shown(headline(document)), style="bold"))
    console.print(Text(shown(_setting(document)), style="dim"))
    console.print()
    volumes = Table.grid(padding=(0, 2))
    for (name, cells, volume), meaning in zip(rows_of_volumes(document), MEANING.values(), strict=True):
        style = _STYLES.get(name, "")
        volumes.add_row(
            Text(name, style=style), f"{volume} m² rad", f"{cells} cells", Text(meaning, style="dim")
        )
    console.print(volumes)
    console.print()
    rates = Table.grid(padding=(0, 2))
    for row in rows_of_rates(document):
        rates.add_row(*row)
    console.print(rates)
    later = rows_over_time(document)
    if later:
        console.print()
        lasting = Table.grid(padding=(0, 2))
        for line in later:
            lasting.add_row(*line)
        console.print(lasting)
    worst = rows_of_worst(document)
    if worst:
        console.print()
        table = Table.grid(padding=(0, 2))
        table.add_row(
            *(Text(text, style="dim") for text in ("worst places", "after", "commands", "comes within"))
        )
        for place in worst:
            table.add_row(*place)
        console.print(table)
    if checks:
        console.print()
        print_checks(checks, console)


def headline(document: CertificateDocument) -> str:
    """Say in a line what was found."""
    rate = document.contested_rate
    text = what_is_certified(document)
    return text if rate.total == 0 else f"{percentage(rate.part, rate.total)} {text}"


def what_is_certified(document: CertificateDocument) -> str:
    """Say what the rate of the headline is of, or that nothing is contested."""
    roots = document.roots
    text = "of the contested volume is certified" if document.contested_rate.total else "no pose is contested"
    if roots.examined < roots.total:
        text += f", in a random {percentage(roots.examined, roots.total)} of the map"
    return text


def _setting(document: CertificateDocument) -> str:
    stop = "" if document.deceleration is None else f" at {document.deceleration:g} m/s²"
    late = f"delay {document.delay:g} s, " if document.delay else ""
    goal = ", ".join(f"{number:g}" for number in document.scenario.goal)
    return (
        f"{document.policy.path} on {document.map.path}, {document.scenario.name}, goal ({goal}), "
        f"eps {describe_eps(document.eps)}, {document.criterion}{stop}, {late}{document.arithmetic}, "
        f"{seconds(sum(document.seconds.values()))}"
    )


def rows_of_volumes(document: CertificateDocument) -> list[tuple[str, str, str]]:
    """Return status, cells and volume of what is free."""
    return [
        (name, count(getattr(document.cells, name)), significant(getattr(document.volume, name)))
        for name in MEANING
    ]


def rows_of_rates(document: CertificateDocument) -> list[tuple[str, str]]:
    """Return the shares in words."""

    def row(name: str, share: Share) -> tuple[str, str]:
        return name, percentage(share.part, share.total)

    return [
        row("contested volume that is certified", document.contested_rate),
        row("contested volume that is decided", document.decided_rate),
        row("free volume that is safe", document.free_rate),
    ]


def rows_over_time(document: CertificateDocument) -> list[tuple[str, str, str]]:
    """Return what holds beyond the next action: the condition, its volume and its share; few of many steps."""
    later = document.over_time
    if later is None:
        return []
    unit = later.volume.free / max(later.forever.total if later.forever else later.steps[0].total, 1)
    few = {1, 2, 5} if len(later.steps) > 3 else {1, 2, 3}
    rows = [
        (f"certified for {step.steps} {'step' if step.steps == 1 else 'steps'}", step)
        for step in later.steps
        if step.steps in few or step.steps % 10 == 0 or step.steps == len(later.steps)
    ]
    shares: list[tuple[str, Share]] = [*rows]
    if later.forever is not None:
        shares.append(("for ever, or until the goal is reached", later.forever))
    return [
        (
            name,
            f"{significant(share.part * unit)} m² rad",
            f"{percentage(share.part, share.total)} of the free volume",
        )
        for name, share in shares
    ]


def rows_of_worst(document: CertificateDocument) -> list[tuple[str, str, str, str]]:
    """Return the worst places: pose, command before, command, clearance."""
    return [
        (
            f"({place.pose[0]:.2f}, {place.pose[1]:.2f}, {place.pose[2]:.2f} rad)",
            f"{place.previous[0]:.2f} m/s {place.previous[1]:+.2f} rad/s",
            f"{place.action[0]:.3f} m/s {place.action[1]:+.3f} rad/s",
            f"{place.clearance:.3f} m after {place.seconds:.2f} s",
        )
        for place in document.worst
    ]
