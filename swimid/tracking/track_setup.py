"""Command ``track setup``, which drafts a setup file from a film."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from itertools import combinations, islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, NoTrustworthyResult, UsageError
from swimid.files import atomic, provenance, yamlio
from swimid.notices import Progress, silent, warn
from swimid.options import takes
from swimid.points.scale import Camera
from swimid.results.result import Text
from swimid.tracking import frames, picking, proposals
from swimid.tracking import setup as setup_format
from swimid.tracking.frames import Video
from swimid.tracking.options import TrackSetupOptions
from swimid.tracking.proposals import MarkerCandidate, distance_change, marker_fault, setup_of
from swimid.tracking.setup import Marker, Setup
from swimid.tracking.tracker import FilmTrack, follow

#: Maximum number of candidate colours that are followed through the film.
MAX_TRIALS = 4
#: Number of frames on the contact sheet, and their width, px.
N_TILES, TILE_WIDTH = 4, 640
#: Minimum score of a second proposed marker, relative to the score of the first.
SECOND_SHARE = 0.25
_HEAD = "# Drafted by swimid track setup from {}; correct it if needed. All keys: swimid schema setup\n"
#: Comment at the end of a drafted setup, on the keys that the draft does not have.
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
class SetupDraft(Text):
    """Draft of a setup, which ``track_setup`` returns. Its ``document`` is YAML text with comments.

    Attributes
    ----------
    sheet : ndarray of uint8, shape (height, width, 3)
        RGB picture of frames with the markers circled and named: ``plt.imshow(draft.sheet)``.
    """

    sheet: NDArray[np.uint8] | None = None

    next_step = "swimid track video {data[video]} --setup {file} -o {free[run.csv]}"

    @property
    def setup(self) -> Setup:
        """Setup of the draft, which can be passed to ``track_video``."""
        return setup_format.read_setup(yamlio.parse_scalar(self.document))

    def _write(self, path: Path) -> list[Path]:
        written = super()._write(path)
        if self.sheet is None:
            return written
        picture = path.with_suffix(".markers.png")
        _, data = cv2.imencode(".png", cv2.cvtColor(self.sheet, cv2.COLOR_RGB2BGR))
        with atomic.replace_file(picture) as temporary:
            temporary.write_bytes(provenance.mark_png(data.tobytes()))
        return [*written, picture]


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
    With ``pick``, a page in the browser shows the film, and the user picks markers and scale there.

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
    output, video = _free(video, output, force), Path(video)
    common = _common_keys(options)
    if options.pick:
        camera = common.get("camera")

        def finish(markers: list[Marker], common: dict[str, Any], progress: Progress) -> SetupDraft:
            _free(video, output, force)
            common |= {"camera": camera}
            return _draft(video, _follow_chosen(video, markers, common, progress), [], output)

        picked: SetupDraft = picking.pick(video, options, common, finish, output=output, progress=progress)
        return picked
    if options.picks or options.background:
        markers = _make_markers(video, options) if options.picks else [picking.BODY]
        return _draft(video, _follow_chosen(video, markers, common, progress), [], output)
    return _draft(video, *_from_film(video, common, progress), output)


def _common_keys(options: TrackSetupOptions) -> dict[str, Any]:
    """Return the keys of the setup that the options state, apart from the markers."""
    common: dict[str, Any] = {"plane": options.plane, "frame_rate_hz": options.fps}
    if options.metres_per_pixel is not None:
        common["scale"] = {"metres_per_pixel": options.metres_per_pixel}
    camera = options.camera
    if isinstance(camera, str | Path):
        from swimid.tracking.track_camera import CameraFile

        camera = CameraFile.read(camera).camera
    if camera is not None:
        common["camera"] = Camera.model_validate(camera).model_dump(mode="json")
    return common


def _free(video: str | Path, output: str | Path | None, force: bool) -> Path | None:
    """Return the path of the output, and raise an error if it cannot be written or must not be replaced."""
    if output is None:
        return None
    output = atomic.check_writable(output, inputs=(video,))
    if output.exists() and not force:
        raise UsageError(f"{output} exists", hint="name another file, or give --force to replace it")
    return output


def _draft(video: Path, run: FilmTrack, rejected: list[MarkerCandidate], output: Path | None) -> SetupDraft:
    """Return the draft of a setup that was tried on the film, after it is written to ``output`` if given."""
    setup = run.setup
    shares = {name: float(run.track.is_whole[i].mean()) for i, name in enumerate(run.track.names)}
    _warn_of_faults(run)
    ahead = None if setup.tail is None else run.track.head_first(*setup.roles)
    notes = [f"{name}: found in {100 * share:.1f} % of the frames" for name, share in shares.items()]
    notes += [f"passed over: {one}" for one in rejected]
    lines = [*notes, f"head {setup.head}, tail {setup.tail}"]
    if setup.tail is None:
        lines[-1] = f"head {setup.head}; no tail, so no yaw"
    if ahead is not None:
        lines.append(f"swims head first in {100 * ahead:.0f} % of the steps")
    if setup.scale is None:
        lines.append("no scale yet: positions will be in pixels. Fill in 'scale' in the file")
    if output is not None:
        lines.append(f"look at {output.with_suffix('.markers.png').name}")
    data = {
        "video": str(video),
        "markers": [m.model_dump(mode="json", exclude_none=True) for m in setup.markers],
        "head": setup.head,
        "tail": setup.tail,
        "head_first_share": ahead,
        "found_share": shares,
        "passed_over": [{"colour": p.name, "hue_deg": p.hue_deg, "reason": p.reason} for p in rejected],
    }
    comments = "".join(f"# {note}\n" for note in notes)
    keys = yamlio.dumps(setup.model_dump(mode="json", exclude_none=True))
    text = "".join([_HEAD.format(video.name), comments, keys, _MORE])
    return SetupDraft("track setup", "\n".join(lines), data, document=text, sheet=_sheet(run)).write_output(
        output
    )


def _warn_of_faults(run: FilmTrack) -> None:
    """Warn of markers that are hardly found, do not move, are not unique, or are on no rigid body."""
    setup, track = run.setup, run.track
    for name in track.names:
        code, fault = marker_fault(track, name)
        if fault:
            warn(code, f"marker '{name}' {fault}")
    for marker in setup.markers:
        if marker.name in track.others:
            warn("SWM172", track.others[marker.name])
    if setup.tail is None or setup.markers[0].method == "background":
        return
    change = distance_change(run, *setup.roles) or 0.0
    if change > frames.MAX_DISTANCE_SD[0]:
        text = f"the distance of '{setup.head}' and '{setup.tail}' changes by {100 * change:.1f} %"
        hint = "pick two markers on one rigid part, with --marker NAME@X,Y for each"
        warn("SWM042", f"{text}: {hint}")


def _try(video: Path, setup: Setup, progress: Progress) -> FilmTrack:
    """Follow the markers of a setup through the film, and return the track in pixels."""
    with progress(f"trying {', '.join(marker.name for marker in setup.markers)}") as step:
        return follow(video, setup, step=step)


def _from_film(
    video: Path, common: dict[str, Any], progress: Progress
) -> tuple[FilmTrack, list[MarkerCandidate]]:
    """Return the track of the most likely marker in a film and, if possible, of a second marker.

    The second returned value holds the rejected colours, each with the reason.

    All candidate colours are followed at once. Of the pairs whose distance is constant, the pair with the
    highest scores is returned, or, if no distance is constant, the pair whose distance changes least.
    """
    with progress(f"looking at {video.name}") as step:
        samples = proposals.sample_frames(video, step=step)
    found, rejected = proposals.find_candidates(samples)
    shift = samples.factor * frames.scene_shifts(samples.frames)
    consequence = ". Objects that move with it are not taken as markers, but a log will contain its motion"
    frames.check_camera(shift, samples.video.width, consequence)
    tried = _name_candidates(found[:MAX_TRIALS])
    markers = {name: Marker(name=name, hsv=c.colours, area_px=c.area_px) for name, c in tried.items()}
    run = _try(video, setup_of(list(markers.values()), common), progress)
    track, reasons = run.track, {}
    scene = proposals.interpolate_shifts(shift, samples.indices, len(track.times))
    for name, candidate in tried.items():
        min_share = max(frames.MIN_FOUND_SHARE, 0.3 * candidate.presence)
        reasons[name] = marker_fault(track, name, min_share, scene)[1]
    scores = {name: tried[name].score for name, reason in reasons.items() if not reason}
    if not scores:
        rejected = [replace(c, reason=reasons[name]) for name, c in tried.items()] + rejected
        raise NoTrustworthyResult(
            f"no marker of {video.name} can be followed and moves. {proposals.describe_rejected(rejected)}"
            f"{frames.describe_colours(samples.frames[::6])}",
            hint="pick the markers by hand: --marker name@x,y with --frame",
        )
    names, first = _choose_names(run, scores, reasons)
    weaker = f"has a lower score than {first}"
    left = {name: c for name, c in tried.items() if name not in names}
    rejected += [replace(c, reason=reasons[name] or weaker) for name, c in left.items()]
    rejected += [replace(c, reason=weaker) for c in found[MAX_TRIALS:]]
    setup = setup_of([markers[name] for name in names], common)
    setup = setup.model_copy(update={"ignore_px": run.setup.ignore_px})
    return replace(run, track=track.select(names), setup=setup), rejected


def _name_candidates(candidates: list[MarkerCandidate]) -> dict[str, MarkerCandidate]:
    """Return candidates by the names of their hues. Names of equal hues get different endings."""
    tried: dict[str, MarkerCandidate] = {}
    for candidate in candidates:
        same = sum(other.name == candidate.name for other in tried.values())
        tried[candidate.name + same * "-b"] = candidate
    return tried


def _choose_names(run: FilmTrack, scores: dict[str, float], reasons: dict[str, str]) -> tuple[list[str], str]:
    """Return the names of one marker, or of head and tail at a constant distance; and the first choice.

    ``scores`` are those of the markers that can be followed, the best first. The reasons against the other
    markers are written into ``reasons``.
    """
    best, limits = next(iter(scores)), frames.MAX_DISTANCE_SD
    changes: dict[tuple[str, str], float | None] = {}
    rigid: dict[tuple[str, str], tuple[float, float]] = {}
    for pair in combinations(scores, 2):
        changes[pair] = change = distance_change(run, *pair)
        strong = min(scores[name] for name in pair) >= SECOND_SHARE * scores[best]
        if strong and change is not None and change <= limits[1]:
            rigid[pair] = (max(change, limits[0]), -sum(scores[name] for name in pair))
    names = [best]
    if rigid:
        pair = min(rigid, key=rigid.__getitem__)
        names = [*pair]
    first = names[0]
    for name in scores:
        change = changes.get((first, name), changes.get((name, first), 0.0))
        if change is None:
            reasons[name] = f"is rarely detected together with {first}"
        elif change > limits[0]:
            text = f"its distance to {first} changes by {100 * change:.1f} %"
            reasons[name] = f"{text}: these markers are not on one rigid part"
    if len(names) > 1 and (run.track.head_first(*names) or 0.0) < 0.5:
        names.reverse()
    return names, first


def _make_markers(video: Path, options: TrackSetupOptions) -> list[Marker]:
    """Return setup entries of the markers that the user picked on the command line."""
    frames_read = enumerate(islice(Video(video).frames(), options.frame + 1))
    ((index, (_, frame)),) = deque(frames_read, maxlen=1)
    if index < options.frame:
        raise InputError(f"has no frame {options.frame}: the last frame is {index}", file=video)
    return proposals.pick_markers(frame, proposals.kinds_of(options.picks), path=video, index=options.frame)


def _follow_chosen(
    video: Path, markers: list[Marker], common: dict[str, Any], progress: Progress
) -> FilmTrack:
    """Return the track of the markers that the user chose, or of the body that differs from the empty scene.

    Raises
    ------
    NoTrustworthyResult
        The body is found in less than :data:`swimid.tracking.frames.MIN_FOUND_SHARE` of the frames.
    """
    run = _try(video, setup_of(markers, common), progress)
    if markers[0].method == "background":
        return _with_area(run)
    if markers[0].number > 1 and run.setup.tail is not None:
        # Use the second marker as tail only if its distance from the first is constant. Markers that look
        # alike may belong to different bodies.
        separation = distance_change(run, *run.setup.roles)
        if separation is None or separation > frames.MAX_DISTANCE_SD[1]:
            run = replace(run, setup=run.setup.model_copy(update={"tail": None}))
    return run


def _with_area(run: FilmTrack) -> FilmTrack:
    """Return the track of a silhouette, with limits of its area in the setup."""
    if run.track.is_whole[0].mean() < frames.MIN_FOUND_SHARE:
        hint = "the scene is the film's median: the body must leave its place for more than half of it"
        raise NoTrustworthyResult(f"nothing in {run.video.path.name} differs from the empty scene", hint=hint)
    low, high = np.percentile(run.track.area[0, run.track.is_whole[0]], [2, 98])
    area = (max(round(0.3 * low), 1), round(2.5 * high))
    marker = run.setup.markers[0].model_copy(update={"area_px": area})
    return replace(run, setup=run.setup.model_copy(update={"markers": [marker]}))


def _sheet(run: FilmTrack) -> NDArray[np.uint8]:
    """Return a contact sheet: some frames of the film with circled and named markers."""
    tiles, track = [], run.track
    ranked = sorted(run.kept, key=lambda k: (not track.is_whole[:, k].all(), k))
    for index in sorted(ranked[:N_TILES]):
        frame = run.kept[index]
        factor = TILE_WIDTH / frame.shape[1]
        down = factor / run.video.pixel_aspect
        tile = cv2.resize(frame, None, fx=factor, fy=down, interpolation=cv2.INTER_AREA)
        for i in np.flatnonzero(track.is_whole[:, index]):
            x, y = round(factor * track.x[i, index]), round(down * track.y[i, index])
            radius = round(factor * float(np.sqrt(track.area[i, index] / np.pi))) + 5
            cv2.circle(tile, (x, y), radius, frames.MEASURED, 2, cv2.LINE_AA)
            # Names of neighbours are above and below them in turn, so that none covers another marker.
            below = (-radius - 6, radius + 16)[i % 2]
            frames.draw_text(tile, track.names[i], (x - radius, y + below), 0.5)
        frames.draw_text(tile, f"frame {index}", (8, tile.shape[0] - 8), 0.5)
        tiles.append(tile)
    return np.asarray(cv2.cvtColor(np.vstack(tiles), cv2.COLOR_BGR2RGB), dtype=np.uint8)
