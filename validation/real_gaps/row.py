"""A real recording in which one known thing differs from the model, and the answer that is right."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

Array = NDArray[np.float64]
Gap = Mapping[str, Any]
AIR = {"density_kg_m3": 1.2, "gravity_m_s2": 9.81}


class MissingDataError(Exception):
    """A row's recordings are not on this machine."""


@dataclass(frozen=True)
class Sources:
    """The two folders of recordings, which are only read.

    Attributes
    ----------
    data : Path
        The folder that ``SWIMID_DATA`` names.
    repositories : Path
        Files of public repositories as ``<owner>/<name>/<commit>/<path>``.
    """

    data: Path
    repositories: Path

    def recording(self, path: str) -> Path:
        """Path of a file or folder below ``data``.

        Raises
        ------
        MissingDataError
            If it is not there.
        """
        return _existing(self.data / path)

    def repository(self, name: str, commit: str, path: str = "") -> Path:
        """Path of a file or folder of a repository.

        Raises
        ------
        MissingDataError
            If it is not there.
        """
        return _existing(self.repositories / name / commit / path)


@dataclass(frozen=True)
class Known:
    """The size of the known difference.

    Attributes
    ----------
    value : float
    unit : str
    source : str
        Who states it, or how it was measured.
    read : callable
        Takes the gap file and returns the corresponding value and standard error of the answer.
    """

    value: float
    unit: str
    source: str
    read: Callable[[Gap], tuple[float, float | None]]


@dataclass(frozen=True)
class Row:
    """One recording, the commands of a user, and the right answer, which is stated before the first run.

    Attributes
    ----------
    name : str
    model, lacks : str
        What the model is of, and the known difference of the recording.
    source, licence : str
        Repository and commit, or DOI. A licence ``none`` allows tests only.
    steps : sequence of str or callable
        Command lines of swimid in the folder of the row, and functions that write logs, trials and robot
        files into it. The last command line writes ``gap.yaml``.
    causes : frozenset of str
        Acceptable names. If it is empty, the cause is outside the catalogue and ``unexplained`` is right.
    known : Known, optional
        None if the size of the difference is not known.
    """

    name: str
    model: str
    lacks: str
    source: str
    licence: str
    steps: Sequence[str | Callable[[Sources, Path], None]]
    causes: frozenset[str]
    known: Known | None = None


def size_of(*names: str, factor: float = 1.0) -> Callable[[Gap], tuple[float, float | None]]:
    """Return a reader of the first parameter of these names among the causes, in the unit of the known size.

    Of a parameter that has changed it gives the change. It raises KeyError if no cause has such a parameter.
    """

    def read(gap: Gap) -> tuple[float, float | None]:
        for cause in gap["causes"]:
            for name, parameter in cause["parameters"].items():
                if name in names:
                    error, count = parameter["stderr"], parameter.get("standard_errors")
                    change = parameter["value"] - parameter.get("from", 0.0)
                    if count:
                        # the error of a change is that of both values
                        error = abs(change) / count
                    return factor * change, None if error is None else abs(factor) * error
        raise KeyError(f"none of {', '.join(names)} among the causes")

    return read


def write_log(path: Path, columns: Mapping[str, Array]) -> None:
    """Write a log."""
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")


def write_yaml(path: Path, document: Mapping[str, Any]) -> None:
    """Write a robot or trials file."""
    path.write_text(yaml.safe_dump(dict(document), sort_keys=False, default_flow_style=None, width=1000))


def write_robot(path: Path, **parts: Any) -> None:
    """Write a robot file whose robot has the name of the file."""
    write_yaml(path, {"format": "swimid-robot/1", "name": path.stem, **parts})


def write_pendulum(
    path: Path,
    coefficients: Mapping[str, Any],
    arms: Sequence[Mapping[str, Any]],
    hinges: Sequence[Mapping[str, Any]],
    **inputs: Mapping[str, Any],
) -> None:
    """Write a robot file of arms that hang in a row from a block, in air."""
    block = {"length_m": 0.1, "mass_kg": 1.0, "com_m": 0.05, "inertia_kg_m2": 8e-4}
    names = ["block", *(f"arm{k}" for k in range(1, len(arms) + 1))]
    links = [
        {"name": name, **link, "inertia_about": "com"}
        for name, link in zip(names, (block, *arms), strict=True)
    ]
    joints = [
        {"name": f"hinge{k}", "parent": names[k - 1], "child": names[k], **hinge}
        for k, hinge in enumerate(hinges, 1)
    ]
    multilink = {"plane": "vertical", "base": "fixed", "heading_deg": 90, "coefficients": coefficients}
    multilink |= {"links": links, "inputs": inputs, "joints": joints}
    multilink["elements"] = [{"kind": "hydrostatics", "link": name} for name in names[1:]]
    write_robot(path, fluid=AIR, multilink=multilink)


def write_trials(path: Path, experiment: str, robot: str, trials: Sequence[Mapping[str, Any]]) -> None:
    """Write a trials file."""
    head = {"format": "swimid-trials/1", "experiment": experiment, "robot": robot}
    write_yaml(path, {**head, "trials": [dict(trial) for trial in trials]})


def _existing(path: Path) -> Path:
    if not path.exists():
        raise MissingDataError(str(path))
    return path
