"""Options of the commands ``swimid map``, ``swimid optimise stiffness`` and ``swimid optimise gait``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import swimid.options as fits
from swimid.options import option
from swimid.simulation import options as simulations


class GaitOptions(simulations.DriveOptions):
    """Options that all optimisation commands share: robot, drive, duration of a simulation, and threads."""

    duration_s: float = option(15.0, gt=0, help="Duration of each run from rest; its last beats are judged.")
    jobs: int | None = fits.jobs()


class MapOptions(GaitOptions, argument="", makes="map"):
    r"""Map speed, cost of transport and turning over a grid of gaits.

    Speed, cost of transport, Strouhal number, turning, power and torque are computed over one or two of
    frequency, amplitude, bias, asymmetry and any coefficient. The map marks the range of the identification
    trials. An interrupted run continues when it is started again.

    Examples:
      swimid map --robot dolphin --amplitude-deg 27 \
          --over frequency_hz=1:5:9 --over K_s=0.2:3.0:15 -o map.yaml
      swimid map --params tfish.yaml --over frequency_hz=0.6:2:8 --over amplitude_deg=15:35:5 -o map.yaml
      swimid map --robot tfish --waveform a-cpg --frequency-hz 1 --amplitude-deg 35 \
          --over bias_deg=25:35:3 --over asymmetry=0:0.4:2 --duration-s 20 -o steering.yaml
    """

    over: Mapping[str, tuple[float, float, int]] = option(
        metavar="NAME=LOW:HIGH:COUNT",
        help="Axis: frequency_hz, amplitude_deg, bias_deg, asymmetry, lag_deg, scale of a stroke, or a "
        "coefficient (K_s). One or two.",
    )


class OptimiseStiffnessOptions(GaitOptions, argument="", makes="rule"):
    r"""Find the best stiffness of a passive joint over frequency and amplitude.

    NSGA-II searches the stiffness at every point of the grid. The rule is a quadratic function of the
    frequency for each amplitude, which a controller reads as YAML. An interrupted run continues when it is
    started again.

    Examples:
      swimid optimise stiffness --params tfish.yaml --over frequency_hz=0.6:2:8 \
          --over amplitude_deg=15:35:5 -o rule.yaml
      swimid optimise stiffness --robot dolphin --amplitude-deg 27 --over frequency_hz=1:5:9 \
          --between 0.1,3 --objective cost-of-transport -o rule.yaml
    """

    over: Mapping[str, tuple[float, float, int]] = option(
        metavar="NAME=LOW:HIGH:COUNT",
        help="frequency_hz, and amplitude_deg if the rule depends on it.",
    )
    coefficient: str | None = option(
        None, metavar="NAME", help="Stiffness; by default the only coefficient in the law of a passive joint."
    )
    between: tuple[float, float] | None = option(
        None, metavar="LOW,HIGH", help="Range of the search; by default the bounds of the coefficient."
    )
    objective: Literal["speed", "cost-of-transport"] = option(
        "speed",
        help="speed: mean speed from rest, and range of the turning rate (T-Fish, Eq 12). "
        "cost-of-transport: cost of transport, and mean speed.",
    )
    population: int = option(24, ge=4, help="NSGA-II: population size.")
    generations: int = option(12, ge=1, help="NSGA-II: number of generations.")
    seed: int = option(0, ge=0, help="Seed of the search: the same seed gives the same file.")


Goal = Literal["speed", "radius", "turn-rate", "cost-of-transport", "power"]


class OptimiseGaitOptions(GaitOptions, argument="", makes="gait"):
    r"""Find the best gait within limits.

    Frequency, amplitude, bias, asymmetry, phase lag and coefficients may be varied. The goal is speed,
    turning, cost of transport or power. With standard errors in the parameter file the result has the
    uncertainty of the best gait.

    Examples:
      swimid optimise gait --params tfish.yaml --vary frequency_hz=0.6,2 --vary d_p=0,0.2 \
          --amplitude-deg 30 --limit joint_rate_deg_s=120 -o gait.yaml
      swimid optimise gait --robot tfish --waveform a-cpg --goal radius --vary bias_deg=0,40 \
          --vary asymmetry=0,0.6 --frequency-hz 1 --amplitude-deg 35 --limit tank_m=4 -o turn.yaml
    """

    vary: Mapping[str, tuple[float, float]] = option(
        {},
        metavar="NAME=LOW,HIGH",
        help="Range of a varied parameter: frequency_hz, amplitude_deg, bias_deg, asymmetry, lag_deg, scale "
        "of a stroke, or a coefficient (a stiffness). Repeatable.",
    )
    goal: Goal = option("speed", help="Quantity to optimise. radius is that of the turn.")
    limits: Mapping[str, float] = option(
        {},
        flag="--limit",
        metavar="NAME=VALUE",
        help="Upper limit: torque_N_m, joint_rate_deg_s, tank_m (side of the basin that holds the run). "
        "Repeatable.",
    )
    reach_speed_m_s: float | None = option(None, gt=0, help="Lower limit of the mean speed.")
    draws: int = option(96, ge=20, help="Draws of the coefficients from their covariance, for intervals.")
    starts: int = option(6, ge=1, help="Number of starts of the gradient search.")
    seed: int = option(0, ge=0, help="Seed of starts and draws: the same seed gives the same file.")
