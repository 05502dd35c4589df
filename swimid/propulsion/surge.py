"""Beat-averaged surge from straight free swimming."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from swimid.errors import NoTrustworthyResult
from swimid.fitting import fit_common, output_error
from swimid.fitting.experiment import Experiment
from swimid.fitting.model import Parameter, chosen
from swimid.notices import warn
from swimid.progress import Progress
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.parameters import Estimate, ParameterFile


def fit(
    experiment: Experiment,
    choices: tuple[Parameter, ...],
    origin: dict[str, Any],
    progress: Progress,
    *,
    from_rest: bool = False,
) -> tuple[ParameterFile, ev.Evidence]:
    """Fit thrust and drag of beat-averaged surge.

    Parameters
    ----------
    choices : tuple of Parameter
        The model's with the user's choices applied.
    origin : dict
        The provenance block.
    from_rest : bool
        Trials start at rest at their first beat; else each trial's speed there is estimated, on held-out
        trials from the trial itself with the shared parameters held.

    Raises
    ------
    NoTrustworthyResult
        When neither thrust nor drag can be identified.
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
    derived = _free_amplitude(experiment, choices)
    reference = model.reference_amplitude_rad  # type: ignore[attr-defined]
    thrust, exponent = result.value("thrust_acceleration"), result.value("amplitude_exponent")
    at_one = thrust / reference**exponent
    spread = math.hypot(
        (result.stderr("thrust_acceleration") or 0.0) / thrust,
        (result.stderr("amplitude_exponent") or 0.0) * abs(math.log(reference)),
    )
    status = "estimated" if spread < 0.5 else "unidentifiable"
    derived["thrust_coefficient"] = Estimate(
        value=at_one, stderr=at_one * spread, unit="m/s^2", status=status
    )
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
    checks = [*fit_common.checks(result, file), fit_common.beat_check(beats)]
    rows: list[list[Any]] = []
    for name, b in beats.items():
        found = "none found"
        if b["found_hz"] is not None:
            found = numbers.measured(b["found_hz"], b["stderr_hz"])
        rows.append([name, b["stated_hz"], found])
    columns = ["trial", "stated (Hz)", "found in yaw (Hz)"]
    starts = "with each trial's initial speed estimated, a held-out one's with all else held"
    evidence = ev.Evidence(
        verb="fit-propulsion",
        title=f"Propulsion of {experiment.robot.name}: beat-averaged surge",
        verdict=ev.judged(fit_common.answer(file), checks),
        checks=checks,
        tables=[ev.Table(id="beats", title="Beat frequency", columns=columns, rows=rows, folded=True)],
        figures=fit_common.figures(result),
        methods=[
            "Surge was averaged over whole tail beats, their frequency found in the yaw, and du/dt = a "
            f"(A/A_ref)^n - c u² fitted to {len(result.trials)} straight trials by output-error maximum "
            f"likelihood, {'every trial from rest' if from_rest else starts}.",
        ],
        references=list(experiment.robot.sources),
        provenance=origin,
    )
    return file, evidence


def _free_amplitude(experiment: Experiment, choices: tuple[Parameter, ...]) -> dict[str, Estimate]:
    """The amplitude exponent of thrust set free, where several amplitudes were driven."""
    amplitudes = {round(t.surge.amplitude_rad, 6) for t in experiment.trials if t.role == "fit"}
    if len(amplitudes) < 2:
        return {}
    name = "amplitude_exponent"
    result = output_error.fit(experiment.model, experiment.trials, parameters=chosen(choices, freed=(name,)))
    fit_common.refuse_interrupted(result)
    value, stderr = result.value(name), result.stderr(name)
    if stderr and abs(value - 2.0) > 3 * stderr:
        warn(
            "SWM031",
            f"set free, the amplitude exponent of thrust is {numbers.measured(value, stderr)}, fitted with 2",
        )
    free = Estimate(value=value, stderr=stderr, unit="1", bounds=(0, 6), status=result.status[name])  # type: ignore[arg-type]
    return {f"free_{name}": free}
