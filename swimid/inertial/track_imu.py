"""``swimid track imu``: an inertial recording gives a log of motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import UsageError
from swimid.files import atomic, provenance
from swimid.inertial import (
    aiding,
    alone,
    attitude,
    evidence,
    fusion,
    inputs,
    motion,
    mounting,
    oscillation,
    paper,
    plausible,
    trust,
)
from swimid.inertial import faults as recording_faults
from swimid.inertial.alignment import Poses
from swimid.inertial.checks import REST_LIMIT
from swimid.inertial.faults.base import Finding
from swimid.inertial.motion import Motion
from swimid.inertial.options import TrackImuOptions
from swimid.inertial.record import Record
from swimid.inertial.run import Run
from swimid.inertial.settings import Settings
from swimid.inertial.smoother import Smoothed, gravity
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
    settings, map_path, other = Settings.of(options), options.map_path, options.other
    recording = log.unread(imu, name="imu")
    rules = None if map_path is None else mapping.of(map_path)
    given: list[provenance.Input] = [recording]
    if rules is not None:
        given.append(map_path if isinstance(map_path, str | Path) else rules)
    if other is not None:
        given.append(log.unread(other, name="other"))
    if output is not None:
        output = atomic.check_writable(output, inputs=given)
    if settings.method == "paper" and other is not None:
        raise UsageError(
            "--method paper fuses with nothing", hint="leave out --with, or take --method smoother"
        )
    with recorded(repeat=True) as notices:
        named = given[0 if rules is None else 1]
        record, notes = inputs.read_record(recording, rules, provenance.path_of(named), progress)
        record, findings = recording_faults.mend(record)
        poses = None if other is None else inputs.read_poses(log.of(other, name="other"))
        run = _prepare(record, findings, settings)
        with progress("smoothing", total=None) as step:
            run = _by_paper(run) if settings.method == "paper" else _by_smoother(run, poses, step)
        _warn(run, notes)
        origin = provenance.collect(given, settings=run.settings.to_dict())
        result = evidence.result(run, poses, notices, origin)
    return result if output is None else result.save(output)


def _prepare(record: Record, findings: list[Finding], settings: Settings) -> Run:
    still = alone.stillness(record, settings.sensor, settings.declared)
    mount, told_by_gravity = mounting.settle(
        record, still.found, settings.mount_deg, level_at_rest=settings.level_at_rest
    )
    source = attitude.estimate(record, still.found)
    body_w = mount.rotation.inv().apply(record.rate)
    body_a = mount.rotation.inv().apply(record.acceleration)
    names_w, names_a = ("wx_rad_s", "wy_rad_s", "wz_rad_s"), ("ax_m_s2", "ay_m_s2", "az_m_s2")
    channels = dict(zip((*names_w, *names_a), np.hstack([body_w, body_a]).T, strict=True))
    stroke = rhythm.find(record.time_s, channels)
    cutoff = oscillation.LOWEST_HZ if stroke is None else oscillation.SHARE * stroke.beat.frequency_hz
    return Run(record, source, still, mount, settings, [*findings, *told_by_gravity], stroke, cutoff)


def _by_paper(run: Run) -> Run:
    turned = run.mount.rotation.inv()
    body = replace(
        run.record, acceleration=turned.apply(run.record.acceleration), rate=turned.apply(run.record.rate)
    )
    found = paper.integrate(
        body,
        run.source.rotation * run.mount.rotation,
        run.settings.mode,
        threshold_m_s2=run.settings.threshold_m_s2,
        threshold_rad_s=run.settings.threshold_rad_s,
    )
    return replace(run, paper=found)


def _by_smoother(run: Run, poses: Poses | None, step: Callable[[], Any]) -> Run:
    settings, fused = run.settings, None
    common = (run.record, run.source, run.still, run.mount)
    if poses is None:
        judged = alone.judged(*common, settings.sensor, settings.declared, advance=step)
        smoothed, still, impossible = judged.smoothed, judged.still, judged.impossible
        sensor, findings = judged.sensor, judged.findings
    else:
        fused = fusion.run(
            *common,
            poses,
            settings.sensor,
            settings.declared,
            clock_offset_s=settings.clock_offset_s,
            fix_sd_m=settings.fix_sd_m,
            advance=step,
        )
        smoothed, still, impossible = fused.smoothed, fused.still, fused.impossible
        sensor, findings = fused.sensor, fused.findings
    settings = replace(settings, sensor=sensor)
    run = replace(run, settings=settings, fused=fused, still=still, findings=[*run.findings, *findings])
    if impossible:
        return _attitude_alone(run, impossible)
    moved = motion.at_reference(smoothed)
    surge = oscillation.surge(moved.time_s, moved.velocity, moved.rotation, run.cutoff_hz)
    surge_sd = oscillation.high_passed_sd(still.noise.acceleration, run.cutoff_hz, sensor.scale_sd, surge)
    if fused is None:
        moved, impossible = _never_too_fast(moved, settings.declared.top_speed_m_s)
    rest = smoothed.errors.scores.get("rest")
    return replace(
        run,
        motion=moved,
        trust=_reach(run, moved) if fused is None else None,
        surge_osc=surge,
        surge_osc_sd=surge_sd,
        rest_score=None if rest is None else float(np.sqrt(np.nanmean(rest**2))),
        bias=_biases(smoothed),
        impossible=tuple(impossible),
    )


def _attitude_alone(run: Run, impossible: list[str]) -> Run:
    """No motion that can be: the attitude before smoothing, everything else empty."""
    turned = run.mount.rotation.inv()
    moved = motion.of_attitude(
        run.record.time_s,
        run.source.rotation * run.mount.rotation,
        turned.apply(run.record.rate - attitude.still_rate(run.record, run.still.found)),
        run.source.rotation.apply(run.record.acceleration) + gravity(np.zeros(2)),
        alone.attitude_sd(run.source, run.settings.sensor),
    )
    return replace(
        run,
        motion=moved,
        trust=_reach(run, moved) if run.fused is None else None,
        surge_osc=np.full(len(run.record), np.nan),
        impossible=tuple(impossible),
    )


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


def _reach(run: Run, moved: Motion) -> trust.Trust:
    first = run.still.used[0] if run.still.used and run.still.used[0].first == 0 else None
    moving_from = run.record.time_s[0 if first is None else first.last - 1]
    return trust.horizon(moved.time_s, moved.position, moved.position_sd, float(moving_from))


def _biases(smoothed: Smoothed) -> Any:
    return np.concatenate([smoothed.path.acceleration_bias[-1], smoothed.path.rate_bias[-1]])


def _warn(run: Run, notes: list[str]) -> None:
    name = run.record.name
    for note in notes:
        warn("SWM004", f"{name}: {note}")
    for finding in run.findings:
        if finding.verdict == "handled":
            warn("SWM080", f"{name}, {finding.fault}: {finding.text}")
    if run.impossible:
        warn(
            "SWM086",
            f"{name}: {'; '.join(run.impossible)}: no such motion can be; its positions and velocities are "
            "empty. Name the true rests with --still, or fuse a camera log (--with)",
        )
    if not run.still.found:
        warn(
            "SWM082",
            f"{name}: no still period found; the biases are known to data-sheet accuracy only. Let the robot "
            "rest for some seconds before and after a run, or name a rest with --still",
        )
    if run.trust is not None and run.trust.seconds is not None:
        warn(
            "SWM081",
            f"{name}: the integrated position is not to be trusted after {run.trust.seconds:.1f} s of motion "
            f"(at t = {run.trust.until_s:.1f} s its 95 % band exceeds 0.1 m and a tenth of the way)",
        )
    if run.fused is not None and run.settings.clock_offset_s is None and run.fused.offset.excludes_zero:
        o = run.fused.offset
        warn(
            "SWM083",
            f"the clocks differ: {1e3 * o.value_s:.1f} ms to add to the other log "
            f"(95 %: {1e3 * o.low_s:.1f} ... {1e3 * o.high_s:.1f} ms); the output is on the inertial clock",
        )
    if run.fused is not None and run.fused.stray > fusion.FEW * len(run.fused.fixes.time_s):
        warn(
            "SWM087",
            f"{name}: {run.fused.stray} of {len(run.fused.fixes.time_s)} fixes of the other log lie beyond "
            f"{aiding.GATE:g} deviations of the motion: the two logs contradict each other",
        )
    if run.fused is not None and run.fused.lasting > fusion.LASTING:
        warn(
            "SWM087",
            f"{name}: many fixes of the other log on end are off by the same (as fused they scatter "
            f"by {np.max(run.fused.fixes.position_sd[:2]):.3g} m): the logs contradict each other, or its "
            f"scale or marker is wrong; every band is widened by {run.fused.lasting:.1f}",
        )
    if run.rest_score is not None and run.rest_score > REST_LIMIT:
        warn(
            "SWM084",
            f"{name}: the motion between rests does not close within its band "
            f"({run.rest_score:.1f} deviations rms): "
            "one of them is no rest of the body, or the sensor is worse than stated",
        )
    if run.doubt:
        warn("SWM033", f"{name}: {run.doubt}")
    if run.stroke is not None and run.contradicted:
        low, high = run.stroke.beat.interval_hz
        warn(
            "SWM032",
            f"{name}: the metadata says frequency_hz {run.stated_hz:g}, {run.stroke.channel} beats at "
            f"{run.stroke.beat.frequency_hz:.4g} Hz (95 %: {low:.4g} ... {high:.4g})",
        )
