"""``swimid track setup``: draft a setup file from a video."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError, NoTrustworthyResult, UsageError
from swimid.files import atomic
from swimid.notices import warn
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.tracking import camera, census, draft, motion, pick, propose
from swimid.tracking.draft import SetupDraft
from swimid.tracking.options import Pick, TrackSetupOptions
from swimid.tracking.propose import Candidate, Passed
from swimid.tracking.reader import Frame, Video
from swimid.tracking.run import Run, follow
from swimid.tracking.setup import Marker, Setup

#: A proposal the tracker itself finds in fewer frames than this share is dropped.
_LEAST_FOUND = 0.05
#: Candidates that are tried as first marker, and trials of each: every trial reads the film once.
_TRIES = 3


@dataclass(frozen=True)
class _Draft:
    """A setup, the run that tried it, a remark on each kind of marker, and what was passed over."""

    setup: Setup
    run: Run
    remarks: list[str]
    passed: list[Passed]


@takes(TrackSetupOptions)
def track_setup(
    video: str | Path,
    *,
    options: TrackSetupOptions,
    output: str | Path | None = None,
    force: bool = False,
    progress: Progress = silent,
) -> SetupDraft:
    """Propose markers, draw them, and draft a setup that ``track_video`` takes as it is.

    Without picks the markers are proposed from what moves. Without any scale positions are in pixels.

    Parameters
    ----------
    video : path
        The film to draft from.
    output : path, optional
        The setup file; a PNG with the markers drawn in goes beside it. Without it nothing is written.
    force : bool
        Replace an existing setup.
    progress : Progress
        Shows the passes over the video.

    Returns
    -------
    SetupDraft
        ``.setup`` for ``track_video``, ``.sheet`` the picture, shape (height, width, 3).

    Raises
    ------
    UsageError
        The setup exists and ``force`` was not given; scale options that contradict.
    InputError
        The video cannot be read.
    NoTrustworthyResult
        No marker can be proposed.

    Examples
    --------
    >>> draft = track_setup("pool.mp4", metres_per_pixel=0.0015)  # doctest: +SKIP
    >>> made = track_video("pool.mp4", setup=draft.setup)  # doctest: +SKIP
    """
    if output is not None:
        output = atomic.check_writable(output, inputs=(video,))
        if output.exists() and not force:
            raise UsageError(f"{output} exists", hint="name another file, or give --force to replace it")
    scale = _scale(options.metres_per_pixel, options.scale_points, options.scale_distance_m)
    video = Path(video)
    common: dict[str, Any] = {"scale": scale, "plane": options.plane, "frame_rate_hz": options.fps}
    drafted = (
        _by_hand(video, options.picks, options.frame, common, progress)
        if options.picks
        else _unattended(video, common, progress)
    )
    setup, run = _measured(drafted.setup, drafted.run), drafted.run
    shares = {name: float(run.track.found[i].mean()) for i, name in enumerate(run.track.names)}
    _doubts(setup, run, shares)
    text = draft.text_of(setup, shares, drafted.remarks, drafted.passed, video.name)
    lines = [
        f"{name}: found in {100 * share:.1f} % of the frames, hue {_hue(setup.marker(name))}, "
        f"area {_area(setup.marker(name))} px"
        for name, share in shares.items()
    ]
    lines += [f"passed over: {colour}" for colour in drafted.passed]
    lines.append(
        f"head {setup.head or setup.marker_names[0]}"
        + (f", tail {setup.tail}" if setup.tail else "; no tail, so no yaw")
    )
    if setup.scale is None:
        lines.append("no scale yet: positions will be in pixels. Fill in 'scale' in the file")
    if output is not None:
        lines.append(
            f"look at {output.with_suffix('.markers.png').name}, then: "
            f"swimid track video {video.name} --setup {output.name} -o run.csv"
        )
    data = {
        "markers": [m.model_dump(mode="json", exclude_none=True) for m in setup.markers],
        "head": setup.head,
        "tail": setup.tail,
        "found_share": shares,
        "passed_over": [{"colour": p.name, "hue_deg": p.hue_deg, "reason": p.reason} for p in drafted.passed],
    }
    sheet = draft.sheet_of(run, setup)
    result = SetupDraft("track setup", "\n".join(lines), data, document=text, sheet=sheet)
    return result if output is None else result.save(output)


def _scale(
    factor: float | None, points: tuple[float, float, float, float] | None, distance_m: float | None
) -> dict[str, Any] | None:
    if factor is not None and (points is not None or distance_m is not None):
        raise UsageError(
            "contradicting scales: give --metres-per-pixel, or --scale-points with --scale-distance-m"
        )
    if (points is None) != (distance_m is None):
        raise UsageError("--scale-points and --scale-distance-m go together")
    for name, value in (("--metres-per-pixel", factor), ("--scale-distance-m", distance_m)):
        if value is not None and not value > 0:
            raise UsageError(f"{name} {value:g} must be above 0")
    if factor is not None:
        return {"metres_per_pixel": factor}
    if points is None:
        return None
    if points[:2] == points[2:]:
        raise UsageError("the two --scale-points are the same")
    return {"points_px": [list(points[:2]), list(points[2:])], "distance_m": distance_m}


def _setup(markers: list[Marker], head: str | None, tail: str | None, common: dict[str, Any]) -> Setup:
    data = {
        "format": "swimid-setup/1",
        "markers": [m.model_dump(exclude_none=True) for m in markers],
        "head": head,
        "tail": tail,
        **common,
    }
    return Setup.model_validate(data)


def _unattended(video: Path, common: dict[str, Any], progress: Progress) -> _Draft:
    """The best candidate that can be followed and moves, with the partner it keeps its distance to."""
    with progress(f"looking at {video.name}") as step:
        samples = propose.sample(video, step=step)
    found, passed = propose.candidates(samples)
    shift = samples.factor * camera.shifts(samples.frames)
    _camera_still(shift, samples.info.width)
    reasons: dict[int, str] = {}
    for k, first in enumerate(found[:_TRIES]):
        for second in [*propose.partners(first, found[k + 1 :])[: _TRIES - 1], None]:
            pair = [first] if second is None else [first, second]
            if second is not None and not propose.leads(first, second):
                pair.reverse()
            setup, run = _tried(video, pair, common, progress)
            scene = camera.between(shift, samples.indices, len(run.track.times))
            faults = _faults(run, pair, scene)
            reasons |= {id(pair[i]): text for i, text in faults.items()}
            if not faults:
                for candidate in pair:
                    reasons.pop(id(candidate), None)
                rest = [c for c in found if c not in pair]
                passed += [_passed(c, reasons.get(id(c)) or _weaker(c, pair)) for c in rest]
                return _Draft(setup, run, [_remark(c) for c in pair], passed)
            if any(pair[i] is first for i in faults):
                break
    passed = [_passed(c, reasons[id(c)]) for c in found if id(c) in reasons] + passed
    raise NoTrustworthyResult(
        f"no marker of {video.name} can be followed and moves. {propose.listed(passed)}"
        f"{census.describe_colours(samples.frames[::6])}",
        hint="pick the markers by hand: --marker name@x,y with --frame",
    )


def _tried(
    video: Path, pair: list[Candidate], common: dict[str, Any], progress: Progress
) -> tuple[Setup, Run]:
    """Follow one or two candidates through the film."""
    names: list[str] = []
    for candidate in pair:
        names.append(propose.name_of(candidate, names))
    markers = [propose.as_marker(c, n) for c, n in zip(pair, names, strict=True)]
    setup = _setup(markers, names[0], names[1] if len(names) > 1 else None, common)
    still = [box for candidate in pair for box in candidate.still if not _crossed(box, pair)]
    setup = setup.model_copy(update={"ignore_px": still})
    with progress(f"trying {', '.join(names)}") as step:
        run = follow(video, setup, step=step)
    return run.setup, run


def _camera_still(shift: motion.Array, width: int) -> None:
    """Warn of a camera that moves."""
    largest = float(np.nanmax(np.hypot(*shift.T), initial=0.0))
    if largest > camera.limit_px(width):
        warn(
            "SWM068",
            f"the whole scene shifts by {largest:.1f} px in the film: the camera moves. What moves with it "
            "is taken for no marker, but a log will hold the camera's motion",
        )


def _faults(run: Run, pair: list[Candidate], scene: motion.Array | None) -> dict[int, str]:
    """Why candidates of a trial are no markers, by their place in ``pair``.

    ``scene``, shape (2, n), px, is how far the scene is shifted in each frame.
    """
    faults: dict[int, str] = {}
    track = run.track
    for i, (name, candidate) in enumerate(zip(track.names, pair, strict=True)):
        share, reach = float(track.found[i].mean()), motion.reach(track, name, scene)
        if share < max(_LEAST_FOUND, 0.3 * candidate.presence):
            faults[i] = f"cannot be followed (found in {100 * share:.1f} % of the frames)"
        elif not reach.moves:
            faults[i] = f"does not move (stays within {reach.radii:.2g} of its radius of one place)"
    if faults or len(pair) == 1:
        return faults
    first, second = track.names
    weaker = int(pair[0].score >= pair[1].score)
    apart = motion.distance(track, first, second)
    other = track.names[1 - weaker]
    if apart is None:
        faults[weaker] = f"is hardly seen together with {other}"
    elif apart.change > motion.KEPT[1]:
        faults[weaker] = (
            f"its distance to {other} changes by {100 * apart.change:.0f} %: they are on no rigid part"
        )
    return faults


def _passed(candidate: Candidate, reason: str) -> Passed:
    return Passed(candidate.name, candidate.hue_deg, reason)


def _weaker(candidate: Candidate, pair: list[Candidate]) -> str:
    best = max(pair, key=lambda c: c.score)
    if candidate.score >= propose.SECOND_SHARE * best.score and len(pair) == 1:
        return f"not seen together with {best.name} at one distance"
    return f"less like a marker (score {candidate.score:.2f}, {best.name} {best.score:.2f})"


def _crossed(box: tuple[float, float, float, float], pair: list[Candidate]) -> bool:
    """Whether a marker was seen inside a box: it must not be ignored then."""
    left, top, right, bottom = box
    for candidate in pair:
        reach = np.sqrt(candidate.area_px[1] / 3)
        x, y = candidate.place.T
        if np.any((x > left - reach) & (x < right + reach) & (y > top - reach) & (y < bottom + reach)):
            return True
    return False


def _remark(candidate: Candidate) -> str:
    text = f"score {candidate.score:.2f}, seen in {100 * candidate.presence:.0f} % of the samples"
    if candidate.like > 1:
        text += f"; {candidate.like} patches of this colour move together: the largest is followed"
    return text


def _by_hand(
    video: Path, picks: tuple[Pick, ...], index: int, common: dict[str, Any], progress: Progress
) -> _Draft:
    """The markers picked; those of one name are equal ones, told apart by their places."""
    kinds: dict[str, list[tuple[float, float]]] = {}
    for one in picks:
        kinds.setdefault(one.name, []).append((one.x, one.y))
    picture = _frame(video, index)
    markers = pick.markers(picture, kinds, path=video, index=index)
    names = [name for marker in markers for name in marker.names]
    head, tail = names[0], names[1] if len(names) > 1 else None
    setup = _setup(markers, head, tail, common)
    with progress(f"trying {', '.join(kinds)}") as step:
        run = follow(video, setup, step=step)
    remarks = ["picked by hand"] * len(markers)
    if tail is not None and markers[0].number > 1:
        # Equal markers may be on one body or on several; only a rigid pair gives a heading.
        apart = motion.distance(run.track, head, tail)
        if apart is None or apart.change > motion.KEPT[1]:
            setup = setup.model_copy(update={"tail": None})
            remarks[0] += f"; {head} and {tail} keep no distance, so there is no tail"
    return _Draft(setup, run, remarks, [])


def _doubts(setup: Setup, run: Run, shares: dict[str, float]) -> None:
    """Warn of markers hardly found, of those that do not move, and of a pair that keeps no distance."""
    for name, share in shares.items():
        reach = motion.reach(run.track, name)
        if share < _LEAST_FOUND:
            warn("SWM040", f"marker '{name}' is found in {100 * share:.1f} % of the frames only")
        elif not reach.moves:
            warn(
                "SWM067",
                f"marker '{name}' stays within {reach.radii:.2g} of its radius of one place: "
                "is it the marker, or a still thing of its colour?",
            )
    if setup.head is None or setup.tail is None:
        return
    apart = motion.distance(run.track, setup.head, setup.tail)
    if apart is not None and apart.change > motion.KEPT[0]:
        warn(
            "SWM042",
            f"the distance of '{setup.head}' and '{setup.tail}' changes by {100 * apart.change:.1f} % beyond "
            "what a camera askew explains: on one rigid part it would not",
        )


def _frame(video: Path, index: int) -> Frame:
    if index < 0:
        raise UsageError(f"--frame {index} must not be negative")
    count = 0
    for count, (_, frame) in enumerate(Video(video).frames(), start=1):
        if count - 1 == index:
            return frame
    raise InputError(f"has {count} frames; frame {index} does not exist", file=video)


def _measured(setup: Setup, run: Run) -> Setup:
    """The setup with area ranges from what the tracker measured."""
    markers = []
    for marker in setup.markers:
        i = run.track.names.index(marker.names[0])
        whole = run.track.found[i] & ~run.track.at_edge[i]
        if whole.sum() >= 10:
            low, high = np.percentile(run.track.area[i, whole], [2, 98])
            marker = marker.model_copy(
                update={"area_px": (float(max(round(0.3 * low), 4)), float(round(2.5 * high)))}
            )
        markers.append(marker)
    return setup.model_copy(update={"markers": markers})


def _hue(marker: Marker) -> str:
    low, high = marker.colour_range().hue_deg
    return f"{low:g}..{high:g} deg"


def _area(marker: Marker) -> str:
    return "any" if marker.area_px is None else f"{marker.area_px[0]:g}..{marker.area_px[1]:g}"
