"""What a run of ``swimid track imu`` is told, and everything it finds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from swimid.inertial import paper
from swimid.inertial.alone import Declared, Stillness
from swimid.inertial.attitude import Source
from swimid.inertial.faults.base import Finding
from swimid.inertial.fusion import Fused
from swimid.inertial.motion import Motion
from swimid.inertial.mounting import Mount
from swimid.inertial.paper import PaperMotion
from swimid.inertial.record import Array, Record
from swimid.inertial.sensor import Sensor
from swimid.inertial.trust import Trust
from swimid.logs.rhythm import Rhythm

#: Metadata that disagrees with the stroke by more than this share, and by more than its interval, is wrong.
FREQUENCY_SHARE = 0.03


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


@dataclass(frozen=True)
class Material:
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


def stated_frequency(m: Material) -> float | None:
    """The stroke frequency the metadata states, Hz."""
    value = m.record.metadata.get("frequency_hz")
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def contradicts(stroke: Rhythm, stated_hz: float) -> bool:
    """Whether a stated frequency lies outside the interval, and off by more than 3 %."""
    low, high = stroke.interval_hz
    off = abs(stated_hz / stroke.beat.frequency_hz - 1)
    if stroke.maybe_double and abs(2 * stated_hz / stroke.beat.frequency_hz - 1) < FREQUENCY_SHARE:
        return False
    return off > FREQUENCY_SHARE and not low <= stated_hz <= high
