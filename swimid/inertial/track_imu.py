"""``swimid track imu``: an inertial recording gives a log of motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from swimid.errors import UsageError
from swimid.files import atomic, provenance
from swimid.inertial import evidence, faults, inputs, run
from swimid.inertial.options import TrackImuOptions
from swimid.inertial.setup import prepare
from swimid.logs import log, mapping
from swimid.logs.log import LogLike
from swimid.logs.logged import Logged
from swimid.notices import recorded, warn
from swimid.options import takes
from swimid.progress import Progress, silent


@takes(TrackImuOptions)
def track_imu(
    imu: LogLike,
    *,
    options: TrackImuOptions,
    output: str | Path | None = None,
    progress: Progress = silent,
) -> Logged:
    """Make motion of an inertial recording: velocity, position and attitude with their bands.

    The other log may be a table too: positions (m), angles (rad), or both; and the mapping a dict of names
    and units of foreign columns.

    Parameters
    ----------
    imu : path, Log or DataFrame
        The recording, shape (n, k), n at least 64: ``t_s``, specific force ``ax_m_s2`` to ``az_m_s2``, turn
        rate ``wx_rad_s`` to ``wz_rad_s``, in the sensor's axes; ``qw`` to ``qz`` and ``mx`` to ``mz`` where
        it has them. Anything else with a mapping.
    output : path, optional
        The log, CSV or Parquet by its ending; ``<stem>.evidence.json`` goes beside it. Without it nothing is
        written; :meth:`~swimid.results.result.Result.save` writes the same later.
    progress : Progress
        Shows reading and smoothing.

    Returns
    -------
    Logged
        ``.frame`` has n rows: position (m), attitude (rad), velocity in the body and in the world (m/s),
        turn rates (rad/s), accelerations (m/s^2), each with its standard deviation.

    Raises
    ------
    InputError
        An input cannot be used, or a fault of recording cannot be repaired.
    NoTrustworthyResult
        The two logs do not move together.
    UsageError
        Settings that do not fit together.

    Notes
    -----
    An error-state Kalman filter and Rauch-Tung-Striebel smoother (Rauch, Tung and Striebel, 1965,
    doi:10.2514/3.3166; Groves, 2013, ch. 14); ``method="paper"`` follows Shang et al. (2012),
    doi:10.1017/S0263574711001159.

    Examples
    --------
    A sensor on a table, which knows that it does not move:

    >>> import numpy as np, pandas as pd
    >>> t, rng = np.arange(0.0, 8.0, 0.02), np.random.default_rng(1)
    >>> table = pd.DataFrame({"t_s": t})
    >>> for axis, gravity in zip("xyz", (0.0, 0.0, 9.80665)):
    ...     table[f"a{axis}_m_s2"] = gravity + 0.02 * rng.normal(size=len(t))
    ...     table[f"w{axis}_rad_s"] = 0.002 * rng.normal(size=len(t))
    >>> made = track_imu(table)
    >>> bool(made.frame[["vx_m_s", "vy_m_s", "vz_m_s"]].abs().to_numpy().max() < 0.01)
    True
    """
    map_path, other = options.map_path, options.other
    recording = log.unread(imu, name="imu")
    rules = None if map_path is None else mapping.of(map_path)
    given: list[provenance.Input] = [recording]
    if rules is not None:
        given.append(map_path if isinstance(map_path, str | Path) else rules)
    if other is not None:
        given.append(log.unread(other, name="other"))
    if output is not None:
        output = atomic.check_writable(output, inputs=given)
    if options.method == "paper" and other is not None:
        raise UsageError(
            "--method paper fuses with nothing", hint="leave out --with, or take --method smoother"
        )
    with recorded(repeat=True) as notices:
        named = given[0 if rules is None else 1]
        record, notes = inputs.read_record(recording, rules, provenance.path_of(named), progress)
        record, findings = faults.mend(record)
        poses = None if other is None else inputs.read_poses(log.of(other, name="other"))
        setup, of_mounting = prepare(record, options)
        with progress("smoothing", total=None) as step:
            made = run.estimate(replace(setup, advance=step), [*findings, *of_mounting], poses)
        for note in notes:
            warn("SWM004", f"{record.name}: {note}")
        origin = provenance.collect(given, settings=options.settings())
        result = evidence.result(made, notices, origin)
    return result.saved(output)
