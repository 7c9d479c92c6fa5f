"""Whole missions: proved ones hold every run that an oracle drives, refuted ones can be driven again."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import count

import numpy as np
import pytest

from tests.choosing import write_choosing
from tests.hall import write_policy
from tests.loop.noisy_runs import runs, sensor_errors
from viatool import load_policy
from viatool.cli import main
from viatool.errors import ConfigurationError
from viatool.loop import successor
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.successor import states_of
from viatool.missions import MissionLimits, cells, follow, mission
from viatool.missions.cells import CellSides
from viatool.missions.directions import BoundedParts, PoseDirections
from viatool.missions.families import directions_of
from viatool.missions.follow import MissionFollower, MissionProof, MissionTube, best
from viatool.missions.work import MissionExamination
from viatool.schedule import Campaign, Deadline
from viatool.sets.forms import Forms, PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.setting.driven import DrivenPolicy
from viatool.setting.setting import Setting
from viatool.sight import windows
from viatool.uncertainty import ErrorModel
from viatool.world import Scenario

EPS, START = 0.01, (0.02, 0.02)
LIMIT = 9.0
ROUNDING = 1e-7
RUNS = 1500


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    return load_policy(write_policy(tmp_path_factory.mktemp("policies") / "straight.onnx"))


@pytest.fixture(scope="module")
def proved(hall, dodging):
    return mission(dodging, hall, eps=EPS, start_error=START, time_limit=LIMIT)


def driven(hall, policy, scenario, steps, seed=0, setting=None):
    """Poses (R, K, 3) of adversarial runs of the oracle, from corners and the inside of the box of starts."""
    generator = np.random.default_rng(seed)
    share = generator.uniform(-1.0, 1.0, (RUNS, 3))
    share[::2] = np.sign(share[::2])
    starts = np.array(scenario.start) + share * np.array([START[0], START[0], START[1]])
    radii = (setting or Setting.of(policy, hall, EPS)).radii
    errors = sensor_errors(generator, radii, RUNS, steps)
    return runs(policy, hall, scenario, (starts, np.zeros((RUNS, 2))), errors)[0]


def outside(tube, found, scenario, radius=0.5):
    """By how much runs that have not arrived leave every part of their interval, at most."""
    goal, worst = np.array(scenario.goal), 0.0
    going = np.ones(len(found), dtype=bool)
    for k in range(found.shape[1]):
        going &= np.hypot(*(found[:, k, :2] - goal).T) >= radius
        if not going.any():
            break
        parts = tube.step == k + 1
        if not parts.any():
            return np.inf
        poses = found[going, k][:, None]
        over = np.maximum(tube.lower[parts, :3] - poses, poses - tube.upper[parts, :3])
        worst = max(worst, float(over.max(axis=2).min(axis=1).max()))
    return worst


def test_both_missions_of_the_hall_are_proved(proved):
    assert [one.verdict for one in proved] == ["proved", "proved"]
    for one in proved:
        assert one.clearance > 0.4
        assert one.proof.earliest <= one.arrived.min() <= one.arrived.max() <= one.steps
        assert one.reason == ""


def test_every_run_of_an_oracle_stays_in_its_tube_and_arrives(hall, dodging, proved):
    for one in proved:
        found = driven(hall, dodging, one.scenario, one.steps)
        assert outside(one.proof.tube, found, one.scenario) < ROUNDING
        goal = np.array(one.scenario.goal)
        near = np.hypot(*np.moveaxis(found[:, :, :2] - goal, 2, 0)) < 0.5
        assert near.any(axis=1).all()
        assert near.argmax(axis=1).min() + 1 >= one.proof.earliest


def follower(hall, dodging, sides=None):
    examination = MissionExamination(
        dodging, Setting.of(dodging, hall, EPS), (0.02, 0.02, 0.02), 0.5, MissionLimits(90), "float32", 0
    )
    scenario = hall.scenarios[0]
    loop = ClosedLoop.of(dodging, examination.setting, scenario)
    return MissionFollower(loop, 0.5, MissionLimits(90)), examination.starts(scenario), scenario


def forget_eps(monkeypatch, some):
    object.__setattr__(some.loop.sensors, "radii", None)


def drop_a_part(monkeypatch, some):
    honest = CellSides.divide

    def divide(self, states, bounds, directions):
        parts = honest(self, states, bounds, directions)
        return parts.select(np.arange(len(parts)) != len(parts) // 2)

    monkeypatch.setattr(CellSides, "divide", divide)


def join_to_the_first(monkeypatch, some):
    honest = np.minimum.reduceat, np.maximum.reduceat
    from viatool.missions import cells

    def first_alone(cell, lower, upper):
        _, first = np.unique(cell, axis=0, return_index=True)
        return cell[first], lower[first], upper[first]

    assert honest
    monkeypatch.setattr(cells, "_merged", first_alone)


def cut_without_spread(monkeypatch, some):
    from viatool.missions import cells

    honest = cells._regression

    def narrow(states, rows, quantity):
        middle, slope, spread = honest(states, rows, quantity)
        return middle, slope, 0.5 * spread

    monkeypatch.setattr(cells, "_regression", narrow)


def halve_the_rest(monkeypatch, some):
    honest = CellSides.divide

    def divide(self, states, bounds, directions):
        middle, half = 0.5 * (bounds[0] + bounds[1]), 0.25 * (bounds[1] - bounds[0])
        return honest(self, states, (middle - half, middle + half), directions)

    monkeypatch.setattr(CellSides, "divide", divide)


def carry_without_errors(monkeypatch, some):
    honest = BoundedParts.carried

    def carried(self, source, origin, after):
        low, high, rest = honest(self, source, origin, after)
        return low, high, 0.2 * rest

    monkeypatch.setattr(BoundedParts, "carried", carried)


def tighten_too_far(monkeypatch, some):
    honest = PoseDirections.tightened

    def tightened(self, lower, upper):
        low, high = honest(self, lower, upper)
        narrow = (high - low < upper - lower) & (np.arange(low.shape[1]) < 3)
        return np.where(narrow, low + 0.2 * (high - low), low), np.where(
            narrow, high - 0.2 * (high - low), high
        )

    monkeypatch.setattr(PoseDirections, "tightened", tightened)


def forget_the_other_axes(monkeypatch, some):
    from viatool.missions import directions

    monkeypatch.setattr(directions, "_sum", lambda terms: terms[0])


def cut_and_lose_a_rim(monkeypatch, some):
    honest = BoundedParts.halved

    def halved(self):
        parts = honest(self)
        return parts.select(np.arange(len(parts)) >= len(parts) // 2)

    monkeypatch.setattr(BoundedParts, "halved", halved)
    monkeypatch.setattr("viatool.missions.follow._FAR", -1.0)
    finer = MissionLimits(90, parts=1000, finer=1)
    monkeypatch.setattr(
        MissionFollower, "_ways", lambda self: list(honest_ways(replace(self, limits=finer)))[1:]
    )
    object.__setattr__(some, "limits", finer)


honest_ways = MissionFollower._ways


def lose_the_far_side(monkeypatch, some):
    honest = windows.sides_of

    def nearer_alone(gaps, most):
        found = honest(gaps, most)
        first = np.unique(found.row, return_index=True)[1] if found is not None else []
        return found and windows.Sides(
            found.row[first], {name: one.select(first) for name, one in found.windows.items()}
        )

    monkeypatch.setattr("viatool.channels.quantities.sides_of", nearer_alone)


def arrive_early(monkeypatch, some):
    object.__setattr__(some, "goal_radius", 0.6)


@pytest.mark.parametrize(
    "mutate",
    [
        forget_eps,
        drop_a_part,
        join_to_the_first,
        cut_without_spread,
        halve_the_rest,
        carry_without_errors,
        tighten_too_far,
        forget_the_other_axes,
        cut_and_lose_a_rim,
        lose_the_far_side,
        arrive_early,
    ],
)
def test_runs_of_the_oracle_catch_what_a_tube_leaves_out(hall, dodging, monkeypatch, mutate):
    some, (lower, upper), scenario = follower(hall, dodging)
    mutate(monkeypatch, some)
    found = driven(hall, dodging, scenario, 90)
    assert outside(some.prove(lower, upper).tube, found, scenario) > 10 * ROUNDING


@pytest.mark.parametrize("side", [0.03, 0.1, 0.7])
def test_cells_cover_sets_from_end_to_end_whatever_their_ends_round_to(side):
    generator, sides = np.random.default_rng(0), CellSides(np.array([side, side, side]))
    for _ in range(200):
        ends = np.nextafter(
            side * generator.integers(-40, 40, (2, 3)), generator.choice([-np.inf, 0.0, np.inf])
        )
        low, high = np.sort(ends, axis=0)
        low, high = low[None], np.minimum(high, low + 2.0 * side)[None]
        box = Forms.between(low, high)
        parts = sides.divide(
            Forms(box.centre, box.slope, box.rest * (1.0 + 1e-12) + 1e-12), (low, high), PoseDirections.none()
        )
        lower, upper = parts.lower, parts.upper
        assert (lower.min(axis=0) <= low[0]).all()
        assert (upper.max(axis=0) >= high[0]).all()
        volume = np.prod(upper - lower, axis=1).sum()
        assert volume == pytest.approx(np.prod(high - low), abs=1e-9 * side**3)


def test_cells_become_coarser_along_every_side_where_there_would_be_too_many(monkeypatch):
    """Half of the sets reach over a border, however long cells are; commands are cut as poses are."""
    monkeypatch.setattr(cells, "_MOST_PIECES", 4)
    lower, upper = np.full((2, 5), -0.3), np.full((2, 5), 0.3)
    lower[1] = 0.01
    box = StateBoxes(
        PoseBoxes((lower + upper)[:, :3] / 2, (upper - lower)[:, :3] / 2), lower[:, 3:], upper[:, 3:]
    )
    sides = CellSides(np.array([0.1, 0.1, 0.1, 0.01, 0.01]))
    found = sides.divide(states_of(box), (lower, upper), PoseDirections.none())
    assert 1 < len(found) <= 2 * 2**5
    for q in np.random.default_rng(0).uniform(-0.3, 0.3, (500, 5)):
        assert ((found.lower <= q) & (q <= found.upper)).all(axis=1).any()


def test_parts_that_are_cut_for_their_interval_cover_what_they_are_cut_of(hall, dodging):
    """Every pose of a part is in one of its eighths, and each eighth steps on from its own box."""
    some, (lower, upper), _ = follower(hall, dodging)
    directions = directions_of(some, lower, upper)[5]
    generator = np.random.default_rng(0)
    middle = np.concatenate([directions.origin, np.zeros(2)])
    reach = np.array([[0.02, 0.03, 0.04, 0.02, 0.02]])
    low, high = directions.beside_boxes(middle - reach, middle + reach)
    count = low.shape[1] - len(directions)
    low[:, count:] += 0.3 * (high - low)[:, count:]  # an oblique side, which leaves corners out
    parts = BoundedParts(low, high, directions)
    poses = generator.uniform(low[0, :3], high[0, :3], (4000, 3))
    coordinates = (poses - directions.origin) @ directions.rows.T
    inside = ((coordinates >= low[0, count:]) & (coordinates <= high[0, count:])).all(axis=1)
    assert 50 < inside.sum() < 4000
    eighths = parts.halved()
    over = np.maximum(eighths.lower[:, None, :3] - poses, poses - eighths.upper[:, None, :3]).max(axis=2)
    assert (over.min(axis=0)[inside] < 1e-12).all()
    assert (over.min(axis=0)[~inside] > 1e-6).any()


def test_each_command_that_may_be_chosen_is_followed(hall, tmp_path):
    """Runs of the oracle under a policy that chooses stay in its tube, in which sets part at each choice."""
    policy = load_policy(write_choosing(tmp_path / "choosing.onnx"))
    few = replace(hall.scenarios[1], start=(-1.5, -2.0, 0.5))
    found = mission(
        policy, hall, eps=EPS, start_error=START, scenarios=[few], time_limit=4.0, goal_radius=1.5
    )
    one = found.missions[0]
    assert one.verdict == "proved"
    sent = DrivenPolicy(policy, found.setting.choice, found.setting.overrides)
    paths = driven(hall, sent, few, one.steps, setting=found.setting)
    assert outside(one.proof.tube, paths, few, radius=1.5) < ROUNDING
    tube = one.proof.tube
    assert any(len(np.unique(tube.upper[tube.step == k, 4])) > 1 for k in range(1, one.steps))


def test_a_run_that_collides_refutes_and_can_be_driven_again(hall, straight, tmp_path, capsys):
    witnesses = tmp_path / "w.json"
    arguments = ["mission", str(straight.path), "--map", str(hall.path), "--scenario", "0", "--eps", "0.01"]
    with pytest.raises(SystemExit) as left:
        main([*arguments, "--time-limit", "9", "-o", f"witnesses:{witnesses}", "--max-unsafe", "0"])
    assert left.value.code == 1
    assert "a run comes within" in capsys.readouterr().out
    with pytest.raises(SystemExit) as left:
        main(["replay", str(witnesses), "--map", str(hall.path)])
    assert left.value.code == 0


def test_a_run_that_is_late_refutes(hall, straight):
    found = mission(straight, hall, eps=EPS, scenarios=hall.scenarios[1:], time_limit=3.0)
    assert found.missions[0].verdict == "refuted"
    assert "still on its way after 3 s" in found.missions[0].reason


def test_too_few_parts_leave_a_mission_unknown_with_its_place(hall, dodging):
    few = MissionLimits(90, parts=5, finer=0)
    found = mission(dodging, hall, eps=EPS, start_error=START, scenarios=hall.scenarios[1:], limits=few)
    assert found.missions[0].verdict == "unknown"
    assert "too many parts" in found.missions[0].reason
    assert "x -1.4" in found.missions[0].reason


def test_missions_that_are_not_proved_begin_again_in_more_parts(hall, dodging, monkeypatch):
    tried = []
    follow = MissionFollower._follow
    monkeypatch.setattr(
        MissionFollower, "_follow", lambda self, *given: tried.append(given[3]) or follow(self, *given)
    )
    few = MissionLimits(90, parts=16, finer=3)
    given = {"eps": EPS, "start_error": START, "scenarios": hall.scenarios[:1], "limits": few}
    assert mission(dodging, hall, **given, clearance=0.44).missions[0].verdict == "unknown"
    assert tried == [1, 4, 8]  # once more in as many would find the same


def test_a_clearance_that_no_run_keeps_is_not_proved(hall, dodging):
    found = mission(
        dodging,
        hall,
        eps=EPS,
        start_error=START,
        scenarios=hall.scenarios[:1],
        clearance=0.495,
        time_limit=LIMIT,
    )
    assert found.missions[0].verdict != "proved"


def test_what_is_not_begun_in_time_is_unknown(hall, dodging):
    found = mission(dodging, hall, eps=EPS, until=Deadline.after(0.0))
    assert [one.verdict for one in found] == ["unknown", "unknown"]
    assert found.to_json()["mission_rate"] == {"safe": 0, "total": 2, "rate": 0.0}


def test_a_mission_is_given_up_within_an_interval(monkeypatch, hall, dodging):
    """Sets of an interval are followed some at a time, and the time is looked at before each."""
    monkeypatch.setattr(successor, "_MOST_NUMBERS", 1)  # one set at a time
    monkeypatch.setattr(follow, "check_time", lambda: None)  # not only between intervals
    looks = count()
    until = Deadline.after(100.0, lambda: float(next(looks)))
    found = mission(dodging, hall, eps=EPS, start_error=START, scenarios=hall.scenarios[:1], until=until)
    assert found.missions[0].verdict == "unknown"
    assert "before it was done" in found.missions[0].reason
    assert next(looks) < 200


def test_a_stopped_run_goes_on_from_its_checkpoint(hall, dodging, proved, tmp_path):
    first = Campaign(checkpoint=tmp_path / "kept")
    given = {"eps": EPS, "start_error": START, "time_limit": LIMIT}
    mission(dodging, hall, **given, campaign=first)
    again = mission(dodging, hall, **given, campaign=replace(first, resume=True))
    for one, other in zip(proved, again, strict=True):
        ours, theirs = one.to_json(), other.to_json()
        assert {**ours, "seconds": 0} == {**theirs, "seconds": 0}
        np.testing.assert_array_equal(one.proof.tube.lower, other.proof.tube.lower)


def test_different_scenarios_of_one_name_are_refused_and_the_same_one_twice_is_not(hall, dodging, tmp_path):
    """A checkpoint tells scenarios apart by their names: what was proved of one was found of the other."""
    here, there = (Scenario("one", (-1.0, -2.0, turn), (0.0, -2.0)) for turn in (0.0, 0.1))
    with pytest.raises(ConfigurationError, match="scenario 1, counted from 0, is called 'one'"):
        mission(dodging, hall, eps=0.01, scenarios=[here, there])
    for resume in (False, True):
        kept = Campaign(checkpoint=tmp_path / "kept", resume=resume)
        twice = mission(dodging, hall, eps=0.01, scenarios=[here, replace(here)], campaign=kept)
        assert [one.verdict for one in twice] == ["proved", "proved"]


def test_starts_of_the_error_model_are_those_of_the_option(hall, dodging, proved):
    model = ErrorModel.model_validate({"start": {"x": 0.02, "y": 0.02, "theta": 0.02}})
    found = mission(dodging, hall, eps=EPS, errors=model, scenarios=hall.scenarios[:1], time_limit=LIMIT)
    np.testing.assert_array_equal(found.missions[0].proof.tube.lower, proved.missions[0].proof.tube.lower)
    with pytest.raises(ConfigurationError, match="start"):
        mission(dodging, hall, eps=EPS, errors=model, start_error=(0.1, 0.1))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"clearance": 2.0}, "starts at .* from an obstacle"),
        ({"goal_radius": 4.0}, "starts within 4 m of its goal"),
        ({"time_limit": 0.01}, "time limit is 0.01 s"),
        ({"criterion": "sampled"}, "proves nothing"),
        ({"start_error": (-0.1, 0.0)}, "start error"),
        ({"errors": ErrorModel.model_validate({"obstacles": {"returns": 1.0}})}, "obstacles.returns"),
    ],
)
def test_what_cannot_be_asked_is_refused_before_any_work(hall, dodging, given, said):
    with pytest.raises(ConfigurationError, match=said):
        mission(dodging, hall, eps=EPS, **given)


@pytest.mark.parametrize(
    "given",
    [
        {"position": 0.0},
        {"heading": 1e-20},
        {"position": np.nan},
        {"position": -1.0},
        {"parts": 0},
        {"finer": -1},
        {"steps": -1},
    ],
)
def test_limits_that_no_cells_keep_are_refused(given):
    with pytest.raises(ConfigurationError):
        MissionLimits(**{"steps": 0} | given)


def test_a_cell_of_no_length_is_refused_by_name(hall, dodging, capsys):
    arguments = ["mission", str(dodging.path), "--map", str(hall.path), "--eps", "0.01", "--cell", "0,0"]
    with pytest.raises(SystemExit) as left:
        main(arguments)
    assert left.value.code == 2
    assert "the largest cells are 0 m and 0 rad long, expected at least 1e-06 each" in capsys.readouterr().err


def test_the_report_holds_the_contract(hall, dodging, tmp_path):
    report, tube, picture = (tmp_path / name for name in ("m.json", "t.npz", "m.png"))
    arguments = [
        "mission",
        str(dodging.path),
        "--map",
        str(hall.path),
        "--eps",
        "0.01",
        "--start-error",
        "0.02,0.02",
    ]
    outputs = [
        "-o",
        f"json:{report}",
        "-o",
        f"tube:{tube}",
        "-o",
        f"figure:{picture}",
        "-o",
        f"junit:{tmp_path / 'j.xml'}",
    ]
    with pytest.raises(SystemExit) as left:
        main([*arguments, "--time-limit", "9", *outputs, "--fail-under", "mission=1.0", "-q"])
    assert left.value.code == 0
    content = json.loads(report.read_text(encoding="utf-8"))
    assert content["mission_rate"] == {"safe": 2, "total": 2, "rate": 1.0}
    wanted = {"scenario", "verdict", "steps", "seconds", "clearance", "parts", "start_parts", "reason"}
    assert all(wanted <= one.keys() for one in content["missions"])
    with np.load(tube) as arrays:
        assert set(arrays["scenario"]) == {"past", "clear"}
        assert arrays["lower"].shape == arrays["upper"].shape
        assert (arrays["lower"] <= arrays["upper"]).all()
        assert arrays["step"].min() == 1
    assert picture.stat().st_size > 10_000


def test_a_proved_mission_whose_sets_are_wide_of_driven_runs_is_followed_again(hall, dodging, monkeypatch):
    some, (lower, upper), _ = follower(hall, dodging)
    some = replace(some, limits=MissionLimits(90), attained=np.full((2, 3), 0.1))
    for extent, expected in ((0.4, 1), (0.6, 2)):
        ends = np.zeros((2, 5)), np.full((2, 5), extent)
        found = [
            MissionProof(proved, 3, 1, 0.5, 1, 1, "", MissionTube(np.array([1, 2]), *ends))
            for proved in (True, False)
        ]
        left = iter(found)
        monkeypatch.setattr(MissionFollower, "_follow", lambda self, *given, left=left: next(left))
        some = replace(some, limits=MissionLimits(90, finer=1))
        tried = list(some.attempts(lower, upper))
        assert len(tried) == expected
        assert best(tried) is found[0]
