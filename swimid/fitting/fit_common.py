"""What every output-error fit writes and shows: parameter file, checks, figures, summary."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import Interrupted
from swimid.files import atomic
from swimid.fitting import metrics
from swimid.fitting.experiment import Experiment
from swimid.fitting.identifiability import combinations, sentences
from swimid.fitting.model import Parameter, chosen
from swimid.fitting.output_error import STEP_ERROR, FitResult
from swimid.fitting.residual_tests import autocorrelation, joined, ljung_box
from swimid.fitting.sandwich import HETEROGENEITY
from swimid.logs.beat import TOLERANCE
from swimid.notices import warn
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results import parameters as parameters_format
from swimid.results.fitted import Fitted
from swimid.results.parameters import Correlation, Estimate, Fit, ParameterFile

#: Correlations above this are named.
STRONG = 0.95
#: A validation error above this multiple of the fit error is a warning.
VALIDATION_RATIO = 2.0
#: Residuals beyond this many robust standard deviations are outliers.
OUTLIER = 8.0
#: Traces of single trials shown in one figure.
MAX_TRIALS = 10


def estimates(
    result: FitResult, profiles: Mapping[str, tuple[float | None, float | None]]
) -> dict[str, Estimate]:
    """Every parameter of the model as the parameter file holds it.

    Parameters of single trials (start offsets, say) appear as ``name[trial]`` where they were
    estimated, and are left out where they were fixed.
    """
    found: dict[str, Estimate] = {}
    for parameter in result.parameters:
        labels = [label for label in result.labels if label.split("[")[0] == parameter.name]
        if not labels and not parameter.per_trial:
            found[parameter.name] = Estimate(
                value=parameter.start,
                stderr=None,
                unit=parameter.unit,
                bounds=parameter.bounds,
                status="fixed",
            )
        for label in labels:
            found[label] = Estimate(
                value=float(result.estimate[result.labels.index(label)]),
                stderr=result.stderr(label),
                unit=parameter.unit,
                bounds=parameter.bounds,
                status=result.status[label],  # type: ignore[arg-type]
                ci95=profiles.get(label),
            )
    return found


def correlation_of(result: FitResult) -> Correlation | None:
    """Correlation matrix of the shared parameters that were estimated, with some error each."""
    keep = [i for i, label in enumerate(result.labels) if "[" not in label and result.stderr(label)]
    if len(keep) < 2:
        return None
    part = result.covariance[np.ix_(keep, keep)]
    sd = np.sqrt(np.diag(part))
    return Correlation(names=[result.labels[i] for i in keep], matrix=(part / np.outer(sd, sd)).tolist())


def identifiability(result: FitResult, correlation: Correlation | None) -> list[str]:
    """What the trials cannot tell, in words, and the combination they can; warns of each."""
    said = sentences(result)
    for sentence in said:
        warn("SWM010", sentence)
    for label, status in result.status.items():
        if status == "at-bound":
            name = label.split("[")[0]
            bounds = next(p for p in result.parameters if p.name == name).bounds
            text = (
                f"{label} lies at its bound ({numbers.bounds_text(bounds)}): the data ask for a value outside"
            )
            warn("SWM012", text)
    if correlation is None:
        return said
    for i, first in enumerate(correlation.names):
        for j in range(i + 1, len(correlation.names)):
            rho, second = correlation.matrix[i][j], correlation.names[j]
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


def scores(result: FitResult, role: str) -> dict[str, dict[str, Any]]:
    """Error of each measured channel over all trials of a role, for the parameter file."""
    found = {}
    units = {c.name: c.unit for c in result.model.channels}
    for channel, unit in units.items():
        parts = [s for s in result.series if s.role == role and s.channel == channel]
        if parts:
            pooled = metrics.score(
                np.concatenate([s.measured for s in parts]), np.concatenate([s.simulated for s in parts])
            )
            found[channel] = pooled.as_dict(unit)
    return found


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
    """The parameter file of a fit.

    Parameters
    ----------
    unfinished : bool
        Of a fit that was interrupted, too; the file says that it did not converge.

    Raises
    ------
    Interrupted
    """
    if not unfinished:
        refuse_interrupted(result)
    correlation = correlation_of(result)
    noise = {
        channel: {
            "value_sd": n.value_sd,
            "time_sd_s": n.time_sd_s,
            "autoregression": [float(a) for a in n.autoregression],
        }
        for channel, n in result.noise.items()
    }
    validation = scores(result, "validate")
    return ParameterFile(
        model=result.model.name,
        robot=robot,
        parameters=estimates(result, profiles or {}),
        identifiability=identifiability(result, correlation),
        correlation=correlation,
        derived={**_known_sums(result), **(derived or {})},
        settings=settings or {},
        fit=Fit(
            trials=[t.id for t in result.trials if t.role == "fit"],
            channels=scores(result, "fit"),
            validation={
                "trials": [t.id for t in result.trials if t.role == "validate"],
                "channels": validation,
            }
            if validation
            else {},
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


def _known_sums(result: FitResult) -> dict[str, Estimate]:
    """Sums of confounded parameters that the trials do determine."""
    return {
        c.text.rpartition(" = ")[0]: Estimate(value=c.value, stderr=c.stderr, unit=c.unit, status="estimated")
        for c in combinations(result)
    }


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
    """The parameters to fit with the user's choices, once the output is known to be writable.

    Parameters
    ----------
    parameters : sequence of Parameter, optional
        Default those of the experiment's model.
    also : sequence of Path
        Inputs besides the experiment's own that the output must not replace.

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
    yes = {True: "yes", False: "no"}
    found = [
        blocks.check(
            "converged", yes[result.converged], "yes", result.converged, otherwise="fail", text=result.message
        )
    ]
    if result.restarts is not None:
        after = f", after {result.restarts} restarts" if result.restarts else ""
        found.append(
            blocks.check(
                "starts near the answer lead back to it",
                yes[result.settled] + after,
                "yes",
                result.settled,
                text="points and short searches around it",
            )
        )
    shared = {label: status for label, status in result.status.items() if "[" not in label}
    shaky = [label for label, status in shared.items() if status == "unidentifiable"]
    known = [label for label, status in shared.items() if status == "estimated"]
    found.append(
        blocks.check(
            "identifiable",
            "all" if not shaky else f"not: {', '.join(shaky)}",
            "every estimated parameter",
            not shaky,
            otherwise="warn" if len(known) >= len(shaky) else "fail",
            text="a parameter counts as identified when its standard error is below half its size",
        )
    )
    at_bound = [label for label, status in result.status.items() if status == "at-bound"]
    if at_bound:
        found.append(blocks.check("inside bounds", ", ".join(at_bound), "no parameter at a bound", False))
    found += _whiteness(result)
    if len([t for t in result.trials if t.role == "fit"]) > 2:
        agree = result.scatter_p >= HETEROGENEITY
        text = "" if agree else f"standard errors are enlarged by {result.scatter:.2f}"
        found.append(
            blocks.check(
                "trials agree",
                blocks.p_text(result.scatter_p),
                f"p ≥ {HETEROGENEITY:g}",
                agree,
                text=text,
            )
        )
        if not agree:
            warn(
                "SWM014",
                f"the trials scatter {result.scatter:.2f} times more than their noise allows (p = "
                f"{result.scatter_p:.1g}): something differs between them that the model does not know; the "
                "standard errors are enlarged by that factor",
            )
    found += _outliers(result)
    if result.step_error:
        fine = result.step_error <= STEP_ERROR
        found.append(
            blocks.check(
                "integration step",
                f"{result.step_error:.2g} sd",
                f"≤ {STEP_ERROR:g} sd",
                fine,
                text="largest change of a simulated sample when the step is halved",
            )
        )
        if not fine:
            warn(
                "SWM016",
                f"halving the integration step changes samples by {result.step_error:.2g} sd of their noise",
            )
    return found + _validation(result)


def _outliers(result: FitResult) -> list[ev.Check]:
    """Samples far outside the bulk of the residuals, by the median absolute deviation."""
    found = []
    for channel in result.noise:
        parts = {s.trial: s.weighted for s in result.series if s.role == "fit" and s.channel == channel}
        values = np.concatenate(list(parts.values()))
        values = values[np.isfinite(values)]
        if len(values) < 20:
            continue
        limit = OUTLIER * 1.4826 * float(np.median(np.abs(values - np.median(values))))
        if limit <= 0:
            continue
        owners = {t: int(np.sum(np.abs(v[np.isfinite(v)]) > limit)) for t, v in parts.items()}
        count = sum(owners.values())
        if not count:
            continue
        named = ", ".join(f"{t}: {n}" for t, n in owners.items() if n)
        found.append(
            blocks.check(
                f"no outliers, {channel}",
                f"{count} of {len(values)} samples",
                f"within {OUTLIER:g} robust standard deviations",
                False,
                text=named,
            )
        )
        warn(
            "SWM025",
            f"{count} of {len(values)} samples of {channel} lie more than {OUTLIER:g} robust deviations off "
            f"({named}); they are fitted like all others: blank the cells if the sensor failed there",
        )
    return found


def _whiteness(result: FitResult) -> list[ev.Check]:
    found = []
    for channel in result.noise:
        test = ljung_box(_weighted(result, channel), fitted=0)
        coloured = "coloured residuals: the standard errors account for it, but the model may miss an effect"
        found.append(
            blocks.check(
                f"white residuals, {channel}",
                blocks.p_text(test.p_value),
                "p ≥ 0.01",
                test.passed,
                text="" if test.passed else coloured,
            )
        )
        if not test.passed:
            warn(
                "SWM013",
                f"the residuals of {channel} are coloured (Ljung-Box {blocks.p_text(test.p_value)}): the "
                "model may miss an effect; the standard errors account for the colour",
            )
    return found


def _validation(result: FitResult) -> list[ev.Check]:
    """Errors on validation trials against those on fitted ones, and against knowing nothing."""
    found = []
    for channel in (c for c in result.model.channels if c.name in result.noise):
        held_out = [s for s in result.series if s.role == "validate" and s.channel == channel.name]
        if not held_out:
            continue
        fitted = _rms([s.residual for s in result.series if s.role == "fit" and s.channel == channel.name])
        error = _rms([s.residual for s in held_out])
        nothing = _rms([s.measured - np.nanmean(s.measured) for s in held_out])
        ratio = error / fitted if fitted else math.inf
        worse = ratio > VALIDATION_RATIO
        # on the scale of logarithms more than half of what the model says of fitted trials is lost
        lost = worse and error > math.sqrt(fitted * nothing)
        worst = max(held_out, key=lambda s: _rms([s.residual]))
        found.append(
            blocks.check(
                f"validation, {channel.name}",
                numbers.number(error, 3, channel.unit),
                f"≤ {VALIDATION_RATIO:g} × fit error ({numbers.number(fitted, 3, channel.unit)})",
                not worse,
                otherwise="fail" if lost else "warn",
                text="root-mean-square error on trials that were not fitted"
                + ("; nearer to that of no model at all than to the fit's" if lost else ""),
            )
        )
        if worse:
            far = ", nearer to that of no model at all than to the fit's" if lost else ""
            warn(
                "SWM015",
                f"the error of {channel.name} on validation trials is {ratio:.1f} times that on fitted ones "
                f"(worst in {worst.trial}){far}",
            )
    return found


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
    parts = [s.weighted for s in result.series if s.role == "fit" and s.channel == channel]
    return joined(parts, gap=30)


def figures(result: FitResult) -> list[ev.Figure]:
    """Measured against simulated, residuals over time, and their autocorrelation."""
    found = []
    units = {c.name: (c.unit, c.meaning) for c in result.model.channels}
    for channel in result.noise:
        unit, meaning = units[channel]
        parts = [s for s in result.series if s.channel == channel]
        shown = parts if len(parts) <= MAX_TRIALS else parts[:: math.ceil(len(parts) / MAX_TRIALS)]
        count = "" if len(shown) == len(parts) else f" {len(shown)} of {len(parts)} trials are shown."
        found += [
            blocks.measured_and_simulated(
                f"overlay-{channel}",
                f"Measured and simulated: {channel}",
                "Points are measured, lines simulated with the estimated parameters; in a good fit the lines "
                f"run through the points of every trial.{count}",
                result.model.abscissa,
                f"{meaning or channel} ({numbers.unit_text(unit) or '1'})",
                shown,
            ),
            blocks.residuals(
                f"residuals-{channel}",
                f"Residuals: {channel}",
                "Left: measured minus simulated over the noise's standard deviation; good residuals scatter "
                "about zero, mostly within ±2, without a trend. Right: their autocorrelation with the 95 % "
                "band of white noise.",
                result.model.abscissa,
                shown,
                autocorrelation(_weighted(result, channel)),
            ),
        ]
    return found


def answer(file: ParameterFile) -> str:
    """The shared parameters that were estimated, as one sentence."""
    parts = [
        f"{name} {numbers.measured(e.value, e.stderr, e.unit)}"
        for name, e in file.parameters.items()
        if e.status == "estimated" and "[" not in name
    ]
    return "; ".join(parts) + "." if parts else "Nothing was estimated."


def brief(file: ParameterFile) -> ParameterFile:
    """The file without what belongs to single trials, for the terminal."""

    def shared(block: dict[str, Estimate]) -> dict[str, Estimate]:
        return {k: v for k, v in block.items() if "[" not in k}

    return file.model_copy(update={"parameters": shared(file.parameters), "derived": shared(file.derived)})


def save(output: Path | None, file: ParameterFile, evidence: ev.Evidence) -> list[Path]:
    """Write a parameter file and its evidence beside it; a device takes the parameters alone."""
    if output is None:
        return []
    parameters_format.write(output, file)
    return ev.write_beside(output, evidence)


def fitted(verb: str, text: str, file: ParameterFile, evidence: ev.Evidence, output: Path | None) -> Fitted:
    """The result of a fit, written where an output is named."""
    made = Fitted(verb, text, file.model_dump(mode="json"), evidence=evidence, document=file)
    return made.saved(output)
