"""Parameter file (``swimid-parameters/1``), which every fit writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol

from pydantic import ConfigDict, Field, PrivateAttr

from swimid.errors import InputError
from swimid.files import yamlio
from swimid.files.provenance import Held
from swimid.results import numbers

FORMAT: Literal["swimid-parameters/1"] = "swimid-parameters/1"
Status = Literal["estimated", "fixed", "at-bound", "unidentifiable"]


class Estimate(yamlio.Document):
    """Estimate of one parameter.

    A simulation uses ``value`` whatever the status is. The data support the value only if the status is
    ``estimated``.
    """

    value: float
    stderr: float | None = None
    unit: str
    bounds: tuple[float | None, float | None] = (None, None)
    status: Status
    #: Meaning of the parameter in words.
    meaning: str = ""
    #: Profile-likelihood interval (95 %), if it was requested.
    ci95: tuple[float | None, float | None] | None = None


def spoken(name: str, meaning: str) -> str:
    """Return a parameter as text for a sentence: its name in words, or its meaning followed by its name.

    >>> spoken("c_ma", "added mass over mass"), spoken("added_mass", "added mass")
    ('added mass over mass (c_ma)', 'added mass')
    """
    if not meaning:
        return name
    words = numbers.split_unit(name)[0].replace("_", " ")
    if set(words.split()) <= set(meaning.split()):
        return words
    return f"{meaning} ({name})"


class Correlation(yamlio.Document):
    """Correlation matrix of the estimated parameters."""

    names: list[str]
    matrix: list[list[float]]


class Pole(yamlio.Document):
    """A pole of a discrete-time model in the z plane."""

    real: float
    imag: float
    magnitude: float
    stderr_magnitude: float | None = None


class Fit(yamlio.Document):
    """Errors of a fit by channel, and whether the fit converged."""

    model_config = ConfigDict(extra="allow")

    trials: list[str]
    channels: dict[str, dict[str, Any]] = {}
    validation: dict[str, Any] = {}
    converged: bool
    noise: dict[str, Any] = {}


class ParameterFile(yamlio.ResultFile):
    """Content of a parameter file."""

    kind: ClassVar[str] = "parameter file"

    format: Literal["swimid-parameters/1"] = FORMAT
    model: str
    robot: str | None = None
    parameters: dict[str, Estimate]
    #: Sentences about the combinations of parameters that the data determine or do not determine.
    identifiability: list[str] = []
    correlation: Correlation | None = None
    #: Quantities computed from the parameters, with their uncertainty.
    derived: dict[str, Estimate] = {}
    delay: int | None = None
    sample_time_s: float | None = None
    poles: list[Pole] | None = None
    stable: bool | None = None
    #: Settings that are part of the model: orders, removed means, columns, wake convention.
    settings: dict[str, Any] = {}
    fit: Fit | None = None
    provenance: dict[str, Any] = Field(default_factory=dict)
    #: Drag parameters that were used in the fit of the recoil law, if they were in memory.
    _drag: ParameterFile | None = PrivateAttr(default=None)

    def write(self, path: str | Path) -> None:
        """Write the file, complete or not at all. Floating-point numbers are not rounded."""
        data = self.model_dump(mode="python", exclude_none=False)
        for estimate in (*data["parameters"].values(), *data["derived"].values()):
            for key in ("meaning", "ci95"):
                if not estimate[key]:
                    del estimate[key]
        optional = ("identifiability", "derived", "settings")
        kept = {k: value for k, value in data.items() if value is not None and (value or k not in optional)}
        yamlio.write(path, kept)

    def value(self, name: str) -> float:
        """Return the value of one parameter."""
        return self.parameters[name].value


class HasFile(Protocol):
    """Result of a fit, an object with a parameter file."""

    @property
    def file(self) -> ParameterFile:
        """Parameter file of the fit."""


#: Source of parameters: a parameter file, its content, or the result of a fit.
Source = str | Path | ParameterFile | HasFile


def place(source: Source) -> Path:
    """Return the path of the parameters for messages. Paths in the parameters are relative to its folder."""
    if isinstance(source, str | Path):
        return Path(source)
    return Path("parameters")


def _file(source: Source) -> ParameterFile:
    """Return the content of the parameter file."""
    if isinstance(source, str | Path):
        return ParameterFile.read(source)
    if isinstance(source, ParameterFile):
        return source
    return source.file


def origin(source: Source) -> Path | Held:
    """Return the entry of the parameters in the provenance: a path, or a name and a digest."""
    if isinstance(source, str | Path):
        return Path(source)
    file = _file(source)
    content = file.model_copy(update={"provenance": {}})
    return Held(f"parameters of {file.model}", content.digest())


def read(source: Source, *, model: str | tuple[str, ...] | None = None) -> ParameterFile:
    """Read a parameter file, or take the parameters of a fit in memory.

    Parameters
    ----------
    source : path, ParameterFile or result of a fit
    model : str or tuple of str, optional
        Names of the accepted models. By default every model is accepted.

    Raises
    ------
    InputError
        If the source is not a parameter file, or has another model.
    """
    path = place(source)
    parameters = _file(source)
    models = model
    if isinstance(model, str):
        models = (model,)
    if models and parameters.model not in models:
        raise InputError(
            f"holds parameters of the model '{parameters.model}', not of {' or '.join(models)}",
            file=path,
            column="model",
        )
    return parameters


def require(parameters: ParameterFile, names: tuple[str, ...], path: str | Path) -> list[float]:
    """Return the values of parameters, which must be in the file and must be identifiable.

    Raises
    ------
    InputError
        If a parameter is missing, or its status is ``unidentifiable``.
    """
    values = []
    for name in names:
        estimate = parameters.parameters.get(name)
        if estimate is None:
            raise InputError("this parameter is missing", file=path, column=f"parameters.{name}")
        if estimate.status == "unidentifiable":
            raise InputError(
                "this parameter was not identifiable from its trials and cannot be used further",
                file=path,
                column=f"parameters.{name}",
                hint="add trials that tell it apart, or fix it from another source",
            )
        values.append(estimate.value)
    return values
