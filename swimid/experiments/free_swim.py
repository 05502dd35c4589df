"""Experiment ``free-swim``: a robot swims freely in a plane, driven by a tail beat or by logged joint angles.

A model with links describes every motion. The surge model describes only straight swimming, averaged over
tail beats. ``fit-propulsion`` fits the surge model, which is also the model of a robot without links.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from swimid.errors import InputError
from swimid.files.yamlio import ASK
from swimid.fitting.fit_common import Experiment, read_trial_log
from swimid.fitting.model import SurgeInput, Trial
from swimid.kinematics.frequency import compare_frequencies
from swimid.logs.experiments import (
    EVERYWHERE,
    Drive,
    FreeSwimTrial,
    Params,
    StrokeDrive,
    Trials,
    check_used,
)
from swimid.logs.log import FREQUENCY_RTOL, Log, unwrap
from swimid.notices import warn
from swimid.propulsion.model import SurgeModel
from swimid.propulsion.trials import beat_averages
from swimid.swimmer import trials as swimmer

#: Minimum number of complete tail beats in a trial that the surge model describes.
MIN_WHOLE_BEATS = 4
#: Keys of a trials file that the surge model uses. The keys of stroke drives are included, although strokes
#: are not supported, so that they get a specific error message.
SURGE_KEYS = (
    EVERYWHERE
    | {"trials.drive"}
    | {f"trials.drive.{key}" for kind in (Drive, StrokeDrive) for key in kind.model_fields}
)


class FreeSwim(Trials):
    """Trials file of a free-swimming experiment.

    Example::

        format: swimid-trials/1
        experiment: free-swim
        robot: tfish
        trials:
          - {log: slow.csv, drive: {frequency_hz: 1.0, amplitude_deg: 20}}
          - {log: fast.csv, drive: {frequency_hz: 1.8, amplitude_deg: 20}, role: validate}
    """

    about = "it swims in a plane; add drive: {frequency_hz: 1, amplitude_deg: 20}, or log the joint angles"
    models = ("multilink", "multibody", SurgeModel.name)
    commands = ("fit-graybox", "fit-propulsion")
    needs = (("x_m", "*_m", "*_rad", "*_s", "*_N"),)
    usual = (("x_m",), ("y_m",), ("yaw_rad",))
    asked = {"drive": {"frequency_hz": ASK, "amplitude_deg": ASK}}
    robot_form = "links"

    experiment: Literal["free-swim"]
    trials: Annotated[list[FreeSwimTrial], Field(min_length=1)]

    def load(
        self, path: Path, *, command: str = "", params: Params | None = None, **options: Any
    ) -> Experiment:
        """Read the trials for a model with links, or for the surge model (see :meth:`Trials.load`).

        Parameters
        ----------
        **options
            Options of :func:`swimid.swimmer.trials.load`.
        """
        robot = self.read_robot(path.parent)
        has_links = command == "fit-graybox" or robot.multilink is not None or robot.multibody is not None
        if params is not None:
            has_links = params[1].model != SurgeModel.name
        if has_links and command != "fit-propulsion":
            return swimmer.load(self, path, params=params, **options)
        check_used(self, path, SURGE_KEYS)
        experiment = _load_straight(self, path)
        if params is not None:
            _set_references(experiment, params, path)
        return experiment


def _set_references(experiment: Experiment, params: Params, path: Path) -> None:
    """Set the reference amplitude and frequency of the surge model from its parameter file, in place.

    Raises
    ------
    InputError
        If the parameter file lacks these references, or if its trials had another waveform.
    """
    place, file = params
    for key in ("reference_amplitude_rad", "reference_frequency_hz"):
        if key not in file.settings:
            raise InputError(
                "is missing; give a file of fit-propulsion", file=place, column=f"settings.{key}"
            )
        setattr(experiment.model, key, float(file.settings[key]))
    for key in ("waveform", "asymmetry"):
        fitted, here = file.settings.get(key), experiment.facts[key]
        if fitted is not None and fitted != here:
            raise InputError(
                f"these trials have the {key} {here}, but the parameters were fitted to trials with "
                f"{fitted}, whose thrust differs: fit these trials separately",
                file=path,
                column=f"drive.{key}",
            )


def _load_straight(entries: FreeSwim, path: Path) -> Experiment:
    """Return the surge model with the averages over tail beats of the trials without a turning bias."""
    trials, logs, turning = [], [], []
    beat_facts: dict[str, dict[str, float | None]] = {}
    waveforms: dict[tuple[str, float], str] = {}
    for entry in entries.trials:
        drive = entry.drive
        if not isinstance(drive, Drive):
            raise InputError(
                f"the trial '{entry.id}' has no 'drive' with a beat",
                file=path,
                column="drive",
                hint="give waveform, frequency_hz and amplitude_deg under 'drive'",
            )
        log = read_trial_log(
            entry, path.parent, required=("x_m", "y_m", "yaw_rad"), optional=("u_m_s", "yaw_rate_rad_s")
        )
        logs.append(log.source)
        heading, used = unwrap(log["yaw_rad"]), "the measured frequency is used"
        beat = compare_frequencies(entry.id, drive.frequency_hz, log.time_s, heading, used)
        beat_facts[entry.id] = beat
        if drive.bias_deg != 0:
            turning.append(entry.id)
            continue
        waveforms.setdefault(_waveform(drive), entry.id)
        trials.append(_average_beats(entry, drive, log, beat["found_hz"] or drive.frequency_hz))
    if turning:
        warn(
            "SWM018",
            f"trials with a turning bias are left out of the straight-swimming fit: {', '.join(turning)}",
        )
    if not trials:
        text = f"all {len(turning)} trials have a turning bias; a straight trial is needed"
        raise InputError(text, file=path, column="trials", hint="add a trial with bias_deg: 0")
    _refuse_waveforms(waveforms, path)
    still = [t.id for t in trials if t.surge.amplitude_rad <= 0]
    if still:
        text = f"the amplitude of the beat is not positive in {', '.join(still)}"
        raise InputError(text, file=path, column="amplitude_deg")
    trials = _pool_frequencies(trials)
    model = SurgeModel(
        amplitudes_rad=[t.surge.amplitude_rad for t in trials],
        frequencies_hz=[t.surge.frequency_hz for t in trials],
        speed_m_s=max(float(np.nanmax(t.measured["u_m_s"])) for t in trials),
    )
    waveform, asymmetry = next(iter(waveforms))
    facts = {"beats": beat_facts, "waveform": waveform, "asymmetry": asymmetry}
    return Experiment.of(entries, path, model, trials, logs, facts=facts)


def _average_beats(entry: FreeSwimTrial, drive: Drive, log: Log, frequency_hz: float) -> Trial:
    """Return a trial with the surge averaged over tail beats."""
    time, speed = beat_averages(log, 1.0 / frequency_hz)
    # Use only tail beats with the full amplitude, because the thrust law is valid for these only. Assume no
    # initial ramp of the amplitude unless the trial states one.
    ramp = 0.0
    if "ramp_s" in drive.model_fields_set:
        ramp = drive.ramp_s
    full = time - 0.5 / frequency_hz >= ramp - 1e-9
    time, speed = time[full], speed[full]
    whole = int(np.isfinite(speed).sum())
    if whole < MIN_WHOLE_BEATS:
        after = f" after the drive's ramp of {ramp:g} s" * (not full.all())
        text = f"holds {whole} whole beats{after}; at least {MIN_WHOLE_BEATS} are needed"
        raise InputError(text, file=log.path)
    steady = SurgeInput(frequency_hz, float(np.deg2rad(drive.amplitude_deg)), float(time[0]))
    return Trial(entry.id, entry.role, time, {"u_m_s": speed}, surge=steady)


def _refuse_waveforms(waveforms: Mapping[tuple[str, float], str], path: Path) -> None:
    """Refuse trials with several waveforms, which give different thrusts."""
    if len(waveforms) > 1:
        (one, first), (other, second) = list(waveforms.items())[:2]
        raise InputError(
            f"the waveforms of '{first}', {one[0]} (asymmetry {one[1]:g}), and of '{second}', {other[0]} "
            f"(asymmetry {other[1]:g}), give different thrusts",
            file=path,
            column="drive.waveform",
            hint="write one trials file for each waveform",
        )


def _waveform(drive: Drive) -> tuple[str, float]:
    """Return the name of the waveform of a drive and its asymmetry.

    A Hopf oscillator without asymmetry counts as a sine, because its limit cycle is a sine.
    """
    if drive.waveform == "a-cpg" and drive.asymmetry != 0:
        return "a-cpg", drive.asymmetry
    return "sine", 0.0


def _pool_frequencies(trials: list[Trial]) -> list[Trial]:
    """Replace the beat frequency of each trial by the median over trials with nearly the same frequency."""
    values = np.array([t.surge.frequency_hz for t in trials])
    pooled = [float(np.median(values[np.abs(values / v - 1) < FREQUENCY_RTOL])) for v in values]
    return [replace(t, surge=replace(t.surge, frequency_hz=f)) for t, f in zip(trials, pooled, strict=True)]
