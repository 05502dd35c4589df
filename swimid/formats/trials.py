"""The trials file (``swimid-trials/1``): what every fit reads."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Discriminator, Field, PositiveFloat, Tag, model_validator

from swimid.errors import InputError, nearest
from swimid.formats import robot as robot_format
from swimid.formats import yamlio

FORMAT = "swimid-trials/1"


class Drive(yamlio.Document):
    """The commanded tail beat (interfaces: free-swim)."""

    waveform: Literal["sine", "hopf", "a-cpg"] = "sine"
    frequency_hz: PositiveFloat
    amplitude_deg: Annotated[float, Field(ge=0)]
    bias_deg: float = 0.0
    asymmetry: Annotated[float, Field(gt=-1, lt=1)] = 0.0
    ramp_s: Annotated[float, Field(ge=0)] = 1.0
    #: Phase of the beat at t = 0.
    phase_deg: float = 0.0


class StrokeDrive(yamlio.Document):
    """A stroke of the robot file: several joints at once."""

    stroke: str
    #: Cycles a second; default those of the stroke.
    frequency_hz: PositiveFloat | None = None
    #: What its angles are multiplied with.
    scale: Annotated[float, Field(ge=0)] = 1.0
    ramp_s: Annotated[float, Field(ge=0)] = 0.0
    #: After so many the joints rest.
    cycles: PositiveFloat | None = None
    phase_deg: float = 0.0


def _kind_of_drive(value: Any) -> str:
    named = "stroke" in value if isinstance(value, dict) else isinstance(value, StrokeDrive)
    return "stroke" if named else "beat"


class Trial(yamlio.Document):
    """Keys every trial has."""

    id: str = ""
    log: str
    role: Literal["fit", "validate"] = "fit"
    #: Use the log from and up to these times only.
    start_s: float | None = None
    end_s: float | None = None

    @model_validator(mode="before")
    @classmethod
    def _name_after_log(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("log"), str) and "id" not in data:
            data = {**data, "id": Path(data["log"]).name}
        return data


class RigTrial(Trial):
    """Keys of a trial on a single-degree-of-freedom rig; they override the robot's."""

    inertial_mass_kg: Annotated[float, Field(ge=0)] | None = None
    frontal_area_m2: PositiveFloat | None = None
    fluid_density_kg_m3: PositiveFloat | None = None


class FallingWeightTrial(RigTrial):
    """A body pulled by a falling weight over a pulley, or driven by a known force."""

    pulling_mass_kg: PositiveFloat | None = None
    driving_force_N: float | None = None

    @model_validator(mode="after")
    def _one_drive(self) -> FallingWeightTrial:
        if (self.pulling_mass_kg is None) == (self.driving_force_N is None):
            raise ValueError("give either 'pulling_mass_kg' or 'driving_force_N'")
        return self


class FreeSwimTrial(Trial):
    """A free-swimming trial; without ``drive`` the log's joint columns are the input."""

    drive: (
        Annotated[
            Annotated[Drive, Tag("beat")] | Annotated[StrokeDrive, Tag("stroke")],
            Discriminator(_kind_of_drive),
        ]
        | None
    ) = None
    #: Coefficients that were set otherwise in this trial (a spring's stiffness, say).
    coefficients: dict[str, float] = {}


class _Trials(yamlio.Document):
    format: Literal["swimid-trials/1"]
    robot: str


class FallingWeight(_Trials):
    """Falling-weight trials."""

    experiment: Literal["falling-weight"]
    trials: Annotated[list[FallingWeightTrial], Field(min_length=1)]


class Towed(_Trials):
    """Trials under a measured force."""

    experiment: Literal["towed"]
    trials: Annotated[list[RigTrial], Field(min_length=1)]


class FreeDecay(_Trials):
    """Trials of a displaced body left to itself."""

    experiment: Literal["free-decay"]
    trials: Annotated[list[RigTrial], Field(min_length=1)]


class Cruise(_Trials):
    """A table of cruising speeds."""

    experiment: Literal["cruise"]
    table: str
    drag: str | None = None


class FreeSwim(_Trials):
    """Free-swimming trials."""

    experiment: Literal["free-swim"]
    trials: Annotated[list[FreeSwimTrial], Field(min_length=1)]


class Multibody(_Trials):
    """Trials of a robot with links whose logs hold joint angles, pose, or both."""

    experiment: Literal["multibody"]
    trials: Annotated[list[FreeSwimTrial], Field(min_length=1)]


class Arma(_Trials):
    """Trials for a black-box model from one input column to one output column."""

    experiment: Literal["arma"]
    input: str | None = None
    output: str | None = None
    trials: Annotated[list[Trial], Field(min_length=1)]


EXPERIMENTS: dict[str, type[_Trials]] = {
    "falling-weight": FallingWeight,
    "towed": Towed,
    "free-decay": FreeDecay,
    "cruise": Cruise,
    "free-swim": FreeSwim,
    "multibody": Multibody,
    "arma": Arma,
}
T = TypeVar("T", bound=_Trials)


def read(path: str | Path, *experiments: type[T]) -> T:
    """Read a trials file of one of the given experiments.

    Raises
    ------
    InputError
        For broken YAML, unknown keys, another experiment than those, repeated trial ids.
    """
    path = Path(path)
    data = yamlio.of_format(path, FORMAT, "trials file")
    names = [name for name, kind in EXPERIMENTS.items() if not experiments or kind in experiments]
    experiment = data.get("experiment")
    if experiment not in names:
        line = data.lc.key("experiment")[0] + 1 if "experiment" in data else None
        close = nearest(str(experiment), names)
        what = f"'{experiment}' is not allowed" if "experiment" in data else "is missing"
        raise InputError(
            f"{what}; here: {', '.join(names)}",
            file=path,
            line=line,
            column="experiment",
            hint=f"did you mean '{close}'?" if close else None,
        )
    trials: T = yamlio.validate(data, EXPERIMENTS[experiment], path)  # type: ignore[assignment]
    seen: set[str] = set()
    for index, trial in enumerate(getattr(trials, "trials", [])):
        if trial.id in seen:
            line = data["trials"].lc.item(index)[0] + 1
            raise InputError(f"two trials have the id '{trial.id}'", file=path, line=line, column="id")
        seen.add(trial.id)
    return trials


def robot_of(trials: _Trials, path: str | Path) -> robot_format.Robot:
    """The robot a trials file names, by built-in name or path relative to the file."""
    return robot_format.read(trials.robot, Path(path).parent)


#: Any trials file, for the JSON Schema.
AnyTrials = Annotated[
    FallingWeight | Towed | FreeDecay | Cruise | FreeSwim | Multibody | Arma,
    Field(discriminator="experiment"),
]
