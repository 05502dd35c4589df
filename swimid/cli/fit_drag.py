"""``swimid fit-drag``."""

from __future__ import annotations

from pathlib import Path

import click

from swimid.cli.common import Shared, protect, running, shared_options
from swimid.cli.parsing import bounded, named_number, number_pair


@click.command("fit-drag")
@click.argument("trials", type=click.Path(path_type=Path))
@click.option(
    "--method",
    type=click.Choice(["ml", "two-point"]),
    default="ml",
    show_default=True,
    help="ml: maximum likelihood over all samples. two-point: the boxfish paper's Eqs 13-19.",
)
@click.option("--fix", "fixed", multiple=True, metavar="NAME=VALUE", help="Hold a parameter at a value.")
@click.option(
    "--free", "freed", multiple=True, metavar="NAME", help="Estimate a parameter that is fixed by default."
)
@click.option("--bounds", multiple=True, metavar="NAME=LOW,HIGH", help="Change a parameter's bounds.")
@click.option(
    "--start-state",
    type=click.Choice(["auto", "rest", "estimate"]),
    default="auto",
    show_default=True,
    help="Do trials start at rest at their first sample? auto: unless the data clearly say otherwise.",
)
@click.option(
    "--points", metavar="X1,X2", help="Displacements of the two-point method, m. The paper: 0.293,0.584."
)
@click.option("--profile", is_flag=True, help="Add profile-likelihood intervals.")
@click.option(
    "--coordinate", metavar="COLUMN", help="Coordinate of a free decay, when the logs hold several."
)
@shared_options("Parameter file to write (YAML).")
def command(
    trials: Path,
    method: str,
    fixed: tuple[str, ...],
    freed: tuple[str, ...],
    bounds: tuple[str, ...],
    start_state: str,
    points: str | None,
    profile: bool,
    coordinate: str | None,
    shared: Shared,
) -> None:
    """Identify drag, added mass and friction from a rig.

    TRIALS is a trials file of a falling-weight, towed or free-decay experiment.

    \b
    Examples:
      swimid fit-drag trials.yaml -o drag.yaml
      swimid fit-drag trials.yaml --method two-point --points 0.293,0.584 -o drag.yaml
      swimid fit-drag towed.yaml --free linear_drag --free dry_friction -o rig.yaml
    """
    with running("fit-drag", shared) as run:
        protect(shared.output, shared, inputs=(trials,))
        from swimid.rig.fit_drag import fit_drag

        run.finish(
            fit_drag(
                trials,
                output=shared.output,
                method=method,
                start_state=start_state,
                fixed=named_number(fixed, "--fix"),
                freed=freed,
                bounds=bounded(bounds, "--bounds"),
                points_m=number_pair(points, "--points"),
                profile=profile,
                coordinate=coordinate,
                progress=run.progress,
            )
        )
