"""The map file (``swimid-map/1``): what a robot comes to over a grid of gaits."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pydantic import Field

from swimid.files import yamlio
from swimid.files.yamlio import Number, Rows

FORMAT: Literal["swimid-map/1"] = "swimid-map/1"


class Axis(yamlio.Document):
    """What is varied."""

    name: str
    unit: str
    values: list[float]


class Mapped(yamlio.Document):
    """A quantity over the grid: rows are the first axis, columns the second (one column without one)."""

    unit: str
    values: Rows
    #: Standard deviation from the coefficients' covariance; missing where none is known.
    stderr: Rows | None = None


class MeasuredPoint(yamlio.Document):
    """A recorded trial beside the map."""

    trial: str
    role: Literal["fit", "validate"]
    #: Where it lies on the axes.
    at: dict[str, float]
    inside: bool
    #: Mean speed over its last beats, by the same rule of log and simulation of this very trial, m/s.
    measured_m_s: Number = None
    simulated_m_s: Number = None
    #: By voltage and current, W, over its last beats; and what the model's joints give there.
    electrical_W: Number = None
    mechanical_W: Number = None


class Efficiency(yamlio.Document):
    """Mechanical over electrical power: what gear and motor leave."""

    value: float
    stderr: Number = None
    trials: int


class MapFile(yamlio.ResultFile):
    """A map file."""

    kind: ClassVar[str] = "map file"
    format: Literal["swimid-map/1"] = FORMAT
    verdict: Literal["good", "caution", "bad"]
    robot: str
    model: str
    params: str | None = None
    #: What is not varied.
    drive: dict[str, Any]
    duration_s: float
    axes: list[Axis]
    quantities: dict[str, Mapped]
    #: Runs that broke down, and runs whose speed still changes.
    broken: int
    unsettled: int
    #: Range of drive and axes in the trials the coefficients were identified from; beyond is extrapolation.
    identified: dict[str, tuple[float, float]] = {}
    measured: list[MeasuredPoint] = []
    efficiency: Efficiency | None = None
    provenance: dict[str, Any] = Field(default_factory=dict)
