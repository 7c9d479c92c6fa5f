"""Sensors beyond a box: relative errors, a common bias, and rays that return nothing."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import viatool
from tests.choosing import write_choosing
from tests.uncertainty.sampled import encoded, erred, observed, policy_of, readings_at
from viatool.channels import reading_errors
from viatool.errors import ConfigurationError
from viatool.sets.chance import RowChance
from viatool.sets.forms import Forms
from viatool.setting.admissible import AdmissibleSets
from viatool.setting.explanation import explain
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import roll_out
from viatool.taylor import elsewhere
from viatool.taylor import observed as over
from viatool.taylor.observed import reach_observed
from viatool.uncertainty import ErrorModel
from viatool.verification import verify
from viatool.verification.witness_file import witness_document

LAB = viatool.load_map("maps/lab.yaml")
TERMS = {
    "relative": {"absolute": 0.01, "relative": 0.05},
    "bias": {"absolute": 0.005, "bias": 0.05},
    "missing": {"absolute": 0.01, "missing": 1},
    "missing two": {"missing": 2},
    "all": {"absolute": 0.01, "relative": 0.02, "bias": 0.03, "missing": 1},
}
LAYOUTS = [("plain", "maximum"), ("scaled", "zero"), ("clipped", "maximum"), ("reciprocal", "maximum")]
CASES = [(name, *some) for name in TERMS for some in LAYOUTS if name != "missing two" or some[0] == "plain"]


def model_of(terms):
    return ErrorModel.model_validate({"sensor": {"lidar": terms}})


def setting_of(policy, terms):
    eps = {"": 0.0} if "absolute" in terms else {"": 0.0, "lidar": 0.0}
    return Setting.of(policy, LAB, eps, Wishes(errors=model_of(terms), prefer={"": "policy"}), job="verify")


def escapes(path, terms, encoding, no_return, *, bounded=None, count=8, tries=60, one_ray=True):
    """By how much commands of onnxruntime leave their bounds at most, errors drawn at random and at their ends."""
    policy = viatool.load_policy(path)
    setting = setting_of(policy, terms if bounded is None else bounded)
    generator = np.random.default_rng(3)
    readings = readings_at(generator, count)
    recorded = observed(generator, readings, encoding)
    found = reach_observed(setting.commanding(policy), setting.reading_errors.sets(recorded), refine="none")
    worst = -np.inf
    for _ in range(tries):
        scan = erred(generator, readings, terms, no_return=no_return, one_ray=one_ray)
        seen = recorded.copy()
        seen[:, :20] = encoded(scan, encoding)
        actions = policy.run(seen.astype(np.float32).astype(float))
        worst = max(worst, float(np.maximum(actions - found.upper, found.lower - actions).max()))
    return worst


@pytest.mark.parametrize(("name", "encoding", "no_return"), CASES)
def test_no_admissible_observation_leaves_the_bounds(tmp_path, name, encoding, no_return):
    path = policy_of(tmp_path, encoding, no_return)
    assert escapes(path, TERMS[name], encoding, no_return) <= 0.0


def test_a_bin_of_several_rays_may_read_anything_up_to_the_maximum(tmp_path):
    path = policy_of(tmp_path, rays=180)
    assert escapes(path, {"missing": 2}, "plain", "maximum", one_ray=False) <= 0.0


@pytest.mark.parametrize("term", ["relative", "bias", "missing"])
def test_onnxruntime_catches_a_term_that_is_left_out(tmp_path, term):
    terms = TERMS["all"]
    without = {name: value for name, value in terms.items() if name != term}
    assert escapes(policy_of(tmp_path), terms, "plain", "maximum", bounded=without) > 1e-4


def forget_the_common_error(monkeypatch):
    right = Forms.clipped
    monkeypatch.setattr(
        Forms, "clipped", lambda self, low, high: replace(right(self, low, high), slope=0.0 * self.slope)
    )
    monkeypatch.setattr(
        reading_errors.ReadingErrors, "_encoded", lambda self, low, high, changed: (low, high)
    )


def forget_the_largest(monkeypatch):
    right = elsewhere.FewSymbols.most
    monkeypatch.setattr(
        elsewhere.FewSymbols, "most", lambda self, slope: right(replace(self, elsewhere=self.usual), slope)
    )


def forget_choices(monkeypatch):
    right = over.ObservationSets.choices
    monkeypatch.setattr(over.ObservationSets, "choices", lambda self, most: list(right(self, most))[:3])


@pytest.mark.parametrize(
    ("mutate", "terms"),
    [
        (forget_the_largest, {"missing": 2}),
        (forget_choices, {"missing": 1}),
        (forget_choices, {"missing": 2}),
    ],
)
def test_onnxruntime_catches_bounds_that_leave_something_out(tmp_path, monkeypatch, mutate, terms):
    path = policy_of(tmp_path)
    mutate(monkeypatch)
    assert escapes(path, terms, "plain", "maximum") > 1e-4


def test_a_common_bias_is_tighter_than_as_much_error_of_every_ray(tmp_path):
    policy = viatool.load_policy(policy_of(tmp_path))
    generator = np.random.default_rng(0)
    recorded = observed(generator, readings_at(generator, 60))
    together, apart = (
        reach_observed(policy, setting_of(policy, terms).reading_errors.sets(recorded))
        for terms in ({"absolute": 0.005, "bias": 0.05}, {"absolute": 0.055, "relative": 1e-9})
    )
    assert (together.width <= apart.width + 1e-6).all()
    assert np.median(together.width[:, 1] / apart.width[:, 1]) < 0.7


def test_few_missing_rays_are_tighter_than_all_of_them(tmp_path):
    policy = viatool.load_policy(policy_of(tmp_path))
    generator = np.random.default_rng(0)
    recorded = observed(generator, readings_at(generator, 6))
    widths = [
        reach_observed(
            policy,
            setting_of(policy, {"absolute": 0.01, "missing": count}).reading_errors.sets(recorded),
            refine="none",
        ).width
        for count in (0, 1, 2)
    ]
    for fewer, more in pairwise(widths):
        assert (fewer <= more + 1e-6).all()
        assert fewer[:, 1].mean() < 0.98 * more[:, 1].mean()


@pytest.mark.parametrize("encoding", ["plain", "clipped", "reciprocal"])
def test_sets_grow_with_every_term(tmp_path, encoding):
    policy = viatool.load_policy(policy_of(tmp_path, encoding))
    generator = np.random.default_rng(1)
    recorded = observed(generator, readings_at(generator, 50), encoding)
    terms = {"absolute": 0.01, "relative": 0.01, "bias": 0.02, "missing": 1}
    lower, upper = setting_of(policy, terms).reading_errors.sets(recorded).hull
    for name, value in terms.items():
        for changed in ({**terms, name: 0}, {**terms, name: 2 * value}):
            less, more = setting_of(policy, changed).reading_errors.sets(recorded).hull
            outer, inner = (
                ((lower, upper), (less, more)) if changed[name] == 0 else ((less, more), (lower, upper))
            )
            assert (outer[0] <= inner[0]).all()
            assert (outer[1] >= inner[1]).all()
            assert name == "missing" or ((outer[1] - outer[0]) > (inner[1] - inner[0])).any()


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    path = policy_of(tmp_path_factory.mktemp("driven"))
    several = viatool.load_policy(policy_of(tmp_path_factory.mktemp("several"), rays=180))
    return viatool.load_policy(path), roll_out(several, LAB, LAB.generator.draw(12, 1))


def verified(driven, terms, **options):
    policy, trajectory = driven
    return verify(
        policy, LAB, eps={"": 0.005} if "absolute" in terms else {"": 0.005, "lidar": 0.0},
        errors=model_of(terms), trajectory=trajectory, clearance=0.6, danger=0.8, prefer={"": "policy"},
        **{"refine": "none", **options},
    )  # fmt: skip


def test_terms_of_size_zero_change_no_bit(driven):
    plain = verified(driven, {"absolute": 0.02})
    zero = verified(driven, {"absolute": 0.02, "relative": 0.0, "bias": 0.0, "missing": 0})
    for name in ("lower", "upper", "verdict", "witness"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(zero, name))


ALL = {"absolute": 0.01, "relative": 0.02, "bias": 0.03, "missing": 1}


def test_a_verdict_with_all_terms_is_attacked_with_errors_of_them(driven):
    """No drawn observation of a state that is called safe gives a command outside of what was judged."""
    policy, _ = driven
    result = verified(driven, ALL, only_contested=True)
    assert set(result.verdict) >= {"safe", "unsafe"}
    rows = np.flatnonzero(result.contested.collision)
    generator, recorded = np.random.default_rng(0), result.observations[rows]
    for _ in range(30):
        seen = recorded.copy()
        seen[:, :20] = erred(generator, recorded[:, :20], ALL)
        actions = policy.run(seen.astype(np.float32).astype(float))
        assert (actions >= result.lower[rows]).all()
        assert (actions <= result.upper[rows]).all()
    table = result.state_table()
    assert (table["observation_upper"][:, :20] > 6.99).sum() > 0
    told = {premise.name: premise.value for premise in result.premises}
    assert told["sensor.lidar.bias"].startswith("0.03")
    assert "bias" in result.assumptions()["sensor_error"]


def test_every_witness_tells_the_errors_that_make_it(driven):
    result = verified(driven, {"absolute": 0.01, "bias": 0.6}, only_contested=True)
    errors = result.setting.reading_errors
    pairs = [(result.observations[state], result.witness[state]) for state in result.witnesses.state]
    assert pairs
    assert all(explain(errors, *pair) is not None for pair in pairs)
    document = json.loads(json.dumps(witness_document(result)))
    assert any(entry.get("errors", {}).get("lidar", {}).get("bias") for entry in document["witnesses"])
    plain = verified(driven, {"absolute": 0.01}, only_contested=True)
    assert not (result.judgement.safe & ~plain.judgement.safe).any()
    assert result.judgement.safe.sum() < plain.judgement.safe.sum()


@pytest.mark.parametrize("encoding", ["plain", "clipped", "reciprocal"])
def test_all_that_is_searched_is_explained(tmp_path, encoding):
    policy = viatool.load_policy(policy_of(tmp_path, encoding))
    errors = setting_of(policy, ALL).reading_errors
    generator = np.random.default_rng(5)
    recorded = observed(generator, readings_at(generator, 30), encoding)
    sets, lower_upper = AdmissibleSets(errors, recorded), errors.sets(recorded).hull
    found = [sets.random_corner(RowChance(seed, recorded)) for seed in range(4)]
    found += [sets.nearest(recorded + generator.normal(0.0, 0.05, recorded.shape)) for _ in range(2)]
    told = []
    for points in found:
        points = points.astype(np.float32).astype(float)
        assert (points >= lower_upper[0]).all()
        assert (points <= lower_upper[1]).all()
        told += [explain(errors, *pair) for pair in zip(recorded, points, strict=True)]
    assert all(one is not None for one in told)
    assert any("missing" in one.get("lidar", {}) for one in told)
    assert any("bias" in one.get("lidar", {}) for one in told)


def test_what_the_model_does_not_allow_is_not_explained(driven):
    policy, trajectory = driven
    errors = setting_of(policy, ALL).reading_errors
    recorded = trajectory.observations[0].astype(np.float32).astype(float)
    base = np.clip(recorded[:20], 0.5, 6.0)
    recorded[:20] = base
    for change, admitted in [
        (np.zeros(20), True),
        (np.full(20, 0.03), True),
        (np.r_[np.full(10, 0.05), np.full(10, -0.05) - 0.02 * base[10:]], False),  # two biases
        (np.r_[7.0 - base[0], np.zeros(19)], True),
        (np.r_[7.0 - base[:2], np.zeros(18)], False),  # two rays return nothing
    ]:
        seen = recorded.copy()
        seen[:20] += change
        assert (explain(errors, recorded, seen) is not None) == admitted


def test_a_choice_is_bounded_over_what_errs_together(tmp_path):
    policy = viatool.load_policy(write_choosing(tmp_path / "choosing.onnx"))
    generator = np.random.default_rng(2)
    readings = readings_at(generator, 12)
    recorded = observed(generator, readings)
    terms = {"absolute": 0.005, "bias": 0.05, "missing": 1}
    setting = setting_of(policy, terms)
    found = reach_observed(setting.commanding(policy), setting.reading_errors.sets(recorded))
    boxed = setting_of(policy, {"absolute": 0.055}).uncertain(recorded)
    for _ in range(60):
        seen = recorded.copy()
        seen[:, :20] = erred(generator, readings, terms, one_ray=False)
        chosen = policy.run(seen.astype(np.float32).astype(float)).argmax(axis=1)
        assert found.possible[np.arange(len(chosen)), chosen].all()
    biased = reach_observed(
        setting.commanding(policy),
        setting_of(policy, {"absolute": 0.005, "bias": 0.05}).reading_errors.sets(recorded),
    )
    apart = viatool.reach(policy, *boxed)
    assert biased.possible.sum() < apart.possible.sum()


@pytest.mark.parametrize(
    ("sensor", "said"),
    [
        ({"goal_distance": {"missing": 1}}, "sensor.goal_distance.missing: the channel is no LiDAR"),
        ({"budget": {"bias": 0.1}}, "fixed to 7.3"),
    ],
)
def test_what_a_channel_does_not_have_is_refused_by_name(driven, sensor, said):
    model = ErrorModel.model_validate({"sensor": sensor})
    with pytest.raises(ConfigurationError, match=said):
        Setting.of(driven[0], LAB, 0.01, Wishes(errors=model, prefer={"": "policy"}), job="verify")
