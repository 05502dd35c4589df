"""``swimid plot``."""

from __future__ import annotations

from pathlib import Path

import click

from swimid.cli.common import Shared, protect, running, shared_options


@click.command(
    "plot", short_help="Logs as figures: channels, track from above, spectra, two sensors over each other."
)
@click.argument("logs", nargs=-1, required=True, metavar="LOG...", type=click.Path(path_type=Path))
@click.option("--title", help="Title above the figures.")
@shared_options("The picture: .html, .svg or .png.", required=True)
def command(logs: tuple[Path, ...], title: str | None, shared: Shared) -> None:
    """Draw logs. Several are drawn over each other: one trial seen by two sensors.

    \b
    Examples:
      swimid plot run.csv -o run.png
      swimid plot imu.csv camera.csv -o both.html
    """
    with running("plot", shared) as run:
        from swimid.logs.plot import plot

        protect(shared.output, shared, inputs=logs)
        assert shared.output is not None
        run.finish(plot(logs, output=shared.output, title=title, progress=run.progress))
