"""The recipes of docs/operate/bridging.md against palmd's messages, with stand-ins for ROS 2 and LeRobot."""

import importlib.util
import sys
import types
from pathlib import Path

import msgpack
import pytest

from palmd.daemon.commands import COMMANDS
from palmd.quantities import ESTIMATE

FOLDER = Path(__file__).parents[3] / "docs/operate"
FIELDS = {quantity.name for quantity in ESTIMATE.quantities}
WORDS = {"v": 1, "timestamp": 12.5, "seq": 3}


def estimate(**changes):
    return dict.fromkeys(FIELDS, 0.25) | WORDS | {"valid": True} | changes


def stand_in(monkeypatch, name, **contents):
    module = types.ModuleType(name)
    vars(module).update(contents)
    monkeypatch.setitem(sys.modules, name, module)
    return module


def loaded(name):
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Bus:
    """A socket that delivers the given messages."""

    def __init__(self, *maps):
        self._frames = [[b"palm/estimate", msgpack.packb(each), b"12.5"] for each in maps]

    def connect(self, _address): ...

    def subscribe(self, _topic): ...

    def poll(self, _ms):
        return bool(self._frames)

    def recv_multipart(self):
        return self._frames.pop(0)


class Commands:
    """A command socket that records requests and refuses commands that the daemon does not know."""

    def __init__(self):
        self.asked = []

    def send(self, frame):
        self.asked.append(msgpack.unpackb(frame))

    def recv(self):
        known = self.asked[-1]["cmd"] in COMMANDS
        return msgpack.packb({"id": 1, "ok": known, "error": "" if known else "no such command"})


def test_the_bridge_to_ros_publishes_valid_estimates(monkeypatch):
    published, bus = [], Bus(estimate(valid=False), estimate(phi1_rad=0.7, omega0_rad_s=-2.0))
    node = types.SimpleNamespace(create_publisher=lambda *_: types.SimpleNamespace(publish=published.append))
    time_ = types.SimpleNamespace(Time=lambda seconds: types.SimpleNamespace(to_msg=lambda: seconds))
    stand_in(
        monkeypatch, "rclpy", init=lambda: None, create_node=lambda _name: node, ok=lambda: bus.poll(0), time=time_
    )
    stand_in(monkeypatch, "sensor_msgs")
    stand_in(monkeypatch, "sensor_msgs.msg", JointState=lambda name: types.SimpleNamespace(
        name=name, header=types.SimpleNamespace()))  # fmt: skip
    bridge = loaded("ros2_bridge")
    monkeypatch.setattr(bridge.zmq, "Context", lambda: types.SimpleNamespace(socket=lambda _kind: bus))
    bridge.main()
    (message,) = published
    assert message.name == ["phi1", "phi2", "object"]
    assert (message.position, message.velocity) == ([0.7, 0.25, 0.25], [0.25, 0.25, -2.0])
    assert message.header.stamp == 12.5


@pytest.fixture
def robot(monkeypatch):
    class Robot:
        def __init__(self, config): ...

    class RobotConfig:
        @staticmethod
        def register_subclass(_name):
            return lambda kind: kind

    stand_in(monkeypatch, "lerobot")
    stand_in(monkeypatch, "lerobot.robots", Robot=Robot, RobotConfig=RobotConfig)
    recipe = loaded("lerobot_robot_palmd")
    made = recipe.Palmd(recipe.PalmdConfig())
    made._commands = Commands()
    return made


def test_observations_have_the_declared_features(robot):
    for valid in (False, True):
        robot._bus = Bus(estimate(valid=valid))
        observation = robot.get_observation()
        assert observation.keys() == robot.observation_features.keys()
        assert observation["valid"] == float(valid)
        assert observation["mass_kg"] == (0.25 if valid else 0.0)


def test_actions_are_small_jog_steps_that_the_daemon_accepts(robot):
    robot._bus = Bus(estimate())
    robot.get_observation()
    robot.send_action({"phi1.pos": 0.25 + 0.001, "phi2.pos": -1.0})
    request = robot._commands.asked[-1]
    assert (request["cmd"], request["args"]["phi2_deg"]) == ("jog", -0.5)
    assert request["args"]["phi1_deg"] == pytest.approx(0.0573, abs=1e-3)
    arguments = {argument.name: argument for argument in COMMANDS["jog"].arguments}
    assert all(arguments[name].low <= step <= arguments[name].high for name, step in request["args"].items())
