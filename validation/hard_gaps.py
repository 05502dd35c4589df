"""Hard cases for ``swimid diagnose``, made without swimid, with what has to be said of each.

Causes that act as one unlike them does, noise that resembles a gap and a gap that resembles noise, causes
outside the catalogue, and logs as strangers keep them.

``python -m validation.hard_gaps --out DIR [CASE ...]`` makes each, runs the command and prints a table.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tests.generators import files, gap_trials, rig
from validation.blind import cruises, decays, rig_effects, swim_actuation
from validation.blind.common import write_parameters
from validation.blind.swim_case import Act, Channels, Trial

SEED = 31
SAMPLE = Path(__file__).parents[1] / "sample_logs" / "rig"
#: Frequency (Hz), amplitude (deg) and bias (deg) of a fish's twelve trials; two settings come twice.
TWELVE = tuple(
    (frequency, amplitude, bias)
    for frequency, rest in (
        (1.0, ((20, 0), (20, 0), (30, 10), (25, -8))),
        (1.4, ((20, -12), (25, 0), (30, 0), (30, 8))),
        (1.8, ((20, 0), (25, 8), (25, 8), (20, -10))),
    )
    for amplitude, bias in rest
)
ANY = frozenset({"explained", "ambiguous", "unexplained"})
FRICTION = frozenset({"pulley-friction", "stribeck", "load-friction"})


@dataclass(frozen=True)
class Answer:
    """What a diagnosis says, as far as it is judged.

    Attributes
    ----------
    causes : list of (set of str, float, dict of name to (value, stderr))
        Effect with its equivalents, probability and sizes.
    closed : tuple of float
        Share closed of each channel that has a gap, held out.
    first : list of str
        The effects themselves.
    said : str
        Reasons, advice and warnings.
    """

    verdict: str
    causes: list[tuple[frozenset[str], float, dict[str, tuple[float, float | None]]]]
    closed: tuple[float, ...]
    first: list[str]
    said: str = ""

    @classmethod
    def of(cls, gap: Mapping[str, Any], said: str = "") -> Answer:
        """From the document of a gap file."""
        causes = [
            (
                frozenset({c["effect"], *c["equivalent"]}),
                float(c["probability"]),
                {name: (p["value"], p["stderr"]) for name, p in c["parameters"].items()},
            )
            for c in gap["causes"]
        ]
        rows = gap["causes"][0]["shrinkage"] if gap["causes"] else []
        closed = tuple(r["closed"] for r in rows if r["closed"] is not None)
        return cls(gap["verdict"], causes, closed, [c["effect"] for c in gap["causes"]], said)


@dataclass(frozen=True)
class Truth:
    """What may be said of a case, and what must.

    Attributes
    ----------
    verdicts : set of str
    acts : set of str
        Effects at work, with those of the same kind: every cause told must be one of them, or stand beside
        one among its equivalents.
    most : int
        Causes at most.
    whole : bool
        Whether each of them must be named if any is.
    alone : bool
        Whether nothing else may stand among the equivalents.
    anything : bool
        Whether any other effect may be told, too.
    surest : float
        Largest probability of a cause.
    closed : float
        Least share that each channel's gap is closed by.
    noted : str
        What must be mentioned where the verdict is ``none``.
    """

    verdicts: frozenset[str]
    acts: frozenset[str] = frozenset()
    most: int = 1
    whole: bool = False
    alone: bool = False
    anything: bool = False
    surest: float = 1.0
    closed: float = -math.inf
    noted: str = ""

    def wrong(self, answer: Answer) -> list[str]:
        """What is wrong with an answer; nothing of a right one."""
        sets = [names for names, _, _ in answer.causes]
        known = frozenset().union(*sets)
        faults = []
        if answer.verdict not in self.verdicts:
            faults.append(answer.verdict)
        faults += [" or ".join(sorted(n)) for n in sets if not (self.anything or n & self.acts)]
        if len(sets) > self.most:
            faults.append(f"{len(sets)} causes")
        if self.whole and answer.verdict != "none" and not self.acts <= known:
            faults.append(f"without {', '.join(sorted(self.acts - known))}")
        if self.alone and not known <= self.acts:
            faults.append(f"equivalent {', '.join(sorted(known - self.acts))}")
        if any(p > self.surest for _, p, _ in answer.causes):
            faults.append("too sure")
        if sets and any(share < self.closed for share in answer.closed):
            faults.append(f"closed {min(answer.closed):.0%}")
        if answer.verdict == "none" and self.noted not in answer.said:
            faults.append(f"no word of {self.noted}")
        return faults


@dataclass(frozen=True)
class Case:
    """A case and how a user would ask.

    Attributes
    ----------
    make : callable
        Writes ``trials.yaml`` and the logs into a folder, and ``params.yaml`` where it is of another day.
    says : str
        What must be said, in words.
    fit : tuple of str
        Options of the fit that makes ``params.yaml``, where it is of these trials.
    verb : str
        The fit.
    asked : tuple of str
        Effects that are asked for alone in a second run, which must find the same sizes.
    """

    make: Callable[[Path], None]
    says: str
    truth: Truth
    fit: tuple[str, ...] | None = None
    verb: str = "fit-drag"
    asked: tuple[str, ...] = field(default=())


def rng(*stream: int) -> np.random.Generator:
    """Random numbers of one use."""
    return np.random.default_rng([SEED, *stream])


# ---------------------------------------------------------------- the tendon fish


def steady(speed_m_s: float) -> Act:
    """Water that moves at one velocity everywhere and always."""
    velocity = speed_m_s * np.exp(0.7j)
    return Act(flow=lambda trial, t: np.full(len(t), velocity))


def lag(lag_s: float) -> Act:
    """A servo damped so far beyond its critical damping that it is all but of first order."""
    damping = 3.0
    return Act(joints=lambda trial, t, q: swim_actuation.second_order(t, q, 2.0 * damping / lag_s, damping))


def rounded(place_m: float, angle_deg: float) -> Act:
    """A log that keeps so many digits."""

    def broken(trial: Trial, log: Channels, t: np.ndarray) -> Channels:
        step = {name: place_m if name.endswith("_m") else np.radians(angle_deg) for name in log}
        return {n: v if n == "t_s" else np.round(v / step[n]) * step[n] for n, v in log.items()}

    return Act(broken=broken)


def fish(*acts: Act, **options: Any) -> Callable[[Path], None]:
    """Trials of a tendon fish, and its coefficients as of another day."""

    def make(folder: Path) -> None:
        gap_trials.write(folder, "tfish", acts, **{"seed": SEED, **options})

    return make


def slipping(folder: Path) -> None:
    """The tendon slips after 7 s of every trial, and a third of the stroke is lost from then on."""
    act = swim_actuation.slip(rng(5), 2.2, "tfish")
    gap_trials.write(folder, "tfish", [act], seed=SEED, duration_s=7.0 / act.facts["share"])


# ---------------------------------------------------------------- rigs


def write_trials(folder: Path, experiment: str, robot: str, entries: Mapping[str, str]) -> None:
    """The trials file of logs with these names, each with what else its entry says."""
    trials = [f"log: {name}.csv, id: {name}{more}" for name, more in entries.items()]
    files.write_trials(folder / "trials.yaml", experiment, robot, trials)


def drops(
    stream: int,
    change: Callable[[rig_effects.Rig, int], None],
    weights_g: Sequence[float],
    repeats: int = 1,
    friction_sd: float = 0.01,
) -> Callable[[Path], None]:
    """Weights let go so many times each, seen by a camera at 30 Hz; change is given each drop and its place
    among the weights.
    """

    def make(folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        entries = {}
        for k, grams in enumerate(np.repeat(weights_g, repeats)):
            own = rng(stream, k)
            friction = 3080.0 * own.normal(1.0, friction_sd)
            drag = 0.5 * rig_effects.DENSITY * 0.705 * rig_effects.AREA
            drop = rig_effects.Rig(grams, drag, 685.0, friction, False, own)
            change(drop, k // repeats)
            t, x = drop.fall()
            frames = np.arange(0.0, t[-1], 1.0 / 30.0)
            place = np.interp(frames, t, x) / 100.0 + own.normal(0.0, 0.001, len(frames))
            name = f"w{grams:g}{'abc'[k % repeats]}".replace(".", "_")
            files.write_log(folder / f"{name}.csv", {"t_s": frames, "x_m": place}, "%.6f")
            entries[name] = f", pulling_mass_kg: {grams / 1000:g}"
        write_trials(folder, "falling-weight", "boxfish", entries)

    return make


def in_a_wave(drop: rig_effects.Rig, _: int) -> None:
    """Let go always at the same phase of a standing wave of the tank."""
    omega = 2.0 * np.pi * 0.25

    def wave(t: float, x: float) -> tuple[float, float]:
        level = 0.5 * np.cos(np.pi * (x - 30.0) / 300.0)
        return level * np.sin(omega * t + 0.8), level * omega * np.cos(omega * t + 0.8)

    drop.flow.append(wave)


def pushed(drop: rig_effects.Rig, _: int) -> None:
    """A force of 12 mN that wanders with a memory of 3 s, unlike in each drop."""
    time, memory = np.arange(0.0, 40.0, 0.05), 3.0
    force = drop.rng.normal(0.0, 1200.0, len(time))
    for n in range(1, len(time)):
        kept = np.exp(-0.05 / memory)
        force[n] = kept * force[n - 1] + np.sqrt(1.0 - kept**2) * force[n]
    drop.forces.append(lambda t, x, v: float(np.interp(t, time, force)))


def mislabelled(drop: rig_effects.Rig, place: int) -> None:
    """Weights that are not what is written on them, by up to 0.8 g."""
    drop.weight += (0.4, -0.6, 0.8, -0.3)[place]


def as_it_is(drop: rig_effects.Rig, place: int) -> None:
    """Nothing."""


def mislabelled_stroke(folder: Path) -> None:
    """A table of cruises; what is written as 18 degrees was 16.5."""

    def smaller(session: cruises.Session) -> None:
        those = np.isclose(session.command, np.radians(18.0))
        session.amplitude.append(lambda a: np.where(those, a - np.radians(1.5), a))

    cruises.make_case(folder, robot="cruise", effect=None, size=1.0, rng=rng(10), more=(smaller,))
    for unused in folder.glob("params*.yaml"):
        unused.unlink()


def dry_drive(folder: Path) -> None:
    """A carriage on a slide with dry friction, pushed to and fro."""
    rig.write_slide(folder, rng(4)).rename(folder / "trials.yaml")


def dry_drops(folder: Path) -> None:
    """Drops over a pulley with dry friction."""
    rig.write_falls(folder, rng(4, 1))


def tangent(roll: float) -> float:
    """What a spring that grows as a tangent, to no end at 40 degrees, adds to its angle, rad."""
    bend = 0.5 * np.pi / np.radians(40.0)
    return float(np.tan(bend * roll) / bend - roll)


def stops(roll: float) -> float:
    """The same of a spring that is three times as stiff beyond 10 degrees."""
    return float(2.0 * np.sign(roll) * max(abs(roll) - np.radians(10.0), 0.0))


def roll_decays(stiffer: Callable[[float], float]) -> Callable[[Path], None]:
    """Six roll decays against a spring that stiffens."""

    def make(folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        body, added = 0.002, 0.35
        stiffness = body * (2.0 * np.pi * 1.2) ** 2
        critical = 2.0 * np.sqrt(stiffness * body * (1.0 + added))
        entries = {}
        for k, start_deg in enumerate((9.0, -12.0, 15.0, -18.0, 21.0, 24.0)):
            own, start = rng(5, 1, k), np.radians(start_deg)
            decay = decays.Decay(
                body * (1.0 + added), stiffness, 0.02 * critical, 0.015 * critical, start, own
            )
            decay.moments.append(lambda _, roll, __: -stiffness * stiffer(roll))
            t, roll = decay.swing()
            frames = np.arange(0.0, t[-1], 0.02)
            seen = np.interp(frames, t, roll) + own.normal(0.0, np.radians(0.25), len(frames))
            files.write_log(folder / f"roll{k + 1}.csv", {"t_s": frames, "roll_rad": seen}, "%.6f")
            entries[f"roll{k + 1}"] = ""
        (folder / "hull.yaml").write_text(
            f"format: swimid-robot/1\nname: hull\nbody: {{roll_inertia_kg_m2: {body:.6g}}}\n"
            f"rig: {{roll_stiffness_N_m_rad: {stiffness:.6g}}}\n"
        )
        write_trials(folder, "free-decay", "hull.yaml", entries)

    return make


def one_with_another_drag(folder: Path) -> None:
    """Seven weights; at one of them the body has a third more drag."""
    rig.write_falls(folder, rng(5, 2), odd={25: {"drag_coefficient": 1.33 * 0.705}})


def stranger(
    weights_g: Sequence[int], change: Callable[[int, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
) -> Callable[[Path], None]:
    """Some of the sample's drops, as somebody else keeps them."""

    def make(folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        for grams in weights_g:
            t, x = np.genfromtxt(SAMPLE / f"w{grams}.csv", delimiter=",", comments="#", skip_header=5).T
            t, x = change(grams, t, x)
            files.write_log(folder / f"w{grams}.csv", {"t_s": t, "x_m": x}, "%.6f")
        entries = {f"w{grams}": f", pulling_mass_kg: {grams / 1000:g}" for grams in weights_g}
        write_trials(folder, "falling-weight", "boxfish", entries)

    return make


def coarse(step_m: float) -> Callable[[Path], None]:
    """Two drops whose displacements are rounded."""
    return stranger((20, 30), lambda _, t, x: (t, np.round(x / step_m) * step_m))


def slow_clock(grams: int, t: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One drop was timed by a clock that is 10 % slow."""
    return (0.9 * t if grams == 20 else t), x


def drifting(grams: int, t: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The camera creeps: a random walk of about 2 cm over the drop."""
    walk = np.cumsum(rng(6).normal(0.0, 0.02 / np.sqrt(len(x)), len(x)))
    return t, x + walk - walk[0]


def drifting_camera(folder: Path) -> None:
    """One drop, which alone tells no coefficient: they are known from another day."""
    stranger((25,), drifting)(folder)
    known = {
        "drag_coefficient": (0.71, 0.01, "1", "estimated"),
        "added_mass": (0.69, 0.02, "kg", "estimated"),
        "pulley_friction": (0.0305, 0.001, "N", "estimated"),
    }
    write_parameters(folder / "params.yaml", "falling-weight", "boxfish", known)


# ---------------------------------------------------------------- the list

NONE = frozenset({"none"})
EXPLAINED = frozenset({"explained"})
UNNAMED = Truth(frozenset({"unexplained"}), most=0)
CASES: dict[str, Case] = {
    "fish-current": Case(
        fish(steady(0.036), settings=TWELVE),
        "explained by current, all closed; asked alone the same fit",
        Truth(EXPLAINED, frozenset({"current"}), alone=True, closed=0.9),
        asked=("current",),
    ),
    "fish-lag": Case(
        fish(lag(0.070)),
        "explained by servo-lag, nothing equivalent",
        Truth(EXPLAINED, frozenset({"servo-lag"}), alone=True),
    ),
    "drops-wave": Case(
        drops(3, in_a_wave, (12.5, 20.0, 30.0, 40.0), 3),
        "a gap; waves if anything is named",
        Truth(ANY, frozenset({"waves"})),
        fit=(),
    ),
    "drive-dry": Case(
        dry_drive,
        "dry friction and nothing else",
        Truth(ANY, FRICTION),
        fit=("--fix", "quadratic_drag=0", "--free", "linear_drag", "--free", "force_offset"),
    ),
    "drops-dry": Case(
        dry_drops, "dry friction and nothing else", Truth(ANY, FRICTION), fit=("--fix", "pulley_friction=0")
    ),
    "fish-backlash": Case(
        fish(swim_actuation.servo_backlash(rng(4, 2), 2.0, "tfish")),
        "servo-backlash and nothing else",
        Truth(frozenset({"explained", "ambiguous"}), frozenset({"servo-backlash"})),
    ),
    "fish-slip": Case(slipping, "slip, or unexplained", Truth(ANY, frozenset({"slip"}))),
    "decay-tangent": Case(
        roll_decays(tangent), "hardening, or unexplained", Truth(ANY, frozenset({"hardening"})), fit=()
    ),
    "decay-stops": Case(
        roll_decays(stops), "hardening, or unexplained", Truth(ANY, frozenset({"hardening"})), fit=()
    ),
    "drops-odd-one": Case(
        one_with_another_drag,
        "unexplained, or none with a word of the odd trial",
        Truth(frozenset({"unexplained", "none"}), noted="w25"),
        fit=(),
    ),
    "drops-pushed": Case(
        drops(7, pushed, (10, 15, 20, 25, 30, 40)),
        "a gap, and no confident cause",
        Truth(frozenset({"unexplained"}), anything=True, surest=0.5),
        fit=(),
    ),
    "drops-mislabelled": Case(
        drops(8, mislabelled, (10, 20, 30, 40), 3), "a gap, and nothing that causes it", UNNAMED, fit=()
    ),
    "drops-scatter": Case(
        drops(9, as_it_is, (10, 20, 30, 40), 3, friction_sd=0.1), "none", Truth(NONE), fit=()
    ),
    "table-mislabelled": Case(
        mislabelled_stroke, "a gap, and nothing that causes it", UNNAMED, fit=(), verb="fit-propulsion"
    ),
    "rounded-30mm": Case(coarse(0.030), "none", Truth(NONE), fit=()),
    "rounded-15mm": Case(coarse(0.015), "none", Truth(NONE), fit=()),
    "slow-clock": Case(
        stranger((10, 20, 30, 40), slow_clock),
        "unexplained, a set with clock-rate, or no gap in the others of a trial that is left out",
        Truth(ANY | {"none"}, frozenset({"clock-rate"}), noted="left out w20"),
        fit=(),
    ),
    "drifting-camera": Case(
        drifting_camera,
        "no confident cause",
        Truth(frozenset({"none", "ambiguous", "unexplained"}), anything=True, surest=0.5),
    ),
    "fish-scatter": Case(fish(scatter=2.5), "none", Truth(NONE)),
    "fish-rounded": Case(fish(rounded(0.001, 0.1)), "none", Truth(NONE)),
    "fish-lag-current": Case(
        fish(lag(0.030), steady(0.020)),
        "servo-lag and current, or sets with both",
        Truth(ANY, frozenset({"servo-lag", "current"}), most=2, whole=True),
    ),
}


# ---------------------------------------------------------------- running them


@dataclass(frozen=True)
class Outcome:
    """A case as it went."""

    answer: Answer
    faults: list[str]
    wall_s: float


def command(*words: str | Path) -> subprocess.CompletedProcess[str]:
    """The command line in a process of its own."""
    line = [sys.executable, "-m", "swimid", *map(str, words)]
    return subprocess.run(line, capture_output=True, text=True, check=False)


def diagnosed(folder: Path, *options: str, name: str = "gap.yaml") -> Answer:
    """The answer to the trials in a folder."""
    words = ("diagnose", folder / "trials.yaml", "--params", folder / "params.yaml", "-o", folder / name)
    ran = command(*words, "--json", "--no-progress", *options)
    if ran.returncode:
        raise RuntimeError(ran.stderr)
    gap = json.loads(ran.stdout)["result"]
    shown = json.loads((folder / name).with_suffix(".evidence.json").read_text())["verdict"]["text"]
    said = [*gap["reasons"], shown, *(advice["text"] for advice in gap["advice"]), ran.stderr]
    return Answer.of(gap, "\n".join(said))


def outcome(case: Case, folder: Path) -> Outcome:
    """Make a case, fit where a user would, diagnose, and judge."""
    case.make(folder)
    if case.fit is not None:
        fitted = command(case.verb, folder / "trials.yaml", *case.fit, "-o", folder / "params.yaml", "-q")
        if not (folder / "params.yaml").exists():
            raise RuntimeError(fitted.stderr)
    begun = time.perf_counter()
    answer = diagnosed(folder)
    wall_s = time.perf_counter() - begun
    faults = case.truth.wrong(answer)
    if case.asked:
        alone = diagnosed(folder, "--effects", ",".join(case.asked), name="gap-asked.yaml")
        faults += [f"alone: {fault}" for fault in case.truth.wrong(alone)]
        faults += unlike(answer, alone)
    return Outcome(answer, faults, wall_s)


def unlike(answer: Answer, other: Answer) -> list[str]:
    """Sizes that two answers do not agree on within their standard errors."""
    sizes, others = ({n: v for _, _, own in a.causes for n, v in own.items()} for a in (answer, other))
    if sizes.keys() != others.keys():
        return ["alone: other causes"]
    apart = [n for n, (v, sd) in sizes.items() if abs(v - others[n][0]) > (sd or 0.0)]
    return [f"alone: {n} {others[n][0]:.3g}" for n in apart]


def row(name: str, case: Case, found: Outcome) -> str:
    """A line of the table."""
    causes = []
    for first, (names, p, sizes) in zip(found.answer.first, found.answer.causes, strict=True):
        rivals = ", ".join(sorted(names - {first}))
        numbers = ", ".join(f"{n} {v:.3g}" + (f" ± {sd:.1g}" if sd else "") for n, (v, sd) in sizes.items())
        causes.append(f"{first} {p:.2f}{f' or {rivals}' if rivals else ''} ({numbers})")
    closed = found.answer.closed
    share = f"{min(closed):.0%} to {max(closed):.0%}" if closed else "-"
    right = "right" if not found.faults else f"WRONG: {'; '.join(found.faults)}"
    cells = (name, case.says, found.answer.verdict, " + ".join(causes) or "-", share, f"{found.wall_s:.0f}")
    return f"| {' | '.join(cells)} | {right} |"


def main(argv: Sequence[str] | None = None) -> None:
    """Make, diagnose and judge the cases asked for."""
    parser = argparse.ArgumentParser(prog="python -m validation.hard_gaps", description=__doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}; default all")
    parser.add_argument("--out", type=Path, required=True, help="folder for the cases and their gap files")
    chosen = parser.parse_args(argv)
    unknown = set(chosen.cases) - set(CASES)
    if unknown:
        parser.error(f"no case {', '.join(sorted(unknown))}; there are {', '.join(CASES)}")
    print(
        "| case | must be said | verdict | causes | closed | wall s | |\n|---|---|---|---|---|---|---|",
        flush=True,
    )
    for name in chosen.cases or CASES:
        case = CASES[name]
        try:
            line = row(name, case, outcome(case, chosen.out / name))
        except RuntimeError as error:
            line = f"| {name} | {case.says} | - | - | - | - | WRONG: {' '.join(str(error).split())} |"
        print(line, flush=True)


if __name__ == "__main__":
    main()
