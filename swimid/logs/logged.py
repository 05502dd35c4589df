"""The result of what makes a log: tracking, import, simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from swimid.logs import log
from swimid.logs.log import Log
from swimid.results import evidence as ev
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
    def load(cls, path: str | Path) -> Self:
        """Read a log, with its evidence where that lies beside it.

        Raises
        ------
        InputError
            When either is broken.
        """
        record = log.read(path)
        sidecar = ev.sidecar(path)
        proof = ev.read(sidecar) if sidecar.exists() else None
        span = record.time_s[-1] - record.time_s[0]
        text = f"{record.path.name}: {len(record)} samples over {span:.4g} s"
        if proof is not None:
            text += f"\n{proof.verdict.level.upper()}: {proof.verdict.text}"
        return cls(proof.verb if proof else "log", text, {}, [Path(path)], proof, record)
