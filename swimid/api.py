"""Names of the public API of swimid, and the public functions that read trials, logs and robots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swimid.commands import COMMAND_SPECS
from swimid.errors import UsageError

if TYPE_CHECKING:
    import pandas as pd

    from swimid.logs.experiments import Trials
    from swimid.logs.log import Log
    from swimid.logs.trials import TrialSet
    from swimid.robots.file import Robot

#: Public names of swimid besides the functions of commands. The key is the module that defines the names.
_NAMES_OF = {
    # Functions that read trials, logs and robots.
    "swimid.api": ("load", "read_log", "read_robot", "list_robots"),
    "swimid.logs.log": ("Log",),
    "swimid.logs.trials": ("TrialSet",),
    "swimid.robots.file": ("Robot",),
    # Functions that import logs and fit a model of a user.
    "swimid.imports.import_log": ("import_log",),
    "swimid.imports.mapping": ("guess_mapping",),
    "swimid.fitting.fit": ("fit_model",),
    # Classes of results.
    "swimid.tracking.track_camera": ("Calibration",),
    "swimid.simulation.simulate": ("Simulation",),
    "swimid.simulation.compare": ("Comparison",),
    "swimid.diagnosis.evidence": ("Diagnosis",),
    "swimid.diagnosis.power": ("DetectionPower",),
    "swimid.sensitivity_analysis.sensitivity": ("Sensitivity",),
    "swimid.optimisation.performance_map": ("PerformanceMap",),
    "swimid.optimisation.optimise_stiffness": ("StiffnessRule",),
    "swimid.optimisation.optimise_gait": ("BestGait",),
    "swimid.runs.batch": ("Batch",),
    "swimid.runs.compare_runs": ("ComparedRuns",),
    "swimid.results.result": ("load_result", "Result"),
    "swimid.results.parameters": ("Fitted",),
    "swimid.kinematics.logged": ("Logged",),
    # Base classes for models, experiments and effects that a user writes; classes of errors and warnings.
    "swimid.logs.experiments": ("Trials",),
    "swimid.fitting.model": ("Model", "Parameter", "Channel", "Trial"),
    "swimid.effects.base": ("Effect",),
    "swimid.errors": ("SwimidError", "InputError", "UsageError", "NoTrustworthyResult"),
    "swimid.notices": ("SwimidWarning",),
}
#: Module of each public name. The module is imported on the first use of the name, so that ``import swimid``
#: stays fast.
NAMES = {name: module for module, names in _NAMES_OF.items() for name in names}
NAMES |= {
    name: module for module, name in (spec.place for spec in COMMAND_SPECS.values()) if ".cli." not in module
}


def read_log(path: str | Path, *, required: Sequence[str] = ()) -> Log:
    """Read the log of one trial from a CSV or Parquet file.

    Parameters
    ----------
    path : path
        CSV or Parquet file. The first column is ``t_s``, in s. The name of every other column ends in its
        unit (``docs/formats.md``).
    required : sequence of str
        Names of required columns.

    Returns
    -------
    Log
        Log with its columns as arrays of shape (n,), NaN for a missing sample. ``.frame`` is a DataFrame.

    Raises
    ------
    InputError
        If the file is invalid. The message names the file, the line and the column.

    Examples
    --------
    >>> log = read_log("sample_logs/rig/w10.csv")
    >>> list(log.columns)
    ['t_s', 'x_m']
    """
    from swimid.logs import log
    from swimid.options import explain_types

    with explain_types(read_log, [path]):
        return log.read(path, required=required)


def load(
    trials: str | Path | Sequence[Mapping[str, Any]] | pd.DataFrame | TrialSet,
    *,
    experiment: str | Path | type[Trials] | None = None,
    robot: str | Path | None = None,
    **keys: Any,
) -> TrialSet:
    """Return the trials of one experiment with one robot, from a trials file or from tables in memory.

    Parameters
    ----------
    trials : path, sequence of mappings, or DataFrame
        Path of a trials file; or, for each trial, its keys as in a trials file, with a DataFrame or a
        :class:`~swimid.logs.log.Log` as ``log``; or the table of a cruise experiment.
    experiment : str, path or class, optional
        Name of the experiment, such as ``"falling-weight"``; or an experiment of your own, as a class or as
        the Python file with it. Omit the name for a trials file, which states it.
    robot : str or path, optional
        Name of a built-in robot, or path of a robot file. Omit it for a trials file, which states the robot.
    **keys
        Further keys of the trials file (``docs/formats.md``).

    Returns
    -------
    TrialSet
        Trials, as input of the fits, of ``compare`` and of ``diagnose``.

    Raises
    ------
    InputError
        If a file is invalid, a key is unknown, or a table is not a log.
    UsageError
        If the experiment or the robot is missing, or is given together with a trials file, which states both.

    Examples
    --------
    >>> load("sample_logs/rig/trials.yaml").ids[:2]
    ['w10', 'w15']
    >>> drop = {"id": "w10", "log": read_log("sample_logs/rig/w10.csv").frame, "pulling_mass_kg": 0.01}
    >>> load([drop], experiment="falling-weight", robot="boxfish").experiment
    'falling-weight'
    """
    from swimid.logs.trials import TrialSet, find_own_experiments

    if isinstance(trials, str | Path | TrialSet):
        own = find_own_experiments(experiment or "")
        if (experiment is not None and not own) or robot is not None or keys:
            raise UsageError("a trials file names its experiment, robot and keys itself")
        if isinstance(trials, TrialSet):
            return trials
        return TrialSet.read(trials, own)
    if experiment is None:
        raise UsageError("experiment or robot of these trials is missing: give both")
    given: Any = trials
    if not isinstance(trials, Sequence):
        given, keys = [], {**keys, "table": trials}  # A cruise experiment has one table for all trials.
    return TrialSet.of(
        list(given), experiment=experiment, robot=None if robot is None else str(robot), **keys
    )


def read_robot(name: str | Path) -> Robot:
    """Read the known properties of a robot from a robot file or from a built-in robot.

    Parameters
    ----------
    name : str or path
        Name of a built-in robot (:func:`list_robots`), or path of a robot file (swimid-robot/1).

    Returns
    -------
    Robot
        Robot with ``.body``, ``.fluid``, ``.fins``, ``.multilink`` and others. The name of each field
        contains its unit.

    Raises
    ------
    InputError
        If the name is unknown or the robot file is invalid. The message names the line of the file.

    Examples
    --------
    >>> read_robot("boxfish").body.inertial_mass_kg
    1.196
    """
    from swimid.options import explain_types
    from swimid.robots import file

    with explain_types(read_robot, [name]):
        return file.read(str(Path(name)))


def list_robots() -> list[str]:
    """Return the names of the built-in robots.

    Returns
    -------
    list of str
        Names for :func:`read_robot` and for every argument that takes a robot.

    Examples
    --------
    >>> list_robots()
    ['blimp', 'bluerov2', 'boxfish', 'dolphin', 'long-fin', 'sealion', 'tfish']
    """
    from swimid.robots import file

    return file.list_built_in_robots()
