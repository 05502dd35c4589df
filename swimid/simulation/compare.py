"""``compare``: measured trials against their simulation, for every model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import NoTrustworthyResult, UsageError, suggestion
from swimid.files import atomic, provenance
from swimid.fitting.experiment import Experiment
from swimid.logs.trials import TrialSet
from swimid.notices import recorded
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks, numbers
from swimid.results import evidence as ev
from swimid.results import parameters as parameters_format
from swimid.simulation import (
    catalogue,
    compare_evidence,
    compare_series,
    compare_strokes,
    compare_strokes_evidence,
)
from swimid.simulation.compare_series import Compared
from swimid.simulation.compared import Comparison
from swimid.simulation.comparison_file import ChannelScore, ComparisonFile, TrialComparison
from swimid.simulation.options import CompareOptions

#: Error over the measured range, up to which a channel is described well, and up to which at all.
GOOD, USABLE = 0.15, 0.30
#: The same for the mean speeds of the trials, over those measured.
GOOD_SPEED, USABLE_SPEED = 0.10, 0.25


@takes(CompareOptions)
def compare(
    trials: str | Path | TrialSet,
    *,
    options: CompareOptions,
    output: Path | None = None,
    progress: Progress = silent,
) -> Comparison:
    """Compare recorded trials with their simulation.

    By default every logged channel is compared that the model simulates, and surge, sway and turning rate
    from the pose where they are not logged. A start state that is estimated is estimated from its trial, all
    shared parameters held.

    Parameters
    ----------
    trials : path or TrialSet
        Trials: a file, or what :func:`swimid.load` gives.
    output : Path, optional
        Comparison file to write; its evidence goes beside it.

    Raises
    ------
    UsageError, InputError
        For bad files and options.
    NoTrustworthyResult
        When a simulation breaks down, or nothing can be compared.
    """
    with recorded(repeat=True) as notices:
        loaded = catalogue.load(
            trials,
            options.params,
            robot=options.robot,
            chosen=dict(options.chosen),
            readings=dict(options.readings),
            max_step=options.dt,
        )
        experiment = loaded.experiment
        if output is not None:
            atomic.check_writable(output, inputs=experiment.inputs)
        done = []
        with progress("comparing", total=len(experiment.trials)) as step:
            for trial in experiment.trials:
                one = compare_series.compared(experiment, loaded.applied, trial, refit=options.refit_start)
                done.append(_restricted(one, options.channels))
                step()
        if not any(d.pairs for d in done):
            raise NoTrustworthyResult("the trials hold no channel that the model simulates")
        buoyancy = options.buoyancy_band_percent / 100.0
        origin = provenance.collect(experiment.inputs, settings=options.settings(buoyancy_band=buoyancy))
        profiles = compare_strokes.profiles(experiment, done, buoyancy=buoyancy)
        file = _file(experiment, done, options.params, origin)
        file.profiles = [p.record for p in profiles]
        checks = _checks(file)
    verdict = blocks.verdict(checks, _answer(file))
    file.verdict = verdict.level
    evidence = ev.Evidence(
        verb="compare",
        title=f"Measured against simulated: {experiment.robot.name}, {experiment.name}",
        verdict=verdict,
        checks=checks,
        tables=[*compare_strokes_evidence.tables(file.profiles), *compare_evidence.tables(file)],
        figures=[
            *compare_strokes_evidence.figures(profiles, buoyancy),
            *compare_evidence.figures(experiment, done, file),
        ],
        notices=blocks.notices(notices),
        methods=[
            *_methods(experiment, done, options.params),
            *compare_strokes_evidence.methods(profiles, buoyancy),
        ],
        references=list(experiment.robot.sources),
        provenance=origin,
    )
    text = compare_evidence.summary(file, evidence)
    made = Comparison("compare", text, file.model_dump(mode="json"), evidence=evidence, document=file)
    return made.saved(output)


def _restricted(done: Compared, channels: Sequence[str]) -> Compared:
    if not channels:
        return done
    for name in channels:
        if name not in done.pairs:
            hint = suggestion(name, list(done.pairs))
            raise UsageError(f"the trial '{done.trial.id}' has no channel '{name}' to compare", hint=hint)
    pairs = {name: p for name, p in done.pairs.items() if name in channels}
    return replace(done, pairs=pairs)


def _file(
    experiment: Experiment, done: Sequence[Compared], params: Path, origin: dict[str, Any]
) -> ComparisonFile:
    names = list(dict.fromkeys(name for d in done for name in d.pairs))
    order = [c.name for c in experiment.model.channels]
    pooled: dict[str, ChannelScore] = {}
    for name in sorted(names, key=order.index):
        pooled[name] = compare_series.scored([d.pairs[name] for d in done if name in d.pairs])
    trials = [compare_series.record(d, experiment.model) for d in done]
    return ComparisonFile(
        verdict="caution",
        model=experiment.model.name,
        robot=experiment.robot.name,
        experiment=experiment.name,
        params=parameters_format.place(params).name,
        channels=pooled,
        trials=trials,
        mean_speed_rmse_m_s=_speed_rmse(trials),
        provenance=origin,
    )


def _speed_rmse(trials: Sequence[TrialComparison]) -> float | None:
    errors = [
        t.mean_speed.measured - t.mean_speed.simulated
        for t in trials
        if t.mean_speed is not None
        and t.mean_speed.measured is not None
        and t.mean_speed.simulated is not None
    ]
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else None


def _speed_share(file: ComparisonFile) -> float | None:
    """Error of the mean speeds over their size."""
    measured = [
        t.mean_speed.measured for t in file.trials if t.mean_speed and t.mean_speed.measured is not None
    ]
    size = float(np.sqrt(np.mean(np.square(measured)))) if measured else 0.0
    return file.mean_speed_rmse_m_s / size if file.mean_speed_rmse_m_s is not None and size > 0 else None


def _checks(file: ComparisonFile) -> list[ev.Check]:
    found = []
    for name, score in file.channels.items():
        value = score.nrmse if score.nrmse is not None else math.inf
        found.append(
            ev.Check(
                name=f"error of {name}",
                value=numbers.percent(score.nrmse),
                limit=f"≤ {100 * GOOD:g} % of the measured range (fail above {100 * USABLE:g} %)",
                verdict="pass" if value <= GOOD else "warn" if value <= USABLE else "fail",
                text="root-mean-square error over all trials, over the measured range",
            )
        )
    share = _speed_share(file)
    if share is not None:
        found.append(
            ev.Check(
                name="error of mean speeds",
                value=numbers.percent(share),
                limit=f"≤ {100 * GOOD_SPEED:g} % of the measured (fail above {100 * USABLE_SPEED:g} %)",
                verdict="pass" if share <= GOOD_SPEED else "warn" if share <= USABLE_SPEED else "fail",
                text="root-mean-square difference over the trials, over the root mean square measured",
            )
        )
    fitted = [t.id for t in file.trials if t.start == "estimated"]
    if fitted:
        found.append(
            ev.Check(
                name="start states",
                value=f"estimated for {len(fitted)} of {len(file.trials)} trials",
                verdict="info",
                text="from the trials themselves, all shared parameters held: offsets of pose and start "
                "speed do not count as errors (--no-refit-start)",
            )
        )
    return found


def _answer(file: ComparisonFile) -> str:
    parts = []
    rates = [n for n in file.channels if n == "u_m_s" or n.endswith(("yaw_rate_rad_s", "pitch_rate_rad_s"))]
    for name in rates or list(file.channels)[:3]:
        s = file.channels[name]
        parts.append(
            f"{name}: RMSE {numbers.number(s.rmse, 3, s.unit)} ({numbers.percent(s.nrmse)} of its range), "
            f"VAF {numbers.percent(s.vaf)}"
        )
    if file.mean_speed_rmse_m_s is not None:
        parts.append(f"mean speeds: RMSE {numbers.number(file.mean_speed_rmse_m_s, 3, 'm/s')}")
    return "; ".join(parts) + "."


def _methods(experiment: Experiment, done: Sequence[Compared], params: Path) -> list[str]:
    source = parameters_format.place(params).name
    said = [
        f"{len(done)} {experiment.name} trials were compared with simulations under the parameters of "
        f"{source}. NRMSE is the root-mean-square error over the measured range (tendon fish, Eq 13), "
        "the peak error the difference of the largest magnitudes (Eq 14), VAF the variance accounted for."
    ]
    if any(p.source == "pose" for d in done for p in d.pairs.values()):
        said.append(
            "Surge, sway and turning rate were derived from the measured pose and, in the same way, from "
            "the simulated one, by a cubic fitted over "
            f"{2 * compare_series.WINDOW_BEATS:g} beats around each sample."
        )
    if any(d.start == "estimated" for d in done):
        said.append(
            "Where the parameter file held no start state of a trial it was estimated from the whole trial "
            "with all shared parameters held."
        )
    return said
