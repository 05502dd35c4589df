"""The result of ``simulate``: one log for each run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from swimid.errors import UsageError
from swimid.results.result import Result
from swimid.simulation import run
from swimid.simulation.run import Simulated

if TYPE_CHECKING:
    import pandas as pd

    from swimid.simulation.applied import Quantity


@dataclass(frozen=True, eq=False)
class Simulation(Result):
    """Simulated runs, as ``simulate`` gives them: one, or one for each recorded trial."""

    ending = ".csv"

    @property
    def runs(self) -> dict[str, Simulated]:
        """Each run by its name: its channels, and what it comes to."""
        done: Sequence[Simulated] = self.document
        return {one.case.id: one for one in done}

    @property
    def frames(self) -> dict[str, pd.DataFrame]:
        """The log of each run by its name: SI units, named in the columns."""
        import pandas as pd

        return {name: pd.DataFrame(one.columns) for name, one in self.runs.items()}

    @property
    def frame(self) -> pd.DataFrame:
        """The log of the only run.

        Raises
        ------
        UsageError
            Of several runs: see :attr:`frames`.
        """
        frames = self.frames
        if len(frames) > 1:
            raise UsageError(f"there are {len(frames)} runs", hint="take one of .frames")
        return next(iter(frames.values()))

    @property
    def quantities(self) -> dict[str, Quantity]:
        """What the only run comes to: mean speed, stride, amplitudes, each with its standard error."""
        if len(self.runs) > 1:
            raise UsageError(f"there are {len(self.runs)} runs", hint="take one of .runs")
        return next(iter(self.runs.values())).quantities

    def _write(self, path: Path) -> list[Path]:
        found = run.places(path, list(self.runs))
        if found != [path]:
            path.mkdir(exist_ok=True)
        for place, one in zip(found, self.runs.values(), strict=True):
            run.write(place, one)
        return found
