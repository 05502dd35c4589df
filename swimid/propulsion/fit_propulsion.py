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
from swimid.results.fitted import Fitted


@takes(FitPropulsionOptions)
def fit_propulsion(
    trials: str | Path | TrialSet,
    *,
    options: FitPropulsionOptions,
    output: Path | None = None,
    progress: Progress = silent,
) -> Fitted:
    """Identify the propulsion of a fin: recoil law of cruising speeds, or thrust and drag of straight runs.

    The Strouhal number with either lever of the wake is in the report: the fin's length (the paper's Eq 28),
    and the distance from axle to trailing edge. The start speed of a held-out trial is estimated from the
    trial itself, all else held. The law is of a rigid fin: frequencies that depart from it (SWM030) are left
    out of the fit unless they are kept on purpose, and the result does not hold for them.

    Parameters
    ----------
    trials : path or TrialSet
        Trials: a file, or what :func:`swimid.load` gives.
        A cruise experiment (recoil law, boxfish paper Eqs 3-6, 25-27), or straight free-swim
        trials (beat-averaged surge: thrust by a power of amplitude, quadratic drag).
    output : path, optional
        Parameter file to write; its evidence goes beside it.
    progress : Progress
        Shows the search.

    Returns
    -------
    Fitted
        Of a cruise ``.parameters`` has ``recoil_efficiency`` (1), ``amplitude_offset_deg`` (deg) and the
        ``inertia_<fin>`` (kg m^2) of fins of unknown inertia; ``.derived`` has ``velocity_ratio`` (1), the
        smallest and the largest propulsive force (N) and the exponents set free (1). Standard errors include
        those of the drag file. ``.tables()`` has speeds, forces and Strouhal numbers of each run.
        Of straight runs ``.parameters`` has ``thrust_acceleration`` (m/s^2), ``surge_drag`` (1/m, drag over
        mass) and the exponents of amplitude and frequency (1).

    Raises
    ------
    InputError, UsageError
        For bad files and options.
    NoTrustworthyResult
        When nothing can be identified.

    References
    ----------
    .. [1] W. L. Chan, G. Lee, B. Kim, J. M. Choi, T. Kang, "Experimental Parameter Identification and
       Performance Analysis of a Fish Robot with Ostraciiform Swimming Mode using Rigid Caudal Fins".
       Eqs 3 to 6 and 25 to 27: the recoil law; Eq 28: the Strouhal number; Tables 3 and 4: amplitude offset
       and efficiency.

    Examples
    --------
    >>> import swimid
    >>> drag = swimid.fit_drag("sample_logs/rig/trials.yaml")
    >>> fin = fit_propulsion("sample_logs/cruise/trials.yaml", drag=drag)
    >>> round(fin["recoil_efficiency"].value, 2), round(fin["amplitude_offset_deg"].value, 1)
    (0.34, 5.4)
    >>> fin.verdict, list(fin.warnings["code"])
    ('caution', ['SWM030'])
    """
    with recorded(repeat=True) as notices:
        experiment = experiment_module.load(trials, drag=options.drag)
        choices = fit_common.prepare(experiment, output, fixed=options.fixed, freed=options.freed)
        origin = provenance.collect(experiment.inputs, settings=options.settings())
        if experiment.name == "cruise":
            if options.start_state != "auto":
                warn("SWM004", "--start-state belongs to free-swim trials: runs of a cruise start at rest")
            file, evidence = propulsion_cruise.fit(
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
            file, evidence = propulsion_surge.fit(
                experiment, choices, origin, progress, from_rest=options.start_state == "rest"
            )
    evidence.notices = blocks.notices(notices)
    return Fitted.of(file, evidence).saved(output)
