"""The gait file (``swimid-gait/2``): the best gait, how sure it is, and a robust one."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pydantic import Field

from swimid.files import yamlio
from swimid.files.yamlio import Number, Pair, Rows

FORMAT: Literal["swimid-gait/2"] = "swimid-gait/2"


class Varied(yamlio.Document):
    """What may be changed."""

    unit: str
    low: float
    high: float


class Limit(yamlio.Document):
    """What a gait must keep to."""

    quantity: str
    at_most: Number = None
    at_least: Number = None
    unit: str


class Gait(yamlio.Document):
    """A gait, with what the robot comes to."""

    at: dict[str, float]
    #: At an end of its range: a better gait may lie beyond.
    at_bound: list[str] = []
    #: Limits that hold it back.
    held_by: list[str] = []
    #: Of each goal; SI units.
    goals: dict[str, Number]
    quantities: dict[str, Number] = {}
    #: 95 % interval of each goal at this gait, from the coefficients' covariance.
    goals_ci95: dict[str, Pair] = {}
    #: 95 % interval of the best gait: where it lies in draws of the coefficients.
    at_ci95: dict[str, Pair] = {}
    #: What it loses against the best gait of each draw (in the goal's unit): in nine of ten draws at most,
    #: and on the average of the worst tenth; over draws that were not used to find it.
    loss_90: Number = None
    loss_worst_tenth: Number = None
    #: Share of draws in which it keeps to its limits; missing where it has none.
    kept_in_draws: Number = None


class GaitFile(yamlio.ResultFile):
    """A gait file."""

    kind: ClassVar[str] = "gait file"
    format: Literal["swimid-gait/2"] = FORMAT
    verdict: Literal["good", "caution", "bad"]
    robot: str
    model: str
    params: str | None = None
    drive: dict[str, Any]
    duration_s: float
    #: Range of the drives that the coefficients were identified from; outside it is extrapolation.
    identified: dict[str, tuple[float, float]] = {}
    vary: dict[str, Varied]
    #: In the words of the options, and the quantity and unit of each.
    goals: dict[str, tuple[str, str]]
    limits: dict[str, Limit] = {}
    #: Value of the goal, with the penalties of the limits, at which the search from each start ended; the
    #: best first; empty for two goals.
    ends: list[float] = []
    optimum: Gait
    #: The gait that loses least in the worst tenth of draws; the best one where no other loses less.
    robust: Gait | None = None
    #: Number of draws of the coefficients, and the share of draws within the coefficients' bounds.
    draws: int = 0
    inside: Number = None
    #: Best gait of each draw, in the order of ``vary``; none for two goals.
    drawn: Rows = []
    #: Of two goals: the front, what is varied and then the goals; and the 95 % interval of each goal of each
    #: of these gaits, low and high.
    front: Rows = []
    front_ci95: Rows = []
    provenance: dict[str, Any] = Field(default_factory=dict)
