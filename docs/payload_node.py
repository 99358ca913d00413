"""A node of ROS 2 that publishes what an arm carries, from its joint states."""

import numpy as np
import rclpy
from geometry_msgs.msg import InertiaStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState

from sdp_vs_penalty import PayloadEstimator, load_estimate


class PayloadNode(Node):
    def __init__(self):
        super().__init__("payload")
        estimate = load_estimate("model.json")
        self.names = estimate.robot.joint_names
        self.estimator = PayloadEstimator.calibrated(
            estimate, "without_load.csv", 1000.0
        )
        self.publisher = self.create_publisher(InertiaStamped, "inertia", 10)
        self.create_subscription(JointState, "joint_states", self.take, 10)

    def take(self, state):
        place = [state.name.index(name) for name in self.names]
        q, tau = [[x[k] for k in place] for x in (state.position, state.effort)]
        t = state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec
        if change := self.estimator.update(t, q, tau):
            self.get_logger().info(str(change))
        message = InertiaStamped(header=state.header)
        if payload := self.estimator.payload:
            message.inertia.m = payload.mass
            for name, value in zip("xyz", payload.com.tolist(), strict=True):
                setattr(message.inertia.com, name, value)
            names = "ixx", "ixy", "ixz", "iyy", "iyz", "izz"
            moments = payload.inertia[np.triu_indices(3)].tolist()
            for name, value in zip(names, moments, strict=True):
                setattr(message.inertia, name, value)
        self.publisher.publish(message)


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(PayloadNode())
