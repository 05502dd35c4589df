"""The verdict, checks, tables and text of ``swimid rwls``, as data for the report."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from swimid.blackbox import figures as rwls_figures
from swimid.blackbox.material import Material
from swimid.results import numbers
from swimid.results.evidence import Check, Evidence, NoticeRecord, Table, Verdict

if TYPE_CHECKING:
    pass

PAPER = (
    "L. Shang, S. Wang, M. Tan, L. Cheng: Swimming locomotion modeling for biomimetic underwater vehicle "
    "with two "
    "undulating long-fins. Robotica 30 (2012) 913-923. doi:10.1017/S0263574711001159"
)
BIERMAN = "G. J. Bierman: Factorization Methods for Discrete Sequential Estimation. Academic Press, 1977."
LJUNG_BOX = (
    "G. M. Ljung, G. E. P. Box: On a measure of lack of fit in time series models. Biometrika 65 (1978) "
    "297-303. "
    "doi:10.1093/biomet/65.2.297"
)


def build(m: Material, *, notices: list[NoticeRecord]) -> Evidence:
    """Assemble the evidence."""
    kind = "ARMAX" if m.found.orders.nc else "ARX"
    return Evidence(
        verb="rwls",
        title=f"{kind} model, {m.columns[0]} to {m.columns[1]}",
        verdict=_verdict(m),
        checks=_checks(m),
        tables=[_errors(m), _poles(m), *_orders(m)],
        figures=rwls_figures.figures(m),
        notices=notices,
        methods=_methods(m),
        references=[PAPER, BIERMAN, LJUNG_BOX],
        provenance=m.file.provenance,
    )


def _verdict(m: Material) -> Verdict:
    unstable = any(p.unstable for p in m.poles)
    diverged = m.fit_scores.diverged or any(s.diverged for s in m.scores.values())
    held = [s.free_run.fit_percent for s in m.scores.values()]
    if unstable or diverged:
        return Verdict(
            level="bad",
            text="The model is unstable or its free run diverges: it predicts, but it cannot be simulated.",
        )
    if not held:
        return Verdict(
            level="caution",
            text="No held-out data: nothing shows how the model does on data it has not seen.",
        )
    worst = min(held)
    if worst < 0:
        return Verdict(
            level="bad", text=f"On held-out data the free run is worse than the mean ({worst:.1f} % fit)."
        )
    reasons = []
    if any(p.integrating for p in m.poles):
        reasons.append("it integrates, so that a free run drifts")
    if not m.tests.white.passed:
        reasons.append("its residuals are not white, so that the coefficients are biased")
    if any(e.status == "unidentifiable" for e in m.file.parameters.values()):
        reasons.append("the data do not determine every coefficient")
    tail = f"; but {', and '.join(reasons)}" if reasons else ""
    return Verdict(
        level="caution" if reasons else "good",
        text=f"The free run reproduces {worst:.1f} % of the held-out output{tail}.",
    )


def _checks(m: Material) -> list[Check]:
    checks = []
    largest = m.poles[0] if m.poles else None
    if largest is not None:
        verdict = "fail" if largest.unstable else "warn" if largest.integrating else "pass"
        checks.append(
            Check(
                name="largest pole",
                value=f"|z| = {numbers.measured(largest.magnitude, largest.stderr)}",
                limit="below 1",
                verdict=verdict,
                text="unstable" if largest.unstable else "integrating" if largest.integrating else "stable",
            )
        )
    for name, s in m.scores.items():
        fit = s.free_run.fit_percent
        checks.append(
            Check(
                name=f"free run, {name}",
                value="diverges" if s.diverged else f"{fit:.1f} % fit",
                limit="above 0 %, far above for a simulation model",
                verdict="fail" if s.diverged or not fit > 0 else "pass",
            )
        )
    checks.append(
        Check(
            name="residuals white (Ljung-Box)",
            value=f"p = {numbers.number(m.tests.white.p_value, 2)}",
            limit="p ≥ 0.01",
            verdict="pass" if m.tests.white.passed else "warn",
            text="residuals at rounding level: nothing to test" if m.found.exact else "",
        )
    )
    checks.append(
        Check(
            name="residuals independent of the input",
            value=f"p = {numbers.number(m.tests.independent.p_value, 2)}",
            limit="p ≥ 0.01",
            verdict="pass" if m.tests.independent.passed or m.found.exact else "warn",
        )
    )
    known = m.found.determined
    checks.append(
        Check(
            name="input excites B",
            value=f"{known.input_rank} of {m.found.orders.nb}",
            limit="all",
            verdict="pass" if known.input_rank >= m.found.orders.nb else "warn",
            text=f"condition number of the regression {known.condition:.2g}",
        )
    )
    lost = m.found.data.possible - len(m.found.data)
    checks.append(
        Check(
            name="rows used",
            value=f"{len(m.found.data)} of {m.found.data.possible}",
            verdict="info" if not lost else "warn" if lost > 0.2 * m.found.data.possible else "info",
        )
    )
    return checks


def _errors(m: Material) -> Table:
    rows: list[list[str | float | int | bool | None]] = []
    for name, s in {"fitted": m.fit_scores, **m.scores}.items():
        lines = [("one step", s.one_step), (f"{m.horizon} steps", s.k_step), ("free run", s.free_run)]
        if s.strict is not None:
            lines.append(("free run, predicted level", s.strict))
        for kind, q in lines:
            errors = (_finite(q.fit_percent), _finite(q.rmse), numbers.percent(q.nrmse))
            rows.append([name, kind, *errors, q.samples])
    caption = (
        "A simulation model must be judged by its free run: one-step errors are small for almost any model."
    )
    if m.centred:
        caption += (
            " The working point was removed: held-out data are judged about a level of their own, and "
            "the free run "
            "beside it at the level the fitted part predicts."
        )
    unit = numbers.unit_text(m.units[1])
    rmse = f"RMSE ({unit})" if unit else "RMSE"
    return Table(
        id="errors",
        title="Errors on fitted and held-out data",
        columns=["data", "prediction", "fit (%)", rmse, "NRMSE (of the range)", "samples"],
        rows=rows,
        caption=caption,
    )


def _poles(m: Material) -> Table:
    rows: list[list[str | float | int | bool | None]] = [
        [
            _complex(p.value),
            numbers.measured(p.magnitude, p.stderr),
            _finite(p.frequency_hz),
            _finite(p.damping_ratio),
            "unstable" if p.unstable else "integrating" if p.integrating else "stable",
        ]
        for p in m.poles
    ]
    return Table(
        id="modes",
        title="What the poles mean in time",
        columns=["z", "|z|", "natural frequency (Hz)", "damping ratio", "verdict"],
        rows=rows,
        caption="Standard errors by the delta method from the covariance of a1, a2, ...",
    )


def _complex(z: complex) -> str:
    if abs(z.imag) < 1e-12:
        return numbers.number(z.real)
    return f"{numbers.number(z.real)} {'+' if z.imag > 0 else '−'} {numbers.number(abs(z.imag))}i"


def _orders(m: Material) -> list[Table]:
    if not m.candidates:
        return []
    ranked = sorted(m.candidates, key=lambda c: c.score(m.criterion))[:12]
    aic, bic = (min(getattr(c, name) for c in m.candidates) for name in ("aic", "bic"))
    rows: list[list[str | float | int | bool | None]] = [
        [
            *(c.orders.na, c.orders.nb, c.orders.nk),
            *(round(_finite(v) or 0.0, 1) for v in (c.aic - aic, c.bic - bic)),
            _finite(c.free_run_fit),
            c.stable,
        ]
        for c in ranked
    ]
    where = "held-out data" if m.scores else "the fitted data"
    return [
        Table(
            id="orders",
            title="Orders tried",
            columns=[
                "na",
                "nb",
                "nk",
                "AIC above least",
                "BIC above least",
                f"free-run fit on {where} (%)",
                "stable",
            ],
            rows=rows,
            caption=f"The best {len(rows)} of {len(m.candidates)} by {m.criterion}; all fitted on the "
            "same rows.",
        )
    ]


def _methods(m: Material) -> list[str]:
    o = m.found.orders
    kind = "ARMAX" if o.nc else "ARX"
    text = [
        f"An {kind} model with {o} from {m.columns[0]} to {m.columns[1]} (sample time "
        f"{m.sample_time_s:.6g} s) was "
        f"identified from {len(m.found.data)} samples by recursive weighted least squares (Shang et al. "
        "2012, Eq 9) in "
        f"UD factors (Bierman 1977), with weight {m.weight:g}, P(0) = "
        f"({m.file.settings['prior_scale']:g})² I and zero "
        "initial parameters."
    ]
    if m.forgetting < 1:
        text.append(f"Old samples were discounted exponentially with the factor {m.forgetting:g} per sample.")
    elif m.weight != 1:
        text.append("The weight is constant, so that it rescales P(0) and discounts nothing.")
    if o.nc:
        text.append(
            "From the extended recursion's result the one-step error was minimised by Gauss-Newton steps."
        )
    if m.centred:
        text.append("The means of the fitted part were removed from input and output first.")
    text.append(
        "Standard errors are "
        + (
            "of the sandwich form for correlated residuals."
            if m.found.robust
            else "those of least squares with white residuals."
        )
        + " Residual whiteness was tested after Ljung and Box (1978)."
    )
    return text


def _finite(value: float) -> float | None:
    value = float(value)
    return value if math.isfinite(value) else None
