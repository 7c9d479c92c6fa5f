"""How often `viatool doctor` finds what is said wrong of a policy that drives well: a row for each planted mistake.

Run: python -m tests.benchmarks.doctor [SCENARIOS] [SEED] [WORKERS]
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from tests.doctor.layouts import LAYOUTS, Layout, plants
from viatool.doctor import Diagnosis, Driven, diagnose, scenarios_of
from viatool.doctor.interpretation import Interpretation
from viatool.policy import PolicySpecification, load_policy
from viatool.world import load_map


def goals(diagnosis: Diagnosis, name: str) -> str:
    evidence = getattr(diagnosis.ranking, name).evidence
    assert isinstance(evidence, Driven)
    share = evidence.share("success")
    return f"{share.count}/{share.total}"


def means_the_same(spec: PolicySpecification, layout: Layout) -> bool:
    return Interpretation(spec).meaning == Interpretation(layout.spec).meaning


def main(count: int = 60, seed: int = 0, workers: int = 1) -> None:
    world_map = load_map("lab")
    scenarios = scenarios_of(world_map, count, seed)
    print("| layout | said wrong | as specified | best | named | right | readings | seconds |")
    print("|---|---|---|---|---|---|---|---|")
    found = planted = 0
    with tempfile.TemporaryDirectory() as folder:
        for layout in LAYOUTS:
            policy = load_policy(layout.write(Path(folder)))
            for what, spec in [("nothing", layout.spec), *plants(layout)]:
                if what != "nothing" and means_the_same(spec, layout):
                    continue
                begun = time.perf_counter()
                diagnosis = diagnose(
                    replace(policy, spec=spec), world_map, scenarios, seed=seed, workers=workers
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


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
