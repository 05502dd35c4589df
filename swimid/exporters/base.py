"""What goes into a target and what comes out of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

#: What becomes of the added mass: the target's own way, added to the bodies' masses, acceleration
#: terms of the hydrodynamics plugin, or left out.
AddedMass = Literal["native", "fold", "plugin", "none"]


@dataclass(frozen=True)
class Options:
    """Choices of an export.

    Attributes
    ----------
    added_mass : {"native", "fold", "plugin", "none"}
    servo_hz : float
        Natural frequency of the position servo of a driven joint whose robot file gives none.
    """

    added_mass: AddedMass = "native"
    servo_hz: float = 20.0


@dataclass(frozen=True)
class Exported:
    """A finished export.

    Attributes
    ----------
    text : str
        The file.
    limits : tuple of str
        What the target cannot carry, one sentence each.
    dangers : tuple of str
        Why the target's simulation may be unstable.
    """

    text: str
    limits: tuple[str, ...] = ()
    dangers: tuple[str, ...] = ()
