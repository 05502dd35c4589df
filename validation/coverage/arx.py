"""Coverage of ARX and ARMAX coefficients, and false alarms of the checks of ``swimid rwls``.

The data are simulated here by the difference equation. Order, poles, length, noise and input are drawn. The
last quarter of each record is held out.
"""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
from scipy.signal import lfilter

import swimid
from swimid.errors import NoTrustworthyResult
from validation.coverage.rows import ALARM, alarms, inside

REPEATS = 400


def record(rng: np.random.Generator, nc: int) -> tuple[pd.DataFrame, dict[str, float]]:
    """Return a record of a stable system with two poles and two input coefficients, and its coefficients."""
    radius, angle = rng.uniform(0.3, 0.95), rng.uniform(0.1, 2.5)
    a = np.array([-2 * radius * np.cos(angle), radius**2])
    b = rng.uniform(0.3, 1.0, 2) * rng.choice([-1.0, 1.0], 2)
    c = rng.uniform(-0.7, 0.7, nc)
    n = int(rng.choice([300, 600, 1200]))
    u = 0.3 * rng.normal(size=n)
    if rng.random() < 0.5:  # a slow input
        for k in range(1, n):
            u[k] += 0.8 * u[k - 1]
    e = rng.uniform(0.02, 0.15) * np.std(lfilter([0.0, *b], [1.0, *a], u)) * rng.normal(size=n)
    y = np.zeros(n)
    for k in range(2, n):
        y[k] = -a @ y[[k - 1, k - 2]] + b @ u[[k - 1, k - 2]] + e[k] + c @ e[k - 1 - np.arange(nc)]
    truth = dict(zip(("a1", "a2", "b1", "b2", "c1")[: 4 + nc], (*a, *b, *c), strict=True))
    return pd.DataFrame({"t_s": np.arange(n) / 50, "cmd1_rad": u, "u_m_s": y}), truth


def one(seed: int) -> dict[str, float]:
    """Return whether the intervals of each coefficient hold the truth, and which checks raise an alarm."""
    rng = np.random.default_rng([seed, 3])
    found: dict[str, float] = {}
    for kind, nc in (("ARX", 0), ("ARMAX", 1)):
        table, truth = record(rng, nc)
        columns = {"input_column": "cmd1_rad", "output_column": "u_m_s"}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                fit = swimid.rwls([table], **columns, na=2, nb=2, nc=nc, held_out=(0.25,))
            except NoTrustworthyResult:
                found[f"{kind} {ALARM}refused"] = 1.0
                continue
        for name, true in truth.items():
            found[f"{kind} {name}"] = inside(fit.data["parameters"][name], true)
        found |= alarms(fit, f"{kind} ")
    return found
