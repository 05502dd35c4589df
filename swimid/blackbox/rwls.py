"""``swimid rwls``: a discrete-time model from input and output columns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from swimid.blackbox import evidence, prediction
from swimid.blackbox.identified import Identified, identify
from swimid.blackbox.model import NAME
from swimid.blackbox.options import RwlsOptions
from swimid.blackbox.trials import read
from swimid.errors import UsageError
from swimid.files import atomic, provenance
from swimid.notices import recorded, warn
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks, numbers, parameters
from swimid.results.evidence import Check
from swimid.results.fitted import Fitted

#: Warnings that tell the reason of a check that does not pass.
CODES = {"Largest pole": "SWM020", "Residuals white": "SWM013", "Coefficients determined": "SWM010"}
#: A scaled regression above this condition number is worth a warning.
ILL_CONDITIONED = 1e6


@takes(RwlsOptions)
def rwls(
    logs: Sequence[str | Path],
    *,
    options: RwlsOptions,
    output: Path | None = None,
    progress: Progress = silent,
) -> Fitted:
    """Identify an ARX or ARMAX model by recursive weighted least squares.

    A trials file may name the columns instead. See :class:`swimid.blackbox.difference.Orders` for the orders,
    :mod:`swimid.blackbox.recursive` for weight, forgetting and P(0), and
    :func:`swimid.blackbox.working_point.centre` for the means. Where the one-step residuals are not white
    (SWM013) the coefficients of an ARX model are biased: judge it by its free run, or give ``nc``.

    Parameters
    ----------
    logs : sequence of path, Log or DataFrame
        Logs, or trials files of the experiment ``arma``. One row a sample, at one rate.
    output : Path, optional
        Parameter file; its evidence goes beside it.
    progress : Progress
        Shows the order search.

    Returns
    -------
    Fitted
        ``.parameters`` has ``a1``, ... (1), ``b1``, ... (unit of the output over that of the input) and
        ``c1``, ... (1); ``.tables()`` has the ``errors`` of the predictions and the ``modes`` of the model,
        ``.data["orders_tried"]`` the orders of a search.

    Raises
    ------
    InputError
        For a log that cannot be read, a column that is missing, or rows held out that are fitted too.
    UsageError
        For options that do not fit together, or without orders.
    NoTrustworthyResult
        When there are too few rows, nothing moves in them, or the search for ``c1``, ... does not converge.

    References
    ----------
    .. [1] L. Shang, S. Wang, M. Tan, L. Cheng, "Swimming locomotion modeling for biomimetic underwater
       vehicle with two undulating long-fins", Robotica 30 (2012) 913-923, doi:10.1017/S0263574711001159.
       Eq 3: the substitute input; Eqs 4 to 7: the model; Eqs 6 to 9: the recursion.
    .. [2] G. J. Bierman, *Factorization Methods for Discrete Sequential Estimation* (1977), ch. 5: UD
       factors.
    .. [3] L. Ljung, *System Identification: Theory for the User*, 2nd ed. (1999), section 11.7: forgetting.
    .. [4] G. M. Ljung, G. E. P. Box, "On a measure of lack of fit in time series models", Biometrika 65
       (1978) 297-303, doi:10.1093/biomet/65.2.297: the test of whiteness.

    Examples
    --------
    A table made by y(k) = 0.8 y(k-1) + 0.5 u(k-1) + e(k):

    >>> import numpy as np, pandas as pd
    >>> rng = np.random.default_rng(1)
    >>> u, y = rng.normal(size=400), np.zeros(400)
    >>> for k in range(1, 400):
    ...     y[k] = 0.8 * y[k - 1] + 0.5 * u[k - 1] + 0.01 * rng.normal()
    >>> table = pd.DataFrame({"t_s": np.arange(400) / 50, "cmd1_rad": u, "u_m_s": y})
    >>> fit = rwls([table], input_column="cmd1_rad", output_column="u_m_s", na=1, nb=1)
    >>> fit.parameters["value"].round(2).to_dict()
    {'a1': -0.8, 'b1': 0.5}
    >>> fit["b1"].unit
    '(m/s)/rad'
    """
    if options.order == "given" and (options.na is None or options.nb is None):
        raise UsageError("give --na and --nb, or --order auto")
    with recorded(repeat=True) as notices:
        data = read(logs, options.held_out, options.input_column, options.output_column, options.input_model)
        if output is not None:
            atomic.check_writable(output, inputs=data.files)
        m = identify(data, options, progress)
        checks = evidence.make_checks(m)
        _warn(m, checks)
    # held-out data are named by a share, a file, or a log in memory
    held_out = [
        str(v if isinstance(v, str | float | Path) else getattr(v, "name", "log")) for v in options.held_out
    ]
    settings = _settings(m)
    block = provenance.collect(data.files, settings={**settings, "validate": held_out})
    file = _parameter_file(m, settings, block)
    made = Fitted.of(file, evidence.build(m, file, checks, blocks.notices(notices)))
    made.data["orders_tried"] = [
        {
            **asdict(c.orders),
            "aic": c.aic,
            "bic": c.bic,
            "free_run_fit_percent": c.free_run_fit,
            "stable": c.stable,
        }
        for c in m.candidates
    ]
    return made.saved(output)


def _settings(m: Identified) -> dict[str, Any]:
    """Return the options as the file records them, with the orders, columns and levels they led to."""
    options, columns = m.options, m.data.columns
    settings: dict[str, Any] = {
        "orders": asdict(m.estimate.orders),
        "order": "given" if options.order == "given" else f"auto, {options.criterion}",
        "input": columns.source,
        "output": columns.output,
        "output_unit": columns.units[1],
        **options.model_dump(include={"weight", "forgetting", "prior_scale", "centre", "horizon"}),
        "input_level": m.point.source,
        "output_level": m.point.output,
    }
    if columns.sine:
        names = ("amplitude", "frequency_hz", "phase_rad")
        settings["input_model"] = {"kind": "sine", **dict(zip(names, columns.sine, strict=True))}
    return settings


def _warn(m: Identified, checks: Sequence[Check]) -> None:
    fitted, data, point = m.estimate, m.data, m.point
    orders, known = fitted.orders, fitted.determined
    unit = numbers.unit_text(data.columns.units[1])
    lost = fitted.data.possible - len(fitted.data)
    restarts = max(int(np.count_nonzero(fitted.data.fresh)) - len(data.logs), 0)
    if lost or restarts:
        warn(
            "SWM001",
            f"{lost} of {fitted.data.possible} regression rows left out around missing samples, and the "
            f"regression restarted {restarts} times at gaps; no value was filled in",
        )
    if point.removed:
        text = (
            f"means of the fitted part removed: {data.columns.source} {point.source:.6g}, "
            f"{data.columns.output} {point.output:.6g} (constant term t = {point.t:.1f}); the model is of "
            "deviations from them"
        )
        moved = [f"{name} by {s.level:.3g}" for name, s in m.scores.items() if abs(s.level) > s.free_run.rmse]
        if moved:
            text += f". Held-out data are at another level: {', '.join(moved)} {unit}".rstrip()
        warn("SWM021", text)
    for one in checks:
        if one.name in CODES and one.verdict != "pass":
            warn(CODES[one.name], one.reason)
    source = np.concatenate([record.source for record in data.fit])
    if np.ptp(source[np.isfinite(source)]) == 0:
        warn("SWM022", "the input is constant: B is an offset of the output and says nothing of the input")
    elif known.input_rank < orders.nb:
        text = f"the input excites {known.input_rank} of the {orders.nb} coefficients of B"
        warn("SWM022", f"{text}; a single sine excites two" if known.input_rank == 2 else text)
    elif known.condition > ILL_CONDITIONED:
        text = f"the regression is ill-conditioned (condition number {known.condition:.1e}): lower the orders"
        warn("SWM022", text)
    if fitted.recursion.windup:
        warn(
            "SWM022",
            f"with forgetting, P grew without limit in directions the input does not excite; it was held at "
            f"{fitted.recursion.windup} of {len(fitted.data)} samples",
        )
    for name in m.worse:
        errors = (f"{s.free_run.rmse:.3g} {unit}".rstrip() for s in (m.scores[name], m.fit_scores))
        warn("SWM015", f"the free-run error is {next(errors)} on {name}, {next(errors)} on the fitted part")


def _parameter_file(
    m: Identified, settings: dict[str, Any], block: dict[str, Any]
) -> parameters.ParameterFile:
    fitted, data, horizon = m.estimate, m.data, m.options.horizon
    orders, names = fitted.orders, fitted.orders.names
    unit, channel = data.columns.units[1], data.columns.output
    estimates = {}
    for name, value, stderr in zip(names, fitted.theta, fitted.stderr, strict=True):
        known = math.isfinite(stderr)
        estimates[name] = parameters.Estimate(
            value=float(value),
            stderr=float(stderr) if known else None,
            unit=data.columns.gain_unit if name.startswith("b") else "1",
            status="estimated" if known else "unidentifiable",
        )
    identifiable = [name for name, e in estimates.items() if e.status == "estimated"]
    validation: dict[str, Any] = {}
    if m.scores:
        together = prediction.pooled([r for part in m.held_out.values() for r in part], fitted)
        by_set = {name: s.as_dict(unit, horizon) for name, s in m.scores.items()}
        validation[channel] = {**together.as_dict(unit), "data": by_set}
    words = []
    if len(identifiable) < orders.count:
        words.append(
            f"The data span {fitted.determined.rank} of {orders.na + orders.nb} directions; only "
            f"combinations of {', '.join(name for name in names if name not in identifiable)} are determined."
        )
    # deviations from the input's level, beyond which the model is extrapolated
    deviation = np.concatenate([record.source for record in data.fit]) - m.point.source
    details = {
        "rows": len(fitted.data),
        "rows_left_out": fitted.data.possible - len(fitted.data),
        "condition": fitted.determined.condition,
        "input_excites": fitted.determined.input_rank,
        "input_range": [float(np.nanmin(deviation)), float(np.nanmax(deviation))],
        "stability": m.stability,
        "integrating": any(p.integrating for p in m.poles),
        "recursion_end": dict(zip(names, fitted.recursion.theta.tolist(), strict=True)),
    }
    return parameters.ParameterFile(
        model=NAME,
        robot=data.robot,
        parameters=estimates,
        identifiability=words,
        correlation=parameters.Correlation(names=identifiable, matrix=fitted.correlation.tolist()),
        delay=orders.nk,
        sample_time_s=data.sample_time_s,
        poles=[
            parameters.Pole(
                real=p.value.real,
                imag=p.value.imag,
                magnitude=p.magnitude,
                stderr_magnitude=p.stderr if math.isfinite(p.stderr) else None,
            )
            for p in m.poles
        ],
        stable=not any(p.unstable for p in m.poles),
        settings=settings,
        fit=parameters.Fit(
            trials=data.logs,
            channels={
                channel: {**m.fit_scores.free_run.as_dict(unit), **m.fit_scores.as_dict(unit, horizon)}
            },
            validation=validation,
            converged=True,
            noise={
                "sd": fitted.noise_sd,
                "unit": unit,
                "white": fitted.whiteness.passed,
                "white_p": fitted.whiteness.p_value,
                "input_independent": m.independent.passed,
                "input_independent_p": m.independent.p_value,
                "standard_errors": "sandwich" if fitted.robust else "sigma^2 (H'H)^-1",
            },
            **details,
        ),
        provenance=block,
    )
