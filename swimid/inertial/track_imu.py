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
    fusion,
    motion,
    mounting,
    oscillation,
    paper,
    plausible,
    trust,
)
from swimid.inertial import faults as recording_faults
from swimid.inertial import track_imu_evidence as told
from swimid.inertial.alignment import Poses
from swimid.inertial.faults.base import Finding
from swimid.inertial.motion import Motion
from swimid.inertial.record import Record
from swimid.inertial.smoother import Smoothed, gravity
from swimid.inertial.track_imu_checks import REST_LIMIT
from swimid.inertial.track_imu_input import read_poses, read_record
from swimid.inertial.track_imu_material import Material, Settings, contradicts, stated_frequency
from swimid.logs import log, rhythm
from swimid.logs.rotation import angles
from swimid.notices import Notice, recorded, warn
from swimid.progress import Progress, silent
from swimid.results import evidence
from swimid.results.result import Result


def track_imu(
    imu: str | Path,
    *,
    output: str | Path,
    map_path: str | Path | None = None,
    other: str | Path | None = None,
    settings: Settings | None = None,
    progress: Progress = silent,
) -> Result:
    """Make motion of an inertial recording and write the log.

    Parameters
    ----------
    imu : path
        The recording: CSV or Parquet with the columns of ``docs/formats.md``, or anything with a mapping.
    output : path
        The log; ``<stem>.evidence.json`` goes beside it.
    map_path : path, optional
        ``swimid-mapping/1`` file.
    other : path, optional
        Another log of the trial to fuse with: positions, angles, or both.
    settings : Settings, optional

    Raises
    ------
    InputError
        A file cannot be used, or a fault of recording cannot be repaired.
    NoTrustworthyResult
        The two logs do not move together.
    UsageError
        Settings that do not fit together.
    """
    settings = settings or Settings()
    inputs = [Path(p) for p in (imu, map_path, other) if p is not None]
    output = atomic.check_writable(output, inputs=tuple(inputs))
    if settings.method == "paper" and other is not None:
        raise UsageError(
            "--method paper fuses with nothing", hint="leave out --with, or take --method smoother"
        )
    with recorded(repeat=True) as notices:
        record, notes = read_record(inputs[0], None if map_path is None else Path(map_path), progress)
        record, findings = recording_faults.mend(record)
        poses = None if other is None else read_poses(Path(other))
        material = _prepare(record, findings, settings)
        with progress("smoothing", total=None) as step:
            if settings.method == "paper":
                material = _by_paper(material)
            else:
                material = _by_smoother(material, poses, step)
        _warn(material, notes)
        return _write(material, poses, inputs, output, notices)


def _prepare(record: Record, findings: list[Finding], settings: Settings) -> Material:
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
    return Material(record, source, still, mount, settings, [*findings, *told_by_gravity], stroke, cutoff)


def _by_paper(m: Material) -> Material:
    turned = m.mount.rotation.inv()
    body = replace(
        m.record, acceleration=turned.apply(m.record.acceleration), rate=turned.apply(m.record.rate)
    )
    found = paper.integrate(
        body,
        m.source.rotation * m.mount.rotation,
        m.settings.mode,
        threshold_m_s2=m.settings.threshold_m_s2,
        threshold_rad_s=m.settings.threshold_rad_s,
    )
    return replace(m, paper=found)


def _by_smoother(m: Material, poses: Poses | None, step: Callable[[], Any]) -> Material:
    settings, fused = m.settings, None
    common = (m.record, m.source, m.still, m.mount)
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
    m = replace(m, settings=settings, fused=fused, still=still, findings=[*m.findings, *findings])
    if impossible:
        return _attitude_alone(m, impossible)
    moved = motion.at_reference(smoothed)
    surge = oscillation.surge(moved.time_s, moved.velocity, moved.rotation, m.cutoff_hz)
    surge_sd = oscillation.high_passed_sd(still.noise.acceleration, m.cutoff_hz, sensor.scale_sd, surge)
    if fused is None:
        moved, impossible = _never_too_fast(moved, settings.declared.top_speed_m_s)
    rest = smoothed.errors.scores.get("rest")
    return replace(
        m,
        motion=moved,
        trust=_reach(m, moved) if fused is None else None,
        surge_osc=surge,
        surge_osc_sd=surge_sd,
        rest_score=None if rest is None else float(np.sqrt(np.nanmean(rest**2))),
        bias=_biases(smoothed),
        impossible=tuple(impossible),
    )


def _attitude_alone(m: Material, impossible: list[str]) -> Material:
    """No motion that can be: the attitude before smoothing, everything else empty."""
    turned = m.mount.rotation.inv()
    moved = motion.of_attitude(
        m.record.time_s,
        m.source.rotation * m.mount.rotation,
        turned.apply(m.record.rate - attitude.still_rate(m.record, m.still.found)),
        m.source.rotation.apply(m.record.acceleration) + gravity(np.zeros(2)),
        alone.attitude_sd(m.source, m.settings.sensor),
    )
    return replace(
        m,
        motion=moved,
        trust=_reach(m, moved) if m.fused is None else None,
        surge_osc=np.full(len(m.record), np.nan),
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


def _reach(m: Material, moved: Motion) -> trust.Trust:
    first = m.still.used[0] if m.still.used and m.still.used[0].first == 0 else None
    moving_from = m.record.time_s[0 if first is None else first.last - 1]
    return trust.horizon(moved.time_s, moved.position, moved.position_sd, float(moving_from))


def _biases(smoothed: Smoothed) -> Any:
    return np.concatenate([smoothed.path.acceleration_bias[-1], smoothed.path.rate_bias[-1]])


def _warn(m: Material, notes: list[str]) -> None:
    name = m.record.name
    for note in notes:
        warn("SWM004", f"{name}: {note}")
    for finding in m.findings:
        if finding.verdict == "handled":
            warn("SWM080", f"{name}, {finding.fault}: {finding.text}")
    if m.impossible:
        warn(
            "SWM086",
            f"{name}: {'; '.join(m.impossible)}: no such motion can be; its positions and velocities are "
            "empty. Name the true rests with --still, or fuse a camera log (--with)",
        )
    if not m.still.found:
        warn(
            "SWM082",
            f"{name}: no still period found; the biases are known to data-sheet accuracy only. Let the robot "
            "rest for some seconds before and after a run, or name a rest with --still",
        )
    if m.trust is not None and m.trust.seconds is not None:
        warn(
            "SWM081",
            f"{name}: the integrated position is not to be trusted after {m.trust.seconds:.1f} s of motion "
            f"(at t = {m.trust.until_s:.1f} s its 95 % band exceeds 0.1 m and a tenth of the way)",
        )
    if m.fused is not None and m.settings.clock_offset_s is None and m.fused.offset.excludes_zero:
        o = m.fused.offset
        warn(
            "SWM083",
            f"the clocks differ: {1e3 * o.value_s:.1f} ms to add to the other log "
            f"(95 %: {1e3 * o.low_s:.1f} ... {1e3 * o.high_s:.1f} ms); the output is on the inertial clock",
        )
    if m.fused is not None and m.fused.stray > fusion.FEW * len(m.fused.fixes.time_s):
        warn(
            "SWM087",
            f"{name}: {m.fused.stray} of {len(m.fused.fixes.time_s)} fixes of the other log lie beyond "
            f"{aiding.GATE:g} deviations of the motion: the two logs contradict each other",
        )
    if m.fused is not None and m.fused.lasting > fusion.LASTING:
        warn(
            "SWM087",
            f"{name}: many fixes of the other log on end are off by the same (as fused they scatter "
            f"by {np.max(m.fused.fixes.position_sd[:2]):.3g} m): the logs contradict each other, or its "
            f"scale or marker is wrong; every band is widened by {m.fused.lasting:.1f}",
        )
    if m.rest_score is not None and m.rest_score > REST_LIMIT:
        warn(
            "SWM084",
            f"{name}: the motion between rests does not close within its band "
            f"({m.rest_score:.1f} deviations rms): "
            "one of them is no rest of the body, or the sensor is worse than stated",
        )
    stated = stated_frequency(m)
    if m.stroke is not None and stated is None and m.stroke.doubt:
        warn("SWM033", f"{name}: {m.stroke.doubt}")
    if m.stroke is not None and stated is not None and contradicts(m.stroke, stated):
        low, high = m.stroke.interval_hz
        warn(
            "SWM032",
            f"{name}: the metadata says frequency_hz {stated:g}, {m.stroke.channel} beats at "
            f"{m.stroke.beat.frequency_hz:.4g} Hz (95 %: {low:.4g} ... {high:.4g})",
        )


def _columns(m: Material) -> dict[str, Any]:
    if m.paper is not None:
        body = m.source.rotation * m.mount.rotation
        roll, pitch, yaw = angles(body)
        p, v = m.paper.position, m.paper.velocity
        u = body.inv().apply(v)
        return {
            "t_s": m.record.time_s,
            "x_m": p[:, 0], "y_m": p[:, 1], "z_m": p[:, 2],
            "roll_rad": roll, "pitch_rad": pitch, "yaw_rad": yaw,
            "u_m_s": u[:, 0], "v_m_s": u[:, 1], "w_m_s": u[:, 2],
            "vx_m_s": v[:, 0], "vy_m_s": v[:, 1], "vz_m_s": v[:, 2],
            **{f"a{a}_world_m_s2": c for a, c in zip("xyz", m.paper.acceleration.T, strict=True)},
            **{f"w{a}_world_rad_s": c for a, c in zip("xyz", m.paper.rate.T, strict=True)},
        }  # fmt: skip
    found = m.motion
    assert found is not None
    roll, pitch, yaw = angles(found.rotation)
    quaternion = found.rotation.as_quat()
    out: dict[str, Any] = {"t_s": found.time_s}
    out |= dict(zip(("x_m", "y_m", "z_m"), found.position.T, strict=True))
    out |= {"roll_rad": roll, "pitch_rad": pitch, "yaw_rad": yaw}
    out |= dict(zip(("u_m_s", "v_m_s", "w_m_s"), found.body_velocity.T, strict=True))
    out |= dict(zip(("vx_m_s", "vy_m_s", "vz_m_s"), found.velocity.T, strict=True))
    out |= {"roll_rate_rad_s": found.rate[:, 0], "pitch_rate_rad_s": -found.rate[:, 1]}
    out |= {"yaw_rate_rad_s": found.rate[:, 2], "u_osc_m_s": m.surge_osc}
    out |= dict(zip(("ax_world_m_s2", "ay_world_m_s2", "az_world_m_s2"), found.acceleration.T, strict=True))
    out |= dict(zip(("qx", "qy", "qz", "qw"), quaternion.T, strict=True))
    out |= dict(zip(("x_sd_m", "y_sd_m", "z_sd_m"), found.position_sd.T, strict=True))
    out |= dict(zip(("roll_sd_rad", "pitch_sd_rad", "yaw_sd_rad"), found.angle_sd.T, strict=True))
    out |= dict(zip(("u_sd_m_s", "v_sd_m_s", "w_sd_m_s"), found.body_velocity_sd.T, strict=True))
    out |= dict(zip(("vx_sd_m_s", "vy_sd_m_s", "vz_sd_m_s"), found.velocity_sd.T, strict=True))
    out["u_osc_sd_m_s"] = np.full(len(found.time_s), np.nan if m.surge_osc_sd is None else m.surge_osc_sd)
    out["bridged"] = (m.record.filled_acceleration | m.record.filled_rate).astype(int)
    return out


def _write(
    m: Material, poses: Poses | None, inputs: list[Path], output: Path, notices: list[Notice]
) -> Result:
    machine = told.result(m)
    kept = {k: v for k, v in m.record.metadata.items() if isinstance(v, int | float | str | bool)}
    head = {
        **kept,
        "source": m.record.name,
        "made_by": "swimid track imu",
        "method": m.settings.method,
        "attitude_from": m.source.kind,
        "path_trusted_until_s": None if m.trust is None else m.trust.until_s,
        "clock_offset_s": None if m.fused is None else m.fused.offset.value_s,
        "stroke_hz": None if m.stroke is None else m.stroke.beat.frequency_hz,
    }
    log.write(output, _columns(m), {k: v for k, v in head.items() if v is not None})
    proof = evidence.sidecar(output)
    evidence.write(
        proof, told.record(m, poses, machine, notices, provenance.collect(inputs, settings=told.settings(m)))
    )
    return Result("track imu", told.summary(m, machine), machine, [output, proof])
