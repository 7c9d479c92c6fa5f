"""A criterion for robots whose next command may be lost: every command is held for two intervals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tests.hall import MAP, write_policy
from tests.motion.toys import integrated
from viatool import load_map, load_policy, verify
from viatool.cli import main
from viatool.errors import ConfigurationError
from viatool.places import Resolution, certify
from viatool.world import Scenes

FILES = {
    "viatool/setting/criteria.py": {
        "SAMPLED = Sampled()\n": '''\
class Twice(Swept):
    """Every command is held for two intervals."""

    name = "twice"
    meaning = "every action of the reachable box and every instant of two control intervals"

    def path(self, held: Manoeuvre, deceleration: float, footprint: Footprint) -> Manoeuvre:
        """Return two intervals."""
        return replace(held, interval=2.0 * held.interval)


SAMPLED = Sampled()
''',
        "(Swept(), SAMPLED, Braking())": "(Swept(), SAMPLED, Braking(), Twice())",
    }
}


def check(folder: Path) -> None:
    policy, path = write_policy(folder / "policy.onnx"), folder / "map.yaml"
    path.write_text(MAP, encoding="utf-8")
    world = load_map(path)
    once, twice = (verify(policy, world, eps=0.01, criterion=name) for name in ("swept", "twice"))
    safe = twice.verdict == "safe"
    assert 10 < safe.sum() < (once.verdict == "safe").sum()
    assert (twice.judgement.sampled == once.judgement.sampled).all()
    generator, scenes = np.random.default_rng(0), Scenes.of(world, world.scenarios)
    seen = twice.trajectory.observations[safe]
    poses, scene = twice.trajectory.poses[safe], twice.trajectory.episode[safe]
    for share in np.linspace(0.0, 1.0, 11):
        noisy = seen + generator.uniform(-0.01, 0.01, seen.shape) * (
            np.arange(seen.shape[1]) < seen.shape[1] - 1
        )
        commands = np.clip(load_policy(policy)(noisy), (0.0, -1.0), (0.5, 1.0))
        ends = integrated("differential", poses, commands, np.full(len(poses), 0.2 * share), 1)
        assert (scenes.clearance(ends[:, :2], scene) > world.clearance.collision - 1e-6).all()

    asked = ["verify", str(policy), "--map", str(path), "--eps", "0.01", "--criterion", "twice"]
    done = CliRunner().invoke(main, [*asked, "--output", f"json:{folder / 'report.json'}"])
    assert done.exit_code == 0, done.output
    assert "twice: every action of the reachable box" in " ".join(done.output.split())
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert report["criterion"] == "twice"
    assert report["verdicts"]["safe"] == safe.sum()

    certificate = certify(policy, world, 0, eps=0.01, criterion="twice", resolution=Resolution(0.5, 0))
    assert certificate.rules.criterion == "twice"
    with pytest.raises(ConfigurationError) as refused:
        certify(policy, world, 0, eps=0.01, criterion="sampled")
    assert refused.value.hint == "choose swept or braking or twice"
