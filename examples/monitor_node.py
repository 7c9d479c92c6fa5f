"""A ROS 2 node between a policy and its robot: what passes is proved, else the robot brakes. See docs/monitor.md.

    python3 examples/monitor_node.py --ros-args -p map:=lab.yaml -p pose_error:="[0.03, 0.03, 0.02]" -p delay:=0.1 \
        -r cmd_vel_in:=policy/cmd_vel -r cmd_vel:=robot/cmd_vel

The node takes the policy's commands from ``cmd_vel_in``, where the robot is from tf (``map`` to ``base_link``), and
sends one command in every control interval of the map to ``cmd_vel``. With a command that is older than two
intervals, or a pose that is older than ``pose_age`` seconds, nothing passes. ``pose_error`` has to hold when the
decision is made, the age of the pose included, and ``delay`` to hold all that a command takes from there to the
wheels. Let the base stop by itself when this node falls silent, as most do.
"""

from __future__ import annotations

import math

import viatool


def main() -> None:
    """Run the node until it is stopped."""
    import rclpy
    from geometry_msgs.msg import Twist
    from rclpy.node import Node
    from rclpy.time import Time
    from tf2_ros import Buffer, TransformException, TransformListener

    class MonitorNode(Node):
        def __init__(self) -> None:
            super().__init__("viatool_monitor")
            error = self.declare_parameter("pose_error", [0.05, 0.05, 0.05]).value
            self.pose_age = self.declare_parameter("pose_age", 0.2).value
            pose = dict(zip(("x", "y", "theta"), map(float, error), strict=True))
            self.monitor = viatool.Monitor(
                None,
                self.declare_parameter("map", "lab").value,
                errors=viatool.ErrorModel.model_validate({"pose": pose}),
                delay=float(self.declare_parameter("delay", 0.0).value),
            )
            self.interval = self.monitor.setting.rules.interval
            self.asked, self.since = (math.nan, math.nan), -math.inf
            self.frames = Buffer()
            self.listener = TransformListener(self.frames, self)
            self.sender = self.create_publisher(Twist, "cmd_vel", 1)
            self.create_subscription(Twist, "cmd_vel_in", self.listen, 1)
            self.create_timer(self.interval, self.decide)

        def now(self) -> float:
            return self.get_clock().now().nanoseconds * 1e-9

        def listen(self, message: Twist) -> None:
            self.asked, self.since = (message.linear.x, message.angular.z), self.now()

        def pose(self) -> tuple[float, float, float]:
            try:
                found = self.frames.lookup_transform("map", "base_link", Time())
            except TransformException:
                return (math.nan,) * 3
            stamp, place, turn = found.header.stamp, found.transform.translation, found.transform.rotation
            if self.now() - (stamp.sec + stamp.nanosec * 1e-9) > self.pose_age:
                return (math.nan,) * 3
            theta = math.atan2(2.0 * (turn.w * turn.z + turn.x * turn.y), 1.0 - 2.0 * (turn.y**2 + turn.z**2))
            return place.x, place.y, theta

        def decide(self) -> None:
            fresh = self.now() - self.since <= 2.0 * self.interval
            found = self.monitor.decide(self.pose(), self.asked if fresh else (math.nan, math.nan))
            message = Twist()
            message.linear.x, message.angular.z = map(float, found.command)
            self.sender.publish(message)
            if not found.passed:
                self.get_logger().info(
                    f"{found.source}: {found.asked} did not pass", throttle_duration_sec=1.0
                )
            if not found.proved:
                self.get_logger().warning(
                    "nothing is proved of where the robot stands", throttle_duration_sec=1.0
                )

    rclpy.init()
    rclpy.spin(MonitorNode())


if __name__ == "__main__":
    main()
