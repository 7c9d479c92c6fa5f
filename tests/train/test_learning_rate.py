"""The learning rate falls linearly from the first update of a run to its last, over all epochs."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.train.test_run import tiny
from viatool.train import epoch, train
from viatool.train.agent import Learner


def rates(fraction: float, **options: object) -> list[float]:
    """The learning rates of the updates of one step of the robots."""
    seen: list[float] = []

    def update(multiplier: Any, rate: float, *, measure: bool) -> dict[str, Any]:
        seen.append(rate)
        return {}

    learner = SimpleNamespace(replay=SimpleNamespace(size=100), updates=0, update=update)
    run: Any = SimpleNamespace(configuration=tiny(**options), learner=learner, multiplier=np.zeros(2), due=0)
    epoch._learn(run, fraction, 1, [])
    return seen


@pytest.mark.parametrize(("fraction", "part"), [(0.0, 1.0), (0.25, 0.8), (0.5, 0.6), (1.0, 0.2)])
def test_it_is_a_line_to_its_end(fraction: float, part: float) -> None:
    np.testing.assert_allclose(
        rates(fraction, learning_rate=1e-2, final_learning_rate=0.2), [part * 1e-2] * 2, rtol=1e-12
    )


def test_it_stays_where_its_end_is_its_beginning() -> None:
    assert rates(0.7, learning_rate=1e-2, final_learning_rate=1.0) == [1e-2, 1e-2]


def test_nothing_is_learnt_before_there_is_something_to_learn_from() -> None:
    assert rates(0.5, learning_starts=101) == []


def test_a_run_ends_at_its_final_learning_rate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three epochs of 25 steps: the last step but none to come is 74 / 75 of the way."""
    seen: list[float] = []
    right = Learner.update

    def update(learner: Learner, multiplier: Any, rate: float, **options: Any) -> Any:
        seen.append(rate)
        return right(learner, multiplier, rate, **options)

    monkeypatch.setattr(Learner, "update", update)
    options = tiny(seeds=1, learning_rate=1e-3, final_learning_rate=0.1, tensorboard=False)
    train(options, tmp_path / "run")
    steps = np.array(seen).reshape(-1, 2)
    learnt = len(steps)
    share = (75 - learnt + np.arange(learnt)) / 75  # the first steps fill the replay buffer
    np.testing.assert_allclose(steps, np.repeat(1e-3 * (1.0 - 0.9 * share)[:, None], 2, axis=1), rtol=1e-9)
    assert learnt > 60
