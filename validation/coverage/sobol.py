"""Coverage of the intervals of Sobol indices, on the Ishigami function, whose indices are known."""

from __future__ import annotations

import numpy as np

from swimid.sensitivity_analysis import sensitivity

REPEATS = 400
A, B = 7.0, 0.1


def one(seed: int) -> dict[str, float]:
    """Return the share of the first-order and of the total indices inside their intervals."""

    def each(rows: np.ndarray) -> np.ndarray:
        x, y, z = rows.T
        return (np.sin(x) + A * np.sin(y) ** 2 + B * z**4 * np.sin(x))[:, None]

    alone = np.array([0.5 * (1 + B * np.pi**4 / 5) ** 2, A**2 / 8, 0.0])
    common = B**2 * np.pi**8 * (1 / 18 - 1 / 50)
    first = alone / (alone.sum() + common)
    total = first + np.array([1.0, 0.0, 1.0]) * common / (alone.sum() + common)
    side = np.full(3, np.pi)
    found = sensitivity.sobol(each, -side, side, samples=256, seed=seed)
    shares = {}
    for name, ends, true in (("first-order", found.first_ci, first), ("total", found.total_ci, total)):
        for k in range(3):
            shares[f"{name} index of x{k + 1}"] = float(ends[0, 0, k] <= true[k] <= ends[1, 0, k])
    return shares
