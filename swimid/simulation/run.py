"""One simulated run: its channels, the check of its step, what it comes to; the result of ``simulate``."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

import swimid
from swimid.errors import NoTrustworthyResult, UsageError
from swimid.files import atomic, tabular
from swimid.files.atomic import file_names
from swimid.files.provenance import Input
from swimid.fitting.model import Array
from swimid.logs import log as log_format
from swimid.notices import warn
from swimid.results.evidence import remove_outdated
from swimid.results.result import Result
from swimid.simulation.applied import Quantity
from swimid.simulation.cases import Case

if TYPE_CHECKING:
    import pandas as pd

#: Endings of the logs that are written.
LOG_ENDINGS = (".csv", *tabular.PARQUET)
#: Halving the step may change a channel by this share of its range at most.
STEP_LIMIT = 1e-3


@dataclass(frozen=True)
class StepChange:
    """What halving the integration step does to one channel, as ``share`` of its range too."""

    largest: float
    share: float


@dataclass(frozen=True)
class Simulated:
    """A simulated run.

    Attributes
    ----------
    columns : dict of str to ndarray
        Of the log, ``t_s`` first.
    step : dict of str to StepChange
        By channel; empty where nothing is integrated.
    """

    case: Case
    columns: dict[str, Any]
    quantities: dict[str, Quantity]
    step: dict[str, StepChange]


def run(case: Case) -> Simulated:
    """Simulate a case.

    Raises
    ------
    NoTrustworthyResult
        When the simulation breaks down, with the time.

    Warns
    -----
    SWM016
        When halving the step changes a channel by more than :data:`STEP_LIMIT` of its range.
    """
    model = case.applied.model
    simulated = model.attempt(case.values, case.trial)
    _insist_whole(case, simulated)
    _warn_folded(case, simulated)
    step = _step_changes(case, simulated)
    quantities = case.applied.with_errors(case.values, case.quantities) if case.quantities else {}
    columns: dict[str, Any] = {} if case.per_run else {log_format.TIME: case.trial.time_s}
    columns |= {c.name: simulated[c.name] for c in model.channels if c.name in simulated}
    added = {k: v for k, v in case.extra.items() if k not in columns}
    columns = {**added, **columns} if case.per_run else {**columns, **added}
    return Simulated(case, columns, quantities, step)


def _insist_whole(case: Case, simulated: Mapping[str, Array]) -> None:
    lost = np.any([~np.isfinite(v) for v in simulated.values()], axis=0)
    if not lost[-1] or any(not np.isfinite(v[-1]) for v in case.trial.inputs.values()):
        return
    whole = np.flatnonzero(~lost)
    where = "at its start"
    if len(whole) and not case.per_run:
        where = f"at t = {case.trial.time_s[min(whole[-1] + 1, len(lost) - 1)]:.4g} s"
    raise NoTrustworthyResult(
        f"the simulation of '{case.id}' breaks down {where}",
        hint="take a smaller step with --dt, or check the parameters' signs and units and the drive",
    )


def _warn_folded(case: Case, simulated: Mapping[str, Array]) -> None:
    for name, values in simulated.items():
        if re.fullmatch(r"joint\d+_rad", name) and np.nanmax(np.abs(values), initial=0.0) > math.pi:
            turned = math.degrees(float(np.nanmax(np.abs(values))))
            warn(
                "SWM054",
                f"{case.id}: {name.removesuffix('_rad')} turns by {turned:.0f} degrees: beyond 180 its link "
                "has passed through the one ahead of it, which no body does",
            )


def _step_changes(case: Case, simulated: Mapping[str, Array]) -> dict[str, StepChange]:
    finer = case.applied.model.refined()
    if finer is None:
        return {}
    fine = finer.attempt(case.values, case.trial)
    changes = {}
    for name, values in simulated.items():
        both = np.isfinite(values) & np.isfinite(fine[name])
        if not both.any():
            continue
        largest = float(np.max(np.abs(fine[name] - values)[both]))
        span = float(np.ptp(values[both]))
        changes[name] = StepChange(largest, largest / span if span > 1e-9 else 0.0)
    worst = max(changes, key=lambda name: changes[name].share, default=None)
    if worst is not None and changes[worst].share > STEP_LIMIT:
        warn(
            "SWM016",
            f"{case.id}: halving the integration step changes {worst} by {100 * changes[worst].share:.2g} % "
            "of its range; take a smaller step with --dt",
        )
    return changes


def places(output: Path | None, ids: Sequence[str]) -> list[Path]:
    """Return the file of each run: one log, or a folder of logs named after the trials."""
    if output is None:
        return []
    folder = output.is_dir()
    if output.suffix.lower() in LOG_ENDINGS and not folder:
        if len(ids) > 1:
            raise UsageError(
                f"{len(ids)} trials do not fit into one log: name a folder, or one trial with --trial"
            )
        return [output]
    if len(ids) == 1 and not folder:
        raise UsageError(
            f"'{output.name}' can be no log: its ending is none of a log, and no folder has this name",
            hint=f"let it end in {' or '.join(LOG_ENDINGS)}",
        )
    if output.exists() and not folder:
        raise UsageError(f"{output} is a file; several trials need a folder")
    return [output / name for name in file_names(ids, LOG_ENDINGS)]


def write(output: Path | None, done: Sequence[Simulated]) -> list[Path]:
    """Write runs as logs, all or none; the comment lines of each say what it was made by."""
    paths = places(output, [one.case.id for one in done])
    with atomic.together():
        if output is not None and paths != [output]:
            atomic.make_folder(output)
        for path, one in zip(paths, done, strict=False):
            metadata = {"made_by": "swimid simulate", "version": swimid.__version__, **one.case.metadata}
            remove_outdated(path)
            log_format.write(path, one.columns, metadata)
    return paths


@dataclass(frozen=True, eq=False)
class Simulation(Result):
    """Simulated runs, as ``simulate`` gives them: one, or one for each recorded trial.

    Attributes
    ----------
    frame : DataFrame
        The log of the only run, one row a sample; SI units and radians, named in the columns.
    quantities : dict of str to Quantity
        What the only run comes to, each with ``value``, ``unit`` and ``stderr`` (None where the uncertainty
        of the coefficients is not known).
    frames : dict of str to DataFrame
        The log of each run by its name.
    runs : dict of str to Simulated
        Each run by its name, with ``columns``, ``quantities`` and ``step``, the check of the integration
        step.
    inputs : sequence of path or Log
        Files of the recorded trials.

    Examples
    --------
    >>> import swimid
    >>> made = swimid.simulate(robot="tfish", frequency_hz=1.4, amplitude_deg=20.0, duration_s=6.0)
    >>> list(made.frame)[:4], round(made.quantities["mean_speed_m_s"].value, 2)
    (['t_s', 'x_m', 'y_m', 'yaw_rad'], 0.11)
    """

    inputs: Sequence[Input] = field(default=(), repr=False)

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
        return self._only("frames")

    @property
    def quantities(self) -> dict[str, Quantity]:
        """What the only run comes to: mean speed, stride, amplitudes, each with its standard error."""
        return self._only("runs").quantities

    def _only(self, several: str) -> Any:
        runs = getattr(self, several)
        if len(runs) > 1:
            raise UsageError(f"there are {len(runs)} runs", hint=f"take one of .{several}")
        return next(iter(runs.values()))

    def save(self, path: str | Path) -> Self:
        """Write the run as a log; several into a folder, each as a log named after its trial.

        Raises
        ------
        InputError
            When a log cannot be written.
        UsageError
            When the path is neither the log of one run nor a folder, and where a log of the trials would be
            replaced.
        """
        for place in places(Path(path), list(self.runs)):
            if place.parent.is_dir():
                atomic.check_writable(place, inputs=self.inputs)
        return replace(self, outputs=[*self.outputs, *write(Path(path), self.document)])
