"""Names of the public API, and public functions that belong to no single package."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swimid.errors import UsageError

if TYPE_CHECKING:
    import pandas as pd

    from swimid.logs.log import Log
    from swimid.logs.trials import TrialSet
    from swimid.robots.file import Robot

#: Module of each public name. The module is imported on the first use of the name, so that ``import swimid``
#: stays fast.
NAMES = {
    # reading of trials, logs, robots and results
    "load": "swimid.api",
    "load_result": "swimid.results.result",
    "read_log": "swimid.api",
    "read_robot": "swimid.api",
    "built_in_robots": "swimid.api",
    "Log": "swimid.logs.log",
    "TrialSet": "swimid.logs.trials",
    "Robot": "swimid.robots.file",
    # creation of logs from videos and recordings
    "track_video": "swimid.tracking.track_video",
    "track_setup": "swimid.tracking.track_setup",
    "track_imu": "swimid.inertial.track_imu",
    "import_log": "swimid.logs.import_log",
    "guess_mapping": "swimid.logs.mapping",
    # identification
    "fit_drag": "swimid.rig.fit_drag",
    "fit_propulsion": "swimid.propulsion.fit_propulsion",
    "fit_graybox": "swimid.swimmer.fit_graybox",
    "rwls": "swimid.blackbox.rwls",
    "fit_model": "swimid.fitting.fit_common",
    # simulation, diagnosis, optimisation and publication
    "simulate": "swimid.simulation.simulate",
    "compare": "swimid.simulation.compare",
    "diagnose": "swimid.diagnosis.diagnose",
    "sensitivity": "swimid.sensitivity_analysis.sensitivity",
    "performance_map": "swimid.optimisation.performance_map",
    "optimise_stiffness": "swimid.optimisation.optimise_stiffness",
    "optimise_gait": "swimid.optimisation.optimise_gait",
    "export": "swimid.exporters.export",
    "report": "swimid.results.report",
    "plot": "swimid.logs.plot",
    # classes of results
    "Result": "swimid.results.result",
    "Fitted": "swimid.results.parameters",
    "Logged": "swimid.logs.tracks",
    "Simulation": "swimid.simulation.simulate",
    "Comparison": "swimid.simulation.compare",
    "Diagnosis": "swimid.diagnosis.evidence",
    "DetectionPower": "swimid.diagnosis.power",
    "Sensitivity": "swimid.sensitivity_analysis.sensitivity",
    "PerformanceMap": "swimid.optimisation.performance_map",
    "StiffnessRule": "swimid.optimisation.optimise_stiffness",
    "BestGait": "swimid.optimisation.optimise_gait",
    # classes for models and effects of the user
    "Model": "swimid.fitting.model",
    "Parameter": "swimid.fitting.model",
    "Channel": "swimid.fitting.model",
    "Trial": "swimid.fitting.model",
    "Effect": "swimid.effects.base",
    # errors and warnings
    "SwimidError": "swimid.errors",
    "InputError": "swimid.errors",
    "UsageError": "swimid.errors",
    "NoTrustworthyResult": "swimid.errors",
    "SwimidWarning": "swimid.notices",
}


def read_log(path: str | Path, *, required: Sequence[str] = ()) -> Log:
    """Read the log of one trial, CSV or Parquet.

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
        Log with its columns as arrays of shape (n,), NaN for a missing sample. ``.frame()`` returns a
        DataFrame.

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

    return log.read(path, required=required)


def load(
    trials: str | Path | Sequence[Mapping[str, Any]] | pd.DataFrame | TrialSet,
    *,
    experiment: str | None = None,
    robot: str | Path | None = None,
    **keys: Any,
) -> TrialSet:
    """Return the trials of one experiment with one robot, from a trials file or from tables in memory.

    Parameters
    ----------
    trials : path, sequence of mappings, or DataFrame
        Path of a trials file; or, for each trial, its keys as in a trials file, with a DataFrame or a
        :class:`~swimid.logs.log.Log` as ``log``; or the table of a cruise experiment.
    experiment : str, optional
        ``"falling-weight"``, ``"towed"``, ``"free-decay"``, ``"cruise"``, ``"free-swim"``, ``"multibody"`` or
        ``"arma"``. Omit it for a trials file, which states the experiment.
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
    >>> drop = {"id": "w10", "log": read_log("sample_logs/rig/w10.csv").frame(), "pulling_mass_kg": 0.01}
    >>> load([drop], experiment="falling-weight", robot="boxfish").experiment
    'falling-weight'
    """
    from swimid.logs.trials import TrialSet

    if isinstance(trials, str | Path | TrialSet):
        if experiment is not None or robot is not None or keys:
            raise UsageError("a trials file names its experiment, robot and keys itself")
        return trials if isinstance(trials, TrialSet) else TrialSet.read(trials)
    if experiment is None or robot is None:
        raise UsageError("name the experiment and the robot of these trials")
    if not isinstance(trials, Sequence):  # the table of a cruise
        return TrialSet.of([], experiment=experiment, robot=str(robot), table=trials, **keys)
    given: list[Mapping[str, Any]] = list(trials)  # type: ignore[arg-type]
    return TrialSet.of(given, experiment=experiment, robot=str(robot), **keys)


def read_robot(name: str | Path) -> Robot:
    """Read a built-in robot or a robot file.

    Parameters
    ----------
    name : str or path
        Name of a built-in robot (:func:`built_in_robots`), or path of a robot file (swimid-robot/1).

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
    from swimid.robots import file

    return file.read(str(name))


def built_in_robots() -> list[str]:
    """Return the names of the built-in robots.

    Returns
    -------
    list of str
        Names for :func:`read_robot` and for every argument that takes a robot.

    Examples
    --------
    >>> built_in_robots()
    ['boxfish', 'dolphin', 'long-fin', 'sealion', 'tfish']
    """
    from swimid.robots import file

    return file.built_in()
