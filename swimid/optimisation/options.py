"""The options of ``map``, ``optimise stiffness`` and ``optimise gait``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from swimid.fitting import options as fits
from swimid.options import Options, Source, option
from swimid.simulation import options as simulations
from swimid.swimmer import options as swimmers


class GaitOptions(Options):
    """The robot, and the drive that is varied; what every verb of gaits can be told."""

    params: Source = option(None, help="Parameter file of a robot with links.", recorded=False)
    robot: str | None = simulations.robot("Robot; without --params its file's own values are used.")
    frequency_hz: float | None = option(None, gt=0, help="Beat frequency where it is not varied.")
    amplitude_deg: float | None = option(
        None, ge=0, help="Beat amplitude where it is not varied (T-Fish: of the whole tail)."
    )
    waveform: Literal["sine", "hopf", "a-cpg"] = option("sine", help="Form of the beat.")
    bias_deg: float | None = option(None, help="Turning bias where it is not varied.")
    asymmetry: float | None = option(
        None, gt=-1, lt=1, help="Of an a-cpg beat (T-Fish, Eq 10), where it is not varied."
    )
    lag_deg: float | None = option(
        None, help="Phase by which each driven joint lags the one before it, where it is not varied."
    )
    ramp_s: float = option(1.0, ge=0, help="Time the beat is eased in.")
    stroke: str | None = option(None, metavar="NAME", help="Stroke of the robot file in place of a beat.")
    scale: float | None = option(
        None, ge=0, help="What the stroke's angles are multiplied with, where it is not varied."
    )
    duration_s: float = option(15.0, gt=0, help="Length of each run from rest; judged by its last beats.")
    chosen: Mapping[str, float] = simulations.chosen("Hold a parameter at this value. Repeatable.")
    readings: Mapping[str, str] = swimmers.readings()
    dt: float = swimmers.step()
    jobs: int | None = fits.jobs()


class MapOptions(GaitOptions):
    """What ``map`` can be told."""

    over: Mapping[str, tuple[float, float, int]] = option(
        metavar="NAME=LOW:HIGH:COUNT",
        help="What is varied: frequency_hz, amplitude_deg, bias_deg, asymmetry, lag_deg, scale of a stroke, "
        "or a coefficient (K_s). One or two.",
    )
    trials: Source = option(
        None, help="Trials file: its measured speeds are set beside the map, and its region is marked."
    )
