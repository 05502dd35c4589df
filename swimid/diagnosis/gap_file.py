"""The gap file (``swimid-gap/1``): the gap between trials and a model, and its causes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import ClassVar, Literal

from pydantic import ConfigDict, Field, model_validator

from swimid.effects.base import Stage
from swimid.files import yamlio
from swimid.files.yamlio import Number, Pair
from swimid.logs.log import Log
from swimid.results.parameters import Status
from swimid.simulation.compare_series import ChannelScore

Verdict = Literal["none", "explained", "ambiguous", "partial", "unexplained"]
HeldOut = Literal["validation", "trials", "stretches"]
#: Text that describes each way to hold out data from a fit.
HELD_OUT: dict[HeldOut | None, str] = {
    None: "on held-out data",
    "validation": "on validation trials and in cross-validation",
    "trials": "in cross-validation over trials",
    "stretches": "in cross-validation over stretches of trials",
}
#: Prefix of the names of models that interpret the robot file in another way. The rest of such a name is a
#: value of the option ``--reading``.
READING = "reading:"


class ChannelGap(yamlio.Document):
    """Errors of one channel over all trials, with the model refitted.

    All errors except ``rmse`` are divided by the measured range.
    """

    channel: str
    nrmse: Number
    #: Noise floor of the channel: root-mean-square error that noise alone causes.
    floor: Number
    #: Squared gap of this channel as a fraction of the sum over all channels.
    share: Number
    rmse: Number = None
    unit: str = "1"


class Cell(yamlio.Document):
    """Gap in one part of the data: a phase of the stroke, a setting, or an interval of time."""

    #: Quantity by which the data are divided: ``phase``, ``time``, ``trial``, or a setting (``frequency``).
    kind: str
    label: str
    #: Root-mean-square residual divided by the noise floor.
    ratio: Number
    share: Number


class Where(yamlio.Document):
    """Location of the gap by channel, stage of the simulation, stroke phase, setting and time.

    Every list is sorted by size, largest first.
    """

    channels: list[ChannelGap]
    #: Probability that the cause of the gap acts in each stage of the simulation. It is the sum over the
    #: effects of the stage, normalised to one.
    stage: dict[Stage, Number]
    phase: list[Cell] = []
    regime: list[Cell] = []
    time: list[Cell] = []

    @property
    def cells(self) -> list[Cell]:
        """Return the gap at each setting, in each phase of the stroke, and in each interval of time."""
        return [*self.regime, *self.phase, *self.time]


class Value(yamlio.Document):
    """Estimate of a parameter with its standard error, unit and status."""

    value: Number
    stderr: Number = None
    unit: str
    status: Status = "estimated"


class ChangedValue(Value):
    """Estimate of a parameter that has changed since the parameter file was written."""

    model_config = ConfigDict(populate_by_name=True, serialize_by_alias=True)

    #: Value of the parameter in the parameter file.
    given: float = Field(alias="from")
    #: Absolute change divided by the combined standard error of the file and of the estimate.
    standard_errors: Number = None


class Shrinkage(yamlio.Document):
    """Errors of one channel on held-out data, divided by the measured range.

    The field ``held_out`` of the gap file states which data are held out.
    """

    channel: str
    #: Root-mean-square errors of the refitted model without the causes of the gap, and with them.
    before: Number
    after: Number
    floor: Number
    #: Closed share of the squared gap: (shipped**2 - after**2) / (shipped**2 - floor**2), at most 1.
    closed: Number
    #: Error of the model with the parameters as given.
    shipped: Number = None


class Closed(yamlio.Document):
    """Squared error over all channels on held-out data, and the shares of the squared gap that close.

    Each squared error is that of the held-out parts (:class:`HeldOutTrial`) divided by its expectation: with
    the parameters as given (``before``), refitted without causes (``refitted``), and with the causes
    (``after``). The gap of a model is its squared difference from the true motion, without noise and without
    between-trial variation.
    """

    before: Number
    refitted: Number = None
    after: Number
    #: Closed share of the gap of the parameters as given, at most 1, and its 95 % interval.
    share: Number
    ci95: Pair = (None, None)
    #: Share of the gap of the parameters as given that the refit without causes closes (``by_refit``), and
    #: share of the gap of the refit that the causes close (``by_causes``).
    by_refit: Number = None
    by_causes: Number = None


class WaterfallStep(yamlio.Document):
    """Errors on held-out data of one model: as given, refitted, with the first causes, or the noise alone."""

    label: str
    #: Squared error of all held-out parts (:class:`HeldOutTrial`), divided by its expectation for a correct
    #: model.
    squared: Number
    #: Root-mean-square error of each channel, in the unit of the channel.
    rmse: dict[str, Number]


class HeldOutTrial(yamlio.Document):
    """Squared error of one held-out part: its squared Mahalanobis distance from the prediction.

    The covariance of the prediction includes the noise, the between-trial variation, and the uncertainty
    of the parameters. For a correct model the squared distance has a chi-squared distribution.
    """

    #: Number of held-out samples.
    samples: int
    #: Squared errors of the model with the parameters as given, without the causes, and with them.
    as_given: float
    before: float
    after: float
    #: Expected squared error of a correct model, and the largest squared error that noise and uncertain
    #: parameters explain (``limit``).
    expected: float
    limit: float
    #: Decrease of the deviance (minus twice the log predictive density) by the causes: compared with the
    #: refit without them (``gain``), and with the parameters as given (``gain_as_given``).
    gain: float = 0.0
    gain_as_given: float = 0.0


class Proposed(yamlio.Document):
    """Effect that the fits propose as a cause, before the other facts are considered."""

    equivalent: list[str] = []
    #: Probability of the effect and of effects that change the trials in the same way, divided by that of all
    #: effects that could replace it while the other causes act.
    alone: float
    #: Whether there are more equivalent effects than ``equivalent`` lists.
    crowded: bool = False
    #: Whether the effect has values of its own in each trial.
    per_trial: bool = False
    #: Whether a parameter of the effect lies at its bound.
    at_bound: bool = False


class Facts(yamlio.Document):
    """Facts from which the verdict follows (:mod:`swimid.diagnosis.verdict`)."""

    #: Probabilities of no gap, of causes of the catalogue, and of a cause outside the catalogue.
    no_gap: Number = None
    catalogue: Number = None
    outside: Number = None
    #: Effects that the fits propose as causes, by name, the most important first.
    proposed: dict[str, Proposed] = {}
    #: Errors of each held-out part as given, without the proposed causes, and with them.
    held_out: dict[str, HeldOutTrial] = {}
    #: Whether a held-out simulation diverges with the proposed causes.
    diverged: bool = False
    #: Fraction of the output that a black-box model reproduces, for each channel with less than one half. The
    #: fraction is one minus the root-mean-square error divided by the standard deviation of the output.
    unreproduced: dict[str, Number] = {}
    #: Whether failed samples are a cause.
    failed_samples: bool = False


class Absorbed(yamlio.Document):
    """Values of one model coefficient: as given, refitted without the causes, and with them."""

    coefficient: str
    given: Value | None = None
    without: Value
    with_effect: Value


class Cause(yamlio.Document):
    """Effect that is reported as a cause of the gap."""

    effect: str
    #: Probability that the effect, or one of its equivalents, is missing in the model.
    probability: Number
    #: Effects that these trials cannot distinguish from this effect.
    equivalent: list[str] = []
    #: Estimated parameters of the effect. Another interpretation of the robot's source
    #: (``reading:NAME=OPTION``) has none.
    parameters: dict[str, ChangedValue | Value]
    shrinkage: list[Shrinkage] = []
    stage: Stage | None = None
    meaning: str = ""
    sources: list[str] = []
    #: Decrease of the deviance of held-out data by the effect.
    gain: Number = None
    gain_stderr: Number = None
    absorbed: list[Absorbed] = []


class Remaining(yamlio.Document):
    """Residuals that remain with the causes in the model."""

    #: Fraction of the squared gap that remains with the causes in the model.
    share: Number
    where: str
    #: Whether the remaining residuals have no structure.
    white: bool


class Advice(yamlio.Document):
    """Proposed next experiment."""

    text: str
    #: Rival causes that the experiment would distinguish.
    separates: list[str] = []
    #: Difference between the rival causes in noise standard deviations: predicted for the experiment
    #: (``difference``), 95 % quantile for noise alone (``noise``), and value on the present trials (``now``).
    difference: Number = None
    noise: Number = None
    now: Number = None
    #: Command file of the proposed trial, in memory. The gap file does not contain it.
    _command: Log | None = None

    @property
    def command(self) -> Log | None:
        """Return the command file of the proposed trial; None without a proposal or if read from a file."""
        return self._command


class EffectRow(yamlio.Document):
    """Results for one effect of the catalogue that is the only effect in the model."""

    effect: str
    stage: Stage | None = None
    variant: str = ""
    #: Decrease of the deviance of held-out data; unknown for an effect that was screened only.
    gain: Number = None
    stderr: Number = None
    #: Fraction of the squared change due to the effect that the coefficients can imitate.
    absorbed: Number = None
    #: Probability that the effect is among the causes.
    probability: Number = 0.0


class HypothesisRow(yamlio.Document):
    """Set of effects that was fitted together with the model; the empty set is the model without effects."""

    effects: list[str]
    #: Number of shared parameters of the effects.
    numbers: int = 0
    #: Logarithm of the ratio of the prior volumes of the coefficients with and without the effects.
    widening: float = 0.0
    #: Minus twice the log predictive density of each fold, given the other folds, up to a constant.
    deviances: list[Number] = []
    #: Squared distance of the parameters from their prior means, in units of the prior covariance.
    strain: Number = 0.0
    #: Similarity of each effect of the hypothesis to the others: largest squared cosine between the changes
    #: of the trials due to this effect and due to another one.
    alike: dict[str, float] = {}
    probability: Number = None


class GapFile(yamlio.ResultFile):
    """Content of a gap file: the gap between trials and a model, and its causes.

    Example::

        format: swimid-gap/1
        verdict: explained
        waterfall:
        - {label: as given, squared: 54, expected: 1.0, rmse: {u_m_s: 0.042}}
        - {label: refitted, squared: 45, expected: 1.1, rmse: {u_m_s: 0.031}}
        - {label: + servo-backlash, squared: 2.6, expected: 1.1, rmse: {u_m_s: 0.0074}}
        - {label: noise alone, squared: 1, expected: 1, rmse: {u_m_s: 0.0046}}
        closed: {before: 54, refitted: 45, after: 2.6, share: 0.97, ci95: [0.93, 1.0], by_refit: 0.17}
        causes:
        - effect: servo-backlash
          probability: 0.83
          equivalent: [amplitude-loss]
          parameters: {backlash_rad: {value: 0.035, stderr: 0.002, unit: rad, status: estimated}}
    """

    kind: ClassVar[str] = "gap file"
    format: Literal["swimid-gap/1"] = "swimid-gap/1"
    verdict: Verdict
    #: Errors of the model with the parameters as given, by channel, as the command ``compare`` computes them
    #: over all trials.
    as_given: dict[str, ChannelScore] = {}
    where: Where
    #: Errors on held-out data: as given, refitted, after each cause in turn, and of the noise alone.
    waterfall: list[WaterfallStep] = []
    #: Closed share of the squared gap over all channels; None without a cause.
    closed: Closed | None = None
    #: Causes of the gap, the most important first. Several causes act together.
    causes: list[Cause]
    remaining: Remaining
    advice: list[Advice] = []
    model: str = ""
    robot: str = ""
    experiment: str = ""
    params: str = ""
    trials: list[str] = []
    #: Facts from which the verdict follows.
    facts: Facts = Facts()
    #: Data from which the probabilities in this file are computed: hypotheses, number of samples
    #: (``samples``), and number of effects, changed parameters and other interpretations of the robot
    #: (``tried``).
    hypotheses: list[HypothesisRow] = []
    samples: int | None = None
    tried: int | None = None
    #: Data that are held out to compute the errors without and with the causes: trials of role
    #: ``validation``, or the folds of a cross-validation. A fold is a whole trial (``trials``) or a segment
    #: of one (``stretches``).
    held_out: HeldOut | None = None
    #: Text that states from which data the noise floor was computed.
    floor_from: str = ""
    #: Trials that were left out because they have parameters of their own, each with a text on the
    #: differences.
    odd_trials: dict[str, str] = {}
    #: Random effects: standard deviation between trials, in units of the typical scale of the effect.
    random_effects: dict[str, float] = {}
    #: Number of different settings among the fitted and validation trials.
    setting_count: int | None = None
    #: Scores of all effects, best first.
    scores: list[EffectRow] = []
    #: Parameters whose refitted values differ significantly from those of the parameter file. Their change is
    #: not a hypothesis, because the file states no standard error or the model is a black box.
    moved: dict[str, ChangedValue] = {}
    #: Coefficients that are at a bound in the refit without effects, with the value of the bound.
    at_bound: dict[str, float] = {}
    #: Reasons for the verdict. Each is a clause.
    reasons: list[str] = []
    #: Effects that could not be tested as causes, with the reason.
    left_out: dict[str, str] = {}
    provenance: yamlio.Provenance = Field(default_factory=dict)

    @model_validator(mode="after")
    def _largest_first(self) -> GapFile:
        """Sort every list of the gap file by size, largest first. Unknown values come last.

        Scores without a gain keep the order of the screening.
        """
        where = self.where
        where.channels.sort(key=lambda c: -_size(c.share))
        for cells in (where.phase, where.regime, where.time):
            cells.sort(key=lambda c: -_size(c.ratio))
        where.stage = dict(sorted(where.stage.items(), key=lambda item: -_size(item[1])))
        # A channel without samples in the fitted trials comes last.
        order = {c.channel: place for place, c in enumerate(where.channels)}
        for cause in self.causes:
            cause.shrinkage.sort(key=lambda s: order.get(s.channel, len(order)))
        self.scores.sort(key=lambda s: -_size(s.gain))
        return self

    def write(self, path: str | Path) -> None:
        """Write the gap file completely or not at all. Unknown values are written as null."""
        yamlio.write(path, self.model_dump(mode="python"))


def _size(value: float | None) -> float:
    if value is None:
        return -math.inf
    return value
