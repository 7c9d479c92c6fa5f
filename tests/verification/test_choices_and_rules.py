"""Policies that choose among commands, and rules around policies, against onnxruntime and school formulas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import onnxruntime
import pytest

from tests.choosing import TABLE, choosing_specification, write_choosing
from tests.safety.brute_force import clearance, drive_all
from tests.safety.hand_made_policy import specification, write_policy
from viatool.errors import ConfigurationError
from viatool.policy import load_policy
from viatool.policy.overrides import Overrides
from viatool.safety.pieces import CommandPieces
from viatool.simulate import roll_out
from viatool.verification import verify
from viatool.world import Obstacles, load_map

LAB = "maps/lab.yaml"
DISTANCES = {"clearance": 0.6, "danger": 0.8}
RULES = [
    {"when": {"goal_distance": {"below": 0.9}}, "command": [0.0, 0.0]},
    {"when": {"lidar": {"below": 0.75}, "goal_cosine": {"above": 0.2}}, "command": [0.1, 0.8]},
]


def sent_by_hand(rules, observations, commands):
    """What is sent, one observation after the other; columns as `specification` has them."""
    sent = commands.copy()
    for row, seen in enumerate(observations):
        for rule in rules:
            told = {"goal_distance": seen[20:21], "lidar": seen[:20], "goal_cosine": seen[21:22]}
            holds = [
                any(v < bound.get("below", np.inf) and v > bound.get("above", -np.inf) for v in told[name])
                for name, bound in rule["when"].items()
            ]
            if all(holds):
                sent[row] = rule["command"]
                break
    return sent


def make(tmp_path_factory, discrete, rules):
    """A policy, and a function that tells with onnxruntime alone what is sent."""
    path = tmp_path_factory.mktemp("policy") / "policy.onnx"
    if discrete:
        write_choosing(path, choosing_specification(overrides=rules))
    else:
        told = specification().model_dump(mode="json", exclude_none=True)
        spec = specification().model_validate({**told, "schema_version": 2, "overrides": rules})
        write_policy(path, spec, caution=0.05)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])

    def sent(observations):
        outputs = session.run(None, {"observation": observations.astype(np.float32)})[0].astype(np.float64)
        commands = np.array(TABLE)[outputs.argmax(axis=1)] if discrete else outputs
        return sent_by_hand(rules, observations, commands)

    return load_policy(path), sent


CASES = {"choice": (True, []), "choice and rules": (True, RULES), "rules": (False, RULES)}


@pytest.fixture(scope="module", params=list(CASES))
def verified(request, tmp_path_factory):
    """States of a drive that are verified for more clearance than the robot kept."""
    policy, sent = make(tmp_path_factory, *CASES[request.param])
    scenarios = load_map(LAB).generator.draw(10, 1)
    driven = roll_out(policy, load_map(LAB), scenarios)
    return policy, sent, scenarios, verify(policy, LAB, eps=0.03, trajectory=driven, **DISTANCES)


def least_clearance(result, scenarios, state, commands):
    """The least clearance (K,) of commands (K, 2) in one state, by another geometry."""
    lab = load_map(LAB)
    own = scenarios[result.episode[state]].obstacles
    world = replace(lab, obstacles=Obstacles(np.concatenate([lab.obstacles.circles, own.circles])))
    limited = np.clip(commands, [0.0, -1.0], [0.5, 1.0])
    start = np.tile(result.poses[state], (len(commands), 1))
    paths = drive_all(start, *limited.T, np.linspace(0.0, 0.1, 25)[None])
    left = clearance(world, paths.reshape(-1, 3), world.robot.footprint)
    return left.reshape(len(commands), -1).min(axis=1)


def test_there_is_something_to_decide(verified):
    *_, result = verified
    assert set(result.verdict) >= {"safe", "unsafe"}
    assert result.contested.collision.sum() > 20
    assert (result.upper > result.lower).any(axis=1).sum() > 50


def test_no_command_that_is_sent_leaves_the_hull_or_fails_in_a_safe_state(verified):
    _, sent, scenarios, result = verified
    generator = np.random.default_rng(0)
    safe = np.flatnonzero((result.verdict == "safe") & result.contested.collision)[:60]
    others = generator.choice(len(result.verdict), 60)
    for state in np.concatenate([safe, others]):
        noise = generator.uniform(-1, 1, (300, 26))
        noise[::2] = np.sign(noise[::2])
        seen = (result.observations[state] + noise * result.radii).astype(np.float32).astype(np.float64)
        commands = sent(seen)
        assert (commands >= result.lower[state] - 1e-9).all()
        assert (commands <= result.upper[state] + 1e-9).all()
        if result.verdict[state] == "safe":
            each = np.unique(commands.round(9), axis=0)
            assert least_clearance(result, scenarios, state, each).min() > 0.6 - 1e-9


def test_every_witness_is_in_its_box_and_what_is_sent_then_fails(verified):
    _, sent, scenarios, result = verified
    assert len(result.witnesses) > 10
    for state in result.witnesses.state:
        witness = result.witness[state]
        assert (np.abs(witness - result.observations[state]) <= result.radii + 1e-6).all()
        assert (witness.astype(np.float32) == witness).all()
        assert least_clearance(result, scenarios, state, sent(witness[None]))[0] < 0.6


def test_the_drive_sends_what_is_chosen_and_what_rules_say(verified):
    _, sent, _, result = verified
    told = result.trajectory
    follows = np.flatnonzero(np.diff(told.episode) == 0)
    commands = np.clip(sent(told.observations[follows]), [0.0, -1.0], [0.5, 1.0])
    np.testing.assert_allclose(told.observations[follows + 1][:, 23:25], commands, atol=1e-6)


def test_a_choice_tells_how_many_commands_are_possible(tmp_path_factory):
    policy, _ = make(tmp_path_factory, True, [])
    result = verify(policy, LAB, eps=0.03, scenarios=load_map(LAB).generator.draw(3, 1))
    table = result.state_table()
    assert table["possible"].shape == (len(result.verdict), 5)
    assert table["possible"].any(axis=1).all()
    report = result.to_json()["possible"]
    assert report["commands"] == 5
    assert report["most"] == table["possible"].sum(axis=1).max()


@pytest.mark.parametrize("forgotten", ["a rule may apply", "the policy may command", "a command is possible"])
def test_a_piece_that_is_forgotten_lets_a_command_escape(tmp_path_factory, monkeypatch, forgotten):
    """Mutants: each leaves one kind of piece out, and the containment test notices."""
    policy, sent = make(tmp_path_factory, True, RULES)
    lab, scenarios = load_map(LAB), load_map(LAB).generator.draw(10, 1)
    driven = roll_out(policy, lab, scenarios)
    over, pieces = Overrides.over, CommandPieces.of

    def mutant_over(self, lower, upper):
        found = over(self, lower, upper)
        if forgotten == "a rule may apply":
            middle = over(self, 0.5 * (lower + upper), 0.5 * (lower + upper))
            return found._replace(counts=middle.counts)
        return found._replace(policy=over(self, 0.5 * (lower + upper), 0.5 * (lower + upper)).policy)

    def mutant_pieces(driven, reachable, *observed):
        return pieces(driven, replace(reachable, possible=reachable.attained & False), *observed)

    if forgotten == "a command is possible":
        monkeypatch.setattr(CommandPieces, "of", mutant_pieces)
    else:
        monkeypatch.setattr(Overrides, "over", mutant_over)
    result = verify(policy, LAB, eps=0.03, trajectory=driven, **DISTANCES)
    generator, escaped = np.random.default_rng(0), 0
    for state in range(len(result.verdict)):
        noise = np.sign(generator.uniform(-1, 1, (40, 26))) * result.radii
        commands = sent((result.observations[state] + noise).astype(np.float32).astype(np.float64))
        inside = (commands >= result.lower[state] - 1e-9) & (commands <= result.upper[state] + 1e-9)
        escaped += int(not inside.all())
    assert escaped > 0


def test_a_rule_beyond_the_clip_of_its_channel_is_refused(tmp_path):
    told = choosing_specification().model_dump(mode="json", exclude_none=True)
    told["observation"][1] |= {"clip": [0.0, 5.0]}
    told["overrides"] = [{"when": {"goal_distance": {"above": 6.0}}, "command": [0.0, 0.0]}]
    spec = specification().model_validate(told)
    policy = load_policy(write_choosing(tmp_path / "policy.onnx", spec))
    with pytest.raises(ConfigurationError, match="clipped to"):
        verify(policy, LAB, eps=0.01)
