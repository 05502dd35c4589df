"""A run of ``swimid track imu``: its inputs and everything that is estimated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial import alone, fusion, motion, plausible
from swimid.inertial.alignment import Poses
from swimid.inertial.fusion import Fused
from swimid.inertial.motion import Motion
from swimid.inertial.plausible import Trust
from swimid.inertial.record import ACCELERATION, RATE, Array, Finding
from swimid.inertial.setup import Setup
from swimid.inertial.smoother import gravity
from swimid.logs import rhythm
from swimid.logs.rhythm import Rhythm
from swimid.logs.rotation import angles

#: Metadata that disagrees with the stroke by more than this share, and by more than its interval, is wrong.
FREQUENCY_SHARE = 0.03
ANGLES = ("roll", "pitch", "yaw")


@dataclass(frozen=True, kw_only=True)
class Run(Setup):
    """Everything a run found, for its log and its evidence.

    ``impossible`` says why positions and velocities of the motion are empty where they are.
    """

    findings: list[Finding]
    stroke: Rhythm | None
    cutoff_hz: float
    poses: Poses | None = None
    motion: Motion
    fused: Fused | None = None
    trust: Trust | None = None
    #: Surge within a stroke, m/s, and its standard deviation; NaN where there is none.
    surge_osc: Array
    surge_osc_sd: Array
    #: Shape (6,). Of the accelerometer (m/s^2) and the gyroscope (rad/s) at the end.
    bias: Array | None = None
    #: Root-mean-square innovation at rests, in standard deviations.
    rest_score: float | None = None
    impossible: tuple[str, ...] = ()

    @property
    def by_paper(self) -> bool:
        """Whether the motion is that of the paper's steps, without standard deviations."""
        return self.options.method == "paper"

    @property
    def body_to_sensor(self) -> Rotation:
        """The mounting: as fused with the other log, else as the rests or the user tell it."""
        return self.mount.rotation if self.fused is None else self.fused.smoothed.path.mount

    @property
    def tilt(self) -> tuple[float, float]:
        """Roll and pitch of the body at rest, rad."""
        up = self.body_to_sensor.inv().apply(self.mount.up)
        return float(np.arctan2(up[1], up[2])), float(np.arctan2(up[0], np.hypot(up[1], up[2])))

    @property
    def stated_hz(self) -> float | None:
        """The stroke frequency the metadata states, Hz."""
        value = self.record.metadata.get("frequency_hz")
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None

    @property
    def doubt(self) -> str:
        """What speaks against the stroke, where the metadata states none; empty where nothing does."""
        return self.stroke.doubt if self.stroke is not None and self.stated_hz is None else ""

    @property
    def contradicted(self) -> bool:
        """Whether the stated frequency lies outside the stroke's interval, and off by more than 3 %."""
        stroke, stated = self.stroke, self.stated_hz
        if stroke is None or stated is None:
            return False
        low, high = stroke.beat.interval_hz
        off = abs(stated / stroke.beat.frequency_hz - 1)
        if stroke.maybe_double and abs(2 * stated / stroke.beat.frequency_hz - 1) < FREQUENCY_SHARE:
            return False
        return off > FREQUENCY_SHARE and not low <= stated <= high

    def columns(self) -> dict[str, Any]:
        """The columns of the log, in order."""
        m = self.motion
        known = {
            "t_s": m.time_s,
            **_named("{}_m", m.position),
            **_named("{}_rad", np.column_stack(angles(m.rotation)), ANGLES),
            **_named("{}_m_s", m.body_velocity, "uvw"),
            **_named("v{}_m_s", m.velocity),
            **_named("{}_rate_rad_s", m.rate * [1.0, -1.0, 1.0], ANGLES),
            **_named("a{}_world_m_s2", m.acceleration),
            **_named("q{}", m.rotation.as_quat(), "xyzw"),
        }
        if self.by_paper:
            return known
        return {
            **known,
            "u_osc_m_s": self.surge_osc,
            **_named("{}_sd_m", m.position_sd),
            **_named("{}_sd_rad", m.angle_sd, ANGLES),
            **_named("{}_sd_m_s", m.body_velocity_sd, "uvw"),
            **_named("v{}_sd_m_s", m.velocity_sd),
            "u_osc_sd_m_s": self.surge_osc_sd,
            "bridged": (self.record.filled_acceleration | self.record.filled_rate).astype(int),
        }


def _named(name: str, values: Array, parts: Sequence[str] = "xyz") -> dict[str, Array]:
    return {name.format(part): column for part, column in zip(parts, values.T, strict=True)}


def estimate(setup: Setup, findings: list[Finding], poses: Poses | None) -> Run:
    """Estimate the motion of a recording by the method of the options.

    Parameters
    ----------
    findings : list of Finding
        Faults found so far.
    poses : Poses or None
        Another log of the trial to fuse with.
    """
    body, o = setup.body, setup.options
    readings = dict(zip((*RATE, *ACCELERATION), np.hstack([body.rate, body.acceleration]).T, strict=True))
    stroke = rhythm.find(body.time_s, readings)
    cutoff = motion.LOWEST_HZ if stroke is None else motion.STROKE_SHARE * stroke.beat.frequency_hz
    empty = np.full(len(body), np.nan)
    known: dict[str, Any] = {"poses": poses, "stroke": stroke, "cutoff_hz": cutoff}
    known |= {"surge_osc": empty, "surge_osc_sd": empty}
    if o.method == "paper":
        limits = (o.threshold_m_s2, o.threshold_rad_s)
        moved, constant = motion.by_paper(body, setup.attitude, o.motion_mode, *limits)
        return Run(**vars(setup), **known, findings=findings, motion=moved, bias=constant)
    found = alone.estimate(setup) if poses is None else fusion.estimate(setup, poses)
    setup = replace(setup, sensor=found.sensor, still=found.still)
    known["findings"] = [*findings, *found.findings]
    if isinstance(found, Fused):
        known["fused"] = found
    impossible = found.impossible
    if impossible:
        record, source = setup.record, setup.source
        turning = setup.mount.rotation.inv().apply(record.rate - setup.still_rate)
        acceleration = source.rotation.apply(record.acceleration) + gravity(np.zeros(2))
        moved = motion.of_attitude(record.time_s, setup.attitude, turning, acceleration, setup.attitude_sd)
    else:
        smoothed = found.smoothed
        moved, path = motion.at_reference(smoothed), smoothed.path
        surge, surge_sd = motion.surge_within_stroke(moved, smoothed, cutoff)
        known |= {"surge_osc": surge, "surge_osc_sd": surge_sd, "rest_score": smoothed.score("rest")}
        known["bias"] = np.concatenate([path.acceleration_bias[-1], path.rate_bias[-1]])
        if poses is None:
            moved, impossible = _without_too_fast(moved, o.top_speed_m_s)
    if poses is None:
        known["trust"] = _trust(setup, moved)
    return Run(**vars(setup), **known, motion=moved, impossible=tuple(impossible))


def _without_too_fast(moved: Motion, top_m_s: float) -> tuple[Motion, list[str]]:
    """Empty velocity and position of the samples that are faster than the robot ever is."""
    fast = plausible.too_fast(moved.velocity, moved.velocity_sd, top_m_s)
    if not fast.any():
        return moved, []
    fastest = float(np.max(np.linalg.norm(moved.velocity, axis=1)))
    text = (
        f"{100 * fast.mean():.0f} % of the samples come out faster than the robot can be, {top_m_s:g} m/s "
        f"(up to {fastest:.1f} m/s)"
    )
    return motion.without(moved, fast), [text]


def _trust(setup: Setup, moved: Motion) -> Trust:
    """Return how far the path of a unit alone can be trusted."""
    rests, t = setup.still.rests, setup.record.time_s
    start = t[rests[0].last - 1] if rests and rests[0].first == 0 else t[0]
    return plausible.reach(moved.time_s, moved.position, moved.position_sd, float(start))
