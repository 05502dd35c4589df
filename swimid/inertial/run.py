"""A run of ``swimid track imu``: what was told to it, and everything it finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial import mounting
from swimid.inertial.alignment import Poses
from swimid.inertial.faults.base import Finding
from swimid.inertial.fusion import Fused
from swimid.inertial.motion import Motion
from swimid.inertial.paper import PaperMotion
from swimid.inertial.plausible import Trust
from swimid.inertial.record import Array
from swimid.inertial.setup import Setup
from swimid.inertial.smoother import Smoothed
from swimid.logs.rhythm import Rhythm
from swimid.logs.rotation import angles

#: Metadata that disagrees with the stroke by more than this share, and by more than its interval, is wrong.
FREQUENCY_SHARE = 0.03
ANGLES = ("roll", "pitch", "yaw")


@dataclass(frozen=True, kw_only=True)
class Run(Setup):
    """Everything a run found, for its log, its evidence and its summary.

    ``impossible`` says why positions and velocities of the motion are empty where they are.
    """

    findings: list[Finding]
    stroke: Rhythm | None
    cutoff_hz: float
    poses: Poses | None = None
    motion: Motion | None = None
    paper: PaperMotion | None = None
    smoothed: Smoothed | None = None
    fused: Fused | None = None
    trust: Trust | None = None
    surge_osc: Array | None = None
    surge_osc_sd: Array | None = None
    impossible: tuple[str, ...] = ()

    @property
    def bias(self) -> Array | None:
        """Of the accelerometer (m/s^2) and the gyroscope (rad/s) at the end, shape (6,)."""
        path = None if self.smoothed is None else self.smoothed.path
        return None if path is None else np.concatenate([path.acceleration_bias[-1], path.rate_bias[-1]])

    @property
    def rest_score(self) -> float | None:
        """Innovations at rests, in their deviations, rms."""
        return None if self.smoothed is None else self.smoothed.score("rest")

    @property
    def body_to_sensor(self) -> Rotation:
        """The mounting: as fused with the other log, else as the rests or the user tell it."""
        return self.mount.rotation if self.fused is None else self.fused.smoothed.path.mount

    @property
    def tilt(self) -> tuple[float, float]:
        """Roll and pitch of the body at rest, rad."""
        return mounting.tilt_at_rest(self.mount.up, self.body_to_sensor)

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
        if self.paper is not None:
            p, v, turn = self.paper.position, self.paper.velocity, self.attitude
            return {
                **_pose(self.record.time_s, p, turn, turn.inv().apply(v), v),
                **_named("a{}_world_m_s2", self.paper.acceleration),
                **_named("w{}_world_rad_s", self.paper.rate),
            }
        m = self.motion
        assert m is not None
        surge_sd = np.full(len(m.time_s), np.nan) if self.surge_osc_sd is None else self.surge_osc_sd
        return {
            **_pose(m.time_s, m.position, m.rotation, m.body_velocity, m.velocity),
            **_named("{}_rate_rad_s", m.rate * [1.0, -1.0, 1.0], ANGLES),
            "u_osc_m_s": self.surge_osc,
            **_named("a{}_world_m_s2", m.acceleration),
            **_named("q{}", m.rotation.as_quat(), "xyzw"),
            **_named("{}_sd_m", m.position_sd),
            **_named("{}_sd_rad", m.angle_sd, ANGLES),
            **_named("{}_sd_m_s", m.body_velocity_sd, "uvw"),
            **_named("v{}_sd_m_s", m.velocity_sd),
            "u_osc_sd_m_s": surge_sd,
            "bridged": (self.record.filled_acceleration | self.record.filled_rate).astype(int),
        }


def _named(name: str, values: Array, parts: Sequence[str] = "xyz") -> dict[str, Array]:
    return {name.format(part): column for part, column in zip(parts, values.T, strict=True)}


def _pose(
    time_s: Array, place: Array, turn: Rotation, body_velocity: Array, velocity: Array
) -> dict[str, Any]:
    return {
        "t_s": time_s,
        **_named("{}_m", place),
        **_named("{}_rad", np.column_stack(angles(turn)), ANGLES),
        **_named("{}_m_s", body_velocity, "uvw"),
        **_named("v{}_m_s", velocity),
    }
