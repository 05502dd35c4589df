"""The public names, and the functions that belong to no package of their own."""

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

#: Where each public name is found; imported when it is first used, so that ``import swimid`` costs nothing.
NAMES = {
    # what is read
    "load": "swimid.api",
    "load_result": "swimid.results.kinds",
    "read_log": "swimid.api",
    "read_robot": "swimid.api",
    "built_in_robots": "swimid.api",
    "Log": "swimid.logs.log",
    "TrialSet": "swimid.logs.trials",
    "Robot": "swimid.robots.file",
    # what is made of films and recordings
    "track_video": "swimid.tracking.track_video",
    "track_setup": "swimid.tracking.track_setup",
    "track_imu": "swimid.inertial.track_imu",
    "import_log": "swimid.logs.import_log",
    "guess_mapping": "swimid.logs.guess_mapping",
    # what is identified
    "fit_drag": "swimid.rig.fit_drag",
    "fit_propulsion": "swimid.propulsion.fit_propulsion",
    "fit_graybox": "swimid.swimmer.fit_graybox",
    "rwls": "swimid.blackbox.rwls",
    "fit_model": "swimid.fitting.fit_common",
    # what follows from it
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
    # what comes of it
    "Result": "swimid.results.result",
    "Fitted": "swimid.results.fitted",
    "Logged": "swimid.logs.logged",
    "Simulation": "swimid.simulation.simulate",
    "Comparison": "swimid.simulation.compare",
    "Diagnosis": "swimid.diagnosis.diagnosed",
    "DetectionPower": "swimid.diagnosis.power_file",
    "Sensitivity": "swimid.sensitivity_analysis.sensitivity",
    "PerformanceMap": "swimid.optimisation.performance_map",
    "StiffnessRule": "swimid.optimisation.optimise_stiffness",
    "BestGait": "swimid.optimisation.optimise_gait",
    # what a model or an effect of one's own is made of
    "Model": "swimid.fitting.model",
    "Parameter": "swimid.fitting.model",
    "Channel": "swimid.fitting.model",
    "Trial": "swimid.fitting.model",
    "Effect": "swimid.effects.base",
    # what is raised
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
        ``t_s`` in s first; columns carry their unit as a suffix (``docs/formats.md``).
    required : sequence of str
        Columns that must be there.

    Returns
    -------
    Log
        Columns as arrays of shape (n,), NaN where a sample is missing; ``.frame()`` is a DataFrame.

    Raises
    ------
    InputError
        Naming file, line and column.

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
        A trials file; or for each trial its keys as in a trials file, with a DataFrame (or a
        :class:`~swimid.logs.log.Log`) as ``log``; or the table of a cruise.
    experiment : str, optional
        ``"falling-weight"``, ``"towed"``, ``"free-decay"``, ``"cruise"``, ``"free-swim"``, ``"multibody"`` or
        ``"arma"``; a trials file says it itself.
    robot : str or path, optional
        Built-in name or robot file; a trials file says it itself.
    **keys
        Further keys of the trials file (``docs/formats.md``).

    Returns
    -------
    TrialSet
        To be given to the fits, to ``compare`` and to ``diagnose``.

    Raises
    ------
    InputError
        For a broken file, unknown keys, tables that are no logs.
    UsageError
        When experiment or robot are missing, or given beside a file that names them.

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
    """Read a built-in robot, or one of a robot file.

    Parameters
    ----------
    name : str or path
        One of :func:`built_in_robots`, or the path of a robot file (swimid-robot/1).

    Returns
    -------
    Robot
        ``.body``, ``.fluid``, ``.fins``, ``.multilink`` and others; each field has its unit in its name.

    Raises
    ------
    InputError
        For an unknown name, and for anything wrong in the file, with its line.

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
        For :func:`read_robot`, and wherever a robot is asked for.

    Examples
    --------
    >>> built_in_robots()
    ['boxfish', 'dolphin', 'long-fin', 'sealion', 'tfish']
    """
    from swimid.robots import file

    return file.built_in()
