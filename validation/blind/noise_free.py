"""Noise-free motions of a case, and the share of the gap to them that the diagnosed model closes.

The motions are the held-out trials without noise and without scatter between trials. Errors against them have
no noise floor. The models are simulated by the command line under test: as given, and as repaired.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

#: Environment variables that a command keeps.
KEPT_VARIABLES = ("PATH", "LANG", "LC_ALL", "PYTHONPATH", "LD_LIBRARY_PATH", "NUMBA_CACHE_DIR", "SYSTEMROOT")
#: Name of the parameter file of the model with the causes, which a diagnosis writes.
REPAIRED = "repaired.yaml"
#: End of the name of a noise-free motion.
MOTION = "_noise_free"
#: Name of the file with the errors of both models against the noise-free motions.
FOUND = "noise_free.json"


def environment(home: str, search: Path | None) -> dict[str, str]:
    """Return the environment of a command, which finds packages in ``search`` first, if it is given."""
    found = {key: os.environ[key] for key in KEPT_VARIABLES if key in os.environ}
    if search is not None:
        paths = [str(search), *filter(None, [found.get("PYTHONPATH")])]
        found["PYTHONPATH"] = os.pathsep.join(paths)
    return found | {"HOME": home, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def write(folder: Path, place: Path, logs: Mapping[str, str]) -> None:
    """Write the noise-free logs of the held-out trials into a folder of the labels.

    Parameters
    ----------
    folder : Path
        Folder of the case. Its trials file and its other YAML files are copied.
    place : Path
        Folder to write.
    logs : mapping of file name to text
        Noise-free logs of all trials, or the noise-free table.
    """
    shutil.rmtree(place, ignore_errors=True)
    if not logs:
        return
    place.mkdir(parents=True)
    for path in folder.glob("*.yaml"):
        shutil.copy2(path, place)
    for name, text in logs.items():
        (place / name).write_text(text)
    yaml = YAML()
    trials = yaml.load(place / "trials.yaml")
    listed = trials.get("trials", [])
    held_out = [trial for trial in listed if trial.get("role") == "validate"] or listed
    if held_out:
        for trial in held_out:
            trial.pop("role", None)
            # A parameter file has estimates of the scatter of a fitted trial, under the name of the trial.
            trial["id"] = f"{trial['id']}{MOTION}"
        trials["trials"] = held_out
        yaml.dump(trials, place / "trials.yaml")


def compare(
    place: Path,
    results: Path,
    *,
    program: Sequence[str],
    search: Path | None = None,
    timeout_s: float = 300.0,
) -> None:
    """Write the errors of both models against the noise-free motions to ``noise_free.json`` of the results.

    Nothing is written if the diagnosis names no cause, or if the command cannot simulate a model.

    Parameters
    ----------
    place : Path
        Folder that :func:`write` has written.
    results : Path
        Folder with the files that the diagnosis has written.
    """
    found = results / FOUND
    found.unlink(missing_ok=True)
    repaired = results / REPAIRED
    if not (place.exists() and repaired.exists()):
        return
    given = place / "params_prior.yaml"
    if not given.exists():
        given = results / "params.yaml"
    errors: dict[str, Any] = {}
    with tempfile.TemporaryDirectory(prefix="motions_") as temporary:
        work = Path(temporary) / "run"
        shutil.copytree(place, work)
        for name, source in (("given", given), ("repaired", repaired)):
            shutil.copy2(source, work / f"params_{name}.yaml")
            command = ["compare", "trials.yaml", "--params", f"params_{name}.yaml", "--no-refit-start"]
            command += ["-o", f"{name}.yaml", "--no-progress"]
            subprocess.run(
                [*program, *command],
                cwd=work,
                env=environment(temporary, search),
                capture_output=True,
                timeout=timeout_s,
                check=False,
            )
            if not (work / f"{name}.yaml").exists():
                return
            channels = YAML(typ="safe").load(work / f"{name}.yaml")["channels"]
            errors[name] = {channel: row["rmse"] for channel, row in channels.items()}
    found.write_text(json.dumps(errors, indent=1) + "\n")


def closed_share(results: Path, floor: Mapping[str, float]) -> float | None:
    """Return the closed share of the squared gap to the noise-free motions, over all channels.

    Parameters
    ----------
    results : Path
        Folder with ``noise_free.json``.
    floor : mapping of channel to float
        Noise of each channel in its unit. Its square is the weight of the squared errors of the channel.

    Returns
    -------
    float or None
        Share of the squared error of the model as given that the repaired model does not have, at most 1.
        None without ``noise_free.json``.
    """
    path = results / FOUND
    if not path.exists():
        return None
    errors = json.loads(path.read_text())
    given, repaired = (
        sum((row[channel] / floor[channel]) ** 2 for channel in floor if channel in row)
        for row in (errors["given"], errors["repaired"])
    )
    return 1.0 - repaired / given
