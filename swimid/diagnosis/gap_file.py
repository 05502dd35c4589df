"""The gap file (``swimid-gap/1``): the gap between trials and a model, and its causes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import ConfigDict, Field, model_validator

from swimid.files import yamlio
from swimid.files.yamlio import Number, Pair
from swimid.results.parameters import Status
from swimid.simulation.compare_series import ChannelScore

FORMAT: Literal["swimid-gap/1"] = "swimid-gap/1"
Verdict = Literal["none", "explained", "ambiguous", "unexplained"]
HeldOut = Literal["validation", "trials", "stretches"]
#: Meaning of each way to hold out data.
HELD_OUT: dict[HeldOut | None, str] = {
    None: "on held-out data",
    "validation": "on the validation trials",
    "trials": "in cross-validation over trials",
    "stretches": "in cross-validation over stretches of trials",
}
#: ``params`` of a diagnosis without a parameter file.
ROBOT_FILE = "the robot file"
Stage = Literal["actuation", "structure", "fluid", "environment", "sensing", "rig"]


class ChannelGap(yamlio.Document):
    """One channel over all trials, with the model refitted; errors over the measured range."""

    channel: str
    nrmse: Number
    #: Error of noise alone.
    floor: Number
    #: Share of the squared size of the whole gap.
    share: Number
    rmse: Number = None
    unit: str = "1"
    #: Error without between-trial variation: noise within trials.
    within: Number = None

    @property
    def differs(self) -> bool:
        """Return whether most of its squared error is between-trial variation."""
        if self.within is None or self.nrmse is None:
            return False
        return self.within**2 < 0.5 * self.nrmse**2


class Cell(yamlio.Document):
    """One part of the data: of the stroke, of the settings, or of the time."""

    #: Quantity that is divided: ``phase``, ``frequency``, ``amplitude``, ``time``, ``change`` ...
    kind: str
    label: str
    #: Root-mean-square residual over the noise floor.
    ratio: Number
    share: Number


class Where(yamlio.Document):
    """Places of the gap; every list begins with the largest."""

    channels: list[ChannelGap]
    #: Share of the evidence for each stage.
    stage: dict[Stage, Number]
    phase: list[Cell] = []
    regime: list[Cell] = []
    time: list[Cell] = []


class Value(yamlio.Document):
    """An estimate."""

    value: Number
    stderr: Number = None
    unit: str
    status: Status = "estimated"


class ChangedValue(Value):
    """An estimate of a parameter that has changed since the parameter file."""

    model_config = ConfigDict(populate_by_name=True, serialize_by_alias=True)

    #: Value in the parameter file.
    given: float = Field(alias="from")
    #: Size of the change in standard errors, those of the file and of the estimate combined.
    standard_errors: Number = None


class Distance(yamlio.Document):
    """Distance of held-out data from the prediction without and with the causes.

    It is a root mean square, over what noise, uncertain coefficients and between-trial variation allow: 1 for
    a correct model.
    """

    before: Number
    after: Number


class Shrinkage(yamlio.Document):
    """One channel on held-out data (see ``held_out`` of the file); errors over the measured range."""

    channel: str
    #: Error of the refitted model, without and with the causes.
    before: Number
    after: Number
    floor: Number
    #: (before - after) / (before - floor).
    closed: Number
    ci95: Pair = (None, None)
    #: Error of the parameters as given.
    shipped: Number = None


class Absorbed(yamlio.Document):
    """A coefficient of the model: as given, refitted without the causes, and with them."""

    coefficient: str
    given: Value | None = None
    without: Value
    with_effect: Value


class Cause(yamlio.Document):
    """An effect that is part of the answer."""

    effect: str
    #: Probability that the effect, or one of its equivalents, is missing in the model.
    probability: Number
    #: Effects that these trials cannot distinguish from it.
    equivalent: list[str] = []
    #: Empty for another reading of the robot (``reading:NAME=OPTION``), which has no parameters.
    parameters: dict[str, Value | ChangedValue]
    shrinkage: list[Shrinkage] = []
    stage: Stage | None = None
    meaning: str = ""
    sources: list[str] = []
    #: Decrease of the held-out squared residuals, in units of the noise.
    gain: Number = None
    gain_stderr: Number = None
    absorbed: list[Absorbed] = []
    #: Distances of the outermost settings, each from a fit to all others.
    extrapolation: dict[str, Distance] = {}


class Remaining(yamlio.Document):
    """Residuals that the causes leave."""

    #: Share of the squared size of the gap.
    share: Number
    where: str
    #: Whether no structure is left.
    white: bool
    #: Held-out gain of a generic description.
    gain: Number = None


class Advice(yamlio.Document):
    """A next experiment."""

    text: str
    #: Rivals that it distinguishes.
    separates: list[str] = []
    #: Predicted difference between them, in units of the noise; and on the present trials.
    difference: Number = None
    now: Number = None


class Score(yamlio.Document):
    """Score of one effect of the catalogue."""

    effect: str
    stage: Stage | None = None
    variant: str = ""
    gain: Number
    stderr: Number = None
    #: Number of trials on which it helps, and number of trials.
    won: tuple[int, int] = (0, 0)
    #: Share of its change that the coefficients imitate.
    absorbed: Number = None
    #: Gain predicted by the screen, and whether the effect was fitted.
    screened: Number = None
    refitted: bool = True
    #: Probability that it is among the causes.
    probability: Number = None


class Hypothesis(yamlio.Document):
    """A set of effects that was fitted together with the model; the empty set is the model itself."""

    effects: list[str]
    #: Number of kinds of parameters of its effects; the per-trial values of one parameter are one kind.
    numbers: int = 0
    #: Squared residuals at the optimum in units of the noise, and the penalty for its parameters.
    score: Number
    #: The same with noise of long memory, if the trials are too few to decide.
    slow: Number = None
    #: For each effect of a set, the largest squared cosine between its change and that of another one.
    alike: dict[str, float] = {}
    #: Squared residuals of each fold.
    folds: list[Number] = []
    probability: Number = None


class GapFile(yamlio.ResultFile):
    """Content of a gap file."""

    kind: ClassVar[str] = "gap file"
    format: Literal["swimid-gap/1"] = FORMAT
    verdict: Verdict
    #: Errors of the parameters as given over all trials, by channel, as ``compare`` computes them.
    as_given: dict[str, ChannelScore] = {}
    where: Where
    #: Ranked. Several causes form one answer.
    causes: list[Cause]
    remaining: Remaining
    advice: list[Advice] = []
    model: str = ""
    robot: str = ""
    experiment: str = ""
    params: str = ""
    trials: list[str] = []
    #: Probability of no gap, and of a cause outside the catalogue.
    no_gap: Number = None
    outside: Number = None
    #: Inputs of these probabilities, with the numbers of samples and of effects.
    hypotheses: list[Hypothesis] = []
    samples: int | None = None
    tried: int | None = None
    #: Data of the errors before and after: ``validation`` trials, or each part of the data held out of a
    #: refit in turn (``trials`` or ``stretches`` of trials).
    held_out: HeldOut | None = None
    #: Distance of these data from the prediction of the causes.
    predicted: Distance | None = None
    #: Source of the noise floor.
    floor_from: str = ""
    #: Whether settings were repeated often enough to estimate the between-trial variation.
    repeats: bool = False
    #: Number of settings of fitted and validation trials.
    setting_count: int | None = None
    #: Every effect that was tried, best first.
    scores: list[Score] = []
    #: Held-out gain of generic residual forces and sensor terms, by axis.
    forces: dict[str, Number] = {}
    #: Parameters of the file that the refit moved by more than their standard errors allow, and whose change
    #: is no hypothesis: the file states no standard error, or the model is a black box.
    moved: dict[str, ChangedValue] = {}
    #: Share of its output that a black-box model reproduces, if it is less than half.
    unreproduced: dict[str, Number] = {}
    #: Coefficients that end at a bound in the refit without effects, and the bound.
    at_bound: dict[str, float] = {}
    #: Evidence for each larger set of effects, in words.
    rounds: list[str] = []
    #: Reasons for the verdict, and why the causes are not certain: clauses.
    reasons: list[str] = []
    unsure: list[str] = []
    #: Effects that could not be evaluated, and the reason.
    left_out: dict[str, str] = {}
    #: Trial that contradicts the others, and its prediction error over the typical one of the others.
    odd_trial: dict[str, float] = {}
    #: Causes that the fits favour but that enlarge the held-out errors by more than the gap.
    refuted: list[str] = []
    #: Validation trials that are not predicted, the farthest first: error over what noise and uncertain
    #: coefficients allow.
    unpredicted: dict[str, float] = {}
    provenance: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _largest_first(self) -> GapFile:
        """Sort every list by size; unknown values come last.

        Scores of refitted effects are sorted by their gain, the others by the gain that the screen predicted.
        """
        where = self.where
        where.channels.sort(key=lambda c: -_size(c.share))
        for cells in (where.phase, where.regime, where.time):
            cells.sort(key=lambda c: -_size(c.ratio))
        where.stage = dict(sorted(where.stage.items(), key=lambda item: -_size(item[1])))
        # A channel that only held-out trials have comes last.
        order = {c.channel: place for place, c in enumerate(where.channels)}
        for cause in self.causes:
            cause.shrinkage.sort(key=lambda s: order.get(s.channel, len(order)))
        self.scores.sort(key=lambda s: (not s.refitted, -_size(s.gain if s.refitted else s.screened)))
        return self

    @property
    def changed(self) -> bool:
        """Return whether a changed parameter is among the causes."""
        return any(isinstance(v, ChangedValue) for c in self.causes for v in c.parameters.values())

    @property
    def told_of_gap(self) -> bool:
        """Return whether no gap is more probable than not."""
        return self.no_gap is None or self.no_gap > 0.5

    @property
    def closing(self) -> list[Shrinkage]:
        """Return errors on held-out data with all causes, by channel, the channel with most of the gap
        first.
        """
        return self.causes[0].shrinkage if self.causes else []

    def write(self, path: str | Path) -> None:
        """Write the file completely or not at all; unknown values are null."""
        yamlio.write(path, self.model_dump(mode="python"))


def _size(value: float | None) -> float:
    return -math.inf if value is None else value
