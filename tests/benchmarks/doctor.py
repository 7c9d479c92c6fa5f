"""How often `viatool doctor` finds what is said wrong of a policy that drives well: a row for each planted mistake.

    python -m tests.benchmarks.doctor --scenarios 60
    python -m tests.benchmarks.doctor --policy actor.onnx --spec right.yaml --map stage.yaml

The first line is about via in the layouts of `tests/doctor/layouts.py`, the second about a policy of others of which
the right specification is known.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from tests.doctor.layouts import LAYOUTS, Layout, plants
from viatool.doctor import Diagnosis, Driven, diagnose, scenarios_of
from viatool.doctor.interpretation import Interpretation
from viatool.policy import Policy, PolicySpecification, load_policy, load_specification
from viatool.world import load_map


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--scenarios", type=int, default=60)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--horizon", type=int)
    options.add_argument("--policy", type=Path)
    options.add_argument("--spec", type=Path)
    options.add_argument("--map", default="lab")
    given = options.parse_args()
    world_map = load_map(given.map)
    scenarios = scenarios_of(world_map, given.scenarios, given.seed)
    print("| layout | said wrong | goals as specified | goals at best | named | right | readings | seconds |")
    print("|---|---|---|---|---|---|---|---|")
    found = planted = 0
    for layout, policy in subjects(given.policy, given.spec):
        for what, spec in [("nothing", layout.spec), *plants(layout)]:
            if what != "nothing" and means_the_same(spec, layout):
                continue
            begun = time.perf_counter()
            diagnosis = diagnose(
                replace(policy, spec=spec), world_map, scenarios, seed=given.seed, horizon=given.horizon
            )
            seconds = time.perf_counter() - begun
            best = diagnosis.ranking.best.interpretation
            right = means_the_same(best.spec, layout)
            if what != "nothing":
                found, planted = found + (right and diagnosis.verdict == "another"), planted + 1
            print(
                f"| {layout.name} | {what} | {goals(diagnosis, 'specified')} | {goals(diagnosis, 'best')} | "
                f"{best.name} | {'yes' if right else 'no'} | {len(diagnosis.ranking.examined)} | {seconds:.0f} |",
                flush=True,
            )
    print(f"\nfound and named: {found} of {planted}")


def subjects(path: Path | None, spec: Path | None) -> Iterator[tuple[Layout, Policy]]:
    """Yield layouts and policies in them."""
    if path is not None and spec is not None:
        told = load_specification(spec).model_dump(mode="json", exclude_none=True)
        yield Layout(path.stem, told["observation"], told["action"], []), load_policy(path, spec)
        return
    with tempfile.TemporaryDirectory() as folder:
        for layout in LAYOUTS:
            yield layout, load_policy(layout.write(Path(folder)))


def goals(diagnosis: Diagnosis, name: str) -> str:
    evidence = getattr(diagnosis.ranking, name).evidence
    assert isinstance(evidence, Driven)
    share = evidence.share("success")
    return f"{share.count}/{share.total}"


def means_the_same(spec: PolicySpecification, layout: Layout) -> bool:
    return Interpretation(spec).meaning == Interpretation(layout.spec).meaning


if __name__ == "__main__":
    main()
