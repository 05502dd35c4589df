"""Speed of the recursion of ``swimid rwls``, beside padasip's and batch least squares.

    python benchmarks/bench_rwls.py

100 000 samples of an ARX process with 7 parameters (na = 3, nb = 4), forgetting 0.9999, CPU
seconds, best of several runs in one process. Every implementation gets the same regression
matrix and its last estimate is compared. padasip is optional (``pip install swimid[bench]``).
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from swimid.blackbox.arx import Recursion, fit_arx, recursive_least_squares, regression
from swimid.blackbox.model import ArxRecord, Orders

SAMPLES = 100_000
ORDERS = Orders(3, 4)
A, B = [-1.6, 0.9, -0.15], [0.4, 0.3, -0.2, 0.1]
FORGETTING = 0.9999


def record() -> ArxRecord:
    rng = np.random.default_rng(1)
    u = rng.normal(size=SAMPLES + ORDERS.lag)
    noise = lfilter([1.0], [1.0, *A], 0.1 * rng.normal(size=len(u)))
    y = lfilter([0.0, *B], [1.0, *A], u) + noise
    return ArxRecord("bench", np.arange(len(u)) * 0.01, u, y)


def best(function: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return min(times)


def measure(repeats: int = 15) -> list[tuple[str, float, np.ndarray]]:
    """Name, CPU seconds and last estimate of every implementation."""
    data = regression([record()], ORDERS)
    h, z = data.rows, data.outputs
    recursive_least_squares(h[:10], z[:10])  # compile, or load from the cache

    def ours() -> Recursion:
        return recursive_least_squares(h, z, forgetting=FORGETTING, prior_scale=1e3)

    rows = [
        ("swimid", best(ours, repeats), ours().theta),
        (
            "numpy lstsq (batch, no forgetting)",
            best(lambda: np.linalg.lstsq(h, z), 3),
            np.linalg.lstsq(h, z)[0],
        ),
        (
            "swimid estimate(): regression, tests, errors",
            best(lambda: fit_arx([record()], ORDERS, forgetting=FORGETTING), 2),
            fit_arx([record()], ORDERS, forgetting=FORGETTING).theta,
        ),
    ]
    try:
        import padasip
    except ImportError:
        print("padasip is not installed: pip install 'swimid[bench]'")
        return rows

    def theirs() -> np.ndarray:
        # Its eps is 1 / P(0), its mu the forgetting factor; it keeps the whole trajectory.
        filter_ = padasip.filters.FilterRLS(n=ORDERS.count, mu=FORGETTING, eps=1e-6, w="zeros")
        filter_.run(z, h)
        return filter_.w

    rows.append(("padasip FilterRLS", best(theirs, 3), theirs()))
    return rows


def main() -> None:
    rows = measure()
    reference = rows[0]
    print(f"{SAMPLES} samples, {ORDERS.count} parameters; last estimate against the first line")
    print(f"{'':<46}{'CPU s':>10}{'samples/s':>14}{'times':>8}{'difference':>12}")
    for name, seconds, theta in rows:
        difference = float(np.max(np.abs(theta - reference[2])))
        rate, slower = SAMPLES / seconds, seconds / reference[1]
        print(f"{name:<46}{seconds:>10.4f}{rate:>14,.0f}{slower:>8.1f}{difference:>12.1e}")


if __name__ == "__main__":
    main()
