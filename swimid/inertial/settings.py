"""How to make motion of an inertial recording."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from swimid.errors import UsageError
from swimid.inertial import paper
from swimid.inertial.alone import Declared
from swimid.inertial.options import TrackImuOptions
from swimid.inertial.sensor import DEG, MILLI_G, Sensor


@dataclass(frozen=True)
class Settings:
    """How to make motion of a recording.

    Attributes
    ----------
    method : str
        ``smoother``, or ``paper`` for Shang et al. (2012).
    mode : str
        The paper's motion mode.
    threshold_m_s2, threshold_rad_s : float
        The paper's threshold on small readings.
    mount_deg : (float, float, float), optional
        Roll, pitch, yaw of the sensor in the body, degrees.
    level_at_rest : bool
        The body is level when at rest: what tilt is seen there is the mounting's.
    clock_offset_s, fix_sd_m : float, optional
        To add to the other log's times; noise of its positions. Estimated without them.
    """

    method: Literal["smoother", "paper"] = "smoother"
    mode: paper.Mode = "marching"
    threshold_m_s2: float = paper.THRESHOLD_M_S2
    threshold_rad_s: float = paper.THRESHOLD_RAD_S
    mount_deg: tuple[float, float, float] | None = None
    level_at_rest: bool = False
    clock_offset_s: float | None = None
    fix_sd_m: float | None = None
    declared: Declared = field(default_factory=Declared)
    sensor: Sensor = field(default_factory=Sensor)

    def to_dict(self) -> dict[str, Any]:
        """The settings as plain data, for the provenance of a result."""
        d = self.declared
        return {
            "method": self.method,
            "motion_mode": self.mode,
            "still_s": [list(w) for w in d.still],
            "rest": d.rests,
            "zero_mean": list(d.zero_mean),
            "top_speed_m_s": d.top_speed_m_s,
            "mount_deg": None if self.mount_deg is None else list(self.mount_deg),
            "level_at_rest": self.level_at_rest,
            "lever_m": None if d.lever_m is None else [float(v) for v in d.lever_m],
            "clock_offset_s": self.clock_offset_s,
            "fix_sd_m": self.fix_sd_m,
            "sensor": dict(vars(self.sensor)),
        }

    @classmethod
    def of(cls, options: TrackImuOptions) -> Settings:
        """Settings from the options, which are in the field's units.

        Raises
        ------
        UsageError
            A rest that ends before it begins.
        """
        for start, end in options.still:
            if not start < end:
                raise UsageError(f"--still {start:g} {end:g}: the rest must end after it begins")
        usual = Sensor()
        accel_mg, gyro_deg_s, attitude_deg = (
            options.accel_bias_mg, options.gyro_bias_deg_s, options.attitude_sd_deg
        )  # fmt: skip
        sensor = Sensor(
            options.accel_noise,
            options.gyro_noise,
            usual.acceleration_bias_sd if accel_mg is None else accel_mg * MILLI_G,
            usual.rate_bias_sd if gyro_deg_s is None else gyro_deg_s * DEG,
            attitude_sd=None if attitude_deg is None else attitude_deg * DEG,
        )
        declared = Declared(
            list(options.still),
            options.rests,
            tuple(dict.fromkeys(options.zero_mean)),
            options.window_s,
            options.mean_sd_m_s,
            options.top_speed_m_s,
            None if options.lever_m is None else np.asarray(options.lever_m, dtype=float),
        )
        return cls(
            options.method,
            options.motion_mode,
            paper.THRESHOLD_M_S2 if options.threshold_m_s2 is None else options.threshold_m_s2,
            paper.THRESHOLD_RAD_S if options.threshold_rad_s is None else options.threshold_rad_s,
            options.mount_deg,
            options.level_at_rest,
            options.clock_offset_s,
            options.fix_sd_m,
            declared,
            sensor,
        )
