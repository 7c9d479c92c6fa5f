"""``viatool import`` and the proposals of ``viatool inspect --write-spec``, as a user meets them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result

from viatool.policy import load_policy, load_specification

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from tests.importing.saved import saved  # only where they are installed

Run = Callable[..., Result]


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("models")
    saved(folder, "TD3", size=24, normalise=True)
    (folder / "dqn").mkdir()
    saved(folder / "dqn", "DQN", choices=5, size=26)
    return folder


def test_a_model_becomes_a_policy_and_a_proposal(run: Run, models: Path, tmp_path: Path) -> None:
    policy = tmp_path / "policy.onnx"
    model = [models / "model.zip", "--vecnormalize", models / "vec_normalize.pkl", "--output"]
    result = run("import", *model, policy)
    assert result.exit_code == 0, result.stderr
    assert "outputs from [-1, 1] scaled to [0, 0.5], [-1, 1]" in result.stdout
    assert "guessed: it is a policy of DRL-robot-navigation" in result.stdout
    sidecar = tmp_path / "policy.yaml"
    assert load_policy(policy, sidecar).spec == load_specification(sidecar)

    again = run("import", *model, policy)
    assert again.exit_code == 2
    assert "is there already" in again.stderr
    inside = run("import", *model, policy, "--spec", sidecar, "--quiet")
    assert (inside.exit_code, inside.stdout) == (0, "")
    assert load_policy(policy).spec == load_specification(sidecar)


def test_a_choice_has_commands_to_fill_in(run: Run, models: Path, tmp_path: Path) -> None:
    result = run(
        "import",
        models / "dqn" / "model.zip",
        "-o",
        tmp_path / "q.onnx",
        "--write-spec",
        tmp_path / "robot.yaml",
    )
    assert result.exit_code == 0, result.stderr
    assert "to fill in: every FILL_IN" in result.stdout
    refused = run("inspect", tmp_path / "q.onnx", "--spec", tmp_path / "robot.yaml")
    assert refused.exit_code == 2
    assert "commands.0.0" in refused.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["model.zip", "--low", "0,1"], "--low and --high belong together"),
        (["model.zip", "--low", "0,one", "--high", "1,1"], "no list of finite numbers"),
        (["model.zip", "--low", "0,0", "--high", "1,1"], "states its limits and sizes itself"),
        (["model.zip", "--spec", "a.yaml", "--write-spec", "b.yaml"], "--write-spec writes a proposal"),
        (["missing.zip"], "cannot read the model"),
    ],
)
def test_wrong_usage_is_said(
    arguments: list[str], message: str, run: Run, models: Path, tmp_path: Path
) -> None:
    path, *rest = arguments
    result = run("import", models / path, *rest, "--output", tmp_path / "policy.onnx")
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())
    assert not list(tmp_path.iterdir())


def test_inspect_takes_what_a_parameter_file_states(run: Run, tmp_path: Path) -> None:
    parameters = tmp_path / "params.yaml"
    parameters.write_text("node: {ros__parameters: {robot_name: scout}}")
    assert (
        run("inspect", "foreign.onnx", "--write-spec", tmp_path / "s.yaml", "--from", parameters).exit_code
        == 0
    )
    assert load_specification(tmp_path / "s.yaml").robot == "scout"
    alone = run("inspect", "foreign.onnx", "--from", parameters)
    assert alone.exit_code == 2
    assert "give --write-spec FILE as well" in alone.stderr
