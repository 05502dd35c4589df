"""The gap file (``swimid-gap/1``): what is between trials and a model, and what causes it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import ConfigDict, Field

from swimid.files import yamlio
from swimid.files.yamlio import Number, Pair
from swimid.results.parameters import Status
from swimid.simulation.comparison_file import ChannelScore

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
#: A verdict as a badge has it.
WORDS: dict[Verdict, str] = {
    "none": "No gap",
    "explained": "Explained",
    "ambiguous": "Ambiguous",
    "unexplained": "Unexplained",
}
#: ``params`` of a diagnosis without a parameter file.
ROBOT_FILE = "the robot file"
#: The causes should close at least this share of a channel's gap.
HALF = 0.5
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


class Predicted(yamlio.Document):
    """How far held-out data are from what the model predicts without and with the causes, over what noise,
    uncertain coefficients and chance differences between trials allow: root-mean-square, 1 where it is right.
    """

    before: float
    after: float


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

    @property
    def half_closed(self) -> bool | None:
        """Whether at least half of the gap closes, surely more than nothing; None where there is none."""
        if self.closed is None:
            return None
        low = self.ci95[0]
        return self.closed >= HALF and (low is None or low > 0)


class Absorbed(yamlio.Document):
    """A coefficient of the model: as given, refitted without the causes, and with them."""

    coefficient: str
    given: Value | None = None
    without: Value
    with_effect: Value
    bounds: Pair = (None, None)


class Extrapolation(yamlio.Document):
    """Distance of a setting from what the model fitted to the others predicts, as :class:`Predicted`."""

    left_out: str
    before: Number
    after: Number


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
    extrapolation: list[Extrapolation] = []


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


class OddTrial(yamlio.Document):
    """A trial that the others do not predict."""

    trial: str
    #: Its error of prediction over that expected: the others' typical one, or what noise and the uncertainty
    #: of the coefficients allow.
    times: float


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
    predicted: Predicted | None = None
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
    #: What each round did, and why the verdict is what it is, in words.
    rounds: list[str] = []
    reasons: list[str] = []
    #: What is wrong is wrong in this trial alone.
    odd_trial: OddTrial | None = None
    #: The likeliest causes by the fits, if held-out errors are worse with them by more than the gap.
    refuted: list[str] = []
    #: Validation trials farther off than noise and what is not known of the coefficients allow, the farthest
    #: first; by how many times.
    unpredicted: list[OddTrial] = []
    settings: dict[str, Any] = {}
    provenance: dict[str, Any] = Field(default_factory=dict)

    @property
    def level(self) -> Literal["good", "caution", "bad"]:
        """How the report grades the verdict: worst where most of a gap stays unexplained; not good where a
        size or a coefficient ends at a bound, a validation trial is not predicted, a single setting was
        tried, that there is no gap is not told for sure, or held-out errors do not bear a cause out.
        """
        if self.verdict == "none":
            sure = self.told_of_gap and not self.unrepeated and self.remaining.white and not self.moved
            return "good" if sure and not self.single and not self.at_bound else "caution"
        if self.verdict == "explained":
            weak = self.bounded or self.stuck or self.unpredicted or self.single or self.lost
            return "caution" if weak or self.mostly_open else "good"
        left = self.remaining.share
        return "bad" if self.verdict == "unexplained" and (left is None or left > 0.5) else "caution"

    @property
    def changed(self) -> bool:
        """Whether a parameter that has changed is among the causes."""
        return any(isinstance(v, ChangedValue) for c in self.causes for v in c.parameters.values())

    @property
    def told_of_gap(self) -> bool:
        """Whether that there is no gap is likelier than not."""
        return self.no_gap is None or self.no_gap > 0.5

    @property
    def follows(self) -> bool:
        """Whether the model follows the trials it is fitted to, and not the validation trials."""
        return self.verdict == "unexplained" and bool(self.unpredicted)

    @property
    def single(self) -> bool:
        """Whether all trials have one setting: at another one nothing was tested."""
        return self.setting_count is not None and self.setting_count < 2

    @property
    def unrepeated(self) -> bool:
        """Whether most of the squared error in some channel is that trials differ from one another, and no
        repeats of a setting tell that this is chance.
        """
        return not self.repeats and any(c.differs for c in self.where.channels)

    @property
    def bounded(self) -> list[str]:
        """Parameters of the causes that end at a bound: ``joint-locked/share``."""
        ends = [(c.effect, name, value) for c in self.causes for name, value in c.parameters.items()]
        return [f"{effect}/{name}" for effect, name, value in ends if value.status == "at-bound"]

    @property
    def closing(self) -> list[Shrinkage]:
        """Errors on held-out data with all causes together, by channel, that with most of the gap first."""
        return self.causes[0].shrinkage if self.causes else []

    @property
    def mostly_open(self) -> bool:
        """Whether in the channel with most of the gap the causes close less than half of it."""
        return any(s.half_closed is False for s in self.closing[:1])

    @property
    def absorbed(self) -> list[Absorbed]:
        """The model's coefficients without and with all causes."""
        return self.causes[0].absorbed if self.causes else []

    @property
    def extrapolation(self) -> list[Extrapolation]:
        """How far settings are from what the others predict, without and with all causes."""
        return self.causes[0].extrapolation if self.causes else []

    @property
    def stuck(self) -> list[str]:
        """Coefficients that end at a bound with the causes: they still stand in for something."""
        return [a.coefficient for a in self.absorbed if a.with_effect.status == "at-bound"]

    @property
    def lost(self) -> list[str]:
        """Settings that are farther from what the others predict with the causes than without."""
        return [
            e.left_out
            for e in self.extrapolation
            if e.before is not None and e.after is not None and e.after > e.before
        ]

    def write(self, path: str | Path) -> None:
        """Write the file, whole or not at all; what is not known is null."""
        yamlio.write(path, self.model_dump(mode="python"))


def ranked(gap: GapFile) -> GapFile:
    """The same with the largest first in every list of ``where`` and of scores, and what is not known last.

    Scores of effects that were refitted go by their gain, then the others by the gain the screen predicted.
    """
    where = gap.where
    channels = sorted(where.channels, key=lambda c: -_size(c.share))
    # a channel that only held-out trials have comes last
    order = {c.channel: place for place, c in enumerate(channels)}
    by_size = {
        name: sorted(getattr(where, name), key=lambda c: -_size(c.ratio))
        for name in ("phase", "regime", "time")
    }
    stage = dict(sorted(where.stage.items(), key=lambda item: -_size(item[1])))
    causes = [
        c.model_copy(
            update={"shrinkage": sorted(c.shrinkage, key=lambda s: order.get(s.channel, len(order)))}
        )
        for c in gap.causes
    ]
    scores = sorted(gap.scores, key=lambda s: (not s.refitted, -_size(s.gain if s.refitted else s.screened)))
    found = where.model_copy(update={"channels": channels, "stage": stage, **by_size})
    return gap.model_copy(update={"where": found, "causes": causes, "scores": scores})


def _size(value: float | None) -> float:
    return -math.inf if value is None else value
