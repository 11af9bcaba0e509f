"""What the configurations of all systems have."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, ClassVar

import yaml
from pydantic import Field, FiniteFloat, ValidationInfo, field_validator

from palmd.config.addresses import guarded_address, local_address
from palmd.config.arms import ArmConfig
from palmd.config.fields import FilePath, Plausible, Strict, one_of
from palmd.config.pads import AnyPads


class LoopConfig(Strict):
    """The control loop."""

    rate_hz: Annotated[FiniteFloat, Field(ge=10, le=1000), Plausible(20, 500)] = 100.0
    """How many ticks a second."""


class BusConfig(Strict):
    """The ZeroMQ addresses; without a folder of keys on this machine only."""

    keys: FilePath | None = None
    """A folder of CURVE keys; with it other machines may listen and command."""
    publish: str = "tcp://127.0.0.1:9872"
    """Where everything is published."""
    command: str = "tcp://127.0.0.1:9873"
    """Where commands are taken."""
    frames: Annotated[int, one_of(3, 2)] = 3
    """Of each message: topic, map and the time it was sent; 2 leaves out the time, for readers that mistake it."""
    group: Annotated[str, Field(min_length=1)] | None = None
    """The group whose members may use local sockets (ipc://) at these addresses; without it the daemon's user alone."""

    @field_validator("publish", "command")
    @classmethod
    def _not_for_strangers(cls, address: str, info: ValidationInfo) -> str:
        guarded = info.data.get("keys", "wrong, which is said at its own place") is not None
        return guarded_address(address) if guarded else local_address(address)

    @field_validator("command")
    @classmethod
    def _own_address(cls, command: str, info: ValidationInfo) -> str:
        if command == info.data.get("publish"):
            raise ValueError(f"{command} is already the publish address")
        return command

    @field_validator("group")
    @classmethod
    def _of_local_sockets(cls, group: str | None, info: ValidationInfo) -> str | None:
        away = [info.data.get(key, "") for key in ("publish", "command")]
        over_tcp = [address for address in away if address.startswith("tcp://")]
        if group is not None and over_tcp:
            raise ValueError(f"a group can be given to local sockets (ipc://PATH) alone, not to {over_tcp[0]}")
        return group


class RecordConfig(Strict):
    """Where runs are recorded."""

    directory: FilePath = Field(default="runs", validate_default=True)
    """Where runs are put."""


class AnyConfig(Strict):
    """What the configurations of all systems have; each is a model of its own.

    Paths are those of the file, joined to the file's folder.
    """

    system: ClassVar[str]
    """Whose it is, by the table of `palmd.systems`."""

    rig: Any
    """Geometry and gravity; of the emulated rig alone there are `imperfections` in it."""
    pads: AnyPads
    """The touchpads."""
    arm: ArmConfig
    """The robot arm."""
    limits: Any
    """What may be done with it."""
    loop: LoopConfig = LoopConfig()
    """The control loop."""
    bus: BusConfig = BusConfig()
    """The addresses."""
    record: RecordConfig = Field(default_factory=dict, validate_default=True)  # its default needs the folder
    """Recordings."""
    plan: FilePath | None = None
    """The motion plan that `start` runs, unless another is chosen."""
    autostart: bool = False
    """Whether the rig moves without having been told to."""

    @field_validator("arm")
    @classmethod
    def _own_port(cls, arm: ArmConfig, info: ValidationInfo) -> ArmConfig:
        pads: AnyPads | None = info.data.get("pads")
        ports = [] if pads is None else [pad.port for pad in pads.each()]
        if arm.port in ports:
            raise ValueError(f"port {arm.port} is already that of {'a' if len(ports) > 1 else 'the'} pad")
        return arm

    @property
    def outlines(self) -> Path | None:
        """Where stored outlines are; None where none are compared with."""
        return None

    @property
    def explores(self) -> bool:
        """Whether its observer knows an outline to explore by."""
        return True


def as_yaml(config: Strict) -> str:
    """An effective configuration, defaults included, as it is kept with a run."""
    return yaml.safe_dump(config.model_dump(mode="json"), allow_unicode=True)


def config_hash(config: Strict) -> str:
    """Sha256 (hex) of an effective configuration or a section of one, defaults included, as canonical JSON."""
    canonical = json.dumps(config.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()
