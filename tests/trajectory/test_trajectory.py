from __future__ import annotations

import numpy as np
import pytest

from viatool.errors import TrajectoryError
from viatool.policy import PolicySpecification
from viatool.trajectory import Trajectory, load_trajectory, whole_file, write_trajectory


def small_trajectory(**changes):
    generator = np.random.default_rng(0)
    fields = {
        "poses": generator.normal(size=(5, 3)),
        "observations": generator.normal(size=(5, 4)),
        "actions": generator.normal(size=(5, 2)),
        "episode": np.array([0, 0, 0, 1, 1]),
        "time": np.array([0.0, 0.1, 0.2, 0.0, 0.1]),
        "outcomes": np.array(["success", "collision"]),
        "costs": np.array([0.0, np.nan]),
        "scenarios": (None, None),
    }
    return Trajectory(**{**fields, **changes})


def assert_same(left, right):
    for name in ("poses", "observations", "actions", "episode", "time", "outcomes", "costs"):
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name), err_msg=name)


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_a_written_trajectory_reads_back_exactly(tmp_path, suffix):
    path = tmp_path / f"run.{suffix}"
    write_trajectory(path, small_trajectory())
    assert_same(load_trajectory(path), small_trajectory())
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_a_trajectory_without_states_reads_back_as_empty(tmp_path, suffix):
    path = tmp_path / f"run.{suffix}"
    write_trajectory(path, small_trajectory().select(np.zeros(5, dtype=bool)))
    assert len(load_trajectory(path)) == 0


def test_select_keeps_the_episodes():
    chosen = small_trajectory().select(np.array([1, 4]))
    assert (len(chosen), chosen.episodes) == (2, 2)
    np.testing.assert_array_equal(chosen.episode, [0, 1])


def test_episode_labels_of_a_table_are_numbered_as_they_appear(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("episode,time,x,y,theta,observation_0,outcome\nb,0,1,2,3,4,success\na,0,5,6,7,8,\n")
    trajectory = load_trajectory(path)
    np.testing.assert_array_equal(trajectory.episode, [0, 1])
    np.testing.assert_array_equal(trajectory.outcomes, ["success", "unknown"])
    np.testing.assert_array_equal(trajectory.poses, [[1, 2, 3], [5, 6, 7]])
    assert trajectory.actions.shape == (2, 0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"poses": np.zeros((5, 2))}, "'poses' has shape"),
        ({"time": np.zeros(4)}, "'time' has shape"),
        ({"observations": np.full((5, 4), np.inf)}, "row 0, column 0"),
        ({"poses": np.full((5, 3), -np.inf)}, "'poses' holds -inf in row 0, column 0"),
        (
            {"poses": np.array([[0.0, 1e7, 0.0]] * 5)},
            r"pose \[0.0, 10000000.0, 0.0\] in row 0, expected at most 1e",
        ),
        ({"time": np.array([0.0, np.nan, 0.1, 0.0, 0.1])}, "'time' holds nan in row 1"),
        ({"episode": np.array([0, 0, 0, 1, 2])}, "episodes 0 to 2"),
        ({"episode": np.array([0, -1, 0, 1, 1])}, "episodes -1 to 1"),
        ({"outcomes": np.array(["success", "won"])}, "outcome 'won'"),
        ({"time": np.array([0.0, 0.2, 0.1, 0.0, 0.1])}, "clock of episode 0 goes back in row 2"),
    ],
)
def test_a_contradiction_is_named(changes, message):
    with pytest.raises(TrajectoryError, match=message):
        small_trajectory(**changes)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("episode,time,x,y,theta\n0,0,1,2,3\n", "observation_0"),
        ("episode,time,x,y,observation_0\n0,0,1,2,3\n", "lacks the column 'theta'"),
        ("episode,time,x,y,theta,observation_0\n0,0,1,2\n", "row 1 has 4 cells"),
        (
            "episode,time,x,y,theta,observation_0\n0,0,1,2,3,much\n",
            "row 1, column 'observation_0' holds 'much'",
        ),
        ("episode,time,x,y,theta,observation_0\n0,0,1,2,3,nan\n", "finite"),
        ("episode,time,x,x,theta,observation_0\n0,0,1,2,3,4\n", "'x' twice"),
        (
            "episode,time,x,y,theta,observation_0,outcome\n0,0,1,2,3,4,success\n0,1,1,2,3,4,timeout\n",
            "row 2 gives the outcome 'timeout'",
        ),
    ],
)
def test_a_broken_table_gives_one_message_with_its_path(tmp_path, text, message):
    path = tmp_path / "run.csv"
    path.write_text(text)
    with pytest.raises(TrajectoryError, match=message) as caught:
        load_trajectory(path)
    assert str(path) in caught.value.message
    assert caught.value.hint


@pytest.mark.parametrize("kept", [0, 10, 200])
def test_a_cut_off_archive_is_refused(tmp_path, kept):
    path = tmp_path / "run.npz"
    write_trajectory(path, small_trajectory())
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(TrajectoryError, match="not a readable npz archive"):
        load_trajectory(path)


def test_an_archive_of_objects_or_without_poses_is_refused(tmp_path):
    path = tmp_path / "run.npz"
    np.savez(path, pose=np.array([None, {}], dtype=object))
    with pytest.raises(TrajectoryError, match="not a readable npz archive"):
        load_trajectory(path)
    np.savez(path, observation=np.zeros((1, 2)))
    with pytest.raises(TrajectoryError, match="lacks the array 'pose'"):
        load_trajectory(path)


def test_a_state_table_is_a_trajectory(tmp_path):
    path = tmp_path / "states.npz"
    np.savez(path, pose=np.ones((3, 3)), observation=np.ones((3, 2)), verdict=np.array(["safe"] * 3))
    trajectory = load_trajectory(path)
    assert (len(trajectory), trajectory.episodes) == (3, 1)
    np.testing.assert_array_equal(trajectory.outcomes, ["unknown"])


HEADER = "episode,time,x,y,theta,observation_0\n"


def test_rows_of_episodes_may_alternate_but_the_clock_of_each_runs_forward(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(HEADER + "a,0,1,2,3,4\nb,7,1,2,3,4\na,1,1,2,3,4\nb,8,1,2,3,4\n")
    trajectory = load_trajectory(path)
    assert trajectory.episode.tolist() == [0, 1, 0, 1]
    assert trajectory.notes == ()
    path.write_text(HEADER + "a,0,1,2,3,4\nb,7,1,2,3,4\na,1,1,2,3,4\nb,6,1,2,3,4\n")
    with pytest.raises(TrajectoryError, match="clock of episode 1 goes back in row 3"):
        load_trajectory(path)


def test_rows_that_stand_twice_are_told(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(HEADER + "a,0,1,2,3,4\nb,0,1,2,3,4\na,0,1,2,3,4\na,0,1,2,3,5\nb,1,1,2,3,4\n")
    assert load_trajectory(path).notes == (
        "1 rows are the same as the one before in their episode, and count again",
    )


def test_unknown_suffixes_and_missing_files_are_refused(tmp_path):
    with pytest.raises(TrajectoryError, match="is not a file"):
        load_trajectory(tmp_path / "none.npz")
    with pytest.raises(TrajectoryError, match=r"ends in '\.txt'"):
        write_trajectory(tmp_path / "run.txt", small_trajectory())


def test_a_failed_write_leaves_the_old_file_alone(tmp_path):
    path = tmp_path / "report.json"
    path.write_text("old")

    def fail_halfway():
        with whole_file(path) as draft:
            draft.write_text("half of the n")
            raise RuntimeError("broken")

    with pytest.raises(RuntimeError, match="broken"):
        fail_halfway()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("frames", "own", "names"),
    [
        (
            {"count": 2, "stride": 2, "order": "oldest_first"},
            None,
            ["scan_0_before_2", "scan_1_before_2", "x_before_2", "scan_0", "scan_1", "observed_x"],
        ),
        (
            None,
            {"count": 2, "order": "newest_first"},
            ["scan_0", "scan_1", "scan_0_before_1", "scan_1_before_1", "observed_x"],
        ),
    ],
)
def test_a_table_of_frames_names_every_number_and_reads_back(tmp_path, frames, own, names):
    """Also where a channel has the name of a column that every table has."""
    specification = PolicySpecification.model_validate(
        {
            "schema_version": 2,
            "observation": [
                {
                    "name": "scan",
                    "kind": "lidar",
                    "size": 2,
                    "frames": own,
                    "lidar": {"angles": [0.0, 1.0], "rays": 2, "maximum_range": 3.0},
                },
                {"name": "x", "kind": "goal_x"},
            ],
            "frames": frames,
            "action": [
                {"name": "y", "kind": "linear", "lower": 0.0, "upper": 1.0},
                {"name": "omega", "kind": "angular", "lower": -1.0, "upper": 1.0},
            ],
        }
    )
    observations = np.random.default_rng(3).uniform(0.1, 3.0, (5, len(names)))
    trajectory = small_trajectory(observations=observations)
    write_trajectory(tmp_path / "run.csv", trajectory, specification)
    header = (tmp_path / "run.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert header[5 : 5 + len(names)] == names
    assert header[5 + len(names) :][:2] == ["command_y", "omega"]
    assert_same(load_trajectory(tmp_path / "run.csv", specification), trajectory)
