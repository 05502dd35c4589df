"""Command ``swimid doctor``: check of the installation."""

from __future__ import annotations

import importlib
import json
import platform
import re
import sys
import time
from importlib import metadata
from pathlib import Path
from typing import Any

import swimid
from swimid.cli.options import DoctorOptions
from swimid.files import atomic
from swimid.notices import Progress, silent
from swimid.options import takes
from swimid.results import numbers
from swimid.results.evidence import Evidence, Table, Verdict
from swimid.results.result import Result

#: Use of each optional package.
OPTIONAL = {
    "av": "overlay videos that browsers play (pip install 'swimid[video]')",
    "pyarrow": "Parquet files (pip install 'swimid[parquet]')",
    "h5py": "HDF5, MATLAB and SLEAP files (pip install 'swimid[hdf5]')",
    "mcap": "recordings of ROS 2 (pip install 'swimid[mcap]')",
    "pyulog": "recordings of PX4 (pip install 'swimid[ulog]')",
    "tables": "HDF5 tables of DeepLabCut (pip install 'swimid[deeplabcut]')",
    "vqf": "attitude in swimid track imu (pip install 'swimid[imu]')",
    "pymoo": "genetic searches (pip install 'swimid[search]')",
}
#: Modules with compiled kernels; each has a ``warm_up()`` that compiles all of them.
KERNELS = (
    "swimid.rig.model",
    "swimid.swimmer.planar.model",
    "swimid.blackbox.recursive",
    "swimid.fitting.fit_common",
    "swimid.tracking.detect",
    "swimid.tracking.smooth",
)


@takes(DoctorOptions)
def doctor(*, options: DoctorOptions, output: Path | None = None, progress: Progress = silent) -> Result:
    """Check versions, video decoding and optional packages. With ``warm_up``, compile the kernels.

    Parameters
    ----------
    output : path, optional
        File for the findings, as JSON.
    """
    packages = {name: _version(name) for name in _required()}
    optional = {name: _version(name) for name in OPTIONAL}
    findings: dict[str, Any] = {
        "swimid": swimid.__version__,
        "python": sys.version.split()[0],
        "platform": platform.platform(),
        "packages": packages,
        "optional": optional,
        "video_decoding": _video(),
    }
    if options.warm_up:
        findings["kernels_s"] = {}
        with progress("compiling", total=len(KERNELS)) as step:
            for name in KERNELS:
                began = time.perf_counter()
                importlib.import_module(name).warm_up()
                findings["kernels_s"][name] = round(time.perf_counter() - began, 3)
                step()
    missing = [name for name, version in packages.items() if version is None]
    findings["healthy"] = not missing and findings["video_decoding"]
    outputs = []
    if output is not None:
        atomic.write_text(output, json.dumps(findings, indent=2) + "\n")
        outputs.append(output)
    return Result("doctor", data=findings, outputs=outputs, evidence=_evidence(findings, missing))


def _required() -> list[str]:
    """Return the packages that every command needs, from the metadata of the installed swimid."""
    try:
        stated = [text for text in metadata.requires("swimid") or () if "extra ==" not in text]
    except metadata.PackageNotFoundError:
        # swimid runs from its source and is not installed
        return ["swimid"]
    return [re.split(r"[^\w.-]", text, maxsplit=1)[0] for text in stated]


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _video() -> bool:
    import cv2

    return (
        bool(cv2.videoio_registry.getStreamBackends())
        and "FFMPEG:                      YES" in cv2.getBuildInformation()
    )


def _evidence(findings: dict[str, Any], missing: list[str]) -> Evidence:
    """Return the findings as a table and a verdict."""
    rows: list[list[Any]] = [
        [name, version or "MISSING", ""] for name, version in findings["packages"].items()
    ]
    for name, version in findings["optional"].items():
        rows.append([name, version or "not installed", OPTIONAL[name]])
    rows += [[name, "compiled", f"in {s:.1f} s"] for name, s in findings.get("kernels_s", {}).items()]
    verdict = Verdict(level="good", text="Everything is in place.")
    if not findings["healthy"]:
        lacking = ", ".join(missing) or "FFmpeg in OpenCV"
        verdict = Verdict(level="bad", text=f"Reinstall swimid. Missing: {lacking}.")
    facts = {"Python": findings["python"], "Platform": findings["platform"]}
    facts["Video decoding"] = numbers.number(findings["video_decoding"])
    table = Table(id="packages", title="Packages", columns=["package", "state", "use"], rows=rows)
    title = f"swimid {findings['swimid']}"
    return Evidence(command="doctor", title=title, verdict=verdict, facts=facts, tables=[table])
