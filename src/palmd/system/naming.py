"""What a system's joints and pads are called, wherever something is published of them."""

from __future__ import annotations

from dataclasses import dataclass

PAD_NUMBERS = (1, 2, 3)
"""The numbers that pads have in any system: each has faults and counters of its own."""


@dataclass(frozen=True, slots=True)
class Naming:
    """The joints' names in the order of every joint vector, their unit's, and the pads' numbers.

    along, across: what the coordinates of a contact are called; `across` is empty where pads read but one.
    """

    joints: tuple[str, ...]
    unit: str
    pads: tuple[int, ...]
    along: str = "s"
    across: str = ""

    @property
    def measured(self) -> tuple[str, ...]:
        """The fields of the joints as they are."""
        return tuple(f"{joint}_{self.unit}" for joint in self.joints)

    @property
    def commanded(self) -> tuple[str, ...]:
        """The fields of the joints as they are told to be."""
        return tuple(f"{joint}_cmd_{self.unit}" for joint in self.joints)

    @property
    def following(self) -> tuple[str, str]:
        """The fields of the following error and of its limit, of all joints."""
        return f"following_error_{self.unit}", f"following_limit_{self.unit}"
