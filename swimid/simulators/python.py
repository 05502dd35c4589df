"""Model of a simulator that is a function in Python."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError, UsageError, suggestion
from swimid.files.user_code import run_file
from swimid.fitting.model import Array, Hooks, Parameter, Trial
from swimid.simulators.model import SimulatorModel

#: Type of the function of a simulator. Its arguments are the parameters by name, the inputs by column, each
#: shape (n,), and the sample times (s), shape (n,). It returns the outputs by channel, each shape (n,).
Simulate = Callable[[Mapping[str, float], Mapping[str, Array], Array], Mapping[str, Any]]


class PythonModel(SimulatorModel):
    """Model whose simulation is a function of the user.

    Effects of commands, clocks and sensors act on this model. Its parameters may be changed as hypotheses.

    Parameters
    ----------
    simulate : callable
            Function ``simulate(parameters, inputs, times) -> outputs``. Each input is an array of values at
            ``times``.
    parameters : sequence of Parameter
    inputs, outputs : sequence of str
        Columns of the log.

    Examples
    --------
    >>> def coast(parameters, inputs, times):
    ...     return {"x_m": np.log1p(parameters["drag_1_m"] * times) / parameters["drag_1_m"]}
    >>> drag = Parameter("drag_1_m", "1/m", 0.0, 10.0, start=0.5, scale=0.5)
    >>> model = PythonModel(coast, [drag], inputs=(), outputs=("x_m",))
    >>> run = Trial("run 1", "fit", time_s=np.array([0.0, 1.0]), measured={})
    >>> model.run(np.array([0.5]), run)["x_m"].round(3).tolist()
    [0.0, 0.811]
    """

    name = "python"

    def __init__(
        self,
        simulate: Simulate,
        parameters: Sequence[Parameter],
        inputs: Sequence[str],
        outputs: Sequence[str],
    ) -> None:
        super().__init__(parameters, inputs, outputs)
        self._simulate = simulate

    def simulate_hooked(self, values: Array, trial: Trial, hooks: Hooks) -> dict[str, Array]:
        """Simulate a trial (see :meth:`Model.simulate_hooked`).

        Raises
        ------
        UsageError
            If the function lacks an output, or an output has another length than the times.
        """
        time = trial.time_s
        inputs = {name: hooks.actuate(time, trial.inputs[name], k) for k, name in enumerate(self.columns)}
        if hooks.late:
            time = hooks.compute_event_times(time)
            inputs = {name: np.interp(time, trial.time_s, column) for name, column in inputs.items()}
        named = {p.name: float(value) for p, value in zip(self.parameters, values, strict=False)}
        outputs = self._simulate(named, inputs, time)
        found = {}
        for channel in self.channels:
            if channel.name not in outputs:
                raise UsageError(
                    f"the simulator returns no '{channel.name}'",
                    hint=f"it returns: {', '.join(map(str, outputs)) or 'nothing'}",
                )
            found[channel.name] = np.asarray(outputs[channel.name], dtype=float)
            if found[channel.name].shape != time.shape:
                shapes = f"{found[channel.name].shape}; it must be {time.shape}, as that of the times"
                raise UsageError(f"the simulator returns '{channel.name}' with the shape {shapes}")
        return hooks.sense(found, trial.time_s) if hooks.output else found


def find_function(name: str, folder: Path) -> tuple[Simulate, Path | None]:
    """Return the function ``module:function``, and its file if the module is the path of a file.

    Parameters
    ----------
    name : str
        Importable module, or path of a Python file relative to ``folder``; a colon; name of the function.

    Raises
    ------
    InputError
        If there is no such function, or its file cannot be run.
    """
    place, colon, function = name.rpartition(":")
    if not colon:
        raise InputError(f"'{name}' must have the form module:function", hint="for example sim.py:simulate")
    path: Path | None = folder / place
    if place.endswith(".py") or (path is not None and path.is_file()):
        assert path is not None
        module = run_file(path, "simulators")
    else:
        path = None
        try:
            module = importlib.import_module(place)
        except ImportError as error:
            hint = "give the path of a file (sim.py:simulate), or install the module"
            raise InputError(f"the module '{place}' cannot be imported: {error}", hint=hint) from error
    found = getattr(module, function, None)
    if not callable(found):
        names = [key for key, value in vars(module).items() if callable(value) and not key.startswith("_")]
        raise InputError(f"'{place}' has no function '{function}'", hint=suggestion(function, names))
    return found, path
