"""``fit-propulsion``: the recoil law from a cruise table, or beat-averaged surge from free swimming."""

from __future__ import annotations

from pathlib import Path

from swimid.errors import UsageError
from swimid.files import provenance
from swimid.fitting import fit_common
from swimid.logs.trials import TrialSet
from swimid.notices import recorded, warn
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.propulsion import cruise as propulsion_cruise
from swimid.propulsion import surge as propulsion_surge
from swimid.propulsion import trials as experiment_module
from swimid.propulsion.options import FitPropulsionOptions
from swimid.results import blocks
from swimid.results.fitted import Fitted, rows


@takes(FitPropulsionOptions)
def fit_propulsion(
    trials: str | Path | TrialSet,
    *,
    options: FitPropulsionOptions,
    output: Path | None = None,
    progress: Progress = silent,
) -> Fitted:
    """Identify the propulsion of a fin.

    The Strouhal number with either lever of the wake is in the report: the fin's length (the paper's Eq 28),
    and the distance from axle to trailing edge. The start speed of a held-out trial is estimated from the
    trial itself, all else held.

    Parameters
    ----------
    trials : path or TrialSet
        Trials: a file, or what :func:`swimid.load` gives.
        A cruise experiment (recoil law, boxfish paper Eqs 3-6, 25-27), or straight free-swim
        trials (beat-averaged surge: thrust by a power of amplitude, quadratic drag).
    output : path, optional
        Parameter file to write; its evidence goes beside it.

    Raises
    ------
    InputError, UsageError
        For bad files and options.
    NoTrustworthyResult
        When nothing can be identified.
    """
    with recorded(repeat=True) as notices:
        experiment = experiment_module.load(trials, drag=options.drag)
        choices = fit_common.prepare(experiment, output, fixed=options.fixed, freed=options.freed)
        origin = provenance.collect(experiment.inputs, settings=options.settings())
        if experiment.name == "cruise":
            if options.start_state != "auto":
                warn("SWM004", "--start-state belongs to free-swim trials: runs of a cruise start at rest")
            page = propulsion_cruise.fit(
                experiment, choices, origin, options.wake, options.keep_departures, progress
            )
        else:
            if options.drag is not None:
                raise UsageError("--drag belongs to a cruise experiment; free-swim trials do not use it")
            if options.wake != "fin" or options.keep_departures:
                warn(
                    "SWM004",
                    "--wake and --keep-departures belong to a cruise experiment and have no effect here",
                )
            page = propulsion_surge.fit(
                experiment, choices, origin, progress, from_rest=options.start_state == "rest"
            )
    file, evidence = page
    evidence.notices = blocks.notices(notices)
    summary = "\n".join(
        [
            f"{experiment.name} of {experiment.robot.name}",
            rows(fit_common.brief(file)),
            f"{evidence.verdict.level.upper()}: {blocks.judgement(evidence)}",
        ]
    )
    return fit_common.fitted("fit-propulsion", summary, file, evidence, output)
