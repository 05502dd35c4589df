"""``swimid diagnose``."""

from __future__ import annotations

from pathlib import Path

import click

from swimid.cli.common import Shared, protect, reading_option, running, shared_options, step_option
from swimid.cli.parsing import named_word


@click.command("diagnose", short_help="The unmodelled effect behind a gap between trials and simulation.")
@click.argument("trials", type=click.Path(path_type=Path))
@click.option(
    "--params",
    type=click.Path(path_type=Path),
    help="Parameter file, of any model. Default: the values of the robot file.",
)
@click.option(
    "--effects",
    "names",
    multiple=True,
    metavar="A,B",
    help="Try these effects of the catalogue only. Repeatable. Default: all that apply to the model.",
)
@click.option(
    "--effect",
    "own",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Try the effects of this Python file as well. Repeatable.",
)
@click.option(
    "--max-causes",
    type=click.IntRange(1, 5),
    default=3,
    show_default=True,
    help="Combine at most so many effects.",
)
@click.option(
    "--jobs",
    type=click.IntRange(1),
    help="Effects refitted at the same time. Default: one for each processor core.",
)
@click.option(
    "--budget-s",
    type=click.FloatRange(0, min_open=True),
    metavar="S",
    help="Stop trying further effects after this wall time, s. Default: no limit.",
)
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Of the random draws behind thresholds and intervals.",
)
@click.option("--robot", metavar="NAME|FILE", help="Accept the parameters for this robot.")
@reading_option
@step_option
@shared_options("Gap file to write (YAML).")
def command(
    trials: Path,
    params: Path | None,
    names: tuple[str, ...],
    own: tuple[Path, ...],
    max_causes: int,
    jobs: int | None,
    budget_s: float | None,
    seed: int,
    robot: str | None,
    readings: tuple[str, ...],
    dt: float,
    shared: Shared,
) -> None:
    """Name the effect that a model lacks.

    TRIALS is a trials file of any experiment; the parameter file says which model is to describe it, and
    without one the robot file does. The model is refitted alone and with every effect that applies to it;
    an effect counts by what it gains on trials left out of the fit, against what noise alone would gain.
    The answer is one effect, a combination, several that the trials cannot tell apart, or none. Every
    answer is a result: exit status 0.

    \b
    Examples:
      swimid diagnose trials.yaml -o gap.yaml
      swimid diagnose trials.yaml --params tfish.yaml -o gap.yaml
      swimid diagnose trials.yaml --params tfish.yaml --effects servo-lag,servo-delay,time-offset
      swimid diagnose trials.yaml --params drag.yaml --effect my_effect.py -o gap.yaml
      swimid report gap.yaml -o gap.html
    """
    with running("diagnose", shared) as run:
        protect(shared.output, shared, inputs=(trials, *([params] if params else []), *own))
        from swimid.diagnosis.diagnose import diagnose

        run.finish(
            diagnose(
                trials,
                parameters=params,
                output=shared.output,
                effects=tuple(n.strip() for text in names for n in text.split(",") if n.strip()),
                own=own,
                jobs=jobs,
                budget_s=budget_s,
                seed=seed,
                most_causes=max_causes,
                robot=robot,
                readings=named_word(readings, "--reading"),
                max_step=dt,
                progress=run.progress,
            )
        )
