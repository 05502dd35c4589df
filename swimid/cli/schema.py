"""JSON Schema of every file format, from the models that validate it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import BaseModel, TypeAdapter

import swimid
from swimid.diagnosis import gap_file as gap
from swimid.diagnosis import power_file
from swimid.errors import UsageError, suggestion
from swimid.files import atomic
from swimid.logs import mapping, trials
from swimid.optimisation import gait_file, map_file, rule
from swimid.results import evidence, parameters
from swimid.results.result import Result
from swimid.robots import file as robot
from swimid.sensitivity_analysis import file as sensitivity
from swimid.simulation import comparison_file as comparison
from swimid.tracking import setup


def schemas() -> dict[str, dict[str, Any]]:
    """Every format by name, with its JSON Schema."""
    models: dict[str, Any] = {
        "trials": TypeAdapter(trials.AnyTrials),
        "robot": robot.Robot,
        "parameters": parameters.ParameterFile,
        "setup": setup.Setup,
        "mapping": mapping.Mapping,
        "comparison": comparison.ComparisonFile,
        "gap": gap.GapFile,
        "power": power_file.PowerFile,
        "sensitivity": sensitivity.SensitivityFile,
        "map": map_file.MapFile,
        "rule": rule.RuleFile,
        "gait": gait_file.GaitFile,
        "evidence": evidence.Evidence,
    }
    return {
        name: model.model_json_schema()
        if isinstance(model, type) and issubclass(model, BaseModel)
        else model.json_schema()
        for name, model in models.items()
    }


def schema(name: str | None = None, *, output: Path | None = None) -> Result:
    """The schema of one format, or the list of formats.

    Parameters
    ----------
    name : str, optional
    output : path, optional

    Raises
    ------
    UsageError
        When there is no such format; names the nearest.
    """
    known = schemas()
    if name is None:
        text = "\n".join(known)
        return Result("schema", text, {"formats": list(known)})
    if name not in known:
        hint = suggestion(name, list(known))
        raise UsageError(f"there is no format '{name}'", hint=hint)
    mark = {"$comment": f"written by swimid {swimid.__version__}"}
    document = {"$schema": "https://json-schema.org/draft/2020-12/schema", **mark, **known[name]}
    text = json.dumps(document, indent=2)
    if output is None:
        return Result("schema", text, document)
    atomic.write_text(output, text + "\n")
    return Result("schema", "", document, [output])
