"""The command ``track setup``: draft a setup file from a film."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, NoTrustworthyResult, UsageError
from swimid.files import atomic, provenance, yamlio
from swimid.notices import warn
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results.result import Result
from swimid.tracking import detect, propose, quality
from swimid.tracking import setup as setup_format
from swimid.tracking.options import TrackSetupOptions
from swimid.tracking.propose import Candidate
from swimid.tracking.reader import MEASURED, Frame, Video, write_text
from swimid.tracking.setup import FORMAT, Marker, Setup
from swimid.tracking.tracker import Run, follow

#: Maximum number of candidates for the first marker, and maximum number of trials of each. Every trial reads
#: the film once.
MAX_TRIALS = 3
#: Number of pictures on the contact sheet, and their width, px.
N_TILES, TILE_WIDTH = 4, 640
_HEAD = "# Drafted by swimid track setup from {}; correct it if needed. All keys: docs/tracking.md\n"
#: Comment with the keys that a draft does not have.
_MORE = """\
# Without scale positions are in pixels. One of:
# scale: {metres_per_pixel: 0.0015}
# scale: {points_px: [[x1, y1], [x2, y2]], distance_m: 1.0}
# scale: {points_px: [four corners], points_m: [the same corners]}
# True frame rate, if the stamps of the container are wrong:
# frame_rate_hz: 240
# The pose is that of the head marker. To get that of the reference point of the robot, give at_m of
# head and tail, or the robot whose file has markers of these names:
# robot: sealion
"""


@dataclass(frozen=True, eq=False)
class SetupDraft(Result):
    """Draft of a setup, as ``track_setup`` returns it; ``document`` is its commented YAML.

    Attributes
    ----------
    sheet : ndarray of uint8, shape (height, width, 3)
        RGB picture of frames with the markers circled and named: ``plt.imshow(draft.sheet)``.
    """

    sheet: NDArray[np.uint8] | None = None

    @property
    def setup(self) -> Setup:
        """Setup that can be passed to ``track_video``."""
        return setup_format.of(yamlio.parse_scalar(self.document))

    def _write(self, path: Path) -> list[Path]:
        atomic.write_text(path, self.document)
        if self.sheet is None:
            return [path]
        picture = path.with_suffix(".markers.png")
        _, data = cv2.imencode(".png", cv2.cvtColor(self.sheet, cv2.COLOR_RGB2BGR))
        with atomic.replacing(picture) as temporary:
            temporary.write_bytes(provenance.mark_png(data.tobytes()))
        return [path, picture]


@takes(TrackSetupOptions)
def track_setup(
    video: str | Path,
    *,
    options: TrackSetupOptions,
    output: str | Path | None = None,
    force: bool = False,
    progress: Progress = silent,
) -> SetupDraft:
    """Propose markers, draw them, and draft a setup that ``track_video`` can use as it is.

    Without picked markers, coloured patches that move are proposed. Without a scale, positions are in pixels.

    Parameters
    ----------
    video : path
        File of the film.
    output : path, optional
        Setup file to write. A PNG with the markers drawn in is written to the same folder. Without ``output``
        nothing is written.
    force : bool
        Whether an existing setup is replaced.
    progress : Progress
        Shows the progress of each reading of the film.

    Returns
    -------
    SetupDraft
        Draft. ``.setup`` can be passed to ``track_video``, and ``.sheet`` is the picture with the markers.

    Raises
    ------
    UsageError
        The setup exists and ``force`` was not given, or options contradict each other.
    InputError
        The film cannot be read.
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
    video = Path(video)
    common: dict[str, Any] = {"plane": options.plane, "frame_rate_hz": options.fps}
    if options.metres_per_pixel is not None:
        common["scale"] = {"metres_per_pixel": options.metres_per_pixel}
    rejected: list[Candidate] = []
    if options.picks:
        run = _from_picks(video, options, common, progress)
    else:
        run, rejected = _from_film(video, common, progress)
    setup = _with_areas(run)
    shares = {name: float(run.track.found[i].mean()) for i, name in enumerate(run.track.names)}
    for name in run.track.names:
        code, fault = quality.marker_fault(run.track, name)
        if fault:
            warn(code, f"marker '{name}' {fault}")
    ahead = None
    if setup.tail is not None:
        ahead = quality.head_first(run.track, *setup.roles)
    lines = [f"{name}: found in {100 * share:.1f} % of the frames" for name, share in shares.items()]
    lines += [f"passed over: {one}" for one in rejected]
    lines.append(f"head {setup.head}, tail {setup.tail}")
    if setup.tail is None:
        lines[-1] = f"head {setup.head}; no tail, so no yaw"
    if ahead is not None:
        lines.append(f"swims head first in {100 * ahead:.0f} % of the steps")
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
        "head_first_share": ahead,
        "found_share": shares,
        "passed_over": [{"colour": p.name, "hue_deg": p.hue_deg, "reason": p.reason} for p in rejected],
    }
    text, sheet = _text(setup, shares, rejected, video.name), _sheet(run)
    return SetupDraft("track setup", "\n".join(lines), data, document=text, sheet=sheet).saved(output)


def _setup(markers: list[Marker], common: dict[str, Any]) -> Setup:
    """Return a setup in which the first marker is the head, and the second marker, if any, is the tail."""
    head, *rest = [name for marker in markers for name in marker.names]
    return Setup(format=FORMAT, markers=markers, head=head, tail=rest[0] if rest else None, **common)


def _try(video: Path, setup: Setup, progress: Progress) -> Run:
    """Follow the markers of a setup through the film."""
    with progress(f"trying {', '.join(marker.name for marker in setup.markers)}") as step:
        return follow(video, setup, step=step)


def _from_film(video: Path, common: dict[str, Any], progress: Progress) -> tuple[Run, list[Candidate]]:
    """Return a trial of the best moving candidate, with a second marker if possible, and the other colours.

    The second marker must have a constant distance from the first one.
    """
    with progress(f"looking at {video.name}") as step:
        samples = propose.sample(video, step=step)
    found, rejected = propose.find_candidates(samples)
    shift = samples.factor * quality.scene_shifts(samples.frames)
    consequence = ". What moves with it is taken for no marker, but a log will hold the camera's motion"
    quality.check_camera(shift, samples.video.width, consequence)
    reasons: dict[int, str] = {}
    for k, first in enumerate(found[:MAX_TRIALS]):
        for second in [*propose.partners(first, found[k + 1 :])[: MAX_TRIALS - 1], None]:
            pair = [one for one in (first, second) if one is not None]
            run = _try(video, _pair_setup(pair, common), progress)
            faults = _faults(
                run, pair, quality.interpolate_shifts(shift, samples.indices, len(run.track.times))
            )
            reasons |= {id(pair[i]): text for i, text in faults.items()}
            if not faults:
                head, tail = run.setup.roles[0], run.setup.tail
                if tail is not None and (quality.head_first(run.track, head, tail) or 0.0) < 0.5:
                    run = replace(run, setup=run.setup.model_copy(update={"head": tail, "tail": head}))
                rest = [c for c in found if c not in pair]
                weaker = f"less like a marker than {pair[0].name}, or at no constant distance from it"
                rejected += [replace(c, reason=reasons.get(id(c), weaker)) for c in rest]
                return run, rejected
            if any(pair[i] is first for i in faults):
                break
    rejected = [replace(c, reason=reasons[id(c)]) for c in found if id(c) in reasons] + rejected
    raise NoTrustworthyResult(
        f"no marker of {video.name} can be followed and moves. {propose.listed(rejected)}"
        f"{detect.describe_colours(samples.frames[::6])}",
        hint="pick the markers by hand: --marker name@x,y with --frame",
    )


def _pair_setup(pair: list[Candidate], common: dict[str, Any]) -> Setup:
    """Return a setup of one or two candidates, each named by its hue."""
    names = [candidate.name for candidate in pair]
    if len(set(names)) < len(names):
        names[1] += "-b"
    markers = [
        Marker(name=name, hsv=candidate.colours, area_px=candidate.area_px)
        for name, candidate in zip(names, pair, strict=True)
    ]
    return _setup(markers, common)


def _faults(run: Run, pair: list[Candidate], scene: quality.Array | None) -> dict[int, str]:
    """Return the reasons why candidates of a trial are not markers, by their index in ``pair``.

    ``scene``, shape (2, n), is the shift of the scene in each frame, px.
    """
    track = run.track
    faults: dict[int, str] = {}
    for i, (name, candidate) in enumerate(zip(track.names, pair, strict=True)):
        min_share = max(quality.MIN_SHARE, 0.3 * candidate.presence)
        _, faults[i] = quality.marker_fault(track, name, min_share, scene)
    faults = {i: fault for i, fault in faults.items() if fault}
    if faults or len(pair) == 1:
        return faults
    first, second = track.names
    weaker = int(pair[0].score >= pair[1].score)
    separation = quality.distance_change(track, first, second)
    other = track.names[1 - weaker]
    if separation is None:
        faults[weaker] = f"is hardly seen together with {other}"
    elif separation > quality.MAX_DISTANCE_SD[1]:
        change = f"{100 * separation:.0f} %"
        faults[weaker] = f"its distance to {other} changes by {change}: they are on no rigid part"
    return faults


def _from_picks(video: Path, options: TrackSetupOptions, common: dict[str, Any], progress: Progress) -> Run:
    """Return a trial of the picked markers."""
    kinds: dict[str, list[tuple[float, float]]] = {}
    for pick in options.picks:
        kinds.setdefault(pick.name, []).append((pick.x, pick.y))
    frame = _frame(video, options.frame)
    markers = propose.pick_markers(frame, kinds, path=video, index=options.frame)
    run = _try(video, _setup(markers, common), progress)
    if markers[0].number > 1:
        # equal markers may be on several bodies, and only a rigid pair gives a heading
        separation = quality.distance_change(run.track, *run.setup.roles)
        if separation is None or separation > quality.MAX_DISTANCE_SD[1]:
            run = replace(run, setup=run.setup.model_copy(update={"tail": None}))
    return run


def _frame(video: Path, index: int) -> Frame:
    """Return one frame of a film; raise an InputError if the frame does not exist."""
    for _, frame in islice(Video(video).frames(), index, None):
        return frame
    raise InputError(f"has no frame {index}", file=video)


def _with_areas(run: Run) -> Setup:
    """Return the setup of a trial with ranges of the areas that were measured in the trial."""
    markers = []
    for marker in run.setup.markers:
        i = run.track.row(marker.names[0])
        whole = run.track.found[i]
        if whole.sum() >= 10:
            low, high = np.percentile(run.track.area[i, whole], [2, 98])
            area = (float(max(round(0.3 * low), 4)), float(round(2.5 * high)))
            marker = marker.model_copy(update={"area_px": area})
        markers.append(marker)
    return run.setup.model_copy(update={"markers": markers})


def _text(setup: Setup, shares: dict[str, float], rejected: list[Candidate], video: str) -> str:
    """Return the setup as commented YAML, with the fraction of frames in which each marker is found."""
    notes = [f"# {name}: found in {100 * share:.1f} % of the frames\n" for name, share in shares.items()]
    notes += [f"# Passed over: {one}\n" for one in rejected]
    data = setup.model_dump(mode="json", exclude_none=True)
    return "".join([_HEAD.format(video), *notes, yamlio.dumps(data), _MORE])


def _sheet(run: Run) -> NDArray[np.uint8]:
    """Return a contact sheet of frames with circled and named markers, and with ignored boxes."""
    tiles, track = [], run.track
    ranked = sorted(run.kept, key=lambda k: (not track.found[:, k].all(), k))
    for index in sorted(ranked[:N_TILES]):
        frame = run.kept[index]
        factor = TILE_WIDTH / frame.shape[1]
        tile = cv2.resize(frame, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
        for box in run.setup.ignore_px:
            corners = [round(factor * v) for v in box]
            cv2.rectangle(tile, corners[:2], corners[2:], (200, 200, 200), 1)
        for i in np.flatnonzero(track.found[:, index]):
            x, y = round(factor * track.x[i, index]), round(factor * track.y[i, index])
            radius = round(factor * float(np.sqrt(track.area[i, index] / np.pi))) + 5
            cv2.circle(tile, (x, y), radius, MEASURED, 2, cv2.LINE_AA)
            write_text(tile, track.names[i], (x + radius + 3, y + 4), 0.5)
        write_text(tile, f"frame {index}", (8, tile.shape[0] - 8), 0.5)
        tiles.append(tile)
    return np.asarray(cv2.cvtColor(np.vstack(tiles), cv2.COLOR_BGR2RGB), dtype=np.uint8)
