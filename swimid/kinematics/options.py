"""Options of the command ``plot``."""

from __future__ import annotations

from swimid.options import Options, option


class PlotOptions(
    Options, argument="LOG...", output="The picture: .svg or .png.", required=True, beside=(), makes="picture"
):
    """Draw logs: channels, track from above, and spectra. Several logs are drawn over each other.

    Examples:
      swimid plot run.csv -o run.png
      swimid plot imu.csv camera.csv -o both.svg
    """

    title: str | None = option(None, help="Title above the figures.")
