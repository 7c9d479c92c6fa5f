"""The configuration: presets, overrides, and messages for wrong ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from viatool.errors import ConfigurationError
from viatool.train import PRESETS
from viatool.train.configuration import load_configuration, make_configuration


def test_the_paper_preset_is_the_schedule_of_the_paper() -> None:
    paper = make_configuration("paper")
    assert (paper.epochs, paper.epoch_episodes, paper.discount, paper.learning_rate) == (100, 70, 0.99, 1e-4)
    assert (paper.actor_hidden, paper.critic_hidden, paper.alpha, paper.cost_limit, paper.seeds) == (
        (26, 26),
        (26, 26),
        0.9,
        10.0,
        5,
    )
    assert (paper.var_rule, paper.multiplier_rule, paper.policy_delay) == ("adaptive", "mean", 2)


@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_comes_back_from_its_yaml(preset: str, tmp_path: Path) -> None:
    configuration = make_configuration(preset, seed=7)
    path = tmp_path / "training.yaml"
    path.write_text(configuration.to_yaml(), encoding="utf-8")
    assert load_configuration(path) == configuration


def test_later_sources_win(tmp_path: Path) -> None:
    path = tmp_path / "training.yaml"
    path.write_text("epochs: 20\nseeds: 2\nbatch_size: 64\n", encoding="utf-8")
    made = make_configuration("paper", path, ["seeds=4", "actor-hidden=[64, 64]"], batch_size=32, robots=None)
    assert (made.epochs, made.seeds, made.batch_size, made.actor_hidden, made.robots) == (
        20,
        4,
        32,
        (64, 64),
        14,
    )


@pytest.mark.parametrize(
    ("settings", "part"),
    [
        (["epochz=3"], "did you mean epochs?"),
        (["epochs"], "is not key=value"),
        (["epochs=0"], "epochs: "),
        (["discount=1.0"], "discount: "),
        (["learning_rate=.nan"], "learning_rate: "),
        (["epoch_episodes=70"], "exactly one of epoch_steps and epoch_episodes"),
        (["noise_highest=0.01"], "noise_highest 0.01 is below"),
        (["test_seed=1000001"], "test_seed must differ"),
        (["epochs=[1"], "not YAML"),
        (["lidar_saturation=soft"], "soft needs lidar_range"),
        (["gain_limit=0"], "gain_limit: "),
        (["mission_feedback=0.2"], "mission_feedback needs mission_scenarios"),
        (["mission_feedback=1.5"], "mission_feedback: "),
    ],
)
def test_a_wrong_setting_is_named(settings: list[str], part: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        make_configuration("quick", None, settings)
    assert part in str(caught.value)


def test_a_wrong_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "training.yaml"
    path.write_text("epochs: 20\nseeds: [\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"training\.yaml:3: not valid YAML"):
        load_configuration(path)
    with pytest.raises(ConfigurationError, match="cannot read"):
        load_configuration(tmp_path / "missing.yaml")
    path.write_text("- 1\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match="expected fields and values"):
        load_configuration(path)
    with pytest.raises(ConfigurationError, match="no preset 'fast'"):
        make_configuration("fast")
