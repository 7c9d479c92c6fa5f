"""Proposals from sizes: they add up, load, and say what was guessed."""

from __future__ import annotations

from pathlib import Path

import onnx
import pytest
import yaml
from onnx import TensorProto, helper

from tests.policy.models import model_of, node, save, two_layers
from viatool.errors import PolicyError
from viatool.policy import PolicySpecification, describe, load_policy, load_specification
from viatool.proposals import PolicyFacts, propose_by_size, specification_text
from viatool.proposals.projects import LAYOUTS, known_layout
from viatool.samples import POLICIES

POLAR = ["lidar", "goal_distance", "goal_bearing"]
BEFORE = ["previous_linear", "previous_angular"]
DIRECTION = ["lidar", "goal_distance", "goal_cosine", "goal_sine"]
SIDEWAYS = ["previous_linear", "previous_lateral", "previous_angular"]
VELOCITIES = ["linear_velocity", "lateral_velocity", "angular_velocity"]
SIZES = [
    (24, 2, "DRL-robot-navigation", [*POLAR, *BEFORE]),
    (25, 2, "DRL-Robot-Navigation-ROS2", [*DIRECTION, *BEFORE]),
    (26, 2, "viatool, of VIA's task", [*DIRECTION, *BEFORE, "budget"]),
    (185, 2, "DRL-robot-navigation-IR-SIM", [*DIRECTION, *BEFORE]),
    (44, 2, "turtlebot3_drlnav", [*POLAR, "previous_raw"]),
    (26, 5, "ROBOTIS turtlebot3_dqn (ROS 2)", ["goal_distance", "goal_bearing", "lidar"]),
    (28, 5, "ROBOTIS turtlebot3_dqn (ROS 1)", ["lidar", "goal_bearing", "goal_distance", "other", "other"]),
    (1540, 2, "rl-collision-avoidance", ["lidar", "goal_x", "goal_y", "linear_velocity", "angular_velocity"]),
    (
        365,
        2,
        "Arena (rosnav-rl), a robot that cannot",
        [*POLAR, "previous_linear", "constant", "previous_angular"],
    ),
    (365, 3, "Arena (rosnav-rl), a robot that moves", ["lidar", "goal_x", "goal_y", *SIDEWAYS]),
    (1085, 3, "NavRep", ["lidar", "goal_x", "goal_y", *VELOCITIES]),
    (722, 2, "ros_jackal (BARN)", ["lidar", "goal_x", "goal_y"]),
    (41, 2, "f1tenth_drl", ["lidar", "linear_velocity"]),
    (28, 2, "28 = 24 rays + 4", [*POLAR, *BEFORE]),
    (40, 2, "40 = 36 rays + 4", [*POLAR, *BEFORE]),
    (362, 2, "362 = 360 rays + 2", POLAR),
    (725, 3, "725 = 720 rays + 5", [*DIRECTION, *BEFORE]),
    (1083, 2, "1083 = 1080 rays + 3", DIRECTION),
    (1538, 2, "1538 = 3 frames of 512 rays + 2", POLAR),
    (72, 2, "72 = 3 x 24: 3 whole observations", [*POLAR, *BEFORE]),
    (1456, 2, "1456 = 4 x 364: 4 whole observations", [*POLAR, *BEFORE]),
]


@pytest.mark.parametrize(("inputs", "outputs", "words", "kinds"), SIZES, ids=[case[2] for case in SIZES])
def test_sizes_that_are_known(
    inputs: int, outputs: int, words: str, kinds: list[str], tmp_path: Path
) -> None:
    text = propose_by_size(PolicyFacts(inputs, outputs, squashed=True)).to_yaml()
    sidecar = tmp_path / "robot.yaml"
    sidecar.write_text(text, encoding="utf-8")
    spec = load_specification(sidecar)
    assert (spec.schema_version, spec.observation_size, spec.action_size) == (2, inputs, outputs)
    assert [channel.kind for channel in spec.observation] == kinds
    assert words in text
    assert "viatool doctor" in text
    head = [line for line in text.splitlines() if line.startswith("#")]
    assert any(line.startswith("# GUESSED") for line in head)


def test_each_project_is_found_by_its_sizes() -> None:
    layouts = [make() for make in LAYOUTS]
    assert [known_layout(each.inputs, each.outputs) for each in layouts] == layouts


def test_a_tanh_at_the_end_is_scaled_to_the_limits_and_commands_are_not() -> None:
    squashed = propose_by_size(PolicyFacts(362, 2, squashed=True)).action
    assert [(a["scale"], a["offset"]) for a in squashed] == [(0.25, 0.25), (1.0, 0.0)]
    commands = propose_by_size(PolicyFacts(362, 2)).action
    assert all("scale" not in action for action in commands)


def test_three_numbers_are_a_holonomic_robot_and_more_are_a_choice() -> None:
    three = propose_by_size(PolicyFacts(362, 3, squashed=True)).action
    assert [action["kind"] for action in three] == ["linear", "lateral", "angular"]
    (choice,) = propose_by_size(PolicyFacts(362, 7)).action
    assert choice["kind"] == "choice"
    assert len(choice["commands"]) == 7


def test_commands_that_no_file_says_have_to_be_filled_in(tmp_path: Path) -> None:
    proposal = propose_by_size(PolicyFacts(362, 7, chooses=True))
    sidecar = tmp_path / "robot.yaml"
    sidecar.write_text(proposal.to_yaml(), encoding="utf-8")
    with pytest.raises(PolicyError, match=r"robot.yaml:\d+: action.0.commands.0.0") as refusal:
        load_specification(sidecar)
    assert "number" in refusal.value.message
    filled = proposal.to_yaml().replace("[FILL_IN, FILL_IN]", "[0.2, 0.5]")
    sidecar.write_text(filled, encoding="utf-8")
    assert load_specification(sidecar).action_size == 7
    # a policy that a file says to be a choice gets no project's commands either
    assert not propose_by_size(PolicyFacts(26, 5, chooses=True)).is_complete


def test_a_stack_of_whole_observations_is_one_entry() -> None:
    proposal = propose_by_size(PolicyFacts(100, 2, squashed=True))
    spec = PolicySpecification.model_validate(proposal.document)
    assert spec.frames is not None
    assert (spec.frames.count, spec.observation_size) == (4, 100)


def test_kinds_of_actions_stay_where_a_file_states_their_limits() -> None:
    proposal = propose_by_size(PolicyFacts(41, 2, limits=((-0.3, 0.3), (0.0, 5.0)), chooses=False))
    assert [(a["kind"], a["upper"]) for a in proposal.action] == [("steering", 0.3), ("linear", 5.0)]


def test_the_names_of_several_inputs_tell_their_kinds(tmp_path: Path) -> None:
    nodes = [
        node("Concat", ["laser", "goal_distance", "goal_angle"], ["all"], axis=1),
        node("Tanh", ["all"], ["y"]),
    ]
    graph = model_of(nodes)
    del graph.graph.input[:]
    for name, size in (("laser", 4), ("goal_distance", 1), ("goal_angle", 1)):
        graph.graph.input.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size]))
    path = save(graph, tmp_path)
    (tmp_path / "robot.yaml").write_text(specification_text(describe(path)), encoding="utf-8")
    spec = load_policy(path, tmp_path / "robot.yaml").spec
    assert spec is not None
    assert [channel.kind for channel in spec.observation] == ["lidar", "goal_distance", "goal_bearing"]
    assert spec.input == ["laser", "goal_distance", "goal_angle"]


def test_limits_that_a_file_states_are_taken() -> None:
    proposal = propose_by_size(PolicyFacts(44, 2, limits=((-0.1, 0.3), (-1.5, 1.5)), chooses=False))
    assert [(a["lower"], a["upper"]) for a in proposal.action] == [(-0.1, 0.3), (-1.5, 1.5)]
    assert all("scale" not in action for action in proposal.action)
    assert "SPEED_LINEAR_MAX" not in proposal.to_yaml()


def test_sizes_that_are_not_known_give_a_template_that_loads(tmp_path: Path) -> None:
    path = save(two_layers(), tmp_path)
    sidecar = tmp_path / "robot.yaml"
    sidecar.write_text(specification_text(describe(path)), encoding="utf-8")
    spec = load_specification(sidecar)
    assert (spec.observation_size, spec.action_size) == (4, 2)
    assert spec.output is None
    assert load_policy(path, sidecar).spec == spec
    assert "goal_distance" in sidecar.read_text()  # the kinds to choose from
    with pytest.raises(PolicyError, match="wave"):
        specification_text(
            describe(save(model_of([node("Sin", ["x"], ["y"], name="wave")]), tmp_path, "sin.onnx"))
        )


def test_the_proposal_names_the_chosen_output(tmp_path: Path) -> None:
    nodes = [node("Tanh", ["x"], ["action"]), node("ReduceSum", ["x"], ["value"])]
    path = save(model_of(nodes, outputs=("action", "value")), tmp_path)
    sidecar = tmp_path / "robot.yaml"
    sidecar.write_text(specification_text(describe(path, output_name="action")), encoding="utf-8")
    assert load_policy(path, sidecar).output_size == 4


def test_a_policy_with_a_specification_keeps_it() -> None:
    text = specification_text(describe("via"))
    spec = load_policy("via").spec
    assert spec is not None
    assert yaml.safe_load(text)["schema_version"] == spec.schema_version
    assert "GUESSED" not in text


def test_commands_that_the_graph_bounds_have_these_limits(tmp_path: Path) -> None:
    foreign = onnx.load(POLICIES.find("via"))
    del foreign.metadata_props[:]
    path = save(foreign, tmp_path)
    document = yaml.safe_load(specification_text(describe(path)))
    assert [(a["kind"], a["lower"], a["upper"]) for a in document["action"]] == [
        ("linear", 0.0, 0.5),
        ("angular", -1.0, 1.0),
    ]
    assert all("scale" not in action for action in document["action"])
    assert "budget" in [channel["kind"] for channel in document["observation"]]
