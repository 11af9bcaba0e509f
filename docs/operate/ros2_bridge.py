"""Publishes palmd's estimate in ROS 2: palms and object as joint states. Needs ROS 2 (rclpy), pyzmq and msgpack."""

import msgpack
import rclpy
import zmq
from sensor_msgs.msg import JointState

PALMD = "tcp://127.0.0.1:9872"
NAMES = {
    "phi1": ("phi1_rad", "omega1_rad_s"),
    "phi2": ("phi2_rad", "omega2_rad_s"),
    "object": ("psi_rad", "omega0_rad_s"),
}


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("palmd")
    publisher = node.create_publisher(JointState, "palmd/joint_states", 10)
    socket = zmq.Context().socket(zmq.SUB)
    socket.connect(PALMD)
    socket.subscribe("palm/estimate")
    while rclpy.ok():
        if not socket.poll(100):
            continue
        estimate = msgpack.unpackb(socket.recv_multipart()[1])
        if not estimate["valid"]:
            continue
        message = JointState(name=list(NAMES))
        message.header.stamp = rclpy.time.Time(seconds=estimate["timestamp"]).to_msg()
        message.position = [estimate[angle] for angle, _ in NAMES.values()]
        message.velocity = [estimate[rate] for _, rate in NAMES.values()]
        publisher.publish(message)


if __name__ == "__main__":
    main()
