"""Names of a system's joints and pads in everything that is published."""

from __future__ import annotations

from dataclasses import dataclass

PAD_NUMBERS = (1, 2, 3)
"""Numbers of pads in any system: each has its own faults and counters."""


@dataclass(frozen=True, slots=True)
class Naming:
    """Names of the joints in the order of every joint vector, the name of their unit, and the pads' numbers.

    along, across: names of a contact's coordinates; `across` is empty for pads that read only one.
    """

    joints: tuple[str, ...]
    unit: str
    pads: tuple[int, ...]
    along: str = "s"
    across: str = ""

    @property
    def measured(self) -> tuple[str, ...]:
        """Field names of the measured joint angles."""
        return tuple(f"{joint}_{self.unit}" for joint in self.joints)

    @property
    def commanded(self) -> tuple[str, ...]:
        """Field names of the commanded joint angles."""
        return tuple(f"{joint}_cmd_{self.unit}" for joint in self.joints)

    @property
    def following(self) -> tuple[str, str]:
        """Field names of the following error and its limit, for all joints."""
        return f"following_error_{self.unit}", f"following_limit_{self.unit}"
