"""Experiment ``falling-weight``: a weight over a pulley, or another known force, pulls the robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, PositiveFloat, model_validator

from swimid.errors import InputError, UsageError
from swimid.files.provenance import Input
from swimid.files.yamlio import ASK
from swimid.fitting.fit_common import Experiment, SimulationRun, read_trial_log, warn_mass
from swimid.fitting.model import Array, RigInput, Trial, choose_parameters
from swimid.logs.experiments import Params, Trials
from swimid.logs.log import Log
from swimid.notices import warn
from swimid.results import parameters as parameters_format
from swimid.rig import model as rig
from swimid.rig.model import (
    ROUNDINGS,
    Displacement,
    RigTrial,
    area_factors,
    mass_of,
    read_encoder,
    true_position,
)
from swimid.robots import file as robot_format
from swimid.robots.file import Robot

#: Minimum number of samples of a trial.
MIN_SAMPLES_FALL = 5
#: Maximum position of the first sample of a drop, as a fraction of the drop distance, at which the drop is
#: assumed to start at the origin.
ORIGIN_RTOL = 0.02


class FallingWeightTrial(RigTrial):
    """Keys of a trial of a body that a falling weight pulls over a pulley, or that a known force drives."""

    pulling_mass_kg: PositiveFloat | None = None
    driving_force_N: float | None = None

    @model_validator(mode="after")
    def _one_drive(self) -> FallingWeightTrial:
        if (self.pulling_mass_kg is None) == (self.driving_force_N is None):
            raise ValueError("the trial needs exactly one of 'pulling_mass_kg' and 'driving_force_N'")
        return self


class FallingWeight(Trials):
    """Trials file of a falling-weight experiment.

    Example::

        format: swimid-trials/1
        experiment: falling-weight
        robot: boxfish
        trials:
          - {log: w10.csv, pulling_mass_kg: 0.010}
          - {log: w20.csv, pulling_mass_kg: 0.020, role: validate}
    """

    about = "a weight pulls the robot; add pulling_mass_kg to each trial"
    models = ("falling-weight",)
    commands = ("fit-drag",)
    needs = (("x_m",),)
    asked = {"pulling_mass_kg": ASK}

    experiment: Literal["falling-weight"]
    trials: Annotated[list[FallingWeightTrial], Field(min_length=1)]

    def load(self, path: Path, *, params: Params | None = None, **options: Any) -> Experiment:
        """Read the drops (see :meth:`Trials.load`). ``params`` states the rounding of encoder counts."""
        robot = self.read_robot(path.parent)
        factors = area_factors(self.trials, robot, path)
        drops = [_drop(e, path, robot, factor) for e, factor in zip(self.trials, factors, strict=True)]
        logs, known, records = zip(*drops, strict=True)
        model = rig.falling_weight(
            mass_kg=float(np.median([k.inertia for k in known])) or 1.0,
            force_N=float(np.median([k.pull for k in known])),
            area_known=factors[0] > 0,
            pulley=any(k.pulley for k in known),
            speed_m_s=float(np.median([np.ptp(r.position) / np.ptp(r.time_s) for r in records])) or 0.1,
        )
        span = min(float(record.time_s[-1] - record.time_s[0]) for record in records)
        model.parameters = choose_parameters(
            model.parameters,
            # Limit the time between the release and the start of the log to the duration of the shortest
            # trial.
            bounds={"clock_offset": (-span, span)},
            # Estimate the start position of drops that do not start at the origin, because their first
            # measured position has noise.
            freed=("start_offset",) * any(k.x0 != 0 for k in known),
        )
        variants: dict[Any, list[Trial]] = {}
        if any(r.kind == "sampled" for r in records):
            variants = {name: self._trials(records, known, name) for name in ROUNDINGS}
        trials = self._trials(records, known, "floor")
        if params is not None:
            trials = variants.get(params[1].settings.get("encoder_rounding"), trials)
        return Experiment.of(self, path, model, trials, logs, robot, variants=variants)

    def _trials(
        self, records: Sequence[Displacement], known: Sequence[RigInput], rounding: str
    ) -> list[Trial]:
        """Return the trials under an assumed rounding of encoder counts."""
        made = []
        for entry, record, one in zip(self.trials, records, known, strict=True):
            clicks = record.kind == "clicks"
            # Leave out the first row of a log with one row per encoder step, because it defines the origin
            # and is not a measurement.
            rows = slice(int(clicks and record.position[0] == 0), None)
            position = {"x_m": true_position(record, rounding)[rows]}
            trial = Trial(entry.id, entry.role, record.time_s[rows], position, rig=one)
            if record.position_sd:
                trial = replace(trial, value_sd={"x_m": record.position_sd})
            made.append(replace(trial, time_sd_s=record.time_sd_s, stamps_uncertain=clicks))
        return made

    @classmethod
    def prepare_run(cls, options: Any, params: Params, time_s: Array) -> SimulationRun:
        """Return a drop of the robot from rest, pulled by the weight of ``--pulling-mass-kg``."""
        path, file = params
        pulling = options.pulling_mass_kg
        if pulling is None:
            raise UsageError("a falling weight needs --pulling-mass-kg")
        robot = robot_format.read(*parameters_format.robot_of(file, path, options.robot))
        mass, area = robot.body.inertial_mass_kg, robot.body.frontal_area_m2
        known = "drag_coefficient" in file.parameters
        if mass is None or (known and area is None):
            text = "needs body.inertial_mass_kg, and body.frontal_area_m2 for a drag coefficient"
            raise InputError(f"the robot '{robot.name}' {text}")
        force = pulling * robot.fluid.gravity_m_s2
        inertia = mass + pulling + robot.rig.pulley_inertia_kg
        model = rig.falling_weight(mass_kg=inertia, force_N=force, area_known=known, pulley=True)
        factor = 0.5 * robot.fluid.density_kg_m3 * (area or 0.0)
        on_rig = RigInput(inertia, force, pulley=True, area_factor=factor, release_s=0.0)
        trial = Trial("run", "fit", time_s, {}, rig=on_rig)

        def compute(applied: Any, values: Array) -> list[float]:
            simulated = applied.model.run(values, trial, measured=False)
            hooks = applied.model.hooks(values, trial)
            top = math.nan
            if not (hooks.force or hooks.flow):
                balance = hooks.change_values(model.equation(values, trial), "coefficients")
                top = rig.compute_terminal_speed(balance, balance["force"])
            return [top, float(simulated[model.speed][-1]), float(simulated["x_m"][-1])]

        units = {"terminal_speed_m_s": "m/s", "last_speed_m_s": "m/s", "distance_m": "m"}
        metadata = {"pulling_mass_kg": pulling}
        return SimulationRun(model, trial, robot.name, metadata, units=units, quantities=compute)


def _drop_standstill(log: Log) -> tuple[Array, Array]:
    """Return the times and displacements of a drop up to the time at which the body comes to rest.

    Raises
    ------
    InputError
        If there are too few samples, or if the displacement does not grow.
    """
    there = np.isfinite(log["x_m"])
    time, position = log.time_s[there], log["x_m"][there]
    if len(time) < MIN_SAMPLES_FALL:
        raise InputError(
            f"has {len(time)} displacement samples; a fit needs at least {MIN_SAMPLES_FALL}",
            file=log.path,
            column="x_m",
        )
    span = float(position.max() - position.min())
    zero = np.flatnonzero((position == 0.0) & (np.maximum.accumulate(position) > 0.1 * span))
    if len(zero):
        raise InputError(
            f"is exactly 0 in {len(zero)} rows, from {time[zero[0]]:.4g} s to {time[zero[-1]]:.4g} s, after "
            f"it had grown to {np.max(position[: zero[0]]):.3g} m: is that a code for a lost sample?",
            file=log.path,
            line=log.line(int(np.flatnonzero(there)[zero[0]])),
            column="x_m",
            hint="empty these cells, or state 'missing: [0]' under 'reader:' in the mapping of an import",
        )
    noise = float(np.median(np.abs(np.diff(position, 2))))
    arrived = position.max() - max(0.01 * span, 6.0 * noise)
    before = np.flatnonzero(position < arrived)
    reference = np.flatnonzero(position < position.min() + 0.7 * (arrived - position.min()))
    if len(before) and len(reference) and len(position) - before[-1] >= 6:
        last, far = int(before[-1]) + 1, int(reference[-1])
        # Compute the time in which the body at its mean speed would cover the rest of the distance.
        needed = 0.0
        if time[last] > time[far] and position[last] > position[far]:
            speed = (position[last] - position[far]) / (time[last] - time[far])
            needed = (position.max() - arrived) / speed
        still = time[-1] - time[last]
        if time[last] > time[far] and still >= max(5.0 * needed, 0.05 * (time[last] - time[0])):
            warn(
                "SWM018",
                f"{log.path.name}: the body stands still from {time[last]:.3g} s on; the {still:.3g} s after "
                "that are left out (set another end with end_s in the trials file)",
            )
            time, position = time[:last], position[:last]
    if position[-1] <= position[0]:
        text = (
            f"the displacement goes from {position[0]:g} to {position[-1]:g} m; it must grow along the pull"
        )
        hint = "if x_m points against the pull, give factor: -1 in a mapping"
        raise InputError(text, file=log.path, column="x_m", hint=hint)
    return time, position


def _drop(
    entry: FallingWeightTrial, path: Path, robot: Robot, factor: float
) -> tuple[Input, RigInput, Displacement]:
    """Return the log of a falling-weight trial, its known quantities and its displacement record.

    The known quantities are the moving mass, the driving force and the time of release.
    """
    log = read_trial_log(entry, path.parent, required=("x_m",))
    time, position = _drop_standstill(log)
    record = read_encoder(time, position, robot.rig.encoder_resolution_m)
    mass = mass_of(entry, robot, path)
    pulley = entry.pulling_mass_kg is not None
    if entry.pulling_mass_kg is not None:
        warn_mass(f"the trial '{entry.id}' has the pulling mass", entry.pulling_mass_kg, mass, path)
        force = entry.pulling_mass_kg * robot.fluid.gravity_m_s2
        mass += entry.pulling_mass_kg + robot.rig.pulley_inertia_kg
    else:
        force = float(entry.driving_force_N or 0.0)
        if force <= 0:
            raise InputError(
                f"the driving force of '{entry.id}' is {force:g} N; it must be positive, along x_m",
                file=path,
                column="driving_force_N",
            )
    travelled = position - position[0]
    from_origin = abs(position[0]) <= ORIGIN_RTOL * float(travelled.max())
    # If the body has already moved in the first row of a drop, it was released before this row. The release
    # is at time zero if the driving force can have moved the body that far since time zero. If not, the time
    # of release is estimated from the time that the driving force needs.
    quickest = np.sqrt(2.0 * max(float(position[0]), 0.0) * mass / force)
    at_zero = from_origin and position[0] > 0 and 0.5 * quickest <= time[0] <= 5.0 * quickest
    # Accept only the count of an encoder as proof that the body has moved before the first row, because a
    # camera position has noise.
    counted = record.kind != "continuous" and record.position[0] > 0 and from_origin
    release, x0 = float(time[0]), float(position[0])
    if at_zero:
        release = 0.0
    elif counted:
        release -= 1.4 * float(quickest)
    if from_origin:
        x0 = 0.0
    known = RigInput(mass, force=force, pulley=pulley, area_factor=factor, release_s=release, x0=x0)
    return log.source, known, record
