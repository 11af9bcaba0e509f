"""A palmd rig as a lerobot robot: joint angles and contacts as observations, jog steps as actions.

Put it into a package called `lerobot_robot_palmd` beside lerobot, pyzmq and msgpack; palmd itself is not imported.
"""

from dataclasses import dataclass
from functools import cached_property

import msgpack
import zmq
from lerobot.robots import Robot, RobotConfig

ANGLES = {"phi1.pos": "phi1_rad", "phi2.pos": "phi2_rad"}
TOUCH = ("s1_m", "s2_m", "f1_n", "f2_n")
OBJECT = ("psi_rad", "rho_m", "mass_kg", "mu")
STEP_DEG = 0.5
"""The largest jog step that palmd accepts."""


@RobotConfig.register_subclass("palmd")
@dataclass
class PalmdConfig(RobotConfig):
    publish: str = "tcp://127.0.0.1:9872"
    command: str = "tcp://127.0.0.1:9873"


class Palmd(Robot):
    config_class = PalmdConfig
    name = "palmd"

    def __init__(self, config: PalmdConfig):
        super().__init__(config)
        self.config = config
        self._bus = None
        self._latest = {}

    @cached_property
    def observation_features(self):
        return dict.fromkeys((*ANGLES, *TOUCH, *OBJECT, "valid"), float)

    @cached_property
    def action_features(self):
        return dict.fromkeys(ANGLES, float)

    @property
    def is_connected(self):
        return self._bus is not None

    @property
    def is_calibrated(self):
        return True  # palmd calibrates: docs/start/calibration.md

    def calibrate(self):
        pass

    def configure(self):
        pass

    def connect(self, calibrate=True):  # noqa: ARG002
        context = zmq.Context.instance()
        self._bus, self._commands = context.socket(zmq.SUB), context.socket(zmq.REQ)
        self._bus.connect(self.config.publish)
        self._bus.subscribe("palm/estimate")
        self._commands.connect(self.config.command)
        self._ask("arm")

    def disconnect(self):
        self._ask("stop")
        self._bus.close()
        self._commands.close()
        self._bus = None

    def get_observation(self):
        """The latest estimate; while it is not valid, `valid` and all values but the angles are 0."""
        while self._bus.poll(0 if self._latest else 1000):
            self._latest = msgpack.unpackb(self._bus.recv_multipart()[1])
        valid = float(self._latest["valid"])
        values = {name: self._latest[field] for name, field in ANGLES.items()}
        values |= {name: self._latest[name] if valid else 0.0 for name in (*TOUCH, *OBJECT)}
        return values | {"valid": valid}

    def send_action(self, action):
        """Turn the palms towards the angles (rad) by one small step; call it at least every 0.1 s."""
        steps = {}
        for name, field in ANGLES.items():
            away_deg = (action[name] - self._latest[field]) * 180.0 / 3.141592653589793
            steps[field.replace("_rad", "_deg")] = max(-STEP_DEG, min(STEP_DEG, away_deg))
        self._ask("jog", **steps)
        return action

    def _ask(self, command, **args):
        request = {"id": 1, "cmd": command, "args": args, "client": "lerobot"}
        self._commands.send(msgpack.packb(request))
        reply = msgpack.unpackb(self._commands.recv())
        if not reply["ok"]:
            raise RuntimeError(f"palmd refused {command}: {reply['error']}")
