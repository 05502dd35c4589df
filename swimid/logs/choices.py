"""What the user states beside a file that a profile reads."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from swimid.errors import InputError, suggestion
from swimid.logs.units import UNITS, canonical


@dataclass(frozen=True)
class Choices:
    """What the user states beside the file.

    Attributes
    ----------
    profile : str or None
        Name of the profile (``--as``).
    select : str or None
        Track, instance, topic or message type to take.
    rate_hz : float or None
        Rate of the frames, Hz.
    length_unit : str or None
        Unit of lengths, for a file that states none.
    min_likelihood : float or None
        A tracked point with a likelihood below this is left empty.
    """

    profile: str | None = None
    select: str | None = None
    rate_hz: float | None = None
    length_unit: str | None = None
    min_likelihood: float | None = None

    def completed(self, profile: str | None, select: str | int | None, length_unit: str | None) -> Choices:
        """Return these choices; what they leave open is taken from a mapping."""
        return replace(
            self,
            profile=self.profile or profile,
            select=self.select or (None if select is None else str(select)),
            length_unit=self.length_unit or length_unit,
        )

    def cut(self, stated: float) -> float:
        """Return the least likelihood: this choice, else the one of the mapping."""
        return stated if self.min_likelihood is None else self.min_likelihood

    def length(self, stated: str | None, path: Path) -> tuple[float, str]:
        """Return factor to SI and unit of lengths, "m" or "px": as the file states it, or as the user does.

        Raises
        ------
        InputError
            Nobody states it, or it is no unit of length.
        """
        unit = canonical(self.length_unit or stated or "")
        if unit == "px":
            return 1.0, "px"
        if unit not in UNITS["length"]:
            text = f"'{unit}' is no unit of length" if unit else "states no unit of length"
            hint = (
                suggestion(unit, ["px", *UNITS["length"]]) if unit else "add --length-unit mm (or m, cm, px)"
            )
            raise InputError(text, file=path, hint=hint)
        return UNITS["length"][unit], "m"
