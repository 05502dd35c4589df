"""The comparison file (``swimid-comparison/1``): measured against simulated, as ``compare`` writes it."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from pydantic import Field

from swimid.files import yamlio
from swimid.files.yamlio import Number, Numbers

FORMAT: Literal["swimid-comparison/1"] = "swimid-comparison/1"


class ChannelScore(yamlio.Document):
    """Errors of one channel, in its unit; measured minus simulated."""

    unit: str
    #: ``logged``, or ``pose``: derived from the logged pose and the simulated one alike.
    source: Literal["logged", "pose"] = "logged"
    rmse: Number = None
    #: Over the measured range (tendon fish, Eq 13).
    nrmse: Number = None
    vaf: Number = None
    fit_percent: Number = None
    bias: Number = None
    samples: int
    #: Difference of the largest magnitudes, and that over the measured one (tendon fish, Eq 14).
    peak_error: Number = None
    peak_error_normalised: Number = None
    #: Of the simulation ahead of the measurement, at the beat.
    phase_error_rad: Number = None
    #: Error per sample left when time may be stretched within a quarter of a beat.
    dtw_distance: Number = None


class CycleTable(yamlio.Document):
    """Means and largest magnitudes of every whole stroke."""

    time_s: Numbers
    mean_measured: Numbers
    mean_simulated: Numbers
    peak_measured: Numbers
    peak_simulated: Numbers


class Speed(yamlio.Document):
    """Mean speed over the last whole beats, m/s."""

    measured: Number = None
    simulated: Number = None
    beats: int


class Cruise(yamlio.Document):
    """Steady swimming of the model under the drive of a trial that begins in motion.

    The start speed of such a trial comes from the trial itself, so its simulated speed is no prediction
    before the speed has settled.
    """

    #: Speed at which the model settles, m/s; null where it never settles.
    settled: Number = None
    #: Time in which a difference from that speed falls by a factor e, s; null where it never settles.
    settling_s: Number = None
    #: Whether the measured speed is steady, so that the two can be compared.
    steady: bool


class TrialComparison(yamlio.Document):
    """One trial."""

    id: str
    role: Literal["fit", "validate"]
    #: Start state: from the parameter file, estimated from this trial, or at rest at the first pose.
    start: Literal["file", "estimated", "neutral"]
    start_values: dict[str, float] = {}
    frequency_hz: Number = None
    #: What drove it.
    drive: dict[str, Any] = {}
    channels: dict[str, ChannelScore]
    cycles: dict[str, CycleTable] = {}
    mean_speed: Speed | None = None
    cruise: Cruise | None = None


class CycleComparison(yamlio.Document):
    """One stroke of a motion profile: quantities by name (Tables I and II of the sea lion paper), in SI."""

    cycle: int
    #: Means over the profile's trials.
    measured: dict[str, Number]
    simulated: dict[str, Number]
    #: Standard deviation over them, where there are several.
    spread: dict[str, Number] = {}


class ProfileComparison(yamlio.Document):
    """Trials that repeat one motion, the mean of them against that of their simulations."""

    name: str
    trials: list[str]
    cycles: list[CycleComparison] = []
    #: Between the mean paths, and the mean angles.
    position_rmse_m: Number = None
    orientation_rmse_rad: Number = None
    #: From the first sample to the last, ``measured`` and ``simulated``.
    surge_m: dict[str, Number] = {}
    heave_m: dict[str, Number] = {}


class ComparisonFile(yamlio.ResultFile):
    """A comparison file."""

    kind: ClassVar[str] = "comparison file"
    format: Literal["swimid-comparison/1"] = FORMAT
    verdict: Literal["good", "caution", "bad"]
    model: str
    robot: str
    experiment: str
    params: str
    #: All trials together, by channel.
    channels: dict[str, ChannelScore]
    trials: list[TrialComparison]
    #: Of a robot in space.
    profiles: list[ProfileComparison] = []
    #: Root-mean-square error of the mean speeds of all trials, m/s.
    mean_speed_rmse_m_s: Number = None
    provenance: dict[str, Any] = Field(default_factory=dict)

    @property
    def mean_speeds(self) -> list[tuple[TrialComparison, float, float]]:
        """The trials that have a mean speed, with the measured and the simulated one, m/s."""
        return [
            (t, t.mean_speed.measured, t.mean_speed.simulated)
            for t in self.trials
            if t.mean_speed and t.mean_speed.measured is not None and t.mean_speed.simulated is not None
        ]
