"""``fit-propulsion``: the recoil law of a cruise table, or thrust and drag of straight swimming."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import NoTrustworthyResult, UsageError
from swimid.files import provenance
from swimid.fitting import fit_common, output_error
from swimid.fitting.covariance import UNIDENTIFIABLE
from swimid.fitting.experiment import Experiment
from swimid.fitting.model import Parameter
from swimid.logs.trials import TrialSet
from swimid.notices import recorded, warn
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.propulsion import cruise
from swimid.propulsion import trials as propulsion_trials
from swimid.propulsion.options import FitPropulsionOptions
from swimid.results import blocks
from swimid.results import evidence as ev
from swimid.results.fitted import Fitted
from swimid.results.parameters import Estimate, ParameterFile

#: Exponent of the amplitude in the law of thrust.
AMPLITUDE_EXPONENT = 2.0


@takes(FitPropulsionOptions)
def fit_propulsion(
    trials: str | Path | TrialSet,
    *,
    options: FitPropulsionOptions,
    output: Path | None = None,
    progress: Progress = silent,
) -> Fitted:
    """Identify the propulsion of a fin: recoil law of cruise speeds, or thrust and drag of straight runs.

    The recoil law is that of a rigid fin. Frequencies whose runs depart from the law (SWM030) are left out of
    the fit, and the result is not valid at these frequencies. The initial speed of a held-out trial is
    estimated from the trial itself, with all other parameters held.

    Parameters
    ----------
    trials : path or TrialSet
        Trials file, or the result of :func:`swimid.load`. It describes a cruise experiment (recoil law,
        boxfish paper Eqs 3-6, 25-27) or straight free-swim trials. Free-swim trials are fitted with the surge
        averaged over tail beats, a thrust by a power of the amplitude, and quadratic drag.
    output : path, optional
        Parameter file to write, together with its evidence file.
    progress : Progress
        Progress bar of the search.

    Returns
    -------
    Fitted
        For a cruise ``.parameters`` has ``recoil_efficiency`` (1), ``amplitude_offset_deg`` (deg), and
        ``inertia_<fin>`` (kg m^2) for each fin of unknown inertia. ``.derived`` has ``velocity_ratio`` (1),
        the minimum and the maximum propulsive force (N), and the free exponents (1). The standard errors
        include those of the drag file. ``.tables()`` has speeds, forces and Strouhal numbers of each run,
        with both levers of the wake width. For straight runs ``.parameters`` has ``thrust_acceleration``
        (m/s^2), ``surge_drag`` (1/m, drag per mass), and the exponents of amplitude and frequency (1).

    Raises
    ------
    InputError, UsageError
        If a file or an option is wrong.
    NoTrustworthyResult
        If no parameter can be identified.

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
        experiment = propulsion_trials.load(trials, drag=options.drag)
        choices = fit_common.prepare(experiment, output, fixed=options.fixed, freed=options.freed)
        origin = provenance.collect(experiment.inputs, settings=options.settings())
        if experiment.name == "cruise":
            if options.start_state != "auto":
                warn("SWM004", "--start-state belongs to free-swim trials: runs of a cruise start at rest")
            file, evidence = cruise.fit(experiment, choices, origin, options.keep_departures, progress)
        else:
            if options.drag is not None:
                raise UsageError("--drag belongs to a cruise experiment; free-swim trials do not use it")
            if options.keep_departures:
                warn("SWM004", "--keep-departures belongs to a cruise experiment and has no effect here")
            file, evidence = _fit_surge(
                experiment, choices, origin, progress, from_rest=options.start_state == "rest"
            )
    evidence.notices = blocks.notices(notices)
    return Fitted.of(file, evidence).saved(output)


# ---------------------------------------------------------------- beat-averaged surge


def _fit_surge(
    experiment: Experiment,
    choices: tuple[Parameter, ...],
    origin: dict[str, Any],
    progress: Progress,
    *,
    from_rest: bool = False,
) -> tuple[ParameterFile, ev.Evidence]:
    """Fit thrust and drag to the surge averaged over tail beats.

    Parameters
    ----------
    choices : tuple of Parameter
        Parameters of the model with the choices of the user.
    origin : dict
        Provenance of the inputs.
    from_rest : bool
        Whether trials are at rest at their first beat. Otherwise the initial speed of each trial is
        estimated.

    Raises
    ------
    NoTrustworthyResult
        If neither thrust nor drag can be identified.
    """
    model = experiment.model
    if from_rest:
        choices = tuple(replace(p, free=False) if p.name == "initial_speed" else p for p in choices)
    result = output_error.fit(model, experiment.trials, parameters=choices, progress=progress)
    fit_common.refuse_interrupted(result)
    result = output_error.with_held_out(result)
    shared = [label for label in result.labels if "[" not in label]
    if all(result.status[label] != "estimated" for label in shared):
        raise NoTrustworthyResult("neither thrust nor drag can be identified from these trials")
    amplitudes = {round(t.surge.amplitude_rad, 6) for t in experiment.trials if t.role == "fit"}
    laws = {}
    if len(amplitudes) > 1:
        laws["amplitude_exponent"] = AMPLITUDE_EXPONENT
    derived, exponent_checks = cruise.free_exponents(model, experiment.trials, choices, laws, "thrust")
    reference = model.reference_amplitude_rad  # type: ignore[attr-defined]
    thrust, exponent = result.value("thrust_acceleration"), result.value("amplitude_exponent")
    at_one = thrust / reference**exponent
    spread = math.hypot(
        (result.stderr("thrust_acceleration") or 0.0) / thrust,
        (result.stderr("amplitude_exponent") or 0.0) * abs(math.log(reference)),
    )
    derived["thrust_coefficient"] = Estimate(
        value=at_one, stderr=at_one * spread, unit="m/s^2", status="estimated"
    )
    if spread >= UNIDENTIFIABLE:
        derived["thrust_coefficient"].status = "unidentifiable"
    beats = experiment.facts["beats"]
    measured = [b for b in beats.values() if b["found_hz"] is not None]
    if measured:
        values = [float(b["found_hz"]) for b in measured]
        scatter = float(np.std(values) / math.sqrt(len(values)))
        derived["beat_frequency"] = Estimate(
            value=float(np.median(values)),
            stderr=max(scatter, min(float(b["stderr_hz"]) for b in measured)),
            unit="Hz",
            status="estimated",
        )
    file = fit_common.parameter_file(
        result,
        robot=experiment.robot.name,
        provenance=origin,
        derived=derived,
        settings={
            "reference_amplitude_rad": reference,
            "reference_frequency_hz": model.reference_frequency_hz,  # type: ignore[attr-defined]
            "beats": beats,
            "waveform": experiment.facts["waveform"],
            "asymmetry": experiment.facts["asymmetry"],
        },
    )
    checks = [*fit_common.checks(result, file), fit_common.beat_check(beats), *exponent_checks]
    starts = "with the initial speed of each trial estimated"
    if from_rest:
        starts = "with every trial from rest"
    evidence = ev.Evidence(
        command="fit-propulsion",
        title=f"Propulsion of {experiment.robot.name}: beat-averaged surge",
        verdict=ev.judged(fit_common.answer(file), checks),
        checks=checks,
        figures=fit_common.figures(result),
        methods=[
            "Surge was averaged over whole tail beats, their frequency found in the yaw, and du/dt = a "
            f"(A/A_ref)^n - c u² fitted to {len(result.trials)} straight trials by output-error maximum "
            f"likelihood, {starts}.",
        ],
        references=list(experiment.robot.sources),
        provenance=origin,
    )
    return file, evidence
