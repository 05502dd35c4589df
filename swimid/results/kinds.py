"""Formats of the results that can be read from a file, and the class for each format."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from swimid.errors import InputError, suggestion
from swimid.files import tabular, yamlio
from swimid.results.result import Result

#: Class of the results with each ``format:`` in a YAML file, as ``module:class``.
FORMATS = {
    "swimid-parameters/1": "swimid.results.parameters:Fitted",
    "swimid-comparison/1": "swimid.simulation.compare:Comparison",
    "swimid-gap/1": "swimid.diagnosis.evidence:Diagnosis",
    "swimid-power/1": "swimid.diagnosis.power:DetectionPower",
    "swimid-sensitivity/2": "swimid.sensitivity_analysis.sensitivity:Sensitivity",
    "swimid-map/1": "swimid.optimisation.performance_map:PerformanceMap",
    "swimid-rule/2": "swimid.optimisation.optimise_stiffness:StiffnessRule",
    "swimid-gait/2": "swimid.optimisation.optimise_gait:BestGait",
}
LOG_ENDINGS = (".csv", *tabular.PARQUET)
LOG = "swimid.logs.tracks:Logged"


def load_result(path: str | Path) -> Result:
    """Read any result that swimid wrote, together with its evidence file.

    Parameters
    ----------
    path : path
        A parameter, comparison, gap, power, sensitivity, map, rule or gait file, or a log.

    Returns
    -------
    Result
        Result, an object of the class that belongs to the format of the file.

    Raises
    ------
    InputError
        If the file is not a result, or is invalid.

    Examples
    --------
    >>> load_result("sample_logs/gap/params.yaml").parameters.loc["c_ma", "unit"]
    '1'
    """
    path = Path(path)
    ending = path.suffix.lower()
    place = LOG
    if path.name.endswith(".evidence.json"):
        stem = path.name.removesuffix(".evidence.json")
        there = [e for e in (".yaml", ".yml", *LOG_ENDINGS) if path.with_name(stem + e).exists()]
        result = stem + (there or [".yaml"])[0]
        raise InputError("is the evidence of a result", file=path, hint=f"name the result itself: {result}")
    if ending in (".yaml", ".yml"):
        form = yamlio.load(path).get("format")
        if form not in FORMATS:
            reason = f"its format '{form}' is that of no result"
            if form is None:
                reason = "has no 'format'"
            hint = suggestion(str(form), sorted(FORMATS), "known")
            raise InputError(reason, file=path, line=1, column="format", hint=hint)
        place = FORMATS[str(form)]
    elif ending not in LOG_ENDINGS:
        allowed = ", ".join([".yaml", *LOG_ENDINGS])
        raise InputError(f"is no result file: its ending must be one of {allowed}", file=path)
    module, _, name = place.partition(":")
    loaded: Result = getattr(import_module(module), name).load(path)
    return loaded
