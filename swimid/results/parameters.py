"""Parameter file (``swimid-parameters/1``), which every fit writes, and the class of the result of a fit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import ConfigDict, Field, PrivateAttr, ValidationInfo, field_validator, model_validator

from swimid.errors import InputError, Named, UsageError, suggestion
from swimid.files import yamlio
from swimid.files.provenance import InputInMemory
from swimid.results import numbers
from swimid.results.evidence import Evidence, Table, Verdict
from swimid.results.next_command import find_inputs
from swimid.results.result import FileResult

if TYPE_CHECKING:
    import pandas as pd

FORMAT: Literal["swimid-parameters/1"] = "swimid-parameters/1"
#: Tolerance of the symmetry and of the range of correlations in a file, and maximum rounding error of an
#: entry with two decimals. Rounding changes an eigenvalue of a matrix with n rows by at most n times the
#: rounding error of an entry, because the norm of a matrix is at most n times its largest entry.
CORRELATION_TOLERANCE, MAX_ROUNDING = 1e-6, 0.005
Status = Literal["estimated", "fixed", "at-bound", "unidentifiable"]
#: Text that tables show for the status of an estimate, if it differs from the name of the status.
STATUS_TEXT = {"at-bound": "at its bound", "unidentifiable": "not identifiable"}


class Estimate(yamlio.Document):
    """Estimate of one parameter, with its standard error, unit, bounds and status.

    A simulation uses ``value`` whatever the status is. The data support the value only if the status is
    ``estimated``.
    """

    value: float
    stderr: float | None = Field(default=None, ge=0)
    unit: str
    bounds: tuple[float | None, float | None] = (None, None)
    status: Status
    #: Meaning of the parameter in words.
    meaning: str = ""

    @property
    def limits(self) -> tuple[float, float]:
        """Lower and upper bound of the parameter. A bound that the file omits is infinite."""
        return yamlio.limits(self.bounds)


def parameter_text(name: str, meaning: str) -> str:
    """Return the text that names a parameter in a sentence.

    If the meaning contains the words of the name, the text is these words. For other parameters the text is
    the meaning, followed by the name in brackets.

    >>> parameter_text("c_ma", "added mass over mass"), parameter_text("added_mass", "added mass")
    ('added mass over mass (c_ma)', 'added mass')
    """
    if not meaning:
        return name
    words = numbers.split_unit(name)[0].replace("_", " ")
    if set(words.split()) <= set(meaning.split()):
        return words
    return f"{meaning} ({name})"


class Correlation(yamlio.Document):
    """Correlation matrix of the estimated parameters of a fit, with the parameter name of each row."""

    names: list[str]
    #: Correlation coefficients, from -1 to 1 within :data:`CORRELATION_TOLERANCE`.
    matrix: list[list[Annotated[float, Field(ge=-1 - CORRELATION_TOLERANCE, le=1 + CORRELATION_TOLERANCE)]]]

    @model_validator(mode="after")
    def _is_of_names(self) -> Self:
        """Check the size, symmetry, diagonal and eigenvalues of the matrix."""
        lengths = {len(self.names), len(self.matrix), *map(len, self.matrix)}
        if len(lengths) > 1 or len(set(self.names)) < len(self.names):
            text = f"has rows of {', '.join(str(len(row)) for row in self.matrix) or 'no'} numbers"
            raise ValueError(f"the correlation matrix {text} for the names {', '.join(self.names)}")
        matrix = np.reshape(self.matrix, (len(self.names), len(self.names)))
        wrong = np.abs(matrix - np.where(np.eye(len(matrix)), 1.0, matrix.T)) > CORRELATION_TOLERANCE
        if wrong.any():
            first = " and ".join(self.names[k] for k in np.argwhere(wrong)[0])
            raise ValueError(f"the correlation matrix must be symmetric with a diagonal of 1; see {first}")
        if np.linalg.eigvalsh(matrix).min(initial=0.0) < -MAX_ROUNDING * len(matrix):
            raise ValueError(
                "the correlation matrix has a negative eigenvalue: no data have such correlations"
            )
        return self


class Pole(yamlio.Document):
    """Pole of a discrete-time model in the z plane, with the standard error of its magnitude."""

    real: float
    imag: float
    magnitude: float
    stderr_magnitude: float | None = None


if TYPE_CHECKING:
    Errors = dict[str, Any]
    Noise = dict[str, Any]
    HeldOut = dict[str, Any]
else:
    #: Errors of one channel, in its unit.
    Errors = yamlio.entries("Errors", rmse=float | None, nrmse=float | None, unit=str, samples=int | None)
    #: Noise of one channel: standard deviation of its values, and of its sample times.
    Noise = yamlio.entries("Noise", value_sd=float | None, time_sd_s=float | None)
    #: Trials that the fit did not use, and the errors of their channels.
    HeldOut = yamlio.entries("HeldOut", channels=dict[str, Errors])


class Fit(yamlio.Document):
    """Block ``fit`` of a parameter file: trials, errors of each channel, noise, convergence of the fit."""

    model_config = ConfigDict(extra="allow")

    trials: list[str]
    channels: dict[str, Errors] = {}
    validation: HeldOut = {}
    converged: bool
    #: Noise of each channel; for a discrete-time model, the entries of its single noise model.
    noise: dict[str, Noise | float | str | bool | None] = {}
    #: SHA-256 of the samples of each fitted trial, by trial id. A later trial with the same samples uses the
    #: per-trial parameters of this id.
    samples_sha256: dict[str, str] = {}


class ParameterFile(yamlio.ResultFile):
    """Content of a parameter file: the estimates of a fit, with its settings, errors and provenance.

    Use the value of a parameter that is not identifiable only together with all other parameters, in a
    simulation. A name such as ``start_offset[w10]`` is a parameter of one trial.

    Example::

        format: swimid-parameters/1
        model: falling-weight
        robot: boxfish
        parameters:
          drag_coefficient: {value: 0.705, stderr: 0.0004, unit: '1', bounds: [0.0, 5.0], status: estimated}
          linear_drag: {value: 0.0, stderr: null, unit: N s/m, bounds: [0.0, null], status: fixed}
        derived:
          terminal_speed[w10]: {value: 0.1654, stderr: 4.2e-05, unit: m/s, status: estimated}
        fit:
          trials: [w10]
          channels: {x_m: {rmse: 0.0021, nrmse: 0.0015, unit: m, samples: 240}}
          converged: true
    """

    kind: ClassVar[str] = "parameter file"

    format: Literal["swimid-parameters/1"] = FORMAT
    model: str
    robot: str | None = None
    #: Names of the effects that were added to the model. Their parameters have names of the form
    #: ``effect/parameter``.
    effects: list[str] = []
    parameters: dict[str, Estimate]
    #: Sentences that state which combinations of parameters the data determine and which they do not.
    identifiability: list[str] = []
    #: Settings of the fit that a simulation needs, such as model orders, subtracted means and column names.
    settings: dict[str, Any] = {}
    correlation: Correlation | None = None
    #: Quantities computed from the parameters, with their uncertainty.
    derived: dict[str, Estimate] = {}
    delay: int | None = None
    sample_time_s: float | None = None
    poles: list[Pole] | None = None
    stable: bool | None = None
    fit: Fit | None = None
    provenance: yamlio.Provenance = Field(default_factory=dict)
    #: Drag parameters that a fit of the recoil law (``fit-propulsion``) used; None for other fits. These
    #: parameters are not written to the file.
    _drag: ParameterFile | None = PrivateAttr(default=None)

    @field_validator("correlation")
    @classmethod
    def _names_agree(cls, found: Correlation | None, info: ValidationInfo) -> Correlation | None:
        """Check that the correlation names only parameters, or values that several parameters share."""
        known, shared = set(info.data.get("parameters", {})), info.data.get("settings", {}).get("shared")
        if isinstance(shared, dict):
            known |= set(shared)
        for name in () if found is None or not known else found.names:
            if name not in known:
                raise ValueError(
                    f"the correlation names '{name}', not a parameter; {suggestion(name, [*known])}"
                )
        return found

    def write(self, path: str | Path) -> None:
        """Write the parameter file, completely or not at all. Floating-point numbers are not rounded."""
        data = self.model_dump(mode="python", exclude_none=False)
        for estimate in (*data["parameters"].values(), *data["derived"].values()):
            if not estimate["meaning"]:
                del estimate["meaning"]
        optional = ("effects", "identifiability", "derived", "settings")
        kept = {k: value for k, value in data.items() if value is not None and (value or k not in optional)}
        yamlio.write(path, kept)

    def of_effect(self, name: str) -> dict[str, Estimate]:
        """Return the estimates of an effect's parameters, by the name of the parameter."""
        start = f"{name}/"
        return {n.removeprefix(start): e for n, e in self.parameters.items() if n.startswith(start)}

    def value(self, name: str) -> float:
        """Return the value of the parameter with the given name."""
        return self.parameters[name].value


#: Type of a source of parameters: the path of a parameter file, its content, or the result of a fit.
Source = str | Path | ParameterFile | FileResult[ParameterFile]


def source_path(source: Source) -> Path:
    """Return the path of a source of parameters, for messages and for relative paths in the parameters.

    A source in memory has the path ``parameters`` in the working folder.
    """
    if isinstance(source, str | Path):
        return Path(source)
    return Path("parameters")


def _file(source: Source) -> ParameterFile:
    """Return the content of a parameter file, given its path, its content or the result of a fit."""
    if isinstance(source, str | Path):
        return ParameterFile.read(source)
    if isinstance(source, ParameterFile):
        return source
    file = getattr(source, "file", None)
    if isinstance(file, ParameterFile):
        return file
    text = f"a {type(source).__name__} holds no parameters of a model"
    raise UsageError(text, hint="pass the path of a parameter file, or the result of a fit")


def origin(source: Source) -> Path | InputInMemory:
    """Return the entry with which a source of parameters is recorded in the provenance of a result.

    The entry is the path of a file, or the name and SHA-256 of parameters in memory.
    """
    if isinstance(source, str | Path):
        return Path(source)
    file = _file(source)
    content = file.model_copy(update={"provenance": {}})
    return InputInMemory(f"parameters of {file.model}", content.digest())


def read(source: Source, *, model: str | tuple[str, ...] | None = None) -> ParameterFile:
    """Return the content of a parameter file, from the file or from the result of a fit in memory.

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
    path = source_path(source)
    parameters = _file(source)
    models = model or (parameters.model,)
    if isinstance(models, str):
        models = (models,)
    if parameters.model not in models:
        text = f"holds parameters of the model '{parameters.model}', not of {' or '.join(models)}"
        raise InputError(text, file=path, column="model")
    return parameters


def robot_of(file: ParameterFile, path: Path, robot: str | None = None) -> tuple[str, Path | None]:
    """Return the robot of a parameter file, and the folder to which its path is relative.

    The robot is the name of a built-in robot or the path of a robot file.

    Raises
    ------
    InputError
        If neither the file nor the user names a robot.
    """
    if robot is not None:
        return robot, None
    if file.robot is None:
        raise InputError("this key is missing", file=path, column="robot", hint="give the robot: --robot")
    return file.robot, path.parent


def require(parameters: ParameterFile, names: tuple[str, ...], path: str | Path) -> list[float]:
    """Return the values of the named parameters of a file, in the order of ``names``.

    Raises
    ------
    InputError
        If a parameter is missing, or its status is ``unidentifiable``.
    """
    for name in names:
        column = f"parameters.{name}"
        if name not in parameters.parameters:
            hint = suggestion(name, list(parameters.parameters), "the file has")
            raise InputError("this parameter is missing", file=path, column=column, hint=hint)
        if parameters.parameters[name].status == "unidentifiable":
            text = "this parameter was not identifiable from its trials and cannot be used further"
            hint = "add trials that determine it, or fix it at a value from another source"
            raise InputError(text, file=path, column=column, hint=hint)
    return [parameters.value(name) for name in names]


# ---------------------------------------------------------------- result of a fit


class Fitted(FileResult[ParameterFile]):
    """Fitted parameters, returned by ``fit_drag``, ``fit_propulsion``, ``fit_graybox`` and ``rwls``.

    ``fitted["added_mass"]`` is one estimate, with ``value``, ``stderr``, ``unit``, ``bounds`` and ``status``.
    A simulation uses ``value`` whatever the status is. The data support the value only if the status is
    ``"estimated"``.

    Attributes
    ----------
    parameters : DataFrame
        A row for each parameter: ``value``, ``stderr``, ``low95``, ``high95`` (in ``unit``), ``status``.
    quantities : DataFrame
        Quantities computed from the parameters, with the same columns as ``parameters``.
    correlation : DataFrame
        Correlation matrix of the estimates, dimensionless.
    has_converged : bool
        Whether the fit converged to a minimum.
    file : ParameterFile
        Parameter file that :meth:`save` writes.

    Examples
    --------
    >>> fitted = Fitted.load("sample_logs/gap/params.yaml")
    >>> fitted.parameters.loc["c_ma", "status"], round(fitted["c_ma"].stderr, 3), fitted["d_p"].unit
    ('estimated', 0.066, 'm')
    """

    file_type = ParameterFile

    @property
    def next_step(self) -> str:  # type: ignore[override]
        """Command that usually follows: a comparison if the fit has a trials file, and else a report."""
        if not find_inputs(self):
            return FileResult.next_step
        own = "{own}" * (not self.file.effects)
        return f"swimid compare {{trials}}{own} --params {{file}} -o {{free[comparison.yaml]}}"

    @property
    def parameters(self) -> pd.DataFrame:
        """Table of the fitted parameters: value, standard error, 95 % interval, unit and status of each."""
        return _estimates_frame(self.file.parameters)

    @property
    def quantities(self) -> pd.DataFrame:
        """Table of the quantities that are computed from the parameters, such as a terminal speed.

        Its columns are those of :attr:`parameters`.
        """
        return _estimates_frame(self.file.derived)

    @property
    def correlation(self) -> pd.DataFrame:
        """Correlation matrix of the estimated parameters; empty without such a matrix in the file."""
        import pandas as pd

        found = self.file.correlation or Correlation(names=[], matrix=[])
        return pd.DataFrame(found.matrix, index=found.names, columns=found.names)

    @property
    def has_converged(self) -> bool:
        """Whether the fit converged to a minimum."""
        return self.file.fit is not None and self.file.fit.converged

    def __getitem__(self, name: str) -> Estimate:
        return Named(self.file.parameters | self.file.derived)[name]

    def _own_facts(self) -> dict[str, str]:
        file = self.file
        facts = {"Model": file.model, "Robot": file.robot or "", "Effects": ", ".join(file.effects)}
        if file.fit is not None:
            facts["Trials"] = str(len(file.fit.trials))
        if file.sample_time_s is not None:
            facts["Sample time"] = numbers.format_number(file.sample_time_s, unit="s")
        if file.delay is not None:
            facts["Delay"] = f"{file.delay} sample{'s' if file.delay != 1 else ''}"
        return {name: value for name, value in facts.items() if value}

    def _own_notes(self) -> list[str]:
        return self.file.identifiability

    def _own_tables(self) -> list[Table]:
        file = self.file
        shared = {name: e for name, e in file.parameters.items() if "[" not in name}
        own = {name: e for name, e in file.parameters.items() if name not in shared}
        tables = [
            _estimates("parameters", "Parameters", shared),
            _estimates("parameters-of-trials", "Parameters of single trials", own, folded=True),
            _estimates("derived", "Derived quantities", file.derived),
            _correlation(file.correlation),
        ]
        if file.fit is not None:
            tables.insert(3, _channels(file.fit))
        return [table for table in tables if table.rows]

    def bare(self) -> Evidence:
        """Return a verdict and tables, without checks and figures, for a fit whose evidence file is missing.

        The verdict follows from the convergence of the fit and from the status of the parameters.
        """
        parameters = self.file.parameters.items()
        weak = [parameter_text(name, e.meaning) for name, e in parameters if e.status == "unidentifiable"]
        verdict = Verdict(level="caution", text="No evidence file, so its checks cannot be shown.")
        if self.file.fit is not None and not self.file.fit.converged:
            verdict = Verdict(level="bad", text="The fit did not converge.")
        elif weak:
            verdict = Verdict(level="bad", text=f"Not identifiable: {', '.join(weak)}. No evidence file.")
            if any(e.status == "estimated" for _, e in parameters):
                verdict.level = "caution"
        title = f"Parameters of {self.file.model}"
        return Evidence(command=self.command, title=title, verdict=verdict, provenance=self.file.provenance)


def _estimates(id: str, title: str, estimates: dict[str, Estimate], *, folded: bool = False) -> Table:
    """Return a report table of estimates, rounded to two significant digits of their standard errors."""
    rows: list[list[Any]] = []
    for name, e in estimates.items():
        band, ends = "", numbers.confidence95(e.value, e.stderr)
        if e.status == "estimated" and ends is not None:
            band = numbers.interval(*ends, e.stderr)
        status = STATUS_TEXT.get(e.status, e.status)
        rows.append([name, estimate_text(e), band, status, e.meaning, numbers.bounds_text(e.bounds)])
    columns = ["parameter", "value ± se", "95 % interval", "status", "meaning", "allowed"]
    if not any(e.meaning for e in estimates.values()):
        columns.remove("meaning")
        rows = [[*row[:4], *row[5:]] for row in rows]
    return Table(id=id, title=title, columns=columns, rows=rows, folded=folded)


def estimate_text(estimate: Estimate) -> str:
    """Return the value and standard error of a parameter as text; a dash if it is not identifiable."""
    if estimate.status == "unidentifiable":
        return numbers.MISSING_TEXT
    if estimate.status == "fixed":
        return numbers.format_number(estimate.value, 6, estimate.unit)
    return numbers.format_estimate(estimate.value, estimate.stderr, estimate.unit)


def _correlation(correlation: Correlation | None) -> Table:
    """Return the report table of the correlation matrix of the estimates.

    The table has no rows if there are fewer than two estimates.
    """
    found = correlation or Correlation(names=[], matrix=[])
    rows: list[list[Any]] = []
    if len(found.names) > 1:
        for name, row in zip(found.names, found.matrix, strict=True):
            rows.append([name, *(numbers.format_fixed(r, 2) for r in row)])
    return Table(
        id="correlation",
        title="Correlation of the estimates",
        columns=["", *found.names],
        rows=rows,
        caption="Above 0.9 in size the trials determine a combination of two better than either of them.",
        folded=True,
    )


def _channels(fit: Fit) -> Table:
    """Return the report table of the errors of each channel, with its noise.

    Errors on fitted trials and on validation trials have separate rows.
    """
    rows: list[list[Any]] = []
    for label, entries in {"fit": fit.channels, "validation": fit.validation.get("channels", {})}.items():
        for name, entry in entries.items():
            unit, rmse, nrmse = str(entry.get("unit", "")), entry.get("rmse"), entry.get("nrmse")
            known = fit.noise.get(name)
            noise, ratio = _noise(known if isinstance(known, dict) else {}, rmse, unit)
            errors = [numbers.format_number(rmse, 3, unit), noise, ratio, numbers.percent(nrmse)]
            rows.append([name, label, *errors, entry.get("samples")])
    columns = ["channel", "data", "RMSE", "noise", "RMSE / noise", "NRMSE", "samples"]
    return Table(id="errors", title="Errors by channel", columns=columns, rows=rows)


def _noise(known: dict[str, Any], rmse: float | None, unit: str) -> tuple[str, str]:
    """Return the noise of a channel as text, and its root-mean-square error divided by the noise as text.

    The noise is the standard deviation of the values and, if it is known, of the sample times. The ratio is a
    dash if the sample times have noise.
    """
    sd, time_sd_s = known.get("value_sd"), known.get("time_sd_s")
    text, ratio = numbers.format_number(sd, 3, unit), numbers.MISSING_TEXT
    if time_sd_s:
        text += f", {numbers.format_number(1e3 * time_sd_s, 3, 'ms')} in time"
    elif rmse is not None and sd:
        ratio = numbers.format_number(rmse / sd, 3)
    return text, ratio


def _estimates_frame(estimates: dict[str, Estimate]) -> pd.DataFrame:
    import pandas as pd

    nothing = (float("nan"), float("nan"))
    return pd.DataFrame(
        [
            (e.value, e.stderr, *(numbers.confidence95(e.value, e.stderr) or nothing), e.unit, e.status)
            for e in estimates.values()
        ],
        columns=["value", "stderr", "low95", "high95", "unit", "status"],
        index=pd.Index(list(estimates), name="parameter"),
    )
