"""Result of the commands that write a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from swimid.logs import log
from swimid.logs.log import Log
from swimid.logs.sampling import rate
from swimid.results import numbers
from swimid.results.evidence import Evidence, Table, Verdict, leaf_table
from swimid.results.result import Result

if TYPE_CHECKING:
    import pandas as pd
    import xarray


@dataclass(frozen=True, eq=False)
class Logged(Result):
    """Result of ``track_video``, ``track_imu`` and ``import_log``: a log and its evidence.

    Attributes
    ----------
    table : dict of str to array_like, each shape (n,)
        Columns as they are written to the file, with text and integers. Empty if the columns of ``log`` are
        written.

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
    next_step = "swimid plot {file} -o {free[log.svg]}"

    @property
    def log(self) -> Log:
        """Log of the result, which any function that reads logs accepts."""
        assert isinstance(self.document, Log)
        return self.document

    @property
    def frame(self) -> pd.DataFrame:
        """Columns of the log, one row per sample, in SI units and radians."""
        import pandas as pd

        return pd.DataFrame(dict(self.table or self.log.columns))

    def to_xarray(self) -> xarray.Dataset:
        """Return the log as an ``xarray.Dataset`` over ``t_s``, each variable with its unit."""
        return self.log.to_xarray()

    def _write(self, path: Path) -> list[Path]:
        log.write(path, self.table or self.log.columns, self.log.metadata)
        return [path]

    @classmethod
    def _read(cls, path: str | Path) -> Log:
        return log.read(path)

    def _own_facts(self) -> dict[str, str]:
        span = float(self.log.time_s[-1] - self.log.time_s[0])
        return {
            "Samples": str(len(self.log)),
            "Duration": numbers.format_number(span, unit="s"),
            "Sampling rate": numbers.format_number(1.0 / rate(self.log.time_s).step_s, unit="Hz"),
        }

    def _own_tables(self) -> list[Table]:
        rows: list[list[Any]] = []
        for name, values in self.log.signals.items():
            lost = numbers.percent(float(np.isnan(values).mean()))
            known = values[np.isfinite(values)]
            ends = [float(end(known)) for end in (np.min, np.max) if len(known)]
            rows.append([name, *(ends or (None, None)), lost])
        columns = ["channel", "smallest", "largest", "missing"]
        folded = self.evidence is not None
        return [Table(id="channels", title="Channels", columns=columns, rows=rows, folded=folded)]

    def bare(self) -> Evidence:
        """Return evidence without checks, for a log whose evidence file is missing."""
        from swimid.kinematics import plot

        verdict = Verdict(level="caution", text="A log without evidence of how it was made.")
        if self.log.metadata.get("made_by") == "swimid simulate":
            verdict = Verdict(level="good", text="A simulated run.")
        return Evidence(
            command=self.command,
            title=f"Log {self.path.name}",
            verdict=verdict,
            figures=plot.figures_of([self.log]),
            tables=[leaf_table("metadata", "Metadata of the log", self.log.metadata)],
        )
