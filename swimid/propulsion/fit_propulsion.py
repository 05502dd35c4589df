"""``fit-propulsion``: the recoil law from a cruise table, or beat-averaged surge from free swimming."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from swimid.errors import UsageError
from swimid.files import provenance
from swimid.fitting import fit_common
from swimid.notices import recorded, warn
from swimid.progress import Progress, silent
from swimid.propulsion import cruise as propulsion_cruise
from swimid.propulsion import surge as propulsion_surge
from swimid.propulsion import trials as experiment_module
from swimid.results.fitted import Fitted, rows


def fit_propulsion(
    trials_file: str | Path,
    *,
    drag: Path | None = None,
    output: Path | None = None,
    wake: str = "fin",
    keep_departures: bool = False,
    start_state: str = "auto",
    fixed: dict[str, float] | None = None,
    freed: Sequence[str] = (),
    progress: Progress = silent,
) -> Fitted:
    """Identify the propulsion of a fin.

    Parameters
    ----------
    trials_file : path
        A cruise experiment (recoil law, boxfish paper Eqs 3-6, 25-27), or straight free-swim
        trials (beat-averaged surge: thrust by a power of amplitude, quadratic drag).
    drag : path, optional
        Drag file of the rig; needed for a cruise.
    output : path, optional
        Parameter file to write; its evidence goes beside it.
    wake : {"fin", "axle"}
        Lever of the wake width in the Strouhal number: the fin's length (the paper's Eq 28), or
        the distance from axle to trailing edge. Both are in the report.
    keep_departures : bool
        Fit frequencies that depart from the law too.
    start_state : {"auto", "rest", "estimate"}
        Whether straight swimming starts at rest at the first beat; ``auto`` estimates the speed there, as
        ``estimate`` does. That of a held-out trial is estimated from the trial itself, all else held.
    fixed, freed
        The user's choices by parameter name.

    Raises
    ------
    InputError, UsageError
        For bad files and options.
    NoTrustworthyResult
        When nothing can be identified.
    """
    with recorded(repeat=True) as notices:
        experiment = experiment_module.load(trials_file, drag=drag)
        choices = fit_common.prepare(experiment, output, fixed=fixed, freed=freed)
        settings = {
            "wake": wake,
            "keep_departures": keep_departures,
            "start_state": start_state,
            "fixed": dict(fixed or {}),
            "freed": list(freed),
        }
        origin = provenance.collect(experiment.inputs, settings=settings)
        if experiment.name == "cruise":
            if start_state != "auto":
                warn("SWM004", "--start-state belongs to free-swim trials: runs of a cruise start at rest")
            page = propulsion_cruise.fit(experiment, choices, origin, wake, keep_departures, progress)
        else:
            if drag is not None:
                raise UsageError("--drag belongs to a cruise experiment; free-swim trials do not use it")
            if wake != "fin" or keep_departures:
                warn(
                    "SWM004",
                    "--wake and --keep-departures belong to a cruise experiment and have no effect here",
                )
            page = propulsion_surge.fit(
                experiment, choices, origin, progress, from_rest=start_state == "rest"
            )
    file, evidence = page
    evidence.notices = fit_common.notices(notices)
    summary = "\n".join(
        [
            f"{experiment.name} of {experiment.robot.name}",
            rows(fit_common.brief(file)),
            f"{evidence.verdict.level.upper()}: {fit_common.judgement(evidence)}",
        ]
    )
    return fit_common.fitted("fit-propulsion", summary, file, evidence, output)
