"""One state at a time: the verdicts are those of verify, hold by brute force, and refuse what verify refuses."""

from __future__ import annotations

import numpy as np
import pytest

import viatool
from tests.choosing import write_choosing
from tests.safety.brute_force import clearance, drive_all
from viatool.errors import ConfigurationError
from viatool.uncertainty import ErrorModel

NARROW = {"eps": 0.05, "clearance": 0.6, "danger": 0.8}
POSE = ErrorModel.model_validate({"pose": {"x": 0.03, "y": 0.03, "theta": 0.03}})
MOTORS = ErrorModel.model_validate(
    {"actuation": {"linear": {"acceleration": 2.0}}, "timing": {"interval": [0.09, 0.12]}}
)
RETURNS = ErrorModel.model_validate({"obstacles": {"returns": 0.2}})
ASKED = {
    "swept": NARROW,
    "wide, refined": {"eps": 0.05, "clearance": 0.7, "danger": 0.8},
    "braking": {**NARROW, "criterion": "braking"},
    "late": {**NARROW, "criterion": "braking", "delay": 0.15},
    "sampled": {**NARROW, "criterion": "sampled"},
    "pose": {**NARROW, "criterion": "braking", "errors": POSE},
    "motors": {**NARROW, "criterion": "braking", "errors": MOTORS},
    "returns": {**NARROW, "criterion": "braking", "errors": RETURNS},
    "one pass": {**NARROW, "refine": "none"},
}


@pytest.fixture(scope="module")
def world():
    return viatool.load_map("lab")


@pytest.fixture(scope="module")
def driven(world):
    policy = viatool.load_policy("via")
    return policy, viatool.roll_out(policy, world.with_clearance(0.1, 0.2))


def near(world, trajectory, count=60):
    """The states nearest to an obstacle, and some others."""
    away = np.concatenate(
        [
            clearance(world, trajectory.poses[trajectory.episode == number], world.robot.footprint, scenario)
            for number, scenario in enumerate(trajectory.scenarios)
        ]
    )
    return np.sort(np.concatenate([away.argsort()[:count], np.arange(0, len(away), 80)]))


def verdicts(verifier, result):
    """What a verifier says of every state of a result."""
    trajectory, found = result.trajectory, []
    each = [verifier.within(scenario) for scenario in trajectory.scenarios]
    for row, (pose, seen) in enumerate(zip(trajectory.poses, result.observations, strict=True)):
        before = result.under_way[row] if result.under_way.shape[1] else None
        step = None if trajectory.steps is None else int(trajectory.steps[row])
        found.append(each[trajectory.episode[row]](pose, seen, before=before, step=step))
    return found


def assert_same(found, result):
    assert [one.verdict for one in found] == result.verdict.tolist()
    assert [one.safe for one in found] == result.judgement.safe.tolist()
    assert [one.danger for one in found] == result.judgement.danger.tolist()
    assert [one.sampled for one in found] == result.judgement.sampled.tolist()
    assert [one.contested for one in found] == result.contested.collision.tolist()
    np.testing.assert_allclose([one.lower for one in found], result.lower, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose([one.upper for one in found], result.upper, rtol=0.0, atol=1e-12)
    table = result.state_table()
    lower, upper = zip(*(one.observed for one in found), strict=True)
    np.testing.assert_array_equal(lower, table["observation_lower"])
    np.testing.assert_array_equal(upper, table["observation_upper"])
    for one, witness in zip(found, table["witness"], strict=True):
        if one.witness is None:
            assert np.isnan(witness).all()
        else:
            np.testing.assert_allclose(one.witness, witness, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("name", ASKED)
def test_the_verdicts_are_those_of_verify(driven, world, name):
    policy, trajectory = driven
    asked, rows = ASKED[name], near(world, trajectory)
    whole = viatool.verify(policy, world, trajectory=trajectory, **asked)
    verifier = viatool.Verifier(policy, world, scenario=trajectory.scenarios[0], **asked)
    some = _Some(whole, rows)
    found = verdicts(verifier, some)
    assert_same(found, some)
    assert len({one.verdict for one in found}) > 1


class _Some:
    """Some rows of a result, as far as the tests look at it."""

    def __init__(self, result, rows):
        self.trajectory, self.under_way = result.trajectory.select(rows), result.under_way[rows]
        self.observations, self.verdict = result.observations[rows], result.verdict[rows]
        self.lower, self.upper = result.lower[rows], result.upper[rows]
        self.judgement = _Rows(result.judgement, rows)
        self.contested = _Rows(result.contested, rows)
        self._table = {
            name: value[rows]
            for name, value in result.state_table().items()
            if len(value) == len(result.trajectory)
        }

    def state_table(self):
        return self._table


class _Rows:
    def __init__(self, parts, rows):
        for name, value in vars(parts).items():
            setattr(self, name, value[rows])


def test_choices_are_judged_as_verify_does(tmp_path, world):
    path = write_choosing(tmp_path / "choosing.onnx")
    result = viatool.verify(path, world, scenarios=world.scenarios[:2], **NARROW)
    assert_same(verdicts(viatool.Verifier(path, world, **NARROW), result), result)


def test_what_is_safe_holds_by_brute_force_and_without_the_error_it_does_not(driven, world):
    policy, trajectory = driven
    asked = {"eps": 0.2, "clearance": 0.7, "danger": 0.8}
    verifier = viatool.Verifier(policy, world, **asked)
    blind = viatool.Verifier(policy, world, **{**asked, "eps": 0.0})
    result = viatool.verify(policy, world, trajectory=trajectory, **asked)
    generator, wrong = np.random.default_rng(3), {"verifier": 0, "blind": 0}
    for row in np.unique(np.concatenate([near(world, trajectory, 25), result.witnesses.state])):
        scenario = trajectory.scenarios[trajectory.episode[row]]
        pose, seen = trajectory.poses[row], result.observations[row]
        found = {
            "verifier": verifier.within(scenario)(pose, seen),
            "blind": blind.within(scenario)(pose, seen),
        }
        radii = verifier.setting.radii
        noisy = seen + 0.999 * radii * np.sign(generator.normal(size=(200, len(seen))))
        noisy = np.concatenate([noisy, [seen], np.nan_to_num(result.witness[[row]], nan=seen)])
        commands = policy.run(noisy)
        paths = drive_all(np.tile(pose, (len(noisy), 1)), *commands.T, np.linspace(0.0, 0.1, 15)[None])
        least = clearance(world, paths, world.robot.footprint, scenario).min()
        for name, one in found.items():
            if one.safe:
                assert (commands >= one.lower).all() or name == "blind"
                assert (commands <= one.upper).all() or name == "blind"
                wrong[name] += least <= 0.7
    assert wrong["verifier"] == 0
    assert wrong["blind"] > 0


def test_a_verdict_tells_what_was_asked_of_it(driven, world):
    policy, trajectory = driven
    verifier = viatool.Verifier(policy, world, eps=0.01).within(trajectory.scenarios[0])
    found = verifier(trajectory.poses[0], trajectory.observations[0])
    own = clearance(world, trajectory.poses[:1], world.robot.footprint, trajectory.scenarios[0])[0]
    assert found.clearance == pytest.approx(own, abs=1e-9)
    assert found.margin == pytest.approx(own - world.clearance.collision, abs=1e-9)
    assert found.witness is None
    assert repr(found).startswith("<safe: linear " if "linear" in repr(found) else "<safe: ")
    np.testing.assert_array_equal(found.commands[0], verifier.setting.rules.clip(found.lower))
    assert {"criterion", "collision distance"} <= {premise.name for premise in verifier.premises}


def test_without_a_search_nothing_is_unsafe(driven, world):
    policy, trajectory = driven
    asked = {"eps": 0.05, "clearance": 0.7, "danger": 0.8}
    result = viatool.verify(policy, world, trajectory=trajectory, **asked)
    row = result.witnesses.state[0]
    verifier = viatool.Verifier(policy, world, search=False, **asked)
    found = verifier.within(trajectory.scenarios[trajectory.episode[row]])(
        trajectory.poses[row], trajectory.observations[row]
    )
    assert found.verdict == "unknown"


def test_what_is_missing_or_misshapen_is_refused(driven, world):
    policy, trajectory = driven
    pose, seen = trajectory.poses[0], trajectory.observations[0]
    with pytest.raises(ConfigurationError, match="no goal"):
        viatool.Verifier(policy, world, eps=0.01, errors=POSE)
    late = viatool.Verifier(policy, world, eps=0.01, delay=0.15)
    with pytest.raises(ConfigurationError, match="leaves 2 commands on their way"):
        late(pose, seen)
    assert late(pose, seen, before=np.full((2, 2), np.nan)).verdict == "unknown"
    with pytest.raises(
        ConfigurationError, match=r"the commands before have shape \(1, 2\), expected \(2, 2\)"
    ):
        late(pose, seen, before=[0.0, 0.0])
    verifier = viatool.Verifier(policy, world, eps=0.01)
    with pytest.raises(ConfigurationError, match=r"a pose has shape \(2,\), expected \(3,\)"):
        verifier(pose[:2], seen)
    with pytest.raises(ConfigurationError, match=r"an observation has shape \(25,\), expected \(26,\)"):
        verifier(pose, seen[:25])
    with pytest.raises(ConfigurationError, match="NaN"):
        verifier(pose, np.where(np.arange(26) == 0, np.nan, seen))
    with pytest.raises(ConfigurationError, match="nobody says how they move"):
        verifier(pose, seen, people=np.zeros((1, 5)))
    assert verifier([np.nan, 0.0, 0.0], seen).verdict != "safe"
