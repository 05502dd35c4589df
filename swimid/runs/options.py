"""Options of the commands ``swimid batch`` and ``swimid compare-runs``."""

from __future__ import annotations

import re
from typing import Literal, Self

from pydantic import model_validator

from swimid.errors import UsageError
from swimid.options import Options, option

Retry = Literal["failed", "refused", "no result"]


class BatchOptions(
    Options,
    argument="PLAN",
    output="Folder of the run. The same folder again does what is missing or changed.",
    required=True,
    beside=(),
    lock=False,
):
    """Process many films, logs or trials files with a sequence of commands.

    PLAN is a plan file (swimid-plan/1) with globs of files, the steps for them, and overrides. Every item
    has a folder with its results, its log and its state. The folder of the run has a table of all items
    (summary.csv), their estimates (metrics.csv) and one page (index.html). Items that are done are not
    repeated. Exit status 4 if an item is refused or failed.

    Examples:
      swimid batch plan.yaml -o run --dry-run
      swimid batch plan.yaml -o run --jobs 8
      swimid batch plan.yaml -o run --retry failed
      swimid batch plan.yaml -o run --shard 3/100
    """

    jobs: int | None = option(None, ge=1, recorded=False, help="Items at a time; default one per processor.")
    retry: tuple[Retry, ...] = option((), recorded=False, help="Also repeat items of this state. Repeatable.")
    shard: str | None = option(
        None, metavar="K/N", recorded=False, help="Do every N-th item only, from the K-th; no summary."
    )
    collect: bool = option(False, recorded=False, help="Do no item. Write the summary of what is there.")
    dry_run: bool = option(False, recorded=False, help="List the items and their states. Write nothing.")

    @property
    def part(self) -> slice:
        """Indices of the items that this shard of the run processes."""
        if self.shard is None:
            return slice(None)
        number, _, count = self.shard.partition("/")
        return slice(int(number) - 1, None, int(count))

    @model_validator(mode="after")
    def _can_be_meant(self) -> Self:
        if self.shard is not None:
            form = re.fullmatch(r"\d{1,9}/\d{1,9}", self.shard)
            if form is None or not 0 <= self.part.start < self.part.step:
                raise UsageError(f"--shard {self.shard} must be K/N with 1 <= K <= N, such as 3/100")
        modes = {
            "--shard": self.shard,
            "--collect": self.collect,
            "--dry-run": self.dry_run,
        }
        given = [flag for flag, value in modes.items() if value]
        if len(given) > 1 and given != ["--shard", "--dry-run"]:
            raise UsageError(f"{' and '.join(given)} contradict each other: give one of them")
        return self


class CompareRunsOptions(
    Options, argument="RUN...", output="Comparison of runs to write (YAML).", makes="run-comparison"
):
    """Compare runs, or results of one robot from several days.

    RUN is a folder of `swimid batch`, or a result file. Names the estimates that differ between the runs by
    more than their errors, and lists changed inputs, options and versions. The runs are drawn in the order
    in which they are given.

    Examples:
      swimid compare-runs run1 run2 -o changes.yaml
      swimid compare-runs monday.yaml tuesday.yaml friday.yaml -o week.yaml
      swimid report week.yaml -o week.html
    """

    false_discovery_rate: float = option(
        0.05, gt=0, lt=1, help="Expected share of false alarms among the changes that are named."
    )
