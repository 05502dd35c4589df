"""Compute the detection power of trials (``swimid-power/1``).

The results are the smallest detectable size of each effect, and the effects that cannot be distinguished. No
cause is sought. The change of these trials by each effect, with the model's parameters projected out, is
compared with the noise of the trials. The decision rule is that of a diagnosis.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.special import chndtrinc

from swimid.diagnosis import crossval, posterior, screening
from swimid.diagnosis.posterior import CALIBRATED, MAX_NO_GAP_PROBABILITY, DataSize
from swimid.diagnosis.screening import ScreeningRuns
from swimid.diagnosis.search import HypothesisSearch, prepare_study
from swimid.diagnosis.study import GapStudy
from swimid.effects.base import Effect
from swimid.files import yamlio
from swimid.files.yamlio import Number
from swimid.fitting.model import Array, Parameter
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.result import FileResult

if TYPE_CHECKING:
    import pandas as pd

FORMAT: Literal["swimid-power/1"] = "swimid-power/1"


class EffectPower(yamlio.Document):
    """Detection power of one effect."""

    effect: str
    stage: str
    #: Name of the parameter that states the size of the effect (``parameter``), and its smallest value that
    #: is detected with 90 % power (``size``). The size is null if no value within the bounds of the parameter
    #: is detected.
    parameter: str
    size: Number = None
    unit: str
    #: Fraction of the squared change due to the effect that the model's parameters imitate.
    absorbed: Number = None
    #: Effects that these trials cannot distinguish from this effect, even if it is very large.
    alike: list[str] = []


class PowerFile(yamlio.ResultFile):
    """Content of a power file."""

    kind: ClassVar[str] = "power file"
    format: Literal["swimid-power/1"] = FORMAT
    model: str
    robot: str
    experiment: str
    params: str
    trials: list[str]
    effects: list[EffectPower]
    #: Effects whose detection power could not be computed, with the reason.
    left_out: dict[str, str] = {}
    provenance: yamlio.Provenance = Field(default_factory=dict)


def build_power_evidence(file: PowerFile, notices: Sequence[ev.NoticeRecord] = ()) -> ev.Evidence:
    """Return the evidence of a power file: a table of the effects, and the number of detectable effects."""
    blind = [r.effect for r in file.effects if r.size is None]
    twins = sum(r.size is not None and bool(r.alike) for r in file.effects)
    seen = len(file.effects) - len(blind)
    answer = (
        f"These trials would show {seen} of {len(file.effects)} effects, {twins} of which they cannot "
        "distinguish from another effect."
    )
    unseen = f"these effects would not be seen at any size within their bounds: {', '.join(blind)}"
    check = ev.make_check("effects seen", str(seen), not blind, str(len(file.effects)), reason=unseen)
    rows = []
    for r in file.effects:
        imitated = None if r.absorbed is None else 100.0 * r.absorbed
        size = numbers.format_number(r.size, 2, r.unit)
        rows.append([r.effect, r.parameter, size, imitated, ", ".join(r.alike)])
    table = ev.Table(
        id="power",
        title="The smallest size of each effect that is seen with 90 % power",
        columns=["effect", "parameter", "smallest size", "imitated (%)", "never distinguished from"],
        rows=rows,
        caption="Imitated: share of the squared change due to an effect that the coefficients reproduce.",
    )
    return ev.Evidence(
        command="diagnose",
        title=f"What trials could show: {file.robot}, {file.experiment}",
        verdict=ev.make_verdict(answer, [check]),
        facts={"Trials": f"{len(file.trials)} against {file.params}"},
        notes=[f"{name}: {why}." for name, why in file.left_out.items()],
        checks=[check],
        tables=[table],
        notices=list(notices),
        methods=[
            "The change due to each effect was computed, the coefficients of the model were projected out, "
            "and the rest was compared with the noise. An effect is seen if the probability of no gap falls "
            "below 10 % in nine of ten repetitions (noncentral chi-square). Two effects are never "
            "distinguished if even a very large one leaves the other a probability above 10 %.",
        ],
        provenance=dict(file.provenance),
    )


class DetectionPower(FileResult[PowerFile]):
    """Detection power of trials: the result of ``diagnose`` with ``power=True``.

    Attributes
    ----------
    effects : DataFrame
        One row for each effect, with the columns ``effect``, ``stage``, ``parameter``, ``size``, ``unit``,
        ``absorbed`` and ``alike``. ``size`` is the smallest value of the parameter that is detected with 90 %
        power; NaN if no value within its bounds is detected. ``absorbed`` is the fraction of the squared
        change by the effect that the model's parameters imitate. ``alike`` lists the effects from which the
        effect is never distinguished.
    file : PowerFile
        The file that :meth:`save` writes.
    """

    file_type = PowerFile

    @property
    def effects(self) -> pd.DataFrame:
        """Return the table of detection powers, with one row for each effect."""
        import pandas as pd

        return pd.DataFrame([r.model_dump() for r in self.file.effects])

    def bare(self) -> ev.Evidence:
        """Return the evidence that the power file alone provides, if its evidence file is missing."""
        return build_power_evidence(self.file)


# ---------------------------------------------------------------- computation

#: Reasons why the detection power of an effect is unknown.
NO_MEASURED_CHANGE = "the effect changes no channel that was measured in these trials"
DIVERGES = "the simulation diverges with the effect"
#: Probability with which an effect of the reported size is detected.
POWER = 0.9
#: Minimum fraction of the squared change by an effect that must remain after the model's parameters are
#: projected out. A smaller remainder is rounding error.
MIN_REMAINING_SHARE = 1e-9


def compute_needed_excess(record: DataSize, numbers: int) -> float:
    """Return the minimum excess of squared residuals over the noise at which a gap is reported.

    The excess is that of the fit without the effect. The effect is assumed to close the whole gap.
    """
    costs = 0.5 * math.log(record.samples) * numbers - posterior.compute_prior_log_odds(1, record.effects)
    wanted = math.log((1.0 - MAX_NO_GAP_PROBABILITY) / MAX_NO_GAP_PROBABILITY) + costs
    directions = CALIBRATED.directions * record.parts
    share = math.expm1(2.0 * wanted / directions)
    # The tolerated excess grows with the gap. If it grows too fast, no gap is ever reported.
    room = 1.0 - CALIBRATED.form * share
    if room <= 0:
        return math.inf
    return share * posterior.compute_tolerance(record, 0.0) / room


def compute_noncentrality(drop: float, numbers: int) -> float:
    """Return the squared change of the trials by an effect that is needed for detection with 90 % power.

    With this probability, a fit of the effect reduces the cost by at least ``drop``. The squared change is in
    units of the noise variance.
    """
    if not math.isfinite(drop):
        return math.inf
    return float(chndtrinc(drop, numbers, 1.0 - POWER))


def is_distinguishable(record: DataSize, cosine: float) -> bool:
    """Return whether the trials can distinguish an effect, if it is very large, from another effect.

    The cosine is the one between the changes of the trials by the two effects.
    """
    left = max(1.0 - cosine**2, 0.0)
    gain = 0.5 * CALIBRATED.directions * record.parts * math.log1p(left / CALIBRATED.form)
    return gain > math.log((1.0 - MAX_NO_GAP_PROBABILITY) / MAX_NO_GAP_PROBABILITY)


def compute_power(
    given: GapStudy, effects: Sequence[Effect], asked: Collection[str] | None, *, seed: int
) -> tuple[list[EffectPower], dict[str, str]]:
    """Return the detection power of each effect, and the reasons why it is unknown for some effects.

    The noise is estimated from the residuals of the model. Structure that a generic description finds in
    these residuals (:mod:`swimid.diagnosis.remainder`) does not count as noise.

    Parameters
    ----------
    effects : sequence of Effect
        All effects that apply, in every form.
    asked : collection of str or None
        Names of the requested effects; None for all effects.

    Returns
    -------
    list of EffectPower
        One row for each effect, in the order given.
    dict of name to reason
        Effects without a detection power.
    """
    study, fit, _ = prepare_study(given, effects)
    search = HypothesisSearch(study, effects, effects, rng=np.random.default_rng(seed))
    search.begin(study.start((), fit))
    search.learn(search.null)
    base, record = search.null, search.record
    columns: list[list[Array]] = []
    lines: list[_Line] = []
    left_out: dict[str, str] = {}
    wanted = [e for e in effects if asked is None or e.name in asked]
    for runs in screening.simulate_effects(search.study, base, wanted):
        own = _lines(runs, columns)
        lines += own
        if not own:
            left_out.setdefault(runs.effect.name, NO_MEASURED_CHANGE if runs.points else DIVERGES)
    inner = crossval.form_normal_equations(search.study, base, columns)
    products = crossval.project_columns(inner)[:-1, :-1]
    squares = np.maximum(products.diagonal(), 0.0)
    whole = inner.products.sum(axis=0).diagonal()[inner.n_shared : -1]
    best: dict[str, tuple[float, EffectPower]] = {}
    every: dict[str, list[int]] = {}
    for line in lines:
        name, index = line.runs.effect.name, line.columns
        every.setdefault(name, []).extend(index.tolist())
        found = _find_size(line, squares[index], whole[index], record, len(study.trials))
        if name not in best or found[0] < best[name][0]:
            best[name] = found
    # If the parameters imitate a change, its remainder is rounding error. Its cosine with all others is set
    # to 0.
    norm = np.where(products.diagonal() > MIN_REMAINING_SHARE * whole, np.sqrt(squares), np.inf)
    cosine = np.abs(products) / np.outer(norm, norm)
    rows = [row for _, row in best.values()]
    for row in rows:
        row.alike = _list_alike(row, cosine, every, record)
    return rows, {n: why for n, why in left_out.items() if n not in best}


def _list_alike(
    row: EffectPower, cosine: Array, columns: Mapping[str, list[int]], record: DataSize
) -> list[str]:
    """Return the effects from which the trials never distinguish an effect that they detect.

    Parameters
    ----------
    cosine : ndarray, shape (c, c)
            Absolute cosines between the c simulated changes of the trials.
    columns : mapping of str to list of int
        Columns of each effect.
    """
    if row.size is None:
        return []
    mine = columns[row.effect]
    others = {name: float(cosine[np.ix_(mine, own)].max()) for name, own in columns.items()}
    del others[row.effect]
    return [name for name, largest in others.items() if not is_distinguishable(record, largest)]


class _Line(NamedTuple):
    """Parameter direction in which an effect was simulated.

    Attributes
    ----------
    parameter : Parameter
            Parameter that states the size of the effect. Further parameters that are not at their null values
            state the place and time of the effect.
    values : ndarray, shape (m,)
            The m tried values of this parameter.
    columns : ndarray of int, shape (m,)
        Indices of the resulting changes of the trials.
    """

    runs: ScreeningRuns
    parameter: Parameter
    values: Array
    columns: NDArray[np.intp]


def _find_size(
    line: _Line, squares: Array, whole: Array, record: DataSize, trial_count: int
) -> tuple[float, EffectPower]:
    """Return the smallest size of an effect that is detected, in typical scales, and its row.

    Parameters
    ----------
    squares, whole : ndarray, shape (m,)
            Squared changes of the trials at the m tried values, with (``squares``) and without (``whole``)
            the parameters of the model projected out.
    """
    p, parameters = line.parameter, line.runs.parameters
    per_trial = sum(one.per_trial for one in parameters)
    count = len(parameters) + per_trial * (trial_count - 1)
    needs = compute_noncentrality(compute_needed_excess(record, len(parameters) - per_trial), count)
    strengths = np.abs(line.values - p.start) / p.scale
    seen = np.where(squares > MIN_REMAINING_SHARE * whole, squares, 0.0)
    strength, at = _strength(strengths, seen, needs)
    size = float(p.start + (line.values[at] - p.start) * strength / strengths[at])
    row = EffectPower(
        effect=line.runs.effect.name,
        stage=line.runs.effect.stage,
        parameter=p.name,
        size=size if p.lower <= size <= p.upper else None,
        unit=p.unit,
        absorbed=float(np.clip(1.0 - squares[at] / whole[at], 0.0, 1.0)),
    )
    return strength, row


def _lines(runs: ScreeningRuns, columns: list[list[Array]]) -> list[_Line]:
    """Return the parameter directions of an effect, and append the changes of the trials to ``columns``."""
    null = np.array([p.start for p in runs.parameters])
    groups: dict[tuple[int, ...], list[tuple[float, int]]] = {}
    for point, changed in runs.points:
        moved = tuple(np.flatnonzero(point != null).tolist())
        if moved and sum(float(c @ c) for c in changed) > screening.MIN_SQUARED_CHANGE:
            groups.setdefault(moved, []).append((float(point[moved[0]]), len(columns)))
            columns.append(changed)
    lines = []
    for moved, members in groups.items():
        values, index = (np.array(part) for part in zip(*members, strict=True))
        lines.append(_Line(runs, runs.parameters[moved[0]], values, index))
    return lines


def _strength(strengths: Array, squares: Array, wanted: float) -> tuple[float, int]:
    """Return the distance of a parameter from its null value at which the squared change reaches ``wanted``.

    The second value is the index of the nearest simulated value. The squared change of the trials is assumed
    to be quadratic in the distance. The distance is infinite if the effect changes nothing.
    """
    with np.errstate(divide="ignore"):
        reached = strengths * np.sqrt(wanted / squares)
    nearest = int(np.argmin(np.abs(np.log(reached / strengths))))
    return float(reached[nearest]), nearest
