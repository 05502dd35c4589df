"""The sensitivity file (``swimid-sensitivity/2``): what each coefficient does to each output."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pydantic import Field

from swimid.files import yamlio
from swimid.files.yamlio import Number

FORMAT: Literal["swimid-sensitivity/2"] = "swimid-sensitivity/2"


class Range(yamlio.Document):
    """What a coefficient was varied over."""

    value: float
    low: float
    high: float
    unit: str
    #: ``bounds``, ``stderr`` (two standard errors to either side), ``share`` of its value, or ``given``.
    source: Literal["bounds", "stderr", "share", "given"]


class Index(yamlio.Document):
    """A Sobol index with its 95 % interval."""

    value: float
    ci95: tuple[float, float]


class Shares(yamlio.Document):
    """A coefficient's share of an output's variance: alone, and with all interactions it takes part in."""

    first: Index
    total: Index
    #: Whether the interval of the first-order index stays clear of zero.
    first_told: bool
    #: Whether the whole interval of the total index lies below 0.01.
    negligible: bool


class Output(yamlio.Document):
    """One output of one trial, or of all trials together where ``trial`` is missing."""

    quantity: str
    unit: str
    trial: str | None = None
    #: With the given coefficients; of all trials together there is none.
    value: Number = None
    #: Over the ranges.
    mean: Number = None
    sd: Number = None
    shares: dict[str, Shares] = {}


class Simulations(yamlio.Document):
    """How many points were simulated."""

    evaluated: int
    broken: int
    #: Rows of the design replaced because a point broke down.
    left_out: int


class SensitivityFile(yamlio.ResultFile):
    """A sensitivity file."""

    kind: ClassVar[str] = "sensitivity file"
    format: Literal["swimid-sensitivity/2"] = FORMAT
    verdict: Literal["good", "caution", "bad"]
    model: str
    robot: str
    experiment: str
    params: str | None = None
    #: Rows of the design.
    samples: int
    trials: list[str]
    ranges: dict[str, Range]
    outputs: list[Output]
    simulations: Simulations
    provenance: dict[str, Any] = Field(default_factory=dict)
