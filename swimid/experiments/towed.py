"""Experiment ``towed``: the robot is towed by a measured force, or coasts down without one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from swimid.errors import InputError
from swimid.fitting.fit_common import Experiment, read_trial_log
from swimid.fitting.model import RigInput, Trial, choose_parameters
from swimid.kinematics.jumps import WINDOW, find_jumps
from swimid.logs.experiments import Trials
from swimid.logs.log import longest_run, runs
from swimid.notices import warn
from swimid.rig import model as rig
from swimid.rig.model import RigTrial, area_factors, mass_of

#: Maximum number of successive missing samples of the applied force, which are interpolated.
MAX_FORCE_GAP = 4


class Towed(Trials):
    """Trials file of an experiment with a measured force on the towed robot.

    Example::

        format: swimid-trials/1
        experiment: towed
        robot: boxfish
        trials:
          - {log: tow1.csv}
          - {log: tow2.csv, role: validate}
    """

    about = "the robot is towed by a measured force"
    models = ("towed",)
    commands = ("fit-drag",)
    needs = (("force_N",), ("x_m", "u_m_s"))

    experiment: Literal["towed"]
    trials: Annotated[list[RigTrial], Field(min_length=1)]

    def load(self, path: Path, **options: Any) -> Experiment:
        """Read the tows (see :meth:`Trials.load`)."""
        robot = self.read_robot(path.parent)
        factors = area_factors(self.trials, robot, path)
        trials, logs, forces, speeds = [], [], [], []
        for entry, factor in zip(self.trials, factors, strict=True):
            log = read_trial_log(entry, path.parent, required=("force_N",), optional=("x_m", "u_m_s"))
            logs.append(log.source)
            measured = {c: log[c] for c in ("x_m", "u_m_s") if c in log}
            if not measured:
                raise InputError("needs a column x_m or u_m_s beside force_N", file=log.path)
            force = log["force_N"]
            missing = np.isnan(force)
            known = np.flatnonzero(~missing)
            # Keep steps of the force, such as those of dry friction at a reversal. Only spikes are errors.
            spikes = known[:0]
            if len(known) > WINDOW:
                spikes = known[~find_jumps(log.time_s[known], force[known, None], brief=True)[0]]
            missing[spikes] = True
            if len(spikes):
                first = log.time_s[spikes[0]]
                text = f"{len(spikes)} outliers of force_N, the first at {first:.4g} s, are interpolated"
                warn("SWM058", f"{log.path.name}: {text}: check the amplifier of the load cell")
            if longest_run(missing) > MAX_FORCE_GAP:
                first, _ = max(runs(missing).tolist(), key=np.ptp)
                text = (
                    f"the force lacks more than {MAX_FORCE_GAP} samples: cut the log with start_s and end_s"
                )
                raise InputError(text, file=log.path, line=log.line(first), column="force_N")
            # Interpolate the force linearly across missing samples and spikes, as the model does between
            # samples.
            force = np.interp(log.time_s, log.time_s[~missing], force[~missing])
            x = measured.get("x_m", np.zeros(1))
            if "u_m_s" in measured:
                speeds.append(float(np.nanmean(np.abs(measured["u_m_s"]))))
            else:
                speeds.append(float((np.nanmax(x) - np.nanmin(x)) / np.ptp(log.time_s)))
            mass, begin, first = (
                mass_of(entry, robot, path),
                float(log.time_s[0]),
                float(x[np.isfinite(x)][0]),
            )
            # A body that coasts down has no measured force. Estimate its mean drag from its momentum.
            taken = mass * speeds[-1] / float(np.ptp(log.time_s))
            forces.append(max(float(np.sqrt(np.mean(force**2))), taken))
            rig_input = RigInput(mass, area_factor=factor, release_s=begin, x0=first)
            trials.append(Trial(entry.id, entry.role, log.time_s, measured, {"force_N": force}, rig_input))
        model = rig.make_towed_model(
            mass_kg=float(np.median([t.rig.inertia for t in trials])),
            force_N=max(float(np.median(forces)), 1e-9),
            area_known=factors[0] > 0,
            speed_m_s=float(np.median(speeds)) or 0.1,
        )
        if not any("x_m" in t.measured for t in trials):
            model.parameters = choose_parameters(model.parameters, fixed={"start_offset": 0.0})
        return Experiment.of(self, path, model, trials, logs, robot)
