"""What every output-error fit writes and shows: parameter file, checks, figures, summary."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import numpy as np

from swimid.errors import Interrupted
from swimid.files import atomic
from swimid.fitting import grading, metrics
from swimid.fitting.experiment import Experiment
from swimid.fitting.fit_result import FitResult
from swimid.fitting.identifiability import combinations, sentences
from swimid.fitting.model import Array, Channel, Parameter, chosen
from swimid.fitting.output_error import STEP_ERROR
from swimid.fitting.residual_tests import autocorrelation, joined, ljung_box
from swimid.fitting.sandwich import HETEROGENEITY
from swimid.logs.beat import TOLERANCE
from swimid.notices import warn
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results.parameters import Correlation, Estimate, Fit, ParameterFile

#: Correlations above this are named.
STRONG = 0.95
#: A validation error above this multiple of the fit error is a warning.
VALIDATION_RATIO = 2.0
#: Residuals beyond this many robust standard deviations are outliers.
OUTLIER = 8.0
#: Traces of single trials shown in one figure.
MAX_TRIALS = 10
#: Maximum number of parameters in the text of a verdict.
MAX_ANSWERS = 3


def estimates(
    result: FitResult, profiles: Mapping[str, tuple[float | None, float | None]]
) -> dict[str, Estimate]:
    """Every parameter of the model as the parameter file holds it.

    Parameters of single trials (start offsets, say) appear as ``name[trial]`` where they were
    estimated, and are left out where they were fixed.
    """
    found: dict[str, Estimate] = {}
    for p in result.parameters:
        labels = [label for label in result.labels if label.split("[")[0] == p.name]
        if not labels and not p.per_trial:
            found[p.name] = Estimate(value=p.start, unit=p.unit, bounds=p.bounds, status="fixed")
        for label in labels:
            found[label] = Estimate(
                value=float(result.estimate[result.labels.index(label)]),
                stderr=result.stderr(label),
                unit=p.unit,
                bounds=p.bounds,
                status=result.status[label],  # type: ignore[arg-type]
                ci95=profiles.get(label),
            )
    return found


def _correlation(result: FitResult) -> Correlation | None:
    """Correlation matrix of the shared parameters that were estimated, with some error each."""
    keep = [i for i, label in enumerate(result.labels) if "[" not in label and result.stderr(label)]
    if len(keep) < 2:
        return None
    part = result.covariance[np.ix_(keep, keep)]
    sd = np.sqrt(np.diag(part))
    return Correlation(names=[result.labels[i] for i in keep], matrix=(part / np.outer(sd, sd)).tolist())


def _identifiability(result: FitResult, correlation: Correlation | None) -> list[str]:
    """What the trials cannot tell, in words, and the combination they can; warns of each."""
    said = sentences(result)
    for sentence in said:
        warn("SWM010", sentence)
    for label, status in result.status.items():
        if status == "at-bound":
            bounds = numbers.bounds_text(result.parameter(label).bounds)
            warn("SWM012", f"{label} lies at its bound ({bounds}): the data ask for a value outside")
    names = correlation.names if correlation else []
    for (i, first), (j, second) in itertools.combinations(enumerate(names), 2):
        rho = correlation.matrix[i][j] if correlation else 0.0
        if abs(rho) > STRONG and result.status[first] == result.status[second] == "estimated":
            said.append(
                f"{first} and {second} are hard to tell apart (correlation {rho:+.3f}): "
                f"{_combination(result, first, second)}"
            )
            warn("SWM011", said[-1])
    return said


def _combination(result: FitResult, first: str, second: str) -> str:
    """The product of powers of two parameters that is known best."""
    indices = [result.labels.index(first), result.labels.index(second)]
    values = result.estimate[indices]
    if np.any(values <= 0):
        return "only a combination of them is well determined"
    relative = result.covariance[np.ix_(indices, indices)] / np.outer(values, values)
    sizes, vectors = np.linalg.eigh(relative)
    power = vectors[:, 0] / vectors[np.argmax(np.abs(vectors[:, 0])), 0]
    percent = 100 * math.sqrt(max(float(sizes[0]), 0.0)) / float(np.linalg.norm(vectors[:, 0] / power.max()))
    return f"best determined is {first}^{power[0]:.2f} · {second}^{power[1]:.2f}, to {percent:.2g} %"


def scores(result: FitResult, role: str, trials: Sequence[str] | None = None) -> dict[str, metrics.Score]:
    """Errors of each measured channel over all trials of a role, or over some of them."""
    ids = [t.id for t in result.trials if t.role == role and (trials is None or t.id in trials)]
    pose = metrics.pose_channels(result.model)
    found: dict[str, list[tuple[Array, Array]]] = {}
    for trial in ids:
        series = [s for s in result.series if s.trial == trial]
        measured, simulated = metrics.own_axes(
            {s.channel: s.measured for s in series}, {s.channel: s.simulated for s in series}
        )
        for s in series:
            found.setdefault(s.channel, []).append((measured[s.channel], simulated[s.channel]))
    return {
        c.name: metrics.score_trials(found[c.name], own_motion=c.name in pose)
        for c in result.model.channels
        if c.name in found
    }


def _listed(result: FitResult, role: str) -> dict[str, dict[str, Any]]:
    """Errors of each measured channel for the parameter file."""
    units = {c.name: c.unit for c in result.model.channels}
    return {name: score.as_dict(units[name]) for name, score in scores(result, role).items()}


def refuse_interrupted(result: FitResult) -> None:
    """Raise :class:`Interrupted` for a fit whose search was stopped, where that is of no use."""
    if result.interrupted:
        raise Interrupted(f"{result.message}; nothing was written")


def parameter_file(
    result: FitResult,
    *,
    robot: str,
    provenance: dict[str, Any],
    profiles: Mapping[str, tuple[float | None, float | None]] | None = None,
    derived: dict[str, Estimate] | None = None,
    settings: dict[str, Any] | None = None,
    method: str = "maximum likelihood",
    unfinished: bool = False,
) -> ParameterFile:
    """The parameter file of a fit; of one that was interrupted, too, where that may be ``unfinished``.

    Raises
    ------
    Interrupted
    """
    if not unfinished:
        refuse_interrupted(result)
    correlation = _correlation(result)
    noise = {
        channel: {**asdict(n), "autoregression": [float(a) for a in n.autoregression]}
        for channel, n in result.noise.items()
    }
    trials = {role: [t.id for t in result.trials if t.role == role] for role in ("fit", "validate")}
    validation = _listed(result, "validate")
    known_sums = {
        c.text.rpartition(" = ")[0]: Estimate(value=c.value, stderr=c.stderr, unit=c.unit, status="estimated")
        for c in combinations(result)
    }
    return ParameterFile(
        model=result.model.name,
        robot=robot,
        parameters=estimates(result, profiles or {}),
        identifiability=_identifiability(result, correlation),
        correlation=correlation,
        derived={**known_sums, **(derived or {})},
        settings=settings or {},
        fit=Fit(
            trials=trials["fit"],
            channels=_listed(result, "fit"),
            validation={"trials": trials["validate"], "channels": validation} if validation else {},
            converged=result.converged,
            message=result.message,  # type: ignore[call-arg]
            noise=noise,
            method=method,  # type: ignore[call-arg]
            samples=result.samples,  # type: ignore[call-arg]
            scatter=result.scatter,  # type: ignore[call-arg]
            step_error=result.step_error,  # type: ignore[call-arg]
        ),
        provenance=provenance,
    )


def prepare(
    experiment: Experiment,
    output: Path | None,
    *,
    parameters: Sequence[Parameter] | None = None,
    fixed: Mapping[str, float] | None = None,
    freed: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    also: Sequence[Path] = (),
) -> tuple[Parameter, ...]:
    """The parameters to fit (the model's own by default) with the user's choices.

    Parameters
    ----------
    output, also : Path
        What must be writable, and must replace neither an input of the experiment nor these.

    Raises
    ------
    InputError, UsageError
    """
    if output is not None:
        atomic.check_writable(output, inputs=(*experiment.inputs, *also))
    return chosen(
        tuple(parameters or experiment.model.parameters), fixed=fixed, freed=tuple(freed), bounds=bounds
    )


def checks(result: FitResult, file: ParameterFile) -> list[ev.Check]:
    """Tests of a fit against their limits; warns of each that fails."""
    found = [_check("converged", _yes(result.converged), "yes", result.converged, "fail", result.message)]
    if result.restarts is not None:
        after = f", after {result.restarts} restarts" if result.restarts else ""
        name, text = "starts near the answer lead back to it", "points and short searches around it"
        found.append(_check(name, _yes(result.settled) + after, "yes", result.settled, text=text))
    shared = [status for label, status in result.status.items() if "[" not in label]
    shaky = [label for label in result.shared if result.status[label] == "unidentifiable"]
    found.append(
        _check(
            "identifiable",
            "all" if not shaky else f"not: {', '.join(shaky)}",
            "every estimated parameter",
            not shaky,
            "warn" if shared.count("estimated") >= len(shaky) else "fail",
            "a parameter counts as identified when its standard error is below half its size",
        )
    )
    at_bound = [label for label, status in result.status.items() if status == "at-bound"]
    if at_bound:
        found.append(_check("inside bounds", ", ".join(at_bound), "no parameter at a bound", False))
    found += [_whiteness(result, channel) for channel in result.noise]
    if len([t for t in result.trials if t.role == "fit"]) > 2:
        agree = result.scatter_p >= HETEROGENEITY
        found.append(
            _check(
                "trials agree",
                blocks.p_text(result.scatter_p),
                f"p ≥ {HETEROGENEITY:g}",
                agree,
                text="" if agree else f"standard errors are enlarged by {result.scatter:.2f}",
                warning=(
                    "SWM014",
                    f"the trials scatter {result.scatter:.2f} times more than their noise allows (p = "
                    f"{result.scatter_p:.1g}): something differs between them that the model does not know; "
                    "the standard errors are enlarged by that factor",
                ),
            )
        )
    found += [check for channel in result.noise if (check := _outliers(result, channel))]
    if result.step_error:
        size = f"{result.step_error:.2g} sd"
        found.append(
            _check(
                "integration step",
                size,
                f"≤ {STEP_ERROR:g} sd",
                result.step_error <= STEP_ERROR,
                text="largest change of a simulated sample when the step is halved",
                warning=("SWM016", f"halving the integration step changes samples by {size} of their noise"),
            )
        )
    held_out = [c for c in result.model.channels if result.series_of(c.name, "validate")]
    return found + [_validation(result, c) for c in held_out if c.name in result.noise]


def error_checks(result: FitResult, roles: Sequence[str] = ("fit", "validate")) -> list[ev.Check]:
    """Errors of fitted and of held-out trials against the limits of ``compare``."""
    found = []
    for role in roles:
        found += grading.error_checks(
            {name: score for name, score in scores(result, role).items() if name in result.noise},
            fitted=result.noise,
            noise=[name for name in result.noise if _is_white(result, name, role)],
            held_out=role == "validate",
        )
    return found


def _is_white(result: FitResult, channel: str, role: str) -> bool:
    """Whether the residuals of a channel cannot be told from white noise."""
    parts = [s.weighted for s in result.series_of(channel, role)]
    return bool(parts) and ljung_box(joined(parts, gap=30), fitted=0).passed


def _yes(fact: bool) -> str:
    return "yes" if fact else "no"


def _check(
    name: str,
    value: str,
    limit: str,
    passed: bool,
    otherwise: Literal["warn", "fail"] = "warn",
    text: str = "",
    warning: tuple[str, str] | None = None,
) -> ev.Check:
    """A test of the result against a limit, with the code and text of the warning where it fails."""
    if warning and not passed:
        warn(*warning)
    return blocks.check(name, value, limit, passed, otherwise=otherwise, text=text)


def _outliers(result: FitResult, channel: str) -> ev.Check | None:
    """Samples far outside the bulk of the residuals, by the median absolute deviation."""
    parts = {s.trial: s.weighted for s in result.series_of(channel, "fit")}
    values = np.concatenate(list(parts.values()))
    values = values[np.isfinite(values)]
    if len(values) < 20:
        return None
    limit = OUTLIER * 1.4826 * float(np.median(np.abs(values - np.median(values))))
    owners = {t: int(np.sum(np.abs(v[np.isfinite(v)]) > limit)) for t, v in parts.items()}
    count = sum(owners.values())
    if limit <= 0 or not count:
        return None
    named = ", ".join(f"{t}: {n}" for t, n in owners.items() if n)
    return _check(
        f"no outliers, {channel}",
        f"{count} of {len(values)} samples",
        f"within {OUTLIER:g} robust standard deviations",
        False,
        text=named,
        warning=(
            "SWM025",
            f"{count} of {len(values)} samples of {channel} lie more than {OUTLIER:g} robust deviations off "
            f"({named}); they are fitted like all others: blank the cells if the sensor failed there",
        ),
    )


def _whiteness(result: FitResult, channel: str) -> ev.Check:
    test = ljung_box(_weighted(result, channel), fitted=0)
    p = blocks.p_text(test.p_value)
    coloured = "coloured residuals: the standard errors account for it, but the model may miss an effect"
    return _check(
        f"white residuals, {channel}",
        p,
        "p ≥ 0.01",
        test.passed,
        text="" if test.passed else coloured,
        warning=(
            "SWM013",
            f"the residuals of {channel} are coloured (Ljung-Box {p}): the "
            "model may miss an effect; the standard errors account for the colour",
        ),
    )


def _validation(result: FitResult, channel: Channel) -> ev.Check:
    """Error on validation trials against that on fitted ones, and against knowing nothing."""
    held_out = result.series_of(channel.name, "validate")
    fitted = _rms([s.residual for s in result.series_of(channel.name, "fit")])
    error = _rms([s.residual for s in held_out])
    nothing = _rms([s.measured - np.nanmean(s.measured) for s in held_out])
    ratio = error / fitted if fitted else math.inf
    worse = ratio > VALIDATION_RATIO
    # on the scale of logarithms more than half of what the model says of fitted trials is lost
    lost = worse and error > math.sqrt(fitted * nothing)
    worst = max(held_out, key=lambda s: _rms([s.residual]))
    far = "nearer to that of no model at all than to the fit's"
    return _check(
        f"validation, {channel.name}",
        numbers.number(error, 3, channel.unit),
        f"≤ {VALIDATION_RATIO:g} × fit error ({numbers.number(fitted, 3, channel.unit)})",
        not worse,
        "fail" if lost else "warn",
        "root-mean-square error on trials that were not fitted" + (f"; {far}" if lost else ""),
        (
            "SWM015",
            f"the error of {channel.name} on validation trials is {ratio:.1f} times that on fitted ones "
            f"(worst in {worst.trial})" + (f", {far}" if lost else ""),
        ),
    )


def _rms(parts: Sequence[np.ndarray]) -> float:
    values = np.concatenate(parts)
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def beat_check(found: Mapping[str, Mapping[str, Any] | None]) -> ev.Check:
    """Whether the beat in each log is the one its metadata state (:mod:`swimid.logs.beat`)."""
    known = {name: b for name, b in found.items() if b is not None and b["found_hz"] is not None}
    wrong = [
        name
        for name, b in known.items()
        if abs(b["found_hz"] - b["stated_hz"]) > max(TOLERANCE * b["stated_hz"], 3 * b["stderr_hz"])
    ]
    return blocks.check(
        "beat frequency as stated",
        "yes" if not wrong else f"not in {len(wrong)} of {len(known)} trials",
        f"within {100 * TOLERANCE:g} %",
        not wrong,
        text="found in the heading of each log",
    )


def _weighted(result: FitResult, channel: str) -> np.ndarray:
    return joined([s.weighted for s in result.series_of(channel, "fit")], gap=30)


def figures(result: FitResult) -> list[ev.Figure]:
    """Measured against simulated, residuals over time, and their autocorrelation."""
    found = []
    for channel in (c for name in result.noise for c in result.model.channels if c.name == name):
        parts = result.series_of(channel.name)
        shown = parts if len(parts) <= MAX_TRIALS else parts[:: math.ceil(len(parts) / MAX_TRIALS)]
        count = "" if len(shown) == len(parts) else f" {len(shown)} of {len(parts)} trials are shown."
        found += [
            blocks.measured_and_simulated(
                f"overlay-{channel.name}",
                f"Measured and simulated: {channel.name}",
                "Points are measured, lines simulated with the estimated parameters; in a good fit the lines "
                f"run through the points of every trial.{count}",
                result.model.abscissa,
                f"{channel.meaning or channel.name} ({numbers.unit_text(channel.unit) or '1'})",
                shown,
            ),
            blocks.residuals(
                f"residuals-{channel.name}",
                f"Residuals: {channel.name}",
                "Left: measured minus simulated over the noise's standard deviation; good residuals scatter "
                "about zero, mostly within ±2, without a trend. Right: their autocorrelation with the 95 % "
                "band of white noise.",
                result.model.abscissa,
                shown,
                autocorrelation(_weighted(result, channel.name)),
            ),
        ]
    return found


def answer(file: ParameterFile) -> str:
    """Return the first shared parameters that were estimated, as one sentence."""
    parts = [
        f"{name} {numbers.measured(e.value, e.stderr, e.unit)}"
        for name, e in file.parameters.items()
        if e.status == "estimated" and "[" not in name
    ]
    if not parts:
        return "Nothing was estimated."
    more = f"; and {len(parts) - MAX_ANSWERS} more" if len(parts) > MAX_ANSWERS else ""
    return f"{'; '.join(parts[:MAX_ANSWERS])}{more}."
