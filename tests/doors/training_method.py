"""A method that pays a fixed price for every cost."""

from __future__ import annotations

import csv
from pathlib import Path

from tests.train.test_run import TINY
from viatool.train import make_configuration, train

FILES = {
    "viatool/train/methods/NAME.py": '''\
"""A fixed price for every cost, without a constraint."""

from __future__ import annotations

from torch import Tensor

from viatool.train.methods.td3 import Td3
from viatool.train.replay import Batch


class Priced(Td3):
    """Every cost lowers the reward by as much as the limit allows in an episode."""

    def learnt_reward(self, batch: Batch, multiplier: Tensor) -> Tensor:
        """Return the reward less the cost."""
        return batch.reward - self.options.cost_limit * batch.cost
''',
    "viatool/train/methods/__init__.py": {
        "from viatool.train.methods.rcpo import": "from viatool.train.methods.priced import Priced\n"
        "from viatool.train.methods.rcpo import",
        '    "via": Via,\n': '    "via": Via,\n    "priced": Priced,\n',
    },
    "viatool/train/configuration.py": {'"cvar-cpo", "via"]': '"cvar-cpo", "via", "priced"]'},
}
NAME = "priced"


def check(folder: Path) -> None:
    options = TINY | {"method": "priced", "epochs": 1, "seeds": 1, "tensorboard": False}
    result = train(make_configuration("quick", None, (), **options), folder / "run")
    assert result.policy.spec.training["method"] == "priced"
    with (result.run_directory / "metrics.csv").open(newline="", encoding="utf-8") as stream:
        (row,) = csv.DictReader(stream)
    assert float(row["multiplier"]) == 0.0
    assert int(row["updates"]) > 10
