"""``swimid track``: logs from videos and IMU recordings."""

from __future__ import annotations

from pathlib import Path

import click

from swimid.cli.common import Shared, protect, running, shared_options
from swimid.cli.track_imu import imu_command


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
@click.option(
    "--from", "from_s", type=float, help="Speeds and stroke from here on, s  [default: over the steady part]."
)
@click.option("--to", "to_s", type=float, help="Speeds and stroke up to here, s. The log holds every frame.")
@shared_options("The log, CSV or Parquet by its ending.", required=True)
def video_command(
    video: Path,
    setup: Path,
    overlay_path: Path | None,
    fps: float | None,
    max_gap_s: float | None,
    from_s: float | None,
    to_s: float | None,
    shared: Shared,
) -> None:
    """Track coloured markers in a video: a log of pose and speeds.

    VIDEO is a film; or a folder of pictures, or a pattern of their names, both with --fps.
    Writes the log, its evidence (<stem>.evidence.json) and a plot (<stem>.png). Prints the path speed, the
    steady speed, the stroke's frequency and amplitudes and the accelerations, each with its 95 % interval.

    \b
    Example:
      swimid track video pool.mp4 --setup setup.yaml -o run.csv --overlay overlay.mp4
      swimid track video frames/%05d.png --fps 30 --setup setup.yaml -o run.csv
    """
    with running("track video", shared) as run:
        from swimid.tracking.track_video import track_video

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
                window_s=(from_s, to_s),
                progress=run.progress,
            )
        )


class _Pick(click.ParamType):
    """``name@x,y``."""

    name = "NAME@X,Y"

    def convert(
        self, value: str, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, float, float]:
        """Split the text; click reports what is wrong with it."""
        name, at, place = value.partition("@")
        parts = place.split(",")
        try:
            x, y = (float(part) for part in parts)
        except ValueError:
            self.fail(f"'{value}' must look like red@320,240", param, ctx)
        if not at or not name:
            self.fail(f"'{value}' must look like red@320,240", param, ctx)
        return name, x, y


@track.command("setup")
@click.argument("video", type=click.Path(path_type=Path))
@click.option(
    "--marker",
    "markers",
    type=_Pick(),
    multiple=True,
    help="Pick a marker of any shade by one of its pixels; head first, then tail. Equal markers: one name.",
)
@click.option("--frame", type=int, default=0, show_default=True, help="Frame the --marker pixels are in.")
@click.option("--metres-per-pixel", type=float, help="Scale as a factor.")
@click.option("--scale-points", type=float, nargs=4, help="Scale: pixels X1 Y1 X2 Y2 of two points.")
@click.option("--scale-distance-m", type=float, help="Their distance in metres.")
@click.option(
    "--plane",
    type=click.Choice(["horizontal", "vertical"]),
    default="horizontal",
    show_default=True,
    help="Camera above, or at the side.",
)
@click.option("--fps", type=float, help="True frame rate in Hz, where the container's is wrong.")
@shared_options("The setup file to write.", required=True)
def setup_command(
    video: Path,
    markers: tuple[tuple[str, float, float], ...],
    frame: int,
    metres_per_pixel: float | None,
    scale_points: tuple[float, float, float, float] | None,
    scale_distance_m: float | None,
    plane: str,
    fps: float | None,
    shared: Shared,
) -> None:
    """Draft a setup from a video: propose markers, draw them, write a YAML file to edit.

    Works unattended and without a display. The file can be used as it is.

    \b
    Example:
      swimid track setup pool.mp4 -o setup.yaml
      swimid track setup pool.mp4 --marker nose@412,230 --marker tail@371,236 -o setup.yaml
    """
    with running("track setup", shared) as run:
        from swimid.tracking.track_setup import Pick, track_setup

        assert shared.output is not None
        run.finish(
            track_setup(
                video,
                output=shared.output,
                picks=tuple(Pick(*marker) for marker in markers),
                frame=frame,
                metres_per_pixel=metres_per_pixel,
                scale_points=scale_points,
                scale_distance_m=scale_distance_m,
                plane=plane,
                fps=fps,
                force=shared.force,
                progress=run.progress,
            )
        )


track.add_command(imu_command)
