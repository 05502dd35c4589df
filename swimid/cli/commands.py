"""Functions of the commands ``swimid import``, ``swimid schema`` and ``swimid doctor``."""

from __future__ import annotations

import importlib
import json
import platform
import re
import sys
import time
from collections.abc import Iterable
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

import swimid
from swimid.cli.options import DoctorOptions, ImportLogOptions, SchemaOptions
from swimid.errors import UsageError, suggestion
from swimid.files import atomic
from swimid.imports import import_log as logs
from swimid.imports.mapping import Draft, guess_mapping
from swimid.kinematics.logged import Logged
from swimid.notices import Progress, silent
from swimid.options import takes
from swimid.results import numbers
from swimid.results.evidence import Evidence, Table, Verdict
from swimid.results.result import Result, class_of, list_result_formats

# ---------------------------------------------------------------- import


@takes(ImportLogOptions)
def import_file(
    file: Path, *, options: ImportLogOptions, output: Path | None, progress: Progress = silent
) -> Logged | Draft:
    """Import a recording of another program as a log, or write a draft of the mapping for this import.

    The mapping states which column of the recording becomes which column of the log.

    Parameters
    ----------
    file : Path
        File of the recording.
    output : Path
        Log to write; with ``guess`` the mapping to write.

    Raises
    ------
    UsageError
        If no output is given for a log, or if ``guess`` is combined with a mapping.
    """
    if options.guess:
        if options.map_path is not None:
            raise UsageError("--guess drafts a mapping and cannot be combined with --map: omit one of them")
        return guess_mapping(file, options=options, output=output)
    if output is None:
        raise UsageError("no output file is given for the log", hint="add -o run.csv")
    return logs.import_log(file, options=options, output=output, progress=progress)


# ---------------------------------------------------------------- schema

#: Pydantic model of each file format of swimid that is not the format of a result, as ``module:attribute``.
OTHERS = {
    "trials": "swimid.logs.experiments:make_schema",
    "robot": "swimid.robots.file:schema_of",
    "setup": "swimid.tracking.setup:Setup",
    "mapping": "swimid.imports.mapping:Mapping",
    "points": "swimid.points.point_files:PointsFile",
    "evidence": "swimid.results.evidence:Evidence",
    "answer": "swimid.cli.answers:CommandAnswer",
}


@takes(SchemaOptions)
def schema(name: str | None = None, *, options: SchemaOptions, output: Path | None = None) -> Result:
    """Return the JSON Schema of a file format or of the output of ``--json``, or the list of all formats.

    Parameters
    ----------
    name : str, optional
        Name of the format: ``"gap"`` for ``format: swimid-gap/1``, ``"answer"`` for ``--json``.
    output : path, optional
        File to which the schema is written.

    Raises
    ------
    UsageError
        If there is no such format. The hint names the most similar format.
    """
    names = [*OTHERS, *list_result_formats()]
    if name is None:
        return Result("schema", "\n".join(names), {"formats": names})
    if name not in names:
        raise UsageError(f"there is no format '{name}'", hint=suggestion(name, names))
    if name in OTHERS:
        module, _, attribute = OTHERS[name].partition(":")
        model: Any = getattr(importlib.import_module(module), attribute)
        model = model if isinstance(model, type) else model()
    else:
        model = class_of(name).file_type
    document = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$comment": f"written by swimid {swimid.__version__}",
        **TypeAdapter(model).json_schema(),
    }
    text = json.dumps(document, indent=2)
    if output is None:
        return Result("schema", text, document)
    atomic.write_text(output, text + "\n")
    return Result("schema", "", document, [output])


# ---------------------------------------------------------------- doctor

#: Extras of the installation that only developers need.
NOT_FOR_USERS = ("all", "dev", "docs", "bench")
#: Modules with functions that numba compiles. The function ``warm_up`` of each module compiles them.
KERNELS = (
    "swimid.rig.model",
    "swimid.swimmer.planar.model",
    "swimid.blackbox.arx",
    "swimid.fitting.fit_common",
    "swimid.tracking.pose",
)


class Installation(Result):
    """Result of ``doctor``: findings on the installation, or the size of the removed compiled functions."""

    @property
    def next_step(self) -> str:
        """Command that usually follows: a sample, or the removal of swimid after ``--clean``."""
        return "pip uninstall swimid" if self.text else "swimid sample"


@takes(DoctorOptions)
def doctor(
    *, options: DoctorOptions, output: Path | None = None, progress: Progress = silent
) -> Installation:
    """Check the installation of swimid: versions of packages, optional packages and video decoding.

    With ``warm_up``, also compile the numerical functions, so that no later command waits for compilation.
    With ``clean``, remove the compiled functions instead.

    Parameters
    ----------
    output : path, optional
        File to which the findings are written as JSON.
    """
    if options.clean:
        from swimid.files import kernels

        if options.warm_up:
            raise UsageError("--clean and --warm-up contradict each other: give one of them")
        freed = kernels.remove_cache()
        text = f"removed compiled kernels of {freed / 1e6:.1f} MB"
        return Installation("doctor --clean", text, {"freed_bytes": freed})
    known = _dependencies()
    import cv2

    backends, build = cv2.videoio_registry.getStreamBackends(), cv2.getBuildInformation()
    findings: dict[str, Any] = {
        "swimid": swimid.__version__,
        "python": sys.version.split()[0],
        "platform": platform.platform(),
        "packages": _versions(name for name, extra in known.items() if not extra),
        "optional": _versions(name for name, extra in known.items() if extra),
        "video_decoding": (bool(backends) and "FFMPEG:                      YES" in build),
    }
    if options.warm_up:
        findings["kernels_s"] = _warm_up(progress)
    findings["healthy"] = all(findings["packages"].values()) and findings["video_decoding"]
    outputs = []
    if output is not None:
        atomic.write_text(output, json.dumps(findings, indent=2) + "\n")
        outputs.append(output)
    return Installation("doctor", data=findings, outputs=outputs, evidence=_evidence(findings, known))


def _warm_up(progress: Progress) -> dict[str, float]:
    """Compile the numerical functions, and return the compilation time of each module, s."""
    times_s = {}
    with progress("compiling", total=len(KERNELS)) as step:
        for name in KERNELS:
            start_s = time.perf_counter()
            importlib.import_module(name).warm_up()
            times_s[name] = round(time.perf_counter() - start_s, 3)
            step()
    return times_s


def _evidence(findings: dict[str, Any], extras: dict[str, str]) -> Evidence:
    """Return the verdict on an installation, and a table of its packages with the ``extras`` of each."""
    rows = [[name, version or "MISSING", ""] for name, version in findings["packages"].items()]
    for name, version in findings["optional"].items():
        rows.append([name, version or "not installed", f"pip install 'swimid[{extras[name]}]'"])
    for name, time_s in findings.get("kernels_s", {}).items():
        rows.append([name, "compiled", f"in {time_s:.1f} s"])
    verdict = Verdict(level="good", text="All parts of swimid are installed.")
    if not findings["healthy"]:
        missing = [name for name, version in findings["packages"].items() if version is None]
        lacking = ", ".join(missing) or "FFmpeg in OpenCV"
        verdict = Verdict(level="bad", text=f"Parts of swimid are missing: {lacking}. Reinstall swimid.")
    return Evidence(
        command="doctor",
        title=f"swimid {swimid.__version__}",
        verdict=verdict,
        facts={
            "Python": findings["python"],
            "Platform": findings["platform"],
            "Video decoding": numbers.format_number(findings["video_decoding"]),
        },
        tables=[Table(id="packages", title="Packages", columns=["package", "state", "use"], rows=rows)],
    )


def _dependencies() -> dict[str, str]:
    """Return the packages that swimid needs: for each name the extra that installs it, empty if required."""
    try:
        stated = metadata.requires("swimid") or ()
    except metadata.PackageNotFoundError:
        # swimid has no package metadata if it runs from its source and is not installed.
        return {"swimid": ""}
    found: dict[str, str] = {}
    for text in stated:
        extra = "".join(re.findall(r"extra == ['\"](\w+)", text))
        if extra not in NOT_FOR_USERS:
            found.setdefault(re.split(r"[^\w.-]", text, maxsplit=1)[0], extra)
    return found


def _versions(names: Iterable[str]) -> dict[str, str | None]:
    """Return the version of each Python package; None for a package that is not installed."""
    versions: dict[str, str | None] = dict.fromkeys(names)
    for name in versions:
        with suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return versions
