"""Wrong readings of a policy that drives well are found, and named; right ones are left alone."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tests.bags import drive_messages, write_bag
from tests.doctor.layouts import AHEAD, AROUND, LAYOUTS, PLAIN, Layout, plants
from tests.report.page.test_page import Outline
from viatool.channels import Quantities, View
from viatool.cli import main
from viatool.doctor import Diagnosis, diagnose, scenarios_of
from viatool.doctor.evidence import Driven
from viatool.doctor.interpretation import Interpretation
from viatool.errors import ConfigurationError, EmptyEvaluationError, PolicyError, TrajectoryError
from viatool.policy import Policy, PolicySpecification, load_policy, load_specification
from viatool.report import Check
from viatool.report.diagnoses.run import DiagnosisRun
from viatool.schedule import Deadline
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import drive
from viatool.trajectory import BagSettings, Trajectory, write_trajectory
from viatool.world import Scenes, WorldMap, load_map

LAB = load_map("maps/lab.yaml")
SCENARIOS = scenarios_of(LAB, 24, 0)
PLANTED = {(layout.name, what): spec for layout in LAYOUTS for what, spec in plants(layout)}


@pytest.fixture(scope="module")
def policies(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Policy]:
    folder = tmp_path_factory.mktemp("layouts")
    return {layout.name: load_policy(layout.write(folder)) for layout in LAYOUTS}


def means(diagnosis: Diagnosis, layout: Layout) -> bool:
    """Whether the best reading is the right one."""
    found = diagnosis.ranking.best.interpretation
    return found.meaning == Interpretation(layout.spec).meaning


def is_reported(diagnosis: Diagnosis, layout: Layout) -> bool:
    """Whether the right reading is named, or among those that driving cannot tell from the one that is."""
    right = Interpretation(layout.spec).meaning
    (name,) = [
        one.interpretation.name for one in diagnosis.ranking.examined if one.interpretation.meaning == right
    ]
    document = DiagnosisRun(diagnosis)
    return name in (document.best.name, *document.alike)


def wrong(policies: dict[str, Policy], layout: Layout, what: str) -> Policy:
    return replace(policies[layout.name], spec=PLANTED[layout.name, what])


@pytest.mark.parametrize(
    ("layout", "what"),
    [
        (AROUND, "ray start +0.25"),
        (AHEAD, "ray order"),
        (PLAIN, "flipped turn"),
    ],
    ids=lambda part: getattr(part, "name", part),
)
def test_a_wrong_reading_is_found_and_named(policies: dict[str, Policy], layout: Layout, what: str) -> None:
    diagnosis = diagnose(wrong(policies, layout, what), LAB, SCENARIOS)
    assert diagnosis.verdict == "another"
    assert means(diagnosis, layout)
    assert diagnosis.edits
    assert ("docs/lidar.md" in DiagnosisRun(diagnosis).advice) is what.startswith("ray ")


def test_a_right_specification_is_kept(policies: dict[str, Policy]) -> None:
    diagnosis = diagnose(policies["plain"], LAB, SCENARIOS)
    assert diagnosis.verdict == "specified"
    assert not diagnosis.edits


def test_a_wrong_scale_that_drives_the_same_is_reported_as_not_told_apart(
    policies: dict[str, Policy],
) -> None:
    diagnosis = diagnose(wrong(policies, AROUND, "actions not scaled"), LAB, SCENARIOS[:12])
    assert diagnosis.verdict in ("specified", "undecided")
    assert is_reported(diagnosis, AROUND)
    document = DiagnosisRun(diagnosis)
    assert "outputs normalised to [-1, 1]" in (document.best.name, *document.alike)
    told = dict(document.facts)["not told apart"]
    assert all(name in told for name in document.alike[:12])
    assert "only a recording of commands can tell" in told


def test_the_page_holds_finding_picture_and_every_reading_and_needs_no_network(
    policies: dict[str, Policy],
) -> None:
    document = DiagnosisRun(diagnose(wrong(policies, AHEAD, "mirrored bearing"), LAB, SCENARIOS[:8]))
    page = document.page((Check("overall >= 0.9", passed=False, figures="0 of 8"),))
    elements = Outline(page).elements
    references = [a[name] for _, a in elements for name in ("src", "href", "srcset") if name in a]
    assert [each[:24] for each in references] == ["#explorer", "data:image/svg+xml;base6"]
    assert "Gate failed" in page
    assert "observation.goal_bearing.scale" in page
    assert len([a for tag, a in elements if tag == "tr" and "data-alike" in a]) == len(
        document.record.readings
    )
    assert "Figures drawn with Bokeh" not in page
    assert len(page) < 2_000_000  # no plotting library


def test_what_is_in_doubt_is_driven_again_on_other_scenarios(policies: dict[str, Policy]) -> None:
    diagnosis = diagnose(wrong(policies, PLAIN, "flipped turn"), LAB, SCENARIOS[:5])
    again = diagnosis.ranking.again
    assert again is not None  # five scenarios cannot be clear among so many readings
    assert len(again.evidence.outcomes) == 20
    assert diagnosis.verdict == "another"
    assert means(diagnosis, PLAIN)


def recording(policy: Policy, spec: PolicySpecification) -> Trajectory:
    """What a robot observes by a specification while the policy drives it rightly."""
    setting = Setting.of(policy, LAB, 0.0, Wishes(prefer={"lidar": "policy"}), SCENARIOS[:6])
    driven = drive(policy, setting, noise=0.0).trajectory
    scenes = Scenes.of(LAB, SCENARIOS[:6])
    goals = np.array([scenario.goal for scenario in SCENARIOS[:6]])[driven.episode]
    begins = np.diff(driven.episode, prepend=-1) != 0
    spots = {action.kind: number for number, action in enumerate(policy.spec.action)}
    commands = driven.actions[:, [spots["linear"], spots["angular"]]]
    previous = np.where(begins[:, None], 0.0, np.roll(commands, 1, axis=0))
    view = View(scenes, driven.poses, driven.episode, goals, previous)
    return replace(driven, observations=Quantities.of(spec.observation, LAB.robot).measure(view))


@pytest.mark.parametrize(
    ("layout", "what"),
    [
        (AROUND, "ray start +0.25"),
        (AHEAD, "ray order"),
        (AHEAD, "mirrored bearing"),
        (AROUND, "degrees"),
        (AHEAD, "ranges in metres"),
        (PLAIN, "ranges normalised twice"),
    ],
    ids=lambda part: getattr(part, "name", part),
)
def test_a_recording_tells_without_a_simulator(
    policies: dict[str, Policy], layout: Layout, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy = wrong(policies, layout, what)
    states = recording(policies[layout.name], policy.spec)
    monkeypatch.setattr("viatool.doctor.course.drive", None)
    diagnosis = diagnose(policy, LAB, trajectory=states)
    assert diagnosis.verdict == "another"
    assert means(diagnosis, layout)
    assert diagnosis.ranking.best.evidence.merit > -1e-4


@pytest.mark.parametrize(
    ("layout", "what"),
    [(PLAIN, "flipped turn"), (AHEAD, "actions swapped"), (AROUND, "actions not scaled")],
    ids=lambda part: getattr(part, "name", part),
)
def test_recorded_commands_tell_of_the_actions(
    policies: dict[str, Policy], layout: Layout, what: str
) -> None:
    policy = wrong(policies, layout, what)
    states = recording(policies[layout.name], layout.spec)
    names = [action.name for action in layout.spec.action]
    order = [names.index(action.name) for action in policy.spec.action]
    diagnosis = diagnose(policy, LAB, trajectory=replace(states, actions=states.actions[:, order]))
    assert diagnosis.verdict == "another"
    assert means(diagnosis, layout)


def test_a_bag_is_read_again_under_every_reading(policies: dict[str, Policy], tmp_path: Path) -> None:
    messages, _ = drive_messages(policies["plain"], LAB)
    bag = write_bag(tmp_path / "run", messages, "mcap")
    settings = BagSettings(goal=LAB.scenarios[0].goal)
    right = diagnose(policies["plain"], LAB, trajectory=bag, bag=settings)
    assert right.verdict == "specified"
    turned = diagnose(wrong(policies, PLAIN, "ray order"), LAB, trajectory=bag, bag=settings)
    assert turned.verdict == "another"
    assert means(turned, PLAIN)


def test_rays_that_were_not_recorded_tell_nothing(policies: dict[str, Policy]) -> None:
    states = recording(policies["plain"], PLAIN.spec)
    diagnosis = diagnose(policies["plain"], LAB, trajectory=states)
    names = [one.interpretation.name for one in diagnosis.ranking.examined]
    assert diagnosis.verdict == "specified"
    assert "rays in reversed order" in names
    assert not [name for name in names if name.startswith(("scan begins", "scan a quarter turn"))]


def test_two_mistakes_are_found_together(policies: dict[str, Policy]) -> None:
    mirrored = PLANTED["plain", "mirrored bearing"].channel("goal_sine")
    observation = [
        mirrored if channel.name == "goal_sine" else channel
        for channel in PLANTED["plain", "ranges normalised twice"].observation
    ]
    spec = PLAIN.spec.model_copy(update={"observation": observation})
    states = recording(policies["plain"], spec)
    diagnosis = diagnose(replace(policies["plain"], spec=spec), LAB, trajectory=states)
    assert diagnosis.verdict == "another"
    assert means(diagnosis, PLAIN)
    assert len(diagnosis.ranking.best.interpretation.changes) == 2


def test_workers_change_nothing(policies: dict[str, Policy]) -> None:
    policy = wrong(policies, PLAIN, "ray order")
    states = recording(policies["plain"], policy.spec)
    ranked = [diagnose(policy, LAB, trajectory=states, workers=workers).ranking for workers in (1, 2)]
    alone, shared = (
        [(one.interpretation.name, one.evidence.merit) for one in ranking.examined] for ranking in ranked
    )
    assert alone == shared


def test_a_map_without_a_generator_turns_its_starts(lab_without_generator: WorldMap) -> None:
    found = scenarios_of(lab_without_generator, 25, 0)
    assert len(found) == 25
    assert len({scenario.name for scenario in found}) == 25
    assert [scenario.name for scenario in found[:10]] == [scenario.name for scenario in LAB.scenarios]
    assert found[10].start[:2] == LAB.scenarios[0].start[:2]
    with pytest.raises(ConfigurationError, match="has no scenarios"):
        scenarios_of(replace(lab_without_generator, scenarios=()), 25, 0)


@pytest.fixture
def lab_without_generator() -> WorldMap:
    return replace(LAB, generator=None)


def test_what_cannot_be_compared_is_refused(policies: dict[str, Policy]) -> None:
    policy = policies["plain"]
    states = recording(policy, PLAIN.spec)
    with pytest.raises(TrajectoryError, match="0 numbers for each command"):
        diagnose(policy, LAB, trajectory=replace(states, actions=np.zeros((len(states), 0))))
    with pytest.raises(TrajectoryError, match="25 observation entries"):
        diagnose(policies["around"], LAB, trajectory=states)
    with pytest.raises(EmptyEvaluationError):
        diagnose(policy, LAB, trajectory=states.select(np.zeros(len(states), bool)))
    with pytest.raises(PolicyError, match="no specification"):
        diagnose(replace(policy, spec=None), LAB, SCENARIOS)


def test_the_command_reports_and_passes(policies: dict[str, Policy], tmp_path: Path) -> None:
    policy = policies["plain"]
    (tmp_path / "wrong.yaml").write_text(PLANTED["plain", "mirrored bearing"].to_yaml(), encoding="utf-8")
    write_trajectory(tmp_path / "run.npz", recording(policy, PLANTED["plain", "mirrored bearing"]))
    arguments = ["doctor", str(policy.path), "--map", "maps/lab.yaml", "--spec", str(tmp_path / "wrong.yaml")]
    recorded = ["--trajectory", str(tmp_path / "run.npz"), "--write-spec", str(tmp_path / "right.yaml")]
    outputs = [f"json:{tmp_path}/report.json", f"png:{tmp_path}/report.png", f"csv:{tmp_path}/report.csv"]
    done = CliRunner().invoke(main, [*arguments, *recorded, *(part for o in outputs for part in ("-o", o))])
    assert done.exit_code == 0, done.output
    assert "warning: another reading is clearly better: bearing mirrored" in done.stderr
    assert "observation.goal_sine.scale: 1 instead of -1" in done.stderr
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert (report["method"], report["verdict"]) == ("recorded", "another")
    assert report["readings"][report["best"]]["edits"] == [
        {"key": "observation.goal_sine.scale", "now": "1", "was": "-1"}
    ]
    assert (tmp_path / "report.png").read_bytes().startswith(b"\x89PNG")
    assert len((tmp_path / "report.csv").read_text(encoding="utf-8").splitlines()) > 10
    right = load_specification(tmp_path / "right.yaml")
    assert Interpretation(right).meaning == Interpretation(PLAIN.spec).meaning
    again = ["--spec", str(tmp_path / "right.yaml"), "--scenarios", "2", "--time-limit", "0.5", "-q"]
    done = CliRunner().invoke(main, [*arguments[:4], *again, "-o", f"figure:{tmp_path}/drive.svg"])
    assert done.exit_code == 0, done.output
    assert (tmp_path / "drive.svg").exists()


def wandering(folder: Path) -> Policy:
    """Write a policy as it is before its training: small random weights."""
    import stable_baselines3
    from gymnasium import Env
    from gymnasium.spaces import Box

    from viatool.importing import ImportRequest, import_policy

    class Yard(Env):
        observation_space = Box(-10.0, 10.0, (38,), np.float32)
        action_space = Box(np.float32([0.0, -1.0]), np.float32([0.5, 1.0]))

    model = stable_baselines3.TD3("MlpPolicy", Yard(), policy_kwargs={"net_arch": [8]}, device="cpu", seed=0)
    model.save(folder / "model.zip")
    done = import_policy(ImportRequest(folder / "model.zip", None, None), folder / "model.onnx")
    spec = folder / "spec.yaml"
    spec.write_text(done.proposal.to_yaml(), encoding="utf-8")
    return load_policy(folder / "model.onnx", spec)


def test_a_policy_that_gets_nowhere_is_left_after_one_change_and_not_called_wrongly_read(
    tmp_path: Path,
) -> None:
    pytest.importorskip("stable_baselines3")
    policy = wandering(tmp_path)
    told: list[float] = []
    diagnosis = diagnose(
        policy, LAB, SCENARIOS[:8], horizon=40, progress=lambda _, done, *__: told.append(done)
    )
    assert diagnosis.verdict == "none"
    assert diagnosis.ranking.best is diagnosis.ranking.specified
    assert all(len(one.interpretation.changes) <= 1 for one in diagnosis.ranking.examined)
    document = DiagnosisRun(diagnosis)
    assert "no more changes were tried" in dict(document.facts)["not tried"]
    assert max(told) == len(diagnosis.ranking.examined)


def test_readings_with_several_changes_are_begun_while_there_is_time(
    policies: dict[str, Policy], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Driven, "is_good", False)  # whatever is found, more is wanted
    policy = policies["plain"]
    diagnosis = diagnose(policy, LAB, SCENARIOS[:4], until=Deadline.after(0.0))
    assert all(len(one.interpretation.changes) <= 1 for one in diagnosis.ranking.examined)
    assert diagnosis.ranking.stopped.startswith("the time was up")
