"""``swimid fit-graybox``."""

from __future__ import annotations

from pathlib import Path

import click

from swimid.cli.common import Shared, protect, running, shared_options
from swimid.cli.parsing import bounded, named_number, named_word
from swimid.errors import UsageError


@click.command("fit-graybox")
@click.argument("trials", type=click.Path(path_type=Path))
@click.option("--fix", "fixed", multiple=True, metavar="NAME=VALUE", help="Hold a parameter at a value.")
@click.option(
    "--free", "freed", multiple=True, metavar="NAME", help="Estimate a parameter that is fixed by default."
)
@click.option("--bounds", multiple=True, metavar="NAME=LOW,HIGH", help="Change a parameter's bounds.")
@click.option(
    "--share",
    multiple=True,
    metavar="PREFIX",
    help="One value for all coefficients of this name and a number (c_f: c_f0, c_f13, c_f4).",
)
@click.option(
    "--channels",
    metavar="A,B",
    default="",
    help="Columns to fit. Default: the pose where it is logged, else velocities; passive joints.",
)
@click.option(
    "--start-state",
    type=click.Choice(["auto", "rest", "estimate"]),
    default="auto",
    show_default=True,
    help="Do trials start at rest at their first sample? auto: unless a log's first stretch moves.",
)
@click.option(
    "--start-from", "begin", type=click.Path(path_type=Path), help="Parameter file to start the search from."
)
@click.option(
    "--loss",
    type=click.Choice(["linear", "huber"]),
    default="linear",
    show_default=True,
    help="huber: outliers pull less.",
)
@click.option(
    "--starts",
    type=click.IntRange(1),
    default=1,
    show_default=True,
    help="Start from so many points in the bounds.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Of the random starts.")
@click.option(
    "--method",
    type=click.Choice(["least-squares", "nsga2", "hybrid"]),
    default="least-squares",
    show_default=True,
    help="nsga2: a Pareto front of time-warped distances, and a point chosen on it. hybrid: least squares "
    "that starts there.",
)
@click.option(
    "--population",
    type=click.IntRange(4),
    default=80,
    show_default=True,
    help="nsga2, hybrid: points at a time.",
)
@click.option(
    "--generations",
    type=click.IntRange(1),
    default=50,
    show_default=True,
    help="nsga2, hybrid: so many times.",
)
@click.option(
    "--crossover",
    type=click.FloatRange(0, 1),
    default=0.8,
    show_default=True,
    help="nsga2, hybrid: probability of crossover.",
)
@click.option(
    "--fronts",
    type=click.Choice(["profile", "overall"]),
    default="profile",
    show_default=True,
    help="nsga2, hybrid: a front for each motion profile, or one over all trials.",
)
@click.option(
    "--pick",
    default="least-worst",
    show_default=True,
    metavar="RULE|INDEX",
    help="nsga2, hybrid: choose a point by least-worst or knee, or by its index.",
)
@click.option(
    "--front",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="nsga2, hybrid: choose from this front of an earlier run; no search.",
)
@click.option(
    "--scale",
    "scales",
    multiple=True,
    metavar="CHANNEL=SIZE",
    help="nsga2, hybrid: an error of this size counts as one. Default: 0.05 m, 0.05 m/s, 5 deg, 10 deg/s.",
)
@click.option(
    "--band",
    type=click.FloatRange(0, 1),
    default=0.05,
    show_default=True,
    help="nsga2, hybrid: stretch time by at most this share of a record.",
)
@click.option(
    "--resume/--no-resume",
    default=None,
    help="nsga2, hybrid: insist on going on with an unfinished search, or begin anew. Default: go on where "
    "there is one.",
)
@click.option("--subset", is_flag=True, help="Hold what the trials cannot tell, until all the rest is known.")
@click.option(
    "--reading",
    "readings",
    multiple=True,
    metavar="NAME=OPTION",
    help="Read an ambiguity of the source otherwise.",
)
@click.option(
    "--dt",
    "max_step",
    type=click.FloatRange(0, min_open=True),
    default=0.005,
    show_default=True,
    help="Integration step, s.",
)
@click.option("--jobs", type=click.IntRange(1), help="Threads; default one per processor.")
@shared_options("Parameter file to write (YAML).")
def command(
    trials: Path,
    fixed: tuple[str, ...],
    freed: tuple[str, ...],
    bounds: tuple[str, ...],
    share: tuple[str, ...],
    channels: str,
    start_state: str,
    begin: Path | None,
    loss: str,
    starts: int,
    seed: int,
    method: str,
    population: int,
    generations: int,
    crossover: float,
    fronts: str,
    pick: str,
    front: Path | None,
    scales: tuple[str, ...],
    band: float,
    resume: bool | None,
    subset: bool,
    readings: tuple[str, ...],
    max_step: float,
    jobs: int | None,
    shared: Shared,
) -> None:
    """Identify the coefficients of a multi-link swimmer.

    TRIALS is a trials file of a free-swim or multibody experiment, with a robot that has links: tfish,
    dolphin, sealion, or a robot file of your own. Ctrl-C keeps the best point so far, and the generations
    of a front.

    \b
    Examples:
      swimid fit-graybox trials.yaml -o tfish.yaml
      swimid fit-graybox trials.yaml --share c_f --starts 8 -o tfish.yaml
      swimid fit-graybox trials.yaml --channels u_m_s,yaw_rate_rad_s --free d_p -o tfish.yaml
      swimid fit-graybox strokes.yaml --method hybrid -o sealion.yaml
      swimid fit-graybox strokes.yaml --method nsga2 --front sealion.front.csv --pick 17 -o mine.yaml
    """
    with running("fit-graybox", shared) as run:
        if method == "least-squares" and (front is not None or resume is not None):
            raise UsageError("--front and --resume belong to --method nsga2 or hybrid")
        protect(shared.output, shared, inputs=(trials,))
        from swimid.swimmer.fit_graybox import fit_graybox
        from swimid.swimmer.front import Genetic

        run.finish(
            fit_graybox(
                trials,
                output=shared.output,
                fixed=named_number(fixed, "--fix"),
                freed=freed,
                bounds=bounded(bounds, "--bounds"),
                share=share,
                channels=[c.strip() for c in channels.split(",") if c.strip()],
                start_state=start_state,
                begin=begin,
                loss=loss,  # type: ignore[arg-type]
                starts=starts,
                seed=seed,
                subset=subset,
                readings=named_word(readings, "--reading"),
                max_step=max_step,
                method=method,  # type: ignore[arg-type]
                options=Genetic(
                    population=population,
                    generations=generations,
                    crossover=crossover,
                    per_profile=fronts == "profile",
                    pick=pick,
                    front=front,
                    resume=resume,
                    scales=named_number(scales, "--scale"),
                    band=band,
                ),
                jobs=jobs,
                progress=run.progress,
            )
        )
