"""The result of what makes a log: tracking, import, simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swimid.logs import figures, log
from swimid.logs.log import Log
from swimid.logs.sampling import pauses
from swimid.results import numbers
from swimid.results.evidence import Evidence, Table, Verdict, leaf_table
from swimid.results.result import Result

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Logged(Result):
    """A log and how it was made, as ``track_video``, ``track_imu`` and ``import_log`` give it.

    Attributes
    ----------
    table : dict of str to array_like, each shape (n,)
        The columns as they are written, words and whole numbers as such; empty where they are the log's.
    log : Log
        The log; hand it to whatever reads logs.
    frame : DataFrame
        Its columns, one row a sample; SI units and radians, named in the columns.

    Examples
    --------
    >>> import swimid
    >>> made = swimid.load_result("sample_logs/rig/w10.csv")
    >>> isinstance(made, Logged), list(made.frame)
    (True, ['t_s', 'x_m'])
    """

    table: Mapping[str, Any] = field(default_factory=dict, repr=False)

    kind = "Log"
    ending = ".csv"

    @property
    def log(self) -> Log:
        """The log; hand it to whatever reads logs."""
        assert isinstance(self.document, Log)
        return self.document

    @property
    def frame(self) -> pd.DataFrame:
        """Its columns, one row a sample; SI units, named in the columns."""
        import pandas as pd

        return pd.DataFrame(dict(self.table)) if self.table else self.log.frame()

    def _write(self, path: Path) -> list[Path]:
        log.write(path, self.table or self.log.columns, self.log.metadata)
        return [path]

    @classmethod
    def _read(cls, path: str | Path) -> Log:
        return log.read(path)

    def _own_facts(self) -> dict[str, str]:
        span = float(self.log.time_s[-1] - self.log.time_s[0])
        rate = 1.0 / float(np.median(np.diff(self.log.time_s)))
        return {
            "Samples": str(len(self.log)),
            "Duration": numbers.number(span, unit="s"),
            "Median rate": numbers.number(rate, unit="Hz"),
        }

    def _own_tables(self) -> list[Table]:
        rows: list[list[Any]] = []
        after = pauses(self.log.time_s)
        for name, values in self.log.columns.items():
            if name == log.TIME:
                continue
            known = values[np.isfinite(values)]
            gaps = figures.missing(self.log.time_s, values, after)
            ends = (float(known.min()), float(known.max())) if len(known) else (None, None)
            missing = numbers.percent(1 - len(known) / len(values))
            longest = max((end - start for start, end in gaps), default=0.0)
            rows.append([name, *ends, missing, numbers.number(longest, 3, "s")])
        columns = ["channel", "smallest", "largest", "missing", "longest gap"]
        folded = self.evidence is not None
        return [Table(id="channels", title="Channels", columns=columns, rows=rows, folded=folded)]

    def bare(self) -> Evidence:
        """Return what a report shows of a log whose evidence is missing."""
        verdict = Verdict(level="caution", text="A log without evidence of how it was made.")
        if self.log.metadata.get("made_by") == "swimid simulate":
            verdict = Verdict(level="good", text="A simulated run.")
        return Evidence(
            verb=self.verb,
            title=f"Log {self.path.name}",
            verdict=verdict,
            figures=figures.figures([self.log]),
            tables=[leaf_table("metadata", "Metadata of the log", self.log.metadata)],
        )
