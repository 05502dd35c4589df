"""``swimid simulate``."""

from __future__ import annotations

from pathlib import Path

import click

from swimid.cli.common import Shared, protect, reading_option, running, shared_options, step_option
from swimid.cli.parsing import named_number, named_word

_POSITIVE = click.FloatRange(0, min_open=True)


@click.command("simulate", short_help="Simulate any robot from any parameter file.")
@click.option("--params", type=click.Path(path_type=Path), help="Parameter file, of any model.")
@click.option(
    "--robot",
    metavar="NAME|FILE",
    help="Robot; without --params its file's own values are used.",
)
@click.option("--frequency-hz", type=_POSITIVE, help="Beat frequency.")
@click.option("--amplitude-deg", type=click.FloatRange(0), help="Beat amplitude (T-Fish: of the whole tail).")
@click.option("--waveform", type=click.Choice(["sine", "hopf", "a-cpg"]), default="sine", show_default=True)
@click.option("--bias-deg", type=float, default=0.0, show_default=True, help="Turning bias.")
@click.option(
    "--asymmetry",
    type=click.FloatRange(-1, 1, min_open=True, max_open=True),
    default=0.0,
    show_default=True,
    help="Of an a-cpg beat (T-Fish, Eq 10).",
)
@click.option(
    "--ramp-s", type=click.FloatRange(0), default=1.0, show_default=True, help="Time the beat is eased in."
)
@click.option("--duration-s", type=_POSITIVE, help="Length of the run  [default: 15]")
@click.option("--sample-rate-hz", type=_POSITIVE, help="Samples a second of the log  [default: 50]")
@step_option
@click.option(
    "--set", "chosen", multiple=True, metavar="NAME=VALUE", help="Use this value of a parameter. Repeatable."
)
@reading_option
@click.option(
    "--input",
    type=click.Path(path_type=Path),
    help="Log that drives the run in place of a beat: joint angles or commands, a force, an arma input.",
)
@click.option("--stroke", metavar="NAME", help="Stroke of the robot file in place of a beat.")
@click.option("--cycles", type=_POSITIVE, help="Cycles of the stroke; then its joints rest.")
@click.option(
    "--scale", type=click.FloatRange(0), default=1.0, help="What the stroke's angles are multiplied with."
)
@click.option("--pulling-mass-kg", type=_POSITIVE, help="Weight of a falling-weight rig.")
@click.option("--fin", help="Fin of a cruise.")
@click.option("--distance-m", type=_POSITIVE, help="Course of a cruise from rest, for its mean speed.")
@click.option(
    "--trials",
    type=click.Path(path_type=Path),
    help="Simulate these recorded trials' own drives and start states; -o is then a folder.",
)
@click.option("--trial", metavar="ID", help="Only this one of --trials; -o is then a log.")
@click.option("--animate", type=click.Path(path_type=Path), help="Film of the links: .mp4 or .gif.")
@click.option(
    "--view",
    type=click.Choice(["auto", "fixed", "follow"]),
    default="auto",
    show_default=True,
    help="The film's frame: the whole path, or moving with the robot.",
)
@shared_options("Log to write (.csv or .parquet).")
def command(
    params: Path | None,
    trials: Path | None,
    input: Path | None,
    animate: Path | None,
    chosen: tuple[str, ...],
    readings: tuple[str, ...],
    shared: Shared,
    **options: object,
) -> None:
    """Simulate any robot from any parameter file.

    A robot with links swims as its beat says; a falling weight, a cruise and a discrete-time model
    have options of their own. Printed with the uncertainty the parameter file gives.

    \b
    Examples:
      swimid simulate --params tfish.yaml --frequency-hz 1 --amplitude-deg 20 --duration-s 15 -o sim.csv
      swimid simulate --robot dolphin --frequency-hz 2.5 --amplitude-deg 27 --animate swim.mp4
      swimid simulate --robot sealion --stroke characteristic --cycles 3 -o stroke.csv
      swimid simulate --params tfish.yaml --trials trials.yaml -o simulated
      swimid simulate --params drag.yaml --pulling-mass-kg 0.02 --duration-s 8 -o drop.csv
      swimid simulate --params arma.yaml --input run.csv -o free_run.csv
    """
    with running("simulate", shared) as run:
        inputs = tuple(p for p in (params, trials, input) if p is not None)
        from swimid.simulation.simulate import simulate

        run.finish(
            simulate(
                params=params,
                trials=trials,
                input=input,
                animate=animate,
                chosen=named_number(chosen, "--set"),
                readings=named_word(readings, "--reading"),
                output=shared.output,
                allow=lambda path: protect(path, shared, inputs=inputs),
                progress=run.progress,
                **options,  # type: ignore[arg-type]
            )
        )
