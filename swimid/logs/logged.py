"""The result of what makes a log: tracking, import, simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swimid.logs import log
from swimid.logs.log import Log
from swimid.results.evidence import Evidence
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

    @classmethod
    def _told(cls, document: Log, evidence: Evidence | None) -> str:
        span = document.time_s[-1] - document.time_s[0]
        text = f"{document.path.name}: {len(document)} samples over {span:.4g} s"
        return f"{text}\n{super()._told(document, evidence)}".rstrip()
