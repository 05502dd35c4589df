"""A run of ``swimid track imu``: what was told to it, and everything it finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from swimid.inertial import mounting
from swimid.inertial.alone import Stillness
from swimid.inertial.attitude import Source
from swimid.inertial.faults.base import Finding
from swimid.inertial.fusion import Fused
from swimid.inertial.motion import Motion
from swimid.inertial.mounting import Mount
from swimid.inertial.paper import PaperMotion
from swimid.inertial.record import Array, Record
from swimid.inertial.settings import Settings
from swimid.inertial.trust import Trust
from swimid.logs.rhythm import Rhythm
from swimid.logs.rotation import angles

#: Metadata that disagrees with the stroke by more than this share, and by more than its interval, is wrong.
FREQUENCY_SHARE = 0.03


@dataclass(frozen=True)
class Run:
    """Everything a run found, for its log, its evidence and its summary.

    ``impossible`` says why positions and velocities of the motion are empty where they are.
    """

    record: Record
    source: Source
    still: Stillness
    mount: Mount
    settings: Settings
    findings: list[Finding]
    stroke: Rhythm | None
    cutoff_hz: float
    motion: Motion | None = None
    paper: PaperMotion | None = None
    fused: Fused | None = None
    rest_score: float | None = None
    trust: Trust | None = None
    surge_osc: Array | None = None
    surge_osc_sd: float | None = None
    bias: Array | None = None
    impossible: tuple[str, ...] = ()

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
            body = self.source.rotation * self.mount.rotation
            roll, pitch, yaw = angles(body)
            p, v = self.paper.position, self.paper.velocity
            u = body.inv().apply(v)
            return {
                "t_s": self.record.time_s,
                "x_m": p[:, 0], "y_m": p[:, 1], "z_m": p[:, 2],
                "roll_rad": roll, "pitch_rad": pitch, "yaw_rad": yaw,
                "u_m_s": u[:, 0], "v_m_s": u[:, 1], "w_m_s": u[:, 2],
                "vx_m_s": v[:, 0], "vy_m_s": v[:, 1], "vz_m_s": v[:, 2],
                **{f"a{a}_world_m_s2": c for a, c in zip("xyz", self.paper.acceleration.T, strict=True)},
                **{f"w{a}_world_rad_s": c for a, c in zip("xyz", self.paper.rate.T, strict=True)},
            }  # fmt: skip
        found = self.motion
        assert found is not None
        roll, pitch, yaw = angles(found.rotation)
        quaternion = found.rotation.as_quat()
        out: dict[str, Any] = {"t_s": found.time_s}
        out |= dict(zip(("x_m", "y_m", "z_m"), found.position.T, strict=True))
        out |= {"roll_rad": roll, "pitch_rad": pitch, "yaw_rad": yaw}
        out |= dict(zip(("u_m_s", "v_m_s", "w_m_s"), found.body_velocity.T, strict=True))
        out |= dict(zip(("vx_m_s", "vy_m_s", "vz_m_s"), found.velocity.T, strict=True))
        out |= {"roll_rate_rad_s": found.rate[:, 0], "pitch_rate_rad_s": -found.rate[:, 1]}
        out |= {"yaw_rate_rad_s": found.rate[:, 2], "u_osc_m_s": self.surge_osc}
        out |= dict(
            zip(("ax_world_m_s2", "ay_world_m_s2", "az_world_m_s2"), found.acceleration.T, strict=True)
        )
        out |= dict(zip(("qx", "qy", "qz", "qw"), quaternion.T, strict=True))
        out |= dict(zip(("x_sd_m", "y_sd_m", "z_sd_m"), found.position_sd.T, strict=True))
        out |= dict(zip(("roll_sd_rad", "pitch_sd_rad", "yaw_sd_rad"), found.angle_sd.T, strict=True))
        out |= dict(zip(("u_sd_m_s", "v_sd_m_s", "w_sd_m_s"), found.body_velocity_sd.T, strict=True))
        out |= dict(zip(("vx_sd_m_s", "vy_sd_m_s", "vz_sd_m_s"), found.velocity_sd.T, strict=True))
        out["u_osc_sd_m_s"] = np.full(
            len(found.time_s), np.nan if self.surge_osc_sd is None else self.surge_osc_sd
        )
        out["bridged"] = (self.record.filled_acceleration | self.record.filled_rate).astype(int)
        return out
