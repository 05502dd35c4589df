"""What a diagnosis found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from swimid.diagnosis.posterior import Candidate
from swimid.fitting.model import Array

Verdict = Literal["none", "explained", "ambiguous", "unexplained"]
HeldOut = Literal["validation", "trials", "stretches"]


@dataclass(frozen=True)
class ChannelGap:
    """The gap in one channel, over all trials, of the nominal model refitted.

    Attributes
    ----------
    nrmse, floor : float
        Error and noise floor over the measured range.
    share : float
        Of the whole gap's squared size (in units of the noise).
    rmse : float
        In ``unit``.
    shipped : float
        ``nrmse`` with the parameters as given.
    """

    channel: str
    unit: str
    nrmse: float
    floor: float
    share: float
    rmse: float
    shipped: float


@dataclass(frozen=True)
class Cell:
    """The gap in one part of the data.

    Attributes
    ----------
    label : str
        ``"1.4 Hz"``, ``"start-up"``, ``"45-90 deg"``.
    kind : str
        What is divided: ``frequency``, ``amplitude``, ``bias``, ``speed``, ``mass``, ``trial``,
        ``phase``, ``time``, ``change``.
    ratio : float
        Root-mean-square residual over the noise floor there.
    share : float
        Of the whole gap's squared size.
    """

    kind: str
    label: str
    ratio: float
    share: float


@dataclass(frozen=True)
class Number:
    """An estimate."""

    value: float
    stderr: float | None
    unit: str
    status: str = "estimated"


@dataclass(frozen=True)
class Shrinkage:
    """Errors of one channel on held-out data (:attr:`Gap.held_out`), over the measured range.

    Attributes
    ----------
    before, after : float
        Nominal model refitted without, and with the causes.
    shipped : float
        The parameters as given.
    floor : float
    closed : float
        ``(before - after) / (before - floor)``; NaN where there is no gap.
    ci95 : (float, float)
        By bootstrap over trials.
    """

    channel: str
    before: float
    after: float
    shipped: float
    floor: float
    closed: float
    ci95: tuple[float, float]


@dataclass(frozen=True)
class Absorbed:
    """A coefficient of the model as given, refitted without the effect and with it."""

    name: str
    unit: str
    given: Number | None
    without: Number
    with_effect: Number
    bounds: tuple[float | None, float | None] = (None, None)


@dataclass(frozen=True)
class Extrapolation:
    """Error on a setting left out of the fit, in units of the noise: without and with the effect."""

    left_out: str
    before: float
    after: float


@dataclass(frozen=True)
class Score:
    """How one effect did.

    Attributes
    ----------
    gain, stderr : float
        Drop of the held-out misfit (squared residuals in units of the noise), and its standard
        error over trials.
    won : (int, int)
        Trials on which it helps, of how many.
    absorbed : float
        Share of the effect's signature that the nominal coefficients can imitate.
    screened : float
        Gain the screen predicted.
    refitted : bool
        False where the screen left it out.
    probability : float
        That it is among the causes.
    """

    effect: str
    stage: str
    variant: str
    gain: float
    stderr: float
    won: tuple[int, int]
    absorbed: float
    screened: float
    refitted: bool
    probability: float


@dataclass(frozen=True)
class Cause:
    """An effect that is part of the answer, and how likely it or an equivalent is."""

    effect: str
    stage: str
    meaning: str
    sources: tuple[str, ...]
    probability: float
    equivalent: tuple[str, ...]
    parameters: Mapping[str, Number]
    shrinkage: tuple[Shrinkage, ...]
    gain: float
    gain_stderr: float
    absorbed: tuple[Absorbed, ...] = ()
    extrapolations: tuple[Extrapolation, ...] = ()


@dataclass(frozen=True)
class Remaining:
    """What is left after the causes.

    Attributes
    ----------
    share : float
        Of the gap's squared size.
    where : str
        In words.
    white : bool
        Whether what is left shows no structure.
    gain : float
        Held-out gain of a generic description of it.
    """

    share: float
    where: str
    white: bool
    gain: float


@dataclass(frozen=True)
class Sketch:
    """A residual force (or sensor term) against something that may drive it.

    Attributes
    ----------
    name, unit : str
        ``surge force``, N.
    against, against_unit : str
        ``speed``, ``phase``, ``time``, ...
    x, y, stderr : ndarray, shape (bins,)
    """

    name: str
    unit: str
    against: str
    against_unit: str
    x: Array
    y: Array
    stderr: Array
    gain: float = 0.0


@dataclass(frozen=True)
class Overlay:
    """One channel of one trial: measured, simulated before and after (held out where that was possible)."""

    trial: str
    channel: str
    unit: str
    held_out: bool
    time_s: Array
    measured: Array
    before: Array
    after: Array


@dataclass(frozen=True)
class Advice:
    """A next experiment.

    Attributes
    ----------
    text : str
        What to do and why, in words.
    separates : tuple of str
        The rivals it tells apart.
    difference : float
        Predicted difference between them, in units of the noise (root of the sum of squares), after
        everything else is refitted.
    now : float
        The same on the trials at hand.
    """

    text: str
    separates: tuple[str, ...]
    difference: float
    now: float


@dataclass(frozen=True)
class Gap:
    """The whole diagnosis.

    Attributes
    ----------
    no_gap, outside : float
        Probability that there is none, and that its cause is outside the catalogue.
    hypotheses : tuple of (Candidate, probability)
        Every set of effects that was fitted: what it leaves in units of the noise, with what its numbers must
        lower that by, and in each fold; the model as it is first.
    samples, tried : int
        Residuals in all, and effects that apply.
    held_out : str
        How the errors before and after were found: ``validation`` trials, or approximate cross-validation
        over ``trials`` or over ``stretches`` of trials.
    stages : mapping of stage to float
        Share of the evidence each stage of the chain has, summing to 1 (0 for all when no gap).
    maps : mapping of title to (row labels, column labels, ratios)
        Heat maps of root-mean-square residual over floor: trial by channel, phase by trial ...
    forces : mapping of name to float
        Held-out gain of generic residual forces and sensor terms, by axis.
    floor_from : str
        How the floor was found, in words.
    at_bound : mapping of coefficient to float
        Bounds at which coefficients end in the refit without effects.
    """

    verdict: Verdict
    channels: tuple[ChannelGap, ...]
    stages: Mapping[str, float]
    phase: tuple[Cell, ...]
    regime: tuple[Cell, ...]
    time: tuple[Cell, ...]
    causes: tuple[Cause, ...]
    remaining: Remaining
    advice: tuple[Advice, ...]
    scores: tuple[Score, ...]
    no_gap: float
    outside: float
    floor_from: str
    held_out: HeldOut = "trials"
    sketches: tuple[Sketch, ...] = ()
    overlays: tuple[Overlay, ...] = ()
    maps: Mapping[str, tuple[list[str], list[str], Array]] = field(default_factory=dict)
    forces: Mapping[str, float] = field(default_factory=dict)
    rounds: tuple[str, ...] = ()
    reasons: tuple[str, ...] = ()
    hypotheses: tuple[tuple[Candidate, float], ...] = ()
    samples: int = 0
    tried: int = 0
    at_bound: Mapping[str, float] = field(default_factory=dict)
