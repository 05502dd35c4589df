"""``swimid import``."""

from __future__ import annotations

from pathlib import Path

import click

from swimid.cli.common import Shared, protect, running, shared_options


@click.command("import", short_help="Logs of other programs, through a mapping, to the log format.")
@click.argument("files", nargs=-1, required=True, metavar="FILE...", type=click.Path(path_type=Path))
@click.option("--map", "map_path", type=click.Path(path_type=Path), help="Mapping file (swimid-mapping/1).")
@click.option("--guess", is_flag=True, help="Write a mapping drafted from names and values instead.")
@click.option(
    "--clean/--raw",
    "clean",
    default=None,
    help="Take repeats and jumps out of the track, or keep all  [default: clean a track of two coordinates].",
)
@click.option("--start", "start_s", type=float, help="Keep the log from here, s on its own clock.")
@click.option("--end", "end_s", type=float, help="Keep the log up to here, s.")
@click.option("--scale", type=float, metavar="M_PER_PX", help="Metres a pixel, for a track in pixels.")
@click.option(
    "--along",
    metavar="LINE",
    help="Put the way along a line in the place of the track, as x_m: line (the one it keeps closest to), "
    "x, -y, z, or components as in 0.6,-0.8.",
)
@click.option(
    "--stroke",
    "stroke_hz",
    type=float,
    nargs=2,
    metavar="LOW HIGH",
    help="Frequencies between which the stroke is known to lie, Hz.",
)
@shared_options("The log, CSV or Parquet by its ending; a folder for several; with --guess the mapping.")
def command(
    files: tuple[Path, ...],
    map_path: Path | None,
    guess: bool,
    clean: bool | None,
    start_s: float | None,
    end_s: float | None,
    scale: float | None,
    along: str | None,
    stroke_hz: tuple[float, float] | None,
    shared: Shared,
) -> None:
    """Import logs: delimited text, MATLAB, HDF5, Parquet, JSON lines, MCAP, ULog.

    A mapping says which source column becomes which column of the log, and in which unit it was
    written. Without one the columns must have the names of the log format already. Beside each log
    goes its evidence (<stem>.evidence.json).

    \b
    Examples:
      swimid import field.csv --guess -o map.yaml
      swimid import field.csv --map map.yaml -o run.csv
      swimid import run.csv --scale 0.0008 --along -y --start 1.2 --end 2.4 -o drop.csv
      swimid import STATES1.txt STATES2.txt --map docs/examples/msu-states.yaml -o logs/
    """
    with running("import", shared) as run:
        from swimid.errors import UsageError
        from swimid.results import evidence

        if guess:
            from swimid.logs.guess_mapping import guess_mapping

            if len(files) > 1 or map_path is not None:
                raise UsageError("--guess drafts the mapping of one file")
            protect(shared.output, shared, inputs=files)
            run.finish(guess_mapping(files[0], output=shared.output))
            return
        from swimid.logs.examine import Request
        from swimid.logs.import_log import destinations, import_logs

        if shared.output is None:
            raise UsageError("say where the log goes", hint="add -o run.csv")
        inputs = files if map_path is None else (*files, map_path)
        for target in destinations(files, shared.output):
            protect(target, shared, inputs=inputs)
            protect(evidence.sidecar(target), shared, inputs=inputs)
        run.finish(
            import_logs(
                files,
                map_path=map_path,
                output=shared.output,
                clean=clean,
                request=Request(start_s, end_s, along, scale, stroke_hz),
                progress=run.progress,
            )
        )
