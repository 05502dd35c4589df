"""Print coverage of 95 % intervals and false alarms of checks: ``python -m validation.coverage stroke``.

The status is 1 if a share lies outside the wanted range with significance. The probabilities of ``diagnose``
are compared with the truth if there are results of ``python -m validation.blind``.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import click

from validation import coverage
from validation.blind import figures, score
from validation.coverage.rows import ALARM, Row, row

NAMES = sorted(
    found.name for found in pkgutil.iter_modules(coverage.__path__) if found.name not in ("__main__", "rows")
)


def measure(name: str, repeats: int | None = None, jobs: int = 1) -> list[Row]:
    """Return the rows of a module, from the seeds 0 to ``repeats - 1``.

    A check that a result does not have has raised no alarm.
    """
    module = importlib.import_module(f"{coverage.__name__}.{name}")
    seeds = range(repeats or module.REPEATS)
    if jobs == 1:
        drawn = [module.one(seed) for seed in seeds]
    else:
        with ProcessPoolExecutor(jobs) as pool:
            drawn = list(pool.map(module.one, seeds))
    keys = dict.fromkeys(key for shares in drawn for key in shares)
    found = []
    for key in sorted(keys, key=lambda key: ALARM in key):
        absent = float("nan")
        if ALARM in key:
            absent = 0.0
        found.append(row(f"{name}, {key}", [shares.get(key, absent) for shares in drawn]))
    return [made for made in found if made is not None]


@click.command(help=__doc__)
@click.argument("names", nargs=-1, type=click.Choice(NAMES))
@click.option("--repeats", type=int, help="Number of simulated recordings; by default that of each module.")
@click.option("--jobs", default=1, show_default=True, help="Number of processes.")
@click.option(
    "--blind", type=click.Path(path_type=Path), default="demo_out/blind", show_default=True,
    help="Folder of results of blind cases.",
)  # fmt: skip
def main(names: tuple[str, ...], repeats: int | None, jobs: int, blind: Path) -> None:
    """Measure the named quantities, or all."""
    print("| quantity | repeats | share | 95 % interval | wanted | |\n|---|---|---|---|---|---|")
    passed = True
    for name in names or NAMES:
        for made in measure(name, repeats, jobs):
            print(made.text, flush=True)
            passed &= made.ok
    if not names and (blind / "results").is_dir():
        print(f"\nStated probabilities against truth: {figures.calibration(score.read(blind))}")
    sys.exit(int(not passed))


if __name__ == "__main__":
    main()
