"""``compare``: measured trials against their simulation, for every model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from swimid.errors import NoTrustworthyResult
from swimid.files import atomic, provenance
from swimid.fitting import mistakes
from swimid.fitting.model import Trial
from swimid.logs.trials import TrialSet
from swimid.notices import recorded
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks
from swimid.results import evidence as ev
from swimid.results import parameters as parameters_format
from swimid.results.result import FileResult
from swimid.simulation import catalogue, compare_evidence, compare_series, compare_strokes
from swimid.simulation.applied import Applied
from swimid.simulation.comparison_file import FORMAT, ComparisonFile
from swimid.simulation.options import CompareOptions

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Comparison(FileResult[ComparisonFile]):
    """Measured trials against their simulation, as ``compare`` gives it.

    Attributes
    ----------
    scores : DataFrame
        A row for each channel of each trial: ``trial``, ``role``, ``channel``, ``unit``, ``rmse``, ``bias``,
        ``peak_error`` (in ``unit``, measured minus simulated), ``nrmse`` (over the measured range), ``vaf``,
        ``fit_percent`` (%), ``phase_error_rad`` (rad) and others.
    file : ComparisonFile
        What :meth:`save` writes; its ``channels`` hold the scores of all trials together.
    """

    format = FORMAT
    file_type = ComparisonFile

    @property
    def scores(self) -> pd.DataFrame:
        """Errors of each channel of each trial: RMSE in the channel's unit, NRMSE, variance accounted for."""
        import pandas as pd

        return pd.DataFrame(
            [
                {"trial": trial.id, "role": trial.role, "channel": channel, **score.model_dump()}
                for trial in self.file.trials
                for channel, score in trial.channels.items()
            ]
        )


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
    shared parameters held. Errors on trials that were fitted say how well the model describes them, not how
    well it predicts: for that, compare trials that no fit has seen.

    Parameters
    ----------
    trials : path or TrialSet
        Trials: a file, or what :func:`swimid.load` gives.
    output : Path, optional
        Comparison file to write; its evidence goes beside it.
    progress : Progress
        Shows the trials.

    Returns
    -------
    Comparison
        ``.scores`` has a row for each channel of each trial: ``rmse`` and ``bias`` (in ``unit``, that of the
        channel), ``nrmse`` (over the measured range), ``vaf``, ``fit_percent`` (%), ``peak_error``,
        ``phase_error_rad``. ``.verdict`` is by ``nrmse`` and mean speeds.

    Raises
    ------
    UsageError, InputError
        For bad files and options.
    NoTrustworthyResult
        When a simulation breaks down, or nothing can be compared.

    References
    ----------
    .. [1] "Locomotion Optimization of a Tendon-Driven Robotic Fish with Variable Passive Tail Fin".
       Eqs 13 and 14: errors of speed and turning rate.
    .. [2] S. Kadapa, N. Marcouiller, A. Drago, J. L. Tangorra, H. G. Kwatny, "Tuning hydrodynamic
       coefficients using a genetic algorithm for a numerical model of a bio-robotic sea lion".
       Tables I and II: speeds and angles of each stroke.

    Examples
    --------
    >>> import swimid
    >>> drag = swimid.fit_drag("sample_logs/rig/trials.yaml")
    >>> against = compare("sample_logs/rig/trials.yaml", params=drag)
    >>> bool((against.scores["nrmse"] < 0.002).all()), against.verdict
    (True, 'good')
    """
    with recorded(repeat=True) as notices:
        experiment, applied = catalogue.load(trials, options)
        if output is not None:
            atomic.check_writable(output, inputs=experiment.inputs)
        done = []
        with progress("comparing", total=len(experiment.trials)) as step:
            for trial in experiment.trials:
                one = compare_series.compared(
                    experiment, applied, trial, refit=options.refit_start, channels=options.channels
                )
                done.append(one)
                step()
        if not any(d.pairs for d in done):
            raise NoTrustworthyResult("the trials hold no channel that the model simulates")
        buoyancy = options.buoyancy_band_percent / 100.0
        profiles = compare_strokes.profiles(experiment, done, buoyancy=buoyancy)
        file = ComparisonFile(
            verdict="caution",
            model=experiment.model.name,
            robot=experiment.robot.name,
            experiment=experiment.name,
            params=parameters_format.place(options.params).name,
            channels=compare_series.pooled(done, experiment.model),
            trials=[d.record for d in done],
            profiles=[p.record for p in profiles],
            provenance=provenance.collect(
                experiment.inputs, settings=options.settings(buoyancy_band=buoyancy)
            ),
        )
        if file.mean_speeds:
            errors = [measured - simulated for _, measured, simulated in file.mean_speeds]
            file.mean_speed_rmse_m_s = float(np.sqrt(np.mean(np.square(errors))))
        known = applied.file.fit if applied.file is not None else None
        checks = compare_evidence.checks(file, file.channels if known is None else known.channels)
        before = {d.trial.id: d.errors for d in done}
        if options.refit_start and mistakes.is_suspect(checks, before):
            usual = mistakes.catalogue(experiment.model, experiment.trials)
            tried = len(usual) * (len(done) + 1)
            found = _explained(experiment.trials, applied, usual, tried, before)
            checks.append(mistakes.check(found, len(usual)))
    verdict = ev.judged(compare_evidence.answer(file), checks)
    file.verdict = verdict.level
    evidence = ev.Evidence(
        verb="compare",
        title=f"Measured against simulated: {experiment.robot.name}, {experiment.name}",
        verdict=verdict,
        facts=compare_evidence.facts(file),
        checks=checks,
        tables=compare_evidence.tables(file),
        figures=compare_evidence.figures(experiment, done, profiles, file),
        notices=blocks.notices(notices),
        methods=compare_evidence.methods(file, profiles, buoyancy),
        references=list(experiment.robot.sources),
        provenance=file.provenance,
    )
    return Comparison.of(file, evidence).saved(output)


def _explained(
    trials: Sequence[Trial],
    applied: Applied,
    known: Sequence[mistakes.Mistake],
    tried: int,
    before: Mapping[str, mistakes.Errors],
) -> mistakes.Explanation | None:
    """Return a usual mistake that explains the errors, with all shared parameters held."""

    def evaluate(trial: Trial) -> mistakes.Errors:
        values, _, _ = compare_series.start_of(applied, trial, True, mistakes.START_TOLERANCE)
        return mistakes.misfits(trial, applied.model.attempt(values, trial))

    best: mistakes.Explanation | None = None
    for mistake, each in mistakes.screened(trials, known, before, evaluate):
        gained = [k for k, (_, _, gain) in each.items() if gain >= mistakes.DECISIVE]
        after = {k: each[k][1] for k in gained}
        found = mistakes.explained(mistake.says, gained, len(trials), tried, before, after)
        if found is not None and (best is None or found.gain > best.gain):
            best = found
    return best
