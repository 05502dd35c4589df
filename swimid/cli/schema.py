"""JSON Schema of every file format, from the models that validate it."""

from __future__ import annotations

import importlib
import json
from pathlib import Path

from pydantic import TypeAdapter

import swimid
from swimid.cli.options import SchemaOptions
from swimid.errors import UsageError, suggestion
from swimid.files import atomic
from swimid.options import takes
from swimid.results.kinds import FORMATS
from swimid.results.result import Result

#: Model of each format that is no result: ``module:attribute``.
OTHERS = {
    "trials": "swimid.logs.trials:AnyTrials",
    "robot": "swimid.robots.file:Robot",
    "setup": "swimid.tracking.setup:Setup",
    "mapping": "swimid.logs.mapping:Mapping",
    "evidence": "swimid.results.evidence:Evidence",
}


@takes(SchemaOptions)
def schema(name: str | None = None, *, options: SchemaOptions, output: Path | None = None) -> Result:
    """Return the JSON Schema of one format, or the list of formats.

    Parameters
    ----------
    name : str, optional
        ``"gap"`` for ``format: swimid-gap/1``.
    output : path, optional
        Write the schema.

    Raises
    ------
    UsageError
        When there is no such format; names the nearest.
    """
    results = {form.removeprefix("swimid-").split("/")[0]: place for form, place in FORMATS.items()}
    places = OTHERS | results
    if name is None:
        return Result("schema", "\n".join(places), {"formats": list(places)})
    if name not in places:
        raise UsageError(f"there is no format '{name}'", hint=suggestion(name, list(places)))
    module, _, attribute = places[name].partition(":")
    found = getattr(importlib.import_module(module), attribute)
    document = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$comment": f"written by swimid {swimid.__version__}",
        # a class of results knows the model of its file
        **TypeAdapter(getattr(found, "file_type", found)).json_schema(),
    }
    text = json.dumps(document, indent=2)
    if output is None:
        return Result("schema", text, document)
    atomic.write_text(output, text + "\n")
    return Result("schema", "", document, [output])
