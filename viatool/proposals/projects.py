"""Observations and commands of public projects, told by their sizes.

What is stated of each is what its environment does, as its source says; a policy of the same sizes may well come from
another program, so everything here is a guess and is said to be one.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from viatool.proposals.layout import PI, VECTORS, Channel, Layout, command, one, scan, twist
from viatool.proposals.proposal import Guess


def _drlnav() -> Layout:
    diagonal = round(math.hypot(4.2, 4.2), 6)
    lidar = {"start": 0.0, "step": round(6.28 / 39, 9), "rays": 40, "maximum_range": 3.5}
    return Layout(
        "turtlebot3_drlnav",
        [
            scan(40, lidar, unit="m", scale=1.0 / 3.5),
            one("goal_distance", unit="m", scale=1.0 / diagonal, clip=[0.0, 1.0]),
            one("goal_bearing", unit="rad", scale=1.0 / PI),
            one("previous", "previous_raw", size=2),
        ],
        twist((0.0, 0.22), 2.0, scaled=True),
        2,
        (
            Guess("the arena's diagonal is 5.94 m", "ARENA_LENGTH and ARENA_WIDTH in settings.py"),
            Guess(
                "40 rays once around from straight ahead, ending at 6.28 rad", "the LiDAR in the robot's SDF"
            ),
        ),
        (
            Guess(
                "the robot does not reverse",
                "with ENABLE_BACKWARD, linear is lower -0.22, scale 0.22, offset 0",
            ),
            Guess("the limits are 0.22 m/s and 2 rad/s", "SPEED_LINEAR_MAX and SPEED_ANGULAR_MAX"),
        ),
    )


def _gaps() -> Layout:
    return Layout(
        "DRL-robot-navigation",
        [
            scan(20, {"field_of_view": PI, "rays": 180, "bins": 20, "maximum_range": 10.0}, unit="m"),
            one("goal_distance", unit="m"),
            one("goal_bearing", unit="rad"),
            one("previous_linear", unit="m/s"),
            one("previous_angular", unit="rad/s"),
        ],
        twist((0.0, 1.0), 1.0, scaled=True),
        2,
        (
            Guess(
                "20 gaps over the 180 degrees ahead, from right to left",
                "velodyne_callback of the environment",
            ),
        ),
        (Guess("the speed is (output + 1) / 2, up to 1 m/s", "a_in where the environment is stepped"),),
    )


def _bins() -> Layout:
    return Layout(
        "DRL-Robot-Navigation-ROS2",
        [
            scan(20, {"field_of_view": PI, "rays": 180, "bins": 20, "maximum_range": 7.0}, unit="m"),
            one("goal_distance", unit="m"),
            one("goal_cosine"),
            one("goal_sine"),
            one("previous_linear", unit="m/s"),
            one("previous_angular", unit="rad/s"),
        ],
        twist((0.0, 0.5), 1.0, scaled=True),
        2,
        (
            Guess(
                "nothing is divided",
                "prepare_state; the IR-SIM version divides ranges by 7 and the distance by 10, and scales the command "
                "before by 2 and to (omega + 1) / 2: give `scale` and `offset`",
            ),
        ),
        (Guess("the speed is (output + 1) / 4, up to 0.5 m/s", "a_in where the environment is stepped"),),
    )


def _own() -> Layout:
    lidar = {"field_of_view": PI, "rays": 180, "bins": 20, "minimum_range": 0.2, "maximum_range": 7.0}
    return Layout(
        "viatool, of VIA's task",
        [
            scan(20, lidar, unit="m"),
            one("goal_distance", unit="m"),
            one("goal_cosine"),
            one("goal_sine"),
            one("previous_linear", unit="m/s"),
            one("previous_angular", unit="rad/s"),
            one("budget"),
        ],
        twist((0.0, 0.5), 1.0, scaled=True),
        2,
        (
            Guess(
                "20 bins, each the least of nine rays over 180 degrees, to 7 m",
                "where the policy was trained",
            ),
            Guess(
                "the last number is the budget of the constraint",
                "give its `value`, to which training converged",
            ),
        ),
        (Guess("the limits are 0 to 0.5 m/s and 1 rad/s", "the robot's limits"),),
    )


def _robotis(outputs: int = 5) -> Layout:
    ahead = [*range(12), *range(36, 48)]
    angles = [round(index * 6.28 / 47, 6) for index in ahead]
    return Layout(
        "ROBOTIS turtlebot3_dqn (ROS 2)",
        [
            one("goal_distance", unit="m"),
            one("goal_bearing", unit="rad"),
            scan(24, {"angles": angles, "maximum_range": 3.5}, unit="m"),
        ],
        [
            {
                "name": "command",
                "kind": "choice",
                "axes": ["linear", "angular"],
                "commands": [[0.2, turn] for turn in (1.5, 0.75, 0.0, -0.75, -1.5)],
            }
        ],
        outputs,
        (
            Guess(
                "the goal comes first, then 24 rays in the order 0 to 90, 270 to 360 degrees",
                "calculate_state",
            ),
            Guess(
                "the scan has 48 rays once around from straight ahead, ending at 6.28 rad",
                "angle_min of the scan",
            ),
        ),
        (Guess("the five commands are 0.2 m/s with 1.5, 0.75, 0, -0.75, -1.5 rad/s", "angular_vel"),),
    )


def _robotis_first() -> Layout:
    lidar = {"start": 0.0, "step": round(2.0 * math.pi / 24, 9), "rays": 24, "maximum_range": 3.5}
    second = _robotis()
    turns = [{**second.action[0], "commands": [[0.15, t] for t in (1.5, 0.75, 0.0, -0.75, -1.5)]}]
    return Layout(
        "ROBOTIS turtlebot3_dqn (ROS 1)",
        [
            scan(24, lidar, unit="m"),
            one("goal_bearing", unit="rad"),
            one("goal_distance", unit="m"),
            one("nearest_range", "other", unit="m"),
            one("nearest_direction", "other"),
        ],
        turns,
        5,
        (
            Guess("24 rays once around from straight ahead", "samples of the LiDAR in the robot's xacro"),
            Guess("the least range and its index come last; viatool does not fill them", "getState"),
        ),
        (
            Guess(
                "the five commands are 0.15 m/s with 1.5, 0.75, 0, -0.75, -1.5 rad/s",
                "max_angular_vel in step",
            ),
        ),
    )


def _collision_avoidance() -> Layout:
    lidar = {"field_of_view": PI, "rays": 512, "maximum_range": 6.0}
    return Layout(
        "rl-collision-avoidance",
        [
            scan(
                512,
                lidar,
                unit="m",
                scale=1.0 / 6.0,
                offset=-0.5,
                frames={"count": 3, "order": "oldest_first"},
            ),
            one("goal_x", unit="m"),
            one("goal_y", unit="m"),
            one("linear_velocity", unit="m/s"),
            one("angular_velocity", unit="rad/s"),
        ],
        twist((0.0, 1.0), 1.0, scaled=False),
        2,
        (
            Guess(
                "three scans of 512 rays over 180 degrees, oldest first, / 6 m - 0.5", "get_laser_observation"
            ),
        ),
        (Guess("the limits are 1 m/s and 1 rad/s", "action_bound"),),
    )


def _irsim() -> Layout:
    return Layout(
        "DRL-robot-navigation-IR-SIM, with a convolutional network",
        [
            scan(180, {"field_of_view": PI, "rays": 180, "maximum_range": 7.0}, unit="m", scale=1.0 / 7.0),
            one("goal_distance", unit="m", scale=0.1),
            one("goal_cosine"),
            one("goal_sine"),
            one("previous_linear", unit="m/s", scale=2.0),
            one("previous_angular", unit="rad/s", scale=0.5, offset=0.5),
        ],
        twist((0.0, 0.5), 1.0, scaled=True),
        2,
        (Guess("ranges are divided by 7 m, the distance by 10 m", "prepare_state"),),
        (Guess("the speed is (output + 1) / 4, up to 0.5 m/s", "a_in where the environment is stepped"),),
    )


def _arena() -> Layout:
    return Layout(
        "Arena (rosnav-rl), a robot that cannot move sideways",
        [
            scan(360, _AROUND, unit="m"),
            one("goal_distance", unit="m"),
            one("goal_bearing", unit="rad"),
            one("previous_linear", unit="m/s"),
            one("previous_sideways", "constant", value=0.0),
            one("previous_angular", unit="rad/s"),
        ],
        twist((0.0, 0.5), 1.5, scaled=True),
        2,
        (
            Guess(
                "the subgoal comes as distance and angle, then the last action (x, y, turn)",
                "the encoder's spaces",
            ),
            Guess(
                "360 rays once around, the first behind the robot, to 8 m",
                "laser in the robot's model parameters",
            ),
        ),
        (Guess("the limits are 0 to 0.5 m/s and 1.5 rad/s", "actions in the robot's model parameters"),),
    )


def _arena_holonomic() -> Layout:
    return Layout(
        "Arena (rosnav-rl), a robot that moves sideways",
        [
            scan(360, _AROUND, unit="m"),
            one("goal_x", unit="m"),
            one("goal_y", unit="m"),
            one("previous_linear", unit="m/s"),
            one("previous_lateral", unit="m/s"),
            one("previous_angular", unit="rad/s"),
        ],
        _sideways(0.5, 1.5),
        3,
        (
            Guess(
                "the subgoal comes as x and y in the robot's frame, then the last action",
                "the encoder's spaces",
            ),
            Guess(
                "360 rays once around, the first behind the robot, to 8 m",
                "laser in the robot's model parameters",
            ),
        ),
        (Guess("the limits are 0.5 m/s each way and 1.5 rad/s", "actions in the robot's model parameters"),),
    )


def _navrep() -> Layout:
    lidar = {"field_of_view": 2.0 * math.pi, "rays": 1080, "maximum_range": 25.0}
    return Layout(
        "NavRep",
        [
            scan(1080, lidar, unit="m", scale=0.04, clip=[0.0, 1.0]),
            one("goal_x", unit="m"),
            one("goal_y", unit="m"),
            one("linear_velocity", unit="m/s"),
            one("lateral_velocity", unit="m/s"),
            one("angular_velocity", unit="rad/s"),
        ],
        _sideways(0.5, 1.0),
        3,
        (
            Guess("1080 rays once around, as shares of 25 m", "the encoder's observation"),
            Guess("goal and velocity come in the robot's frame", "the environment's robot state"),
        ),
        (Guess("the limits are 0.5 m/s each way and 1 rad/s", "the environment's action"),),
    )


def _ros_jackal() -> Layout:
    lidar = {"field_of_view": round(1.5 * PI, 9), "rays": 720, "minimum_range": 0.1, "maximum_range": 30.0}
    return Layout(
        "ros_jackal (BARN)",
        [
            scan(720, lidar, unit="m", scale=0.5, offset=-1.0, clip=[-1.0, 1.0]),
            one("goal_x", unit="m", scale=0.2),
            one("goal_y", unit="m", scale=0.2),
        ],
        twist((0.0, 2.0), 3.14, scaled=True),
        2,
        (
            Guess("720 rays over 270 degrees, clipped at 4 m, to [-1, 1]", "laser_clip of the environment"),
            Guess(
                "the goal comes as x and y in the robot's frame, divided by 5 m",
                "the environment's observation",
            ),
        ),
        (Guess("the limits are 0 to 2 m/s and 3.14 rad/s", "range_dict of the environment"),),
    )


def _f1tenth() -> Layout:
    lidar = {
        "field_of_view": 4.7,
        "rays": 1080,
        "bins": 20,
        "reduce": "first",
        "maximum_range": 30.0,
    }
    frames = {"count": 2, "order": "newest_first"}
    return Layout(
        "f1tenth_drl, from end to end",
        [
            scan(20, lidar, unit="m", scale=0.1, clip=[0.0, 1.0], frames=frames),
            one("linear_velocity", unit="m/s", scale=0.125),
        ],
        [
            command("steering", "rad", (-0.4, 0.4), scaled=True),
            command("linear", "m/s", (0.0, 8.0), scaled=False) | {"scale": 3.5, "offset": 4.5},
        ],
        2,
        (
            Guess(
                "two frames of 20 of 1080 rays over 4.7 rad, as shares of 10 m, newest first", "scan_buffer"
            ),
            Guess("the speed is divided by 8 m/s", "max_speed"),
        ),
        (Guess("steering comes first, up to 0.4 rad; the speed is 3.5 * output + 4.5", "transform_action"),),
    )


def _isaac_lab() -> Layout:
    return Layout(
        "Isaac Lab's navigation task",
        [
            *VECTORS["base_lin_vel"],
            *VECTORS["projected_gravity"],
            *VECTORS["pose_command"],
        ],
        _sideways(1.0, 1.0, scaled=False),
        3,
        (Guess("base velocity, projected gravity, pose command, on flat ground", "the observation group"),),
        (Guess("vx, vy and omega, as they come, up to 1", "the action of the pre-trained walker"),),
    )


_AROUND = {"start": -PI, "step": round(2.0 * math.pi / 360, 9), "rays": 360, "maximum_range": 8.0}


def _sideways(speed: float, turn: float, *, scaled: bool = True) -> list[Channel]:
    """Return the commands of a robot that moves sideways."""
    return [
        command("linear", "m/s", (-speed, speed), scaled),
        command("lateral", "m/s", (-speed, speed), scaled),
        command("angular", "rad/s", (-turn, turn), scaled),
    ]


LAYOUTS: tuple[Callable[[], Layout], ...] = (
    _drlnav,
    _gaps,
    _bins,
    _own,
    _robotis,
    _robotis_first,
    _collision_avoidance,
    _irsim,
    _arena,
    _arena_holonomic,
    _navrep,
    _ros_jackal,
    _f1tenth,
    _isaac_lab,
)


def known_layout(inputs: int, outputs: int) -> Layout | None:
    """Return the project whose policies have these sizes; None where none is known."""
    return next(
        (layout for make in LAYOUTS if ((layout := make()).inputs, layout.outputs) == (inputs, outputs)), None
    )
