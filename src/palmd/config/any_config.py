"""Parts that the configurations of all systems have in common."""

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
    """Ticks per second."""


class BusConfig(Strict):
    """The ZeroMQ addresses; without a folder of keys, on this machine only."""

    keys: FilePath | None = None
    """Folder of CURVE keys; with it other machines may listen and command."""
    publish: str = "tcp://127.0.0.1:9872"
    """Address of the publisher."""
    command: str = "tcp://127.0.0.1:9873"
    """Address of the command socket."""
    frames: Annotated[int, one_of(3, 2)] = 3
    """Frames of each message: topic, map and send time; 2 omits the time, for readers that do not expect it."""
    group: Annotated[str, Field(min_length=1)] | None = None
    """Group whose members may use local sockets (ipc://) at these addresses; without it, the daemon's user only."""

    @field_validator("publish", "command")
    @classmethod
    def _remote_needs_keys(cls, address: str, info: ValidationInfo) -> str:
        guarded = info.data.get("keys", "invalid: reported at this key") is not None
        return guarded_address(address) if guarded else local_address(address)

    @field_validator("command")
    @classmethod
    def _own_address(cls, command: str, info: ValidationInfo) -> str:
        if command == info.data.get("publish"):
            raise ValueError(f"{command} is already the publish address")
        return command

    @field_validator("group")
    @classmethod
    def _group_needs_local_sockets(cls, group: str | None, info: ValidationInfo) -> str | None:
        addresses = [info.data.get(key, "") for key in ("publish", "command")]
        over_tcp = [address for address in addresses if address.startswith("tcp://")]
        if group is not None and over_tcp:
            raise ValueError(f"only local sockets (ipc://PATH) can have a group, not {over_tcp[0]}")
        return group


class RecordConfig(Strict):
    """Recordings of runs."""

    directory: FilePath = Field(default="runs", validate_default=True)
    """Folder of the recordings."""


class AnyConfig(Strict):
    """Base of the configurations of all systems.

    Relative paths are relative to the file's folder.
    """

    system: ClassVar[str]
    """Name of the system in the table of `palmd.systems`."""

    rig: Any
    """Geometry and gravity; `imperfections` apply to the emulated rig only."""
    pads: AnyPads
    """The touchpads."""
    arm: ArmConfig
    """The robot arm."""
    limits: Any
    """Limits of the motion."""
    loop: LoopConfig = LoopConfig()
    """The control loop."""
    bus: BusConfig = BusConfig()
    """The addresses."""
    record: RecordConfig = Field(default_factory=dict, validate_default=True)  # the default depends on the folder
    """Recordings."""
    plan: FilePath | None = None
    """The motion plan that `start` runs unless another is loaded."""
    autostart: bool = False
    """Whether the rig starts the plan automatically, without a command."""

    @field_validator("arm")
    @classmethod
    def _own_port(cls, arm: ArmConfig, info: ValidationInfo) -> ArmConfig:
        pads: AnyPads | None = info.data.get("pads")
        ports = [] if pads is None else [pad.port for pad in pads.each()]
        if arm.port in ports:
            raise ValueError(f"port {arm.port} is already used by {'a' if len(ports) > 1 else 'the'} pad")
        return arm

    @property
    def outlines(self) -> Path | None:
        """File or folder of stored outlines; None if none are used."""
        return None

    @property
    def explores(self) -> bool:
        """Whether its observer estimates an outline, which exploring needs."""
        return True


def as_yaml(config: Strict) -> str:
    """The effective configuration, defaults included, as it is stored with a run."""
    return yaml.safe_dump(config.model_dump(mode="json"), allow_unicode=True)


def config_hash(config: Strict) -> str:
    """SHA-256 (hex) of the canonical JSON of a configuration or a section of it, defaults included."""
    canonical = json.dumps(config.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()
