"""The node for ROS 2, driven by stand-ins for what it imports: only what is decided reaches the wheels."""

from __future__ import annotations

import math
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

import viatool

ROOT = Path(__file__).resolve().parents[2]
START = viatool.load_map("lab").scenarios[0].start


class Twist:
    def __init__(self, v=0.0, omega=0.0):
        self.linear, self.angular = SimpleNamespace(x=v), SimpleNamespace(z=omega)


class Ground:
    """The clock, the frames and the topics of one node."""

    def __init__(self):
        self.time, self.pose, self.stamp, self.sent, self.said = 100.0, START, 100.0, [], []
        self.parameters = {"map": str(ROOT / "maps" / "lab.yaml"), "pose_error": [0.03, 0.03, 0.02]}
        self.node = None

    def modules(self):
        ground = self

        class Node:
            def __init__(self, name):
                ground.node = self

            def declare_parameter(self, name, default):
                return SimpleNamespace(value=ground.parameters.get(name, default))

            def get_clock(self):
                return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=ground.time * 1e9))

            def create_publisher(self, kind, topic, depth):
                return SimpleNamespace(publish=ground.sent.append)

            def create_subscription(self, kind, topic, heard, depth):
                ground.hear = heard

            def create_timer(self, seconds, tick):
                ground.seconds, ground.tick = seconds, tick

            def get_logger(self):
                return SimpleNamespace(
                    info=lambda text, **_: ground.said.append(text),
                    warning=lambda text, **_: ground.said.append(text),
                )

        class TransformException(Exception):  # noqa: N818  # as tf2 calls it
            pass

        class Buffer:
            def lookup_transform(self, target, source, when):
                if ground.pose is None:
                    raise TransformException("no frame")
                x, y, theta = ground.pose
                turn = SimpleNamespace(x=0.0, y=0.0, z=math.sin(theta / 2), w=math.cos(theta / 2))
                stamp = SimpleNamespace(sec=int(ground.stamp), nanosec=(ground.stamp % 1) * 1e9)
                place = SimpleNamespace(translation=SimpleNamespace(x=x, y=y), rotation=turn)
                return SimpleNamespace(header=SimpleNamespace(stamp=stamp), transform=place)

        return {
            "rclpy": {"init": lambda: None, "spin": lambda node: None},
            "rclpy.node": {"Node": Node},
            "rclpy.time": {"Time": object},
            "geometry_msgs": {},
            "geometry_msgs.msg": {"Twist": Twist},
            "tf2_ros": {
                "Buffer": Buffer,
                "TransformException": TransformException,
                "TransformListener": lambda frames, node: None,
            },
        }


@pytest.fixture
def ground(monkeypatch):
    made = Ground()
    for name, content in made.modules().items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    runpy.run_path(str(ROOT / "examples" / "monitor_node.py"))["main"]()
    return made


def tick(ground, asked=None, later=0.1):
    ground.time += later
    ground.stamp = ground.time
    if asked is not None:
        ground.hear(Twist(*asked))
    ground.tick()
    return ground.sent[-1].linear.x, ground.sent[-1].angular.z


def test_commands_pass_where_the_robot_can_stop_and_else_it_brakes(ground):
    assert ground.seconds == 0.1
    assert tick(ground, (0.5, 0.0)) == (0.5, 0.0)
    ground.pose = (
        3.079 - 0.75 - 0.55,
        0.53,
        0.0,
    )  # in front of an obstacle of the first scenario, not of the map
    assert tick(ground, (0.3, 0.1)) == (0.3, 0.1)
    ground.pose = (4.4, 0.0, 0.0)  # in front of the wall
    speeds = [tick(ground, (0.5, 0.0))[0] for _ in range(7)]
    assert speeds[0] < 0.3
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[-1] == 0.0
    assert any("brake" in text for text in ground.said)


def test_without_a_fresh_command_or_a_fresh_pose_the_robot_brakes(ground):
    tick(ground, (0.5, 0.0))
    assert tick(ground)[0] == 0.5  # the command is an interval old
    assert tick(ground, later=0.3)[0] < 0.5
    tick(ground, (0.5, 0.0))
    ground.pose = None
    assert tick(ground, (0.5, 0.0))[0] < 0.5
    ground.pose = START
    tick(ground, (0.5, 0.0))
    ground.time += 1.0
    ground.hear(Twist(0.5, 0.0))
    ground.tick()  # the pose is a second old
    assert ground.sent[-1].linear.x < 0.5
