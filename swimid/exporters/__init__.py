"""Identified coefficients in the formats of simulators: ``swimid export``.

``source`` is what is exported, with every quantity evaluated; one module per target turns it into text and
names everything it cannot carry: ``mjcf``, ``gazebo``, ``stonefish``, ``plain`` (JSON), on ``common``.
``export`` is the verb, with ``options``. A new target is a module with ``export(source, options)`` and a line
in :func:`targets`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from swimid.exporters.common import Exported
    from swimid.exporters.options import AddedMass, ExportOptions
    from swimid.exporters.source import Source


@dataclass(frozen=True)
class Target:
    """A format to export to.

    Attributes
    ----------
    title : str
    export : callable
    added_mass : tuple of str
        The choices of :data:`AddedMass` it knows.
    rigid : bool
        Whether it can take the drag of one rigid body too.
    """

    title: str
    export: Callable[[Source, ExportOptions], Exported]
    added_mass: tuple[AddedMass, ...]
    rigid: bool


def targets() -> dict[str, Target]:
    """The targets by the name ``--to`` takes."""
    from swimid.exporters import gazebo, mjcf, plain, stonefish

    return {
        "mjcf": Target("MuJoCo MJCF", mjcf.export, ("native", "fold", "none"), rigid=False),
        "gazebo": Target("Gazebo SDF", gazebo.export, ("native", "fold", "plugin", "none"), rigid=True),
        "stonefish": Target("Stonefish scenario", stonefish.export, ("native", "fold", "none"), rigid=False),
        "json": Target("JSON", plain.export, ("native",), rigid=True),
    }
