"""What margins say holds: by onnxruntime and a geometry of its own, by `viatool.verify`, and mutants are caught."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import shapely
from shapely.geometry import Point, Polygon

import viatool
from tests.choosing import write_choosing
from tests.margins.conftest import PLACES
from tests.verification.test_stacked_frames import MAP as SQUARE
from tests.verification.test_stacked_frames import asked as stacked_policy
from viatool.errors import BoundsError, ConfigurationError, EnclosureError
from viatool.margins.result import Margins
from viatool.margins.varying import VaryingReadings
from viatool.policy import Affine, Input, Network, PolicySpecification, write_onnx
from viatool.simulate import Places
from viatool.trajectory import Trajectory
from viatool.uncertainty import ErrorModel
from viatool.verification.close import close_places
from viatool.verification.states import states_of

ROOT = Path(__file__).resolve().parents[2]
INTERVAL, CLEARANCE = 0.1, 0.4
TIMES = np.linspace(0.0, INTERVAL, 41)


def commands(name: str, observations: np.ndarray) -> np.ndarray:
    """Run the file itself, and clip to the limits of the lab's robot."""
    session = onnxruntime.InferenceSession(str(ROOT / "policies" / f"{name}.onnx"))
    taken = {session.get_inputs()[0].name: observations.astype(np.float32)}
    return np.clip(session.run(None, taken)[0].astype(float), [0.0, -1.0], [0.5, 1.0])


def least_distance(found: Margins, state: int, sent: np.ndarray) -> np.ndarray:
    """Return how near the origin comes to anything within an interval of commands (K, 2), (K,)."""
    x, y, heading = found.trajectory.poses[state]
    speed, turn = (sent[:, None, axis] for axis in range(2))
    middle = heading + 0.5 * turn * TIMES  # the chord of an arc points half of the turn aside
    chord = speed * TIMES * np.sinc(0.5 * turn * TIMES / np.pi)
    places = shapely.points(x + chord * np.cos(middle), y + chord * np.sin(middle))
    scenario = found.trajectory.scenarios[found.trajectory.episode[state]]
    distances = [shapely.distance(places, Polygon(found.world_map.arena).exterior)]
    for obstacles in (found.world_map.obstacles, scenario.obstacles):
        distances += [shapely.distance(places, Point(a, b)) - radius for a, b, radius in obstacles.circles]
        distances += [shapely.distance(places, Polygon(corners)) for corners in obstacles.polygons]
    return np.min(distances, axis=(0, 2))


def around(found: Margins, row: int, error: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draw observations within an error, at corners and anywhere, as float32 numbers that do not leave it."""
    middle = found.trajectory.observations[found.states[row]]
    free = np.array([not name.startswith("budget") for name in found.setting.inputs.names])
    shares = rng.uniform(-1.0, 1.0, (count, len(middle)))
    shares[: count // 2] = np.sign(shares[: count // 2])
    return (middle + shares * free * error * (1.0 - 1e-6)).astype(np.float32)


def violated_within_certified(name: str, found: Margins, count: int = 96) -> int:
    """Count states in which some random observation within the certified error fails."""
    rng, failing = np.random.default_rng(1), 0
    for row in np.flatnonzero(np.isfinite(found.certified)).tolist():
        seen = around(found, row, found.certified[row], count, rng)
        failing += bool((least_distance(found, found.states[row], commands(name, seen)) <= CLEARANCE).any())
    return failing


def sizes_of_witnesses(found: Margins) -> np.ndarray:
    """Return the largest error of any entry of each counterexample, (C,); infinite where there is none."""
    off = np.abs(found.witness - found.trajectory.observations[found.states]).max(axis=1)
    return np.where(np.isnan(off), np.inf, off)


def assert_sound(found: Margins, known: Margins) -> None:
    """Hold margins against counterexamples that are known."""
    assert (found.certified < found.refuted).all()
    assert (found.certified < sizes_of_witnesses(known)).all()


@pytest.mark.parametrize("name", ["via", "td3"])
def test_no_observation_within_the_certified_error_fails(name: str, request: pytest.FixtureRequest) -> None:
    found: Margins = request.getfixturevalue(name)
    assert np.isfinite(found.certified).sum() > 15
    assert violated_within_certified(name, found) == 0


@pytest.mark.parametrize("name", ["via", "td3"])
def test_what_refutes_was_run_and_fails(name: str, request: pytest.FixtureRequest) -> None:
    found: Margins = request.getfixturevalue(name)
    refuted = np.flatnonzero(np.isfinite(found.refuted))
    assert len(refuted) > 8
    assert (sizes_of_witnesses(found)[refuted] <= found.refuted[refuted]).all()
    for row in refuted.tolist():
        sent = commands(name, found.witness[row, None])
        assert least_distance(found, found.states[row], sent)[0] <= CLEARANCE


def test_certified_is_never_above_refuted(via: Margins, td3: Margins) -> None:
    for found in (via, td3):
        assert_sound(found, found)
        closed = np.isfinite(found.certified) & np.isfinite(found.refuted)
        assert closed.sum() > 8
        # some are followed to where the proof ends; of wide boxes bounds are looser
        assert np.quantile((found.refuted - found.certified)[closed], 0.25) < 0.01


def test_a_margin_is_the_verdict_of_verify_at_that_error(via: Margins) -> None:
    some = via.weakest_first[np.isfinite(via.refuted[via.weakest_first])][3:6]
    for row in some.tolist():
        state = via.trajectory.select(via.states[row : row + 1])
        for error, verdict in ((via.certified[row], "safe"), (via.refuted[row], "unsafe")):
            result = viatool.verify("via", "lab", eps=float(error), trajectory=state)
            assert result.verdict.tolist() == [verdict]


def test_radii_of_their_own_that_are_all_alike_are_eps(via: Margins) -> None:
    errors = np.full(len(via), 0.05)
    asked = states_of(via.setting, via.trajectory).select(via.states)
    ((rows, examination, states),) = via.varying.at(asked, errors)
    found = examination(states)
    plain = replace(examination, setting=via.varying.setting(0.05))(asked)
    assert rows.tolist() == list(range(len(via)))
    assert (found.reachable.lower == plain.reachable.lower).all()
    assert (found.judgement.safe == plain.judgement.safe).all()
    assert found.witnesses.state.tolist() == plain.witnesses.state.tolist()


def test_proofs_at_the_radius_of_another_state_are_caught(
    via: Margins, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = VaryingReadings.at
    monkeypatch.setattr(
        VaryingReadings, "at", lambda self, states, errors: plain(self, states, np.roll(errors, 1))
    )
    with pytest.raises((AssertionError, BoundsError)):
        assert_sound(viatool.margin("via", "lab", places=PLACES), via)


def test_readings_that_err_less_than_asked_are_caught(via: Margins, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = VaryingReadings.at
    monkeypatch.setattr(VaryingReadings, "at", lambda self, states, errors: plain(self, states, 0.5 * errors))
    with pytest.raises(AssertionError):
        assert_sound(viatool.margin("via", "lab", places=PLACES), via)


def test_what_was_found_is_found_again(via: Margins) -> None:
    again = viatool.margin("via", "lab", places=PLACES)
    first, second = ({**found.to_json(), "seconds": None} for found in (via, again))
    assert first == second
    assert (via.witness == again.witness)[np.isfinite(via.refuted)].all()
    other = viatool.margin("via", "lab", places=PLACES, seed=1)
    assert other.states.tolist() != via.states.tolist()


def test_finished_states_are_kept(tmp_path: Path) -> None:
    asked = {"places": Places(count=300), "resolution": 0.05, "checkpoint": tmp_path / "kept"}
    first = viatool.margin("via", "lab", **asked)
    second = viatool.margin("via", "lab", **asked, resume=True)
    assert first.states.tolist() == second.states.tolist()
    assert first.certified.tolist() == second.certified.tolist()
    assert first.witness_document() == second.witness_document()
    with pytest.raises(ConfigurationError, match="most"):
        viatool.margin("via", "lab", **{**asked, "most": 0.25}, resume=True)


def test_one_channel_errs_while_the_others_stay(via: Margins) -> None:
    alone = viatool.margin("via", "lab", places=PLACES, channels=["lidar"])
    assert alone.states.tolist() == via.states.tolist()
    known = np.isfinite(via.certified)
    assert (
        alone.refuted[known] > via.certified[known]
    ).all()  # a counterexample of fewer errors is one of more
    assert alone.certified[known].sum() > via.certified[known].sum()
    assert alone.deciding_channels() == {"lidar": 1.0}
    worse = viatool.margin("via", "lab", places=PLACES, channels=["lidar"], eps={"goal_cosine": 0.2})
    assert (worse.certified < alone.refuted).all()
    assert worse.certified[known].sum() < alone.certified[known].sum()
    assert worse.eps == {"": 0.0, "goal_cosine": 0.2, "lidar": 0.0}


def test_eps_gives_the_proportions_of_errors_that_grow_together(via: Margins) -> None:
    for eps in (0.01, 0.0):  # of nothing there are no proportions: all err alike
        one = viatool.margin("via", "lab", places=PLACES, eps=eps)
        assert one.certified.tolist() == via.certified.tolist()
    some = viatool.margin("via", "lab", places=PLACES, eps={"lidar": 0.03, "": 0.01})
    assert some.varied.proportions["lidar"] == 1.0
    assert some.varied.proportions["goal_cosine"] == pytest.approx(1.0 / 3.0)
    known = np.isfinite(via.certified)
    assert (some.refuted[known] > via.certified[known]).all()


@pytest.mark.parametrize(
    ("place", "model"),
    [
        ("pose.x", {"pose": {"x": 0.01, "y": 0.0, "theta": 0.0}}),
        ("actuation.linear.absolute", {"actuation": {"linear": {"absolute": 0.01}}}),
        ("sensor.lidar.bias", {"sensor": {"lidar": {"bias": 0.01}}}),
    ],
)
def test_a_term_of_the_error_model_varies(place: str, model: dict[str, object]) -> None:
    errors = ErrorModel.model_validate(model)
    few = Places(count=150)
    found = viatool.margin(
        "via", "lab", places=few, errors=errors, term=place, most=0.1, resolution=0.0125, seed=3
    )
    assert (found.certified < found.refuted).all()
    row = int(found.weakest_first[np.isfinite(found.certified[found.weakest_first])][0])
    state = found.trajectory.select(found.states[row : row + 1])
    for error, verdict in ((found.certified[row], "safe"), (found.refuted[row], "unsafe")):
        if np.isfinite(error):
            said = errors.at(place, float(error))
            result = viatool.verify("via", "lab", eps=0.0, errors=said, trajectory=state)
            assert result.verdict.tolist() == [verdict]


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ({"channels": ["radar"]}, "there is no observation channel 'radar'"),
        ({"channels": ["budget"]}, "channel 'budget' is fixed to 0"),
        ({"channels": ["lidar"], "term": "pose.x"}, "cannot vary at once"),
        ({"term": "pose.x"}, "states no term 'pose.x'"),
        (
            {"term": "timing.delay", "errors": {"timing": {"delay": [0.0, 0.1]}}},
            "is no largest size of an error",
        ),
        ({"term": "pose.theta", "errors": {"pose": {"theta": 0.1}}, "most": 4.0}, "pose.theta cannot be 4"),
        ({"most": 0.0}, "the largest error that is tried is 0"),
        ({"most": float("nan")}, "the largest error that is tried is nan"),
        ({"resolution": 0.0}, "the resolution is 0"),
        ({"resolution": 1.0}, "the resolution is 1"),
        ({"also": [0.6]}, "errors from 0 to 0.5 are tried"),
        ({"criterion": "sampled"}, "proves nothing"),
    ],
)
def test_what_cannot_be_asked_is_refused_by_name(asked: dict[str, object], told: str) -> None:
    if "errors" in asked:
        asked = {**asked, "errors": ErrorModel.model_validate(asked["errors"])}
    with pytest.raises(ConfigurationError, match=told) as caught:
        viatool.margin("via", "lab", places=Places(count=10), **asked)
    assert caught.value.hint


def test_states_that_nothing_endangers_have_no_margin() -> None:
    found = viatool.margin("via", "lab", close=0)
    assert len(found.trajectory) == found.driven > 1000
    assert found.states.shape == found.certified.shape == found.refuted.shape == (0,)
    assert found.witness.shape == (0, 26)
    part = found.to_json()["margins"][0]
    assert (part["contested"], part["certified"]["least"], part["curve"]["proved"][0]) == (0, None, 0)


def test_close_places_have_margins_beside_those_of_the_drive() -> None:
    asked = {"criterion": "braking", "resolution": 0.05}
    found, alone = (viatool.margin("via", "lab", close=count, **asked) for count in (40, 0))
    assert len(alone) > 0
    assert not alone.close.any()
    assert found.close.sum() == 40
    drive = ~found.close
    assert found.states[drive].tolist() == alone.states.tolist()
    assert found.certified[drive].tolist() == alone.certified.tolist()
    assert (found.states[found.close] == found.driven + np.arange(40)).all()
    assert (found.certified < found.refuted).all()
    part = found.to_json()["margins"][0]
    assert (part["contested"], part["close"]["contested"]) == (len(alone), 40)
    assert sum(one["close"] for one in part["contested_states"]) == 40
    assert {one["state"] for one in part["contested_states"] if one["close"]} == set(range(40))
    places = close_places(found.setting, found.trajectory.select(np.arange(found.driven)), 40)
    assert (found.trajectory.poses[found.driven :] == places.poses).all()
    row = int(np.flatnonzero(found.close & np.isfinite(found.refuted) & (found.refuted > 0.0))[0])
    state = places.select(found.states[row : row + 1] - found.driven)
    result = viatool.verify("via", "lab", eps=found.refuted[row], trajectory=state, criterion="braking")
    assert result.verdict.tolist() == ["unsafe"]


def test_where_no_close_places_are_the_report_says_why(via: Margins) -> None:
    part = via.part()
    assert part["close"]["contested"] == 0
    assert "beside which there is no path" in part["close"]["reason"]


def test_recorded_states_are_taken_as_they_are(via: Margins) -> None:
    weakest = via.weakest_first[:10]
    order = np.sort(via.states[weakest])
    recorded: Trajectory = via.trajectory.select(order)
    found = viatool.margin("via", "lab", trajectory=recorded, close=0)
    assert found.states.tolist() == list(range(10))
    rows = np.searchsorted(via.states, order)
    assert found.certified.tolist() == via.certified[rows].tolist()


def test_policies_that_choose_and_that_remember_readings_have_margins(tmp_path: Path) -> None:
    choosing = viatool.margin(write_choosing(tmp_path / "choosing.onnx"), "lab", places=Places(count=300))
    stacked = viatool.margin(*stacked_policy(tmp_path), close=5)
    assert "control intervals before" in stacked.no_close
    for found, world_map in ((choosing, "lab"), (stacked, stacked.world_map)):
        assert len(found) > 3
        assert (found.certified < found.refuted).all()
        row = int(np.flatnonzero(np.isfinite(found.certified) & np.isfinite(found.refuted))[0])
        state = found.states[row]
        for error, verdict in ((found.certified[row], "safe"), (found.refuted[row], "unsafe")):
            result = viatool.verify(found.policy_path, world_map, eps=error, trajectory=found.trajectory)
            assert result.verdict[state] == verdict


def test_errors_without_bounds_are_not_proved_and_stop_nothing(tmp_path: Path) -> None:
    """A policy that takes 1 / distance: an error as large as the distance may make it anything."""
    (tmp_path / "map.yaml").write_text(SQUARE, encoding="utf-8")
    spec = PolicySpecification.model_validate(
        {
            "schema_version": 2,
            "control_interval": 0.1,
            "observation": [{"name": "far", "kind": "goal_distance", "unit": "m", "reciprocal": True}],
            "action": [
                {"name": "v", "unit": "m/s", "lower": 0.0, "upper": 0.5, "kind": "linear"},
                {"name": "omega", "unit": "rad/s", "lower": -1.0, "upper": 1.0, "kind": "angular"},
            ],
        }
    )
    weight = np.array([[0.25], [0.0]])
    write_onnx(Network((Input(1), Affine((0,), (weight,), np.zeros(2)))), spec, tmp_path / "policy.onnx")
    asked = (tmp_path / "policy.onnx", tmp_path / "map.yaml")
    found = viatool.margin(*asked, places=Places(count=1500), most=4.0)
    away = 1.0 / found.trajectory.observations[found.states, 0]
    assert (found.certified < away).all()
    assert (found.certified > 0.1).sum() > 5
    for row in np.flatnonzero(found.certified > 0.1)[:2].tolist():
        state = found.trajectory.select(found.states[row : row + 1])
        result = viatool.verify(*asked, eps=float(found.certified[row]), trajectory=state)
        assert result.verdict.tolist() == ["safe"]
    with pytest.raises(EnclosureError):
        viatool.verify(*asked, eps=4.0, trajectory=found.trajectory.select(found.states))
