"""Profile-likelihood intervals of an output-error fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import optimize, special

from swimid.fitting.fit_result import FitResult
from swimid.fitting.restarts import weighted


def profile_interval(
    result: FitResult, name: str, *, level: float = 0.95
) -> tuple[float | None, float | None]:
    """Profile-likelihood interval of one shared parameter.

    The parameter is held at values ever farther from its estimate, all others are refitted,
    and the interval ends where the fit is worse by the chi-square quantile. Coloured residuals
    and scattering trials widen it by the same factor as they widen the standard error. An
    end is None where the interval runs into a bound or does not end within some ten standard errors.
    """
    stderr = result.stderr(name)
    if stderr is None:
        return None, None
    whole = weighted(result, result.parameters)
    best = whole.residuals(result.estimate)
    cost = float(best @ best)
    rows = whole.jacobian(result.estimate)
    j = result.labels.index(name)
    variance = cost / max(len(best) - len(result.labels), 1)
    white = float(np.linalg.pinv(rows.T @ rows)[j, j]) * variance
    inflation = stderr**2 / white if white > 0 else 1.0
    limit = float(special.chdtri(1, 1.0 - level)) * variance * inflation
    centre, others = float(result.estimate[j]), np.delete(result.estimate, j)

    def excess(value: float) -> float:
        held = tuple(replace(p, start=value, free=False) if p.name == name else p for p in result.parameters)
        return weighted(result, held).solve(others, tolerance=1e-8).cost - cost - limit

    parameter = result.parameter(name)
    ends: list[float | None] = []
    for side, bound in ((-1.0, parameter.lower), (1.0, parameter.upper)):
        near, end = centre, None
        for k in range(7):
            far = centre + side * 2.5 * stderr * 1.4**k
            if (far - bound) * side >= 0:
                break
            if excess(far) > 0:
                end = float(optimize.brentq(excess, near, far, xtol=1e-3 * stderr))
                break
            near = far
        ends.append(end)
    return ends[0], ends[1]
