"""``swimid track``: logs from videos and IMU recordings."""

from __future__ import annotations

from pathlib import Path

import click

from swimid.cli.common import Shared, protect, running, shared_options


@click.group()
def track() -> None:
    """Make logs: from videos with coloured markers, and from IMU recordings."""


@track.command("video")
@click.argument("video", type=click.Path(path_type=Path))
@click.option("--setup", required=True, type=click.Path(path_type=Path), help="Setup file (swimid-setup/1).")
@click.option(
    "--overlay",
    "overlay_path",
    type=click.Path(path_type=Path),
    help="Also write the video with the track drawn in.",
)
@click.option("--fps", type=float, help="True frame rate in Hz, where the container's is wrong.")
@click.option(
    "--max-gap", "max_gap_s", type=float, help="Longest dropout to bridge, s  [default: the setup's]."
)
@shared_options("The log, CSV or Parquet by its ending.", required=True)
def video_command(
    video: Path,
    setup: Path,
    overlay_path: Path | None,
    fps: float | None,
    max_gap_s: float | None,
    shared: Shared,
) -> None:
    """Track coloured markers in a video: a log of pose and speeds.

    Writes the log, its evidence (<stem>.evidence.json) and a plot (<stem>.png).

    \b
    Example:
      swimid track video pool.mp4 --setup setup.yaml -o run.csv --overlay overlay.mp4
    """
    with running("track video", shared) as run:
        from swimid.verbs.track_video import track_video

        protect(shared.output, shared, inputs=(video, setup))
        protect(overlay_path, shared, inputs=(video, setup))
        assert shared.output is not None
        run.finish(
            track_video(
                video,
                setup=setup,
                output=shared.output,
                overlay_path=overlay_path,
                fps=fps,
                max_gap_s=max_gap_s,
                progress=run.progress,
            )
        )
