"""Print the coverage of 95 % intervals: ``python -m tests.coverage stroke --repeats 300``."""

from __future__ import annotations

import importlib
import pkgutil
from concurrent.futures import ProcessPoolExecutor

import click
import numpy as np

from tests import coverage

NAMES = sorted(found.name for found in pkgutil.iter_modules(coverage.__path__) if found.name != "__main__")


def measure(name: str, repeats: int, jobs: int = 1) -> dict[str, tuple[float, float]]:
    """Return the mean coverage and its standard error by quantity, from seeds 0 to ``repeats - 1``."""
    one = importlib.import_module(f"{coverage.__name__}.{name}").one
    if jobs == 1:
        drawn = [one(seed) for seed in range(repeats)]
    else:
        with ProcessPoolExecutor(jobs) as pool:
            drawn = list(pool.map(one, range(repeats)))
    keys = dict.fromkeys(key for shares in drawn for key in shares)
    values = {key: np.array([shares[key] for shares in drawn if key in shares]) for key in keys}
    return {key: (float(v.mean()), float(v.std() / np.sqrt(len(v)))) for key, v in values.items()}


@click.command(help=__doc__)
@click.argument("names", nargs=-1, type=click.Choice(NAMES))
@click.option("--repeats", default=300, show_default=True, help="Number of simulated recordings.")
@click.option("--jobs", default=2, show_default=True, help="Number of processes.")
def main(names: tuple[str, ...], repeats: int, jobs: int) -> None:
    """Measure the named quantities, or all."""
    for name in names or NAMES:
        for key, (mean, error) in measure(name, repeats, jobs).items():
            interval = f"{100 * mean:5.1f} % +- {100 * error:.1f}"
            print(f"{name:12s} {key:28s} {interval} ({repeats} repeats)", flush=True)


if __name__ == "__main__":
    main()
