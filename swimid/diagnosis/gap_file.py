"""The gap file (``swimid-gap/1``): what is between trials and a model, and what causes it."""

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
#: What each means in words.
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
    """One channel over all trials, the nominal model refitted; errors over the measured range."""

    channel: str
    nrmse: Number
    #: The error that noise alone would leave.
    floor: Number
    #: Of the whole gap's squared size.
    share: Number
    rmse: Number = None
    unit: str = "1"
    #: The error once each trial has had what differs from trial to trial: noise within trials.
    within: Number = None

    @property
    def differs(self) -> bool:
        """Whether most of its squared error is that trials differ from one another."""
        if self.within is None or self.nrmse is None:
            return False
        return self.within**2 < 0.5 * self.nrmse**2


class Cell(yamlio.Document):
    """One part of the data: of the stroke, of the settings, or of the time."""

    #: What is divided: ``phase``, ``frequency``, ``amplitude``, ``time``, ``change`` ...
    kind: str
    label: str
    #: Root-mean-square residual there over the noise floor.
    ratio: Number
    share: Number


class Where(yamlio.Document):
    """Where the gap is; every list begins with the largest."""

    channels: list[ChannelGap]
    #: Share of the evidence that each stage of the chain has.
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
    """An estimate of a parameter that is no longer what the parameter file says."""

    model_config = ConfigDict(populate_by_name=True, serialize_by_alias=True)

    #: Value in the parameter file.
    given: float = Field(alias="from")
    #: Size of the change in standard errors, those of the file and of the estimate together.
    standard_errors: Number = None


class Distance(yamlio.Document):
    """Distance of held-out data from what the model predicts without and with the causes.

    Root-mean-square, over what noise, uncertain coefficients and chance differences between trials allow: 1
    where the model is right.
    """

    before: Number
    after: Number


class Shrinkage(yamlio.Document):
    """One channel on held-out data (see ``held_out`` of the file); errors over the measured range."""

    channel: str
    #: Nominal model refitted, without and with the causes.
    before: Number
    after: Number
    floor: Number
    #: (before - after) / (before - floor).
    closed: Number
    ci95: Pair = (None, None)
    #: The parameters as given.
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
    #: That the effect, or one of its equivalents, is among what the model lacks.
    probability: Number
    #: Effects these trials cannot tell from it.
    equivalent: list[str] = []
    #: None of another reading of the robot (``reading:NAME=OPTION``): it holds as a whole.
    parameters: dict[str, Value | ChangedValue]
    shrinkage: list[Shrinkage] = []
    stage: Stage | None = None
    meaning: str = ""
    sources: list[str] = []
    #: Drop of the held-out misfit, squared residuals in units of the noise.
    gain: Number = None
    gain_stderr: Number = None
    absorbed: list[Absorbed] = []
    #: Distances of the outermost settings, each from a fit to all others.
    extrapolation: dict[str, Distance] = {}


class Remaining(yamlio.Document):
    """What the causes leave."""

    #: Of the gap's squared size.
    share: Number
    where: str
    #: No structure is left.
    white: bool
    #: Held-out gain of a generic description of it.
    gain: Number = None


class Advice(yamlio.Document):
    """A next experiment."""

    text: str
    #: The rivals it tells apart.
    separates: list[str] = []
    #: Predicted difference between them, in units of the noise; and on the trials at hand.
    difference: Number = None
    now: Number = None


class Score(yamlio.Document):
    """How one effect of the catalogue did."""

    effect: str
    stage: Stage | None = None
    variant: str = ""
    gain: Number
    stderr: Number = None
    #: Trials on which it helps, of how many.
    won: tuple[int, int] = (0, 0)
    #: Share of its signature that the nominal coefficients imitate.
    absorbed: Number = None
    #: Gain predicted by the screen, and whether it went on from there.
    screened: Number = None
    refitted: bool = True
    #: That it is among the causes.
    probability: Number = None


class Hypothesis(yamlio.Document):
    """A set of effects that was fitted together with the model; the empty one is the model as it is."""

    effects: list[str]
    #: Kinds of numbers its effects have; what each trial has of its own is one kind.
    numbers: int = 0
    #: Squared residuals of the optimum in units of the noise, and what its numbers must lower them by.
    score: Number
    #: The same with noise of long memory, where trials are too few to tell which it is.
    slow: Number = None
    #: Of each effect of several, the largest squared cosine between what it changes and what another does.
    alike: dict[str, float] = {}
    #: Squared residuals of each fold.
    folds: list[Number] = []
    probability: Number = None


class GapFile(yamlio.ResultFile):
    """A gap file."""

    kind: ClassVar[str] = "gap file"
    format: Literal["swimid-gap/1"] = FORMAT
    verdict: Verdict
    #: Errors of the model with the parameters as given, by channel, as ``compare`` has them: all trials.
    as_given: dict[str, ChannelScore] = {}
    where: Where
    #: Ranked; the first is the answer. Several form one answer together.
    causes: list[Cause]
    remaining: Remaining
    advice: list[Advice] = []
    model: str = ""
    robot: str = ""
    experiment: str = ""
    params: str = ""
    trials: list[str] = []
    #: Probability that there is no gap, and that something outside the catalogue causes it.
    no_gap: Number = None
    outside: Number = None
    #: What these are computed from, with the number of samples and of effects that apply.
    hypotheses: list[Hypothesis] = []
    samples: int | None = None
    tried: int | None = None
    #: What the errors before and after are of: ``validation`` trials, or each part of the data in turn, left
    #: out of a refit: ``trials`` or ``stretches`` of trials.
    held_out: HeldOut | None = None
    #: Of the causes, on these data.
    predicted: Distance | None = None
    #: How the noise floor was found.
    floor_from: str = ""
    #: Whether settings were repeated often enough to tell what differs by chance.
    repeats: bool = False
    #: How many settings there are, of fitted and validation trials.
    setting_count: int | None = None
    #: Every effect tried, best first.
    scores: list[Score] = []
    #: Held-out gain of generic residual forces and sensor terms, by axis.
    forces: dict[str, Number] = {}
    #: Parameters of the file that the refit moved by more than its standard errors allow, and whose change is
    #: no hypothesis: the file states no standard error, or the model is a black box.
    moved: dict[str, ChangedValue] = {}
    #: Share of its output that a black-box model reproduces, where that is less than half.
    unreproduced: dict[str, Number] = {}
    #: Coefficients that end at a bound in the refit without effects, and the bound.
    at_bound: dict[str, float] = {}
    #: What each larger set of effects was worth, in words.
    rounds: list[str] = []
    #: Why the verdict is what it is, and why the causes are not told for sure: clauses.
    reasons: list[str] = []
    unsure: list[str] = []
    #: Effects of which nothing can be said, and why.
    left_out: dict[str, str] = {}
    #: Trial in which alone something is wrong, and its error of prediction over the others' typical one.
    odd_trial: dict[str, float] = {}
    #: The likeliest causes by the fits, if held-out errors are worse with them by more than the gap.
    refuted: list[str] = []
    #: Validation trials that are not predicted, the farthest first: error over what noise and the uncertainty
    #: of the coefficients allow.
    unpredicted: dict[str, float] = {}
    provenance: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _largest_first(self) -> GapFile:
        """Put the largest first in every list, and what is not known last.

        Scores of effects that were refitted go by their gain, the others by the gain the screen predicted.
        """
        where = self.where
        where.channels.sort(key=lambda c: -_size(c.share))
        for cells in (where.phase, where.regime, where.time):
            cells.sort(key=lambda c: -_size(c.ratio))
        where.stage = dict(sorted(where.stage.items(), key=lambda item: -_size(item[1])))
        # a channel that only held-out trials have comes last
        order = {c.channel: place for place, c in enumerate(where.channels)}
        for cause in self.causes:
            cause.shrinkage.sort(key=lambda s: order.get(s.channel, len(order)))
        self.scores.sort(key=lambda s: (not s.refitted, -_size(s.gain if s.refitted else s.screened)))
        return self

    @property
    def changed(self) -> bool:
        """Whether a parameter that has changed is among the causes."""
        return any(isinstance(v, ChangedValue) for c in self.causes for v in c.parameters.values())

    @property
    def told_of_gap(self) -> bool:
        """Whether that there is no gap is likelier than not."""
        return self.no_gap is None or self.no_gap > 0.5

    @property
    def closing(self) -> list[Shrinkage]:
        """Errors on held-out data with all causes together, by channel, that with most of the gap first."""
        return self.causes[0].shrinkage if self.causes else []

    def write(self, path: str | Path) -> None:
        """Write the file, whole or not at all; what is not known is null."""
        yamlio.write(path, self.model_dump(mode="python"))


def _size(value: float | None) -> float:
    return -math.inf if value is None else value
