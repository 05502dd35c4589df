"""Command ``schema``: JSON Schema of a file format, from the model that validates the format."""

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
from swimid.results.result import FORMATS, Result

#: Model of each format that is not a result, as ``module:attribute``.
OTHERS = {
    "trials": "swimid.logs.trials:AnyTrials",
    "robot": "swimid.robots.file:schema_of",
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
        Name of the format: ``"gap"`` for ``format: swimid-gap/1``.
    output : path, optional
        File for the schema.

    Raises
    ------
    UsageError
        If there is no such format. The hint names the most similar format.
    """
    results = {form.removeprefix("swimid-").split("/")[0]: place for form, place in FORMATS.items()}
    places = OTHERS | results
    if name is None:
        return Result("schema", "\n".join(places), {"formats": list(places)})
    if name not in places:
        raise UsageError(f"there is no format '{name}'", hint=suggestion(name, list(places)))
    module, _, attribute = places[name].partition(":")
    found = getattr(importlib.import_module(module), attribute)
    if name == "robot":
        found = found()
    document = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$comment": f"written by swimid {swimid.__version__}",
        # a class of results has the model of its file as ``file_type``
        **TypeAdapter(getattr(found, "file_type", found)).json_schema(),
    }
    text = json.dumps(document, indent=2)
    if output is None:
        return Result("schema", text, document)
    atomic.write_text(output, text + "\n")
    return Result("schema", "", document, [output])
