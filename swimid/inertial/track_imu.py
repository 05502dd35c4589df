"""``swimid track imu``: an inertial recording gives a log of motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from swimid.errors import UsageError
from swimid.files import atomic, provenance
from swimid.inertial import alone, evidence, faults, fusion, inputs, motion, paper, plausible
from swimid.inertial.alignment import Poses
from swimid.inertial.checks import warnings
from swimid.inertial.faults.base import Finding
from swimid.inertial.fusion import Fused
from swimid.inertial.motion import Motion
from swimid.inertial.options import TrackImuOptions
from swimid.inertial.record import ACCELERATION, RATE
from swimid.inertial.run import Run
from swimid.inertial.setup import Setup, prepare
from swimid.inertial.smoother import gravity
from swimid.logs import log, mapping, rhythm
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
        run = _begun(setup, [*findings, *of_mounting], poses)
        with progress("smoothing", total=None) as step:
            setup = replace(setup, advance=step)
            run = _by_paper(run) if options.method == "paper" else _by_smoother(run, setup)
        for note in notes:
            warn("SWM004", f"{record.name}: {note}")
        for code, text in warnings(run):
            warn(code, text)
        origin = provenance.collect(given, settings=options.settings())
        result = evidence.result(run, notices, origin)
    return result if output is None else result.save(output)


def _begun(setup: Setup, findings: list[Finding], poses: Poses | None) -> Run:
    """What is found before the motion: the stroke."""
    body = setup.body
    readings = np.hstack([body.rate, body.acceleration]).T
    stroke = rhythm.find(body.time_s, dict(zip((*RATE, *ACCELERATION), readings, strict=True)))
    cutoff = motion.LOWEST_HZ if stroke is None else motion.STROKE_SHARE * stroke.beat.frequency_hz
    return Run(**vars(setup), findings=findings, poses=poses, stroke=stroke, cutoff_hz=cutoff)


def _by_paper(run: Run) -> Run:
    o = run.options
    moved = paper.integrate(run.body, run.attitude, o.motion_mode, o.threshold_m_s2, o.threshold_rad_s)
    return replace(run, paper=moved)


def _by_smoother(run: Run, setup: Setup) -> Run:
    estimate = alone.estimate(setup) if run.poses is None else fusion.estimate(setup, run.poses)
    run = replace(
        run,
        sensor=estimate.sensor,
        still=estimate.still,
        findings=[*run.findings, *estimate.findings],
        fused=estimate if isinstance(estimate, Fused) else None,
    )
    if estimate.impossible:
        return _attitude_alone(run, estimate.impossible)
    moved = motion.at_reference(estimate.smoothed)
    impossible: list[str] = []
    surge, surge_sd = motion.surge_within_stroke(moved, estimate.smoothed, run.cutoff_hz)
    if run.fused is None:
        moved, impossible = _never_too_fast(moved, run.options.top_speed_m_s)
    return replace(
        run,
        motion=moved,
        smoothed=estimate.smoothed,
        trust=_reach(run, moved),
        surge_osc=surge,
        surge_osc_sd=surge_sd,
        impossible=tuple(impossible),
    )


def _attitude_alone(run: Run, impossible: list[str]) -> Run:
    """No motion that can be: the attitude before smoothing, everything else empty."""
    moved = motion.of_attitude(
        run.record.time_s,
        run.attitude,
        run.mount.rotation.inv().apply(run.record.rate - run.still_rate),
        run.source.rotation.apply(run.record.acceleration) + gravity(np.zeros(2)),
        run.attitude_sd,
    )
    empty = np.full(len(run.record), np.nan)
    return replace(run, motion=moved, trust=_reach(run, moved), surge_osc=empty, impossible=tuple(impossible))


def _never_too_fast(moved: Motion, top_m_s: float) -> tuple[Motion, list[str]]:
    """Samples faster than the robot ever is have neither velocity nor position."""
    fast = plausible.too_fast(moved.velocity, moved.velocity_sd, top_m_s)
    if not fast.any():
        return moved, []
    fastest = float(np.max(np.linalg.norm(moved.velocity, axis=1)))
    text = (
        f"{100 * fast.mean():.0f} % of the samples come out faster than the robot can be, {top_m_s:g} m/s "
        f"(up to {fastest:.1f} m/s)"
    )
    return motion.without(moved, fast), [text]


def _reach(run: Run, moved: Motion) -> plausible.Trust | None:
    """How far the path of a unit alone can be trusted."""
    if run.fused is not None:
        return None
    first = run.still.rests[0] if run.still.rests and run.still.rests[0].first == 0 else None
    moving_from = run.record.time_s[0 if first is None else first.last - 1]
    return plausible.reach(moved.time_s, moved.position, moved.position_sd, float(moving_from))
