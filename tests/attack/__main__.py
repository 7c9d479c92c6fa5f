"""Attack random graphs: every value that a program gives must lie within the bounds of its box.

    python -m tests.attack --graphs 5000 --points 10000000 --seed 1 --workers 2 [--resume] [--journal FILE]
    python -m tests.attack --graph 83 --seed 1 [--minimise]

Graphs are numbered; the first command attacks them one after the other until enough of them have been attacked, and
the second one shows a single one: its text, how it ended and, with ``--minimise``, the fewest nodes with which the same
thing happens. The exit code is 1 if there is a finding: a value outside of its bounds, in onnxruntime or in exact
arithmetic, no number where bounds were given, an exception, or a mismatch in the self-check. Every line of the journal
is what came of one graph.
"""

from __future__ import annotations

import argparse
import datetime
import platform
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

from tests.attack.campaign import Campaign
from tests.attack.graphs import random_graph
from tests.attack.minimise import minimised
from tests.attack.strike import Effort, strike_in_memory


def main() -> int:
    given = arguments()
    if given.graph is not None:
        return show(given.graph, given.seed, given.minimise)
    effort = Effort.for_points(given.points / given.graphs, given.exact / given.graphs)
    campaign = Campaign(given.seed, effort, given.graphs, given.workers, given.journal)
    if not given.resume:
        given.journal.unlink(missing_ok=True)
    began = time.perf_counter()
    outcomes = []
    for outcome in campaign.run():
        outcomes.append(outcome)
        for finding in outcome["findings"]:
            print(f"graph {outcome['number']} ({outcome['kind']}, opset {outcome['opset']}): {finding['kind']}, "
                  f"by {finding['excess']:.3g}\n  {finding['detail']}\n"
                  f"  python -m tests.attack --graph {outcome['number']} --seed {given.seed}", flush=True)  # fmt: skip
        if len(outcomes) % 200 == 0:
            print(f"{len(outcomes)} graphs, {time.perf_counter() - began:.0f} s", flush=True)
    print(summary(outcomes, given.seed, time.perf_counter() - began))
    return 1 if any(outcome["findings"] for outcome in outcomes) else 0


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.attack", description=__doc__.splitlines()[0])
    parser.add_argument(
        "--graphs", type=int, default=5000, help="how many are attacked, refused ones not counted"
    )
    parser.add_argument(
        "--points", type=float, default=1e7, help="run by onnxruntime, in all graphs together"
    )
    parser.add_argument(
        "--exact", type=float, default=1e5, help="evaluated exactly or in 240 bits, in all graphs"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--journal", type=Path, default=Path("attack.jsonl"))
    parser.add_argument("--resume", action="store_true", help="go on after what the journal holds")
    parser.add_argument("--graph", type=int, help="attack one graph in this process and show it")
    parser.add_argument("--minimise", action="store_true")
    return parser.parse_args()


def show(number: int, seed: int, minimise: bool) -> int:
    """Attack one graph and print everything about it."""
    from onnx import printer

    graph = random_graph(number, seed)
    outcome = strike_in_memory(graph, Effort())
    if minimise and outcome.findings:
        graph = minimised(graph, outcome)
        outcome = strike_in_memory(graph, Effort())
    print(printer.to_text(graph.model))
    print({name: value for name, value in outcome.as_dict().items() if name != "findings"})
    for finding in outcome.findings:
        print(f"{finding.kind}, by {finding.excess:.3g}: {finding.detail}")
    return 1 if outcome.findings else 0


def summary(outcomes: list[dict[str, Any]], seed: int, seconds: float) -> str:
    """Return the counts of a run, in words."""
    import onnx
    import onnxruntime

    ended = Counter(outcome["ended"] for outcome in outcomes)
    attacked = [outcome for outcome in outcomes if outcome["ended"] == "attacked"]
    kinds = Counter(finding["kind"] for outcome in outcomes for finding in outcome["findings"])
    total = max(len(outcomes), 1)
    lines = [
        f"{datetime.date.today()}, seed {seed}, {platform.machine()}, onnxruntime {onnxruntime.__version__}, "
        f"onnx {onnx.__version__}, {seconds:.0f} s",
        f"{len(outcomes)} graphs: " + ", ".join(f"{count} {name}" for name, count in ended.most_common()),
        f"{sum(o['points'] for o in attacked)} points in {sum(o['boxes'] for o in attacked)} boxes by onnxruntime, "
        f"{sum(o['exact'] for o in attacked)} in exact arithmetic; "
        f"{sum(o['unbounded'] for o in outcomes)} boxes without finite bounds",
        f"{sum(o['gated'] for o in attacked)} graphs with a part behind a gate, "
        f"{sum(o['unchecked'] for o in attacked)} in which the self-check tells nothing; "
        + ", ".join(f"{count} {kind}" for kind, count in Counter(o["kind"] for o in attacked).most_common()),
        f"operators: {len({name for o in attacked for name in o['operators']})}; "
        f"opsets {min(o['opset'] for o in attacked)} to {max(o['opset'] for o in attacked)}"
        if attacked
        else "",
        f"findings: {dict(kinds) or 0}",
        "not attacked, by reason:",
    ]
    reasons = Counter((o["ended"], o["reason"]) for o in outcomes if o["reason"])
    lines += [f"  {count / total:6.2%}  {end}: {reason}" for (end, reason), count in reasons.most_common(40)]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
