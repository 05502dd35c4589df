"""Experiment ``python``: trials of a robot whose simulator is a Python function."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from swimid.errors import InputError
from swimid.files import yamlio
from swimid.fitting.fit_common import Experiment
from swimid.logs.experiments import TrialEntry
from swimid.simulators.model import SimulatorParameter, SimulatorTrials
from swimid.simulators.python import PythonModel, find_function


class PythonEntry(yamlio.Document):
    """Entry ``model`` of a trials file: a Python function, with its parameters, inputs and outputs."""

    #: Module and function: ``sim.py:simulate`` or ``lab.fish:simulate``.
    python: str
    parameters: Annotated[dict[str, SimulatorParameter], Field(min_length=1)]
    #: Columns of the log that are the inputs of the function.
    inputs: list[str] = []
    #: Channels that the function returns.
    outputs: Annotated[list[str], Field(min_length=1)]


class Python(SimulatorTrials):
    """Trials file of a robot whose simulator is a function ``simulate(parameters, inputs, times)``.

    Example::

        format: swimid-trials/1
        experiment: python
        model:
          python: sim.py:simulate
          parameters:
            drag_N_s2_m2: {start: 2.0, bounds: [0, 10]}
          inputs: [cmd_rad]
          outputs: [x_m, yaw_rad]
        trials:
          - {log: run1.csv}
          - {log: run2.csv, role: validate}
    """

    about = "a robot whose simulator is a function in Python"
    models = ("python",)

    experiment: Literal["python"]
    model: PythonEntry
    trials: Annotated[list[TrialEntry], Field(min_length=1)]

    def simulator_name(self) -> str:
        """Return the name of the simulator function."""
        return self.model.python.rpartition(":")[2]

    def load(self, path: Path, **options: Any) -> Experiment:
        """Import the simulator function, and read the logs (see :meth:`Trials.load`)."""
        entry = self.model
        try:
            simulate, file = find_function(entry.python, path.parent)
            parameters = [p.to_parameter(name) for name, p in entry.parameters.items()]
        except InputError as error:
            if error.file is not None:
                raise
            raise self.error_at(path, ["model", "python"], error.reason, error.hint) from error
        except ValueError as error:
            raise self.error_at(path, ["model", "parameters"], error) from error
        model = PythonModel(simulate, parameters, entry.inputs, entry.outputs)
        trials, sources = self.read_trials(path, entry.inputs, entry.outputs)
        values = np.array([p.start for p in parameters])
        once, again = model.run_many([(values, trials[0])] * 2)
        if any(not np.array_equal(once[name], again[name], equal_nan=True) for name in once):
            text = f"{entry.python} returns other values for equal arguments, so that it has no derivatives"
            hint = "seed its random numbers in each call, or leave its noise out"
            raise self.error_at(path, ["model", "python"], text, hint)
        return self.make_experiment(path, model, trials, [file, *sources] if file else sources)
