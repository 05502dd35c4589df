"""``swimid track video``: a film and a setup give a log."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from swimid.errors import InputError, NoTrustworthyResult
from swimid.files import atomic, provenance
from swimid.logs import log
from swimid.logs.log import Log
from swimid.logs.logged import Logged
from swimid.notices import Notice, recorded
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import blocks, drawing
from swimid.results.evidence import Evidence, judged
from swimid.tracking import evidence, pictures, plane, pose, quality, reader
from swimid.tracking import setup as setup_format
from swimid.tracking.colour import describe_colours
from swimid.tracking.options import TrackVideoOptions
from swimid.tracking.pose import Pose
from swimid.tracking.setup import Setup
from swimid.tracking.tracker import Run, follow

#: Columns a wrong scale shows in.
UNIT_COLUMNS = ("t_s", "x_m", "y_m", "z_m", "u_m_s", "v_m_s", "w_m_s")


@dataclass(frozen=True, eq=False)
class Track(Logged):
    """The track of a film, as ``track_video`` gives it.

    Attributes
    ----------
    pose : Pose
        Path and heading with their standard deviations; None where the log was read from a file.
    setup : Setup
        How the film was read, with what was left out in a second look.
    """

    pose: Pose | None = None
    setup: Setup | None = None

    def _write(self, path: Path) -> list[Path]:
        written = super()._write(path)
        if self.evidence is None or atomic.is_device(path):
            return written
        plot = path.with_suffix(".png")
        shown = [figure for figure in self.evidence.figures if figure.id in ("path", "pose")]
        drawing.write(plot, shown, title=self.evidence.title)
        return [*written, plot]


@takes(TrackVideoOptions)
def track_video(
    video: str | Path,
    *,
    options: TrackVideoOptions,
    output: str | Path | None = None,
    metadata: dict[str, Any] | None = None,
    progress: Progress = silent,
) -> Track:
    """Track the markers of a video: pose, speeds and stroke of the robot.

    The setup is a file, a Setup or a dict: colours of the markers, scale, camera; ``track_setup`` drafts one.
    The log holds every frame, whatever part speeds and stroke of the result are over.

    Parameters
    ----------
    video : path
        The film; or a folder of pictures, or a pattern of their names (``%05d.png``).
    output : path, optional
        The log, CSV or Parquet by its ending. Beside it go ``<stem>.evidence.json`` and ``<stem>.png``.
        Without it nothing is written; :meth:`~swimid.results.result.Result.save` writes the same files later.
    metadata : dict, optional
        Further ``# key: value`` lines of the log.
    progress : Progress
        Shows the passes over the video.

    Returns
    -------
    Track
        ``.frame`` has a row for each of the n frames: ``t_s``, pose (m, rad; px without a scale), speeds
        (m/s, rad/s), their standard deviations, what was measured, and each marker. ``.data["swimming"]`` is
        speed, stroke and accelerations with their 95 % intervals.

    Raises
    ------
    InputError
        The video or the setup cannot be used.
    NoTrustworthyResult
        No marker, or hardly any frame with one.
    UsageError
        An option out of its range, or a window that holds next to nothing of the track.

    Notes
    -----
    Positions are smoothed by a Kalman filter and a Rauch-Tung-Striebel smoother (Rauch, Tung and Striebel,
    1965, doi:10.2514/3.3166); the steady part is found by the marginal standard error rule (White, 1997,
    doi:10.1177/003754979706900601).

    Examples
    --------
    >>> made = track_video("pool.mp4", setup="setup.yaml")  # doctest: +SKIP
    >>> made.frame[["t_s", "x_m", "y_m", "yaw_rad"]].plot(x="t_s")  # doctest: +SKIP
    """
    video, setup, overlay_path = Path(video), options.setup, options.overlay_path
    if output is not None:
        output = atomic.check_writable(output, inputs=(video, setup))
        reader.check_output(video, output)
    if overlay_path is not None:
        overlay_path = atomic.check_writable(overlay_path, inputs=(video, setup, output))
    changed = {"frame_rate_hz": options.fps, "max_gap_s": options.max_gap_s}
    rules = setup_format.of(setup)
    source = setup if isinstance(setup, str | Path) else rules
    rules = rules.model_copy(update={k: v for k, v in changed.items() if v is not None})
    with recorded(repeat=True) as notices:
        with progress(f"tracking {video.name}") as step:
            run = follow(video, rules, step=step, file=str(provenance.path_of(source)))
        result, painter = _judged(run, source, options, metadata or {}, notices)
        with atomic.together():
            remark = "" if overlay_path is None else painter.write(overlay_path, progress)
            if remark and result.evidence is not None:
                result = replace(result, evidence=result.evidence.model_copy(update={"notes": [remark]}))
            result = result.saved(output)
    return result if overlay_path is None else replace(result, outputs=[*result.outputs, overlay_path])


def _judged(
    run: Run,
    source: str | Path | Setup,
    options: TrackVideoOptions,
    metadata: dict[str, Any],
    notices: list[Notice],
) -> tuple[Track, pictures.Painter]:
    """Return the track with its evidence, and its painter."""
    track, video, rules = run.track, run.video, run.setup
    ground = plane.build(rules, video.width, video.height, file=str(provenance.path_of(source)))
    _demand_markers(run)
    ground = pose.facing(track, rules, ground)
    made = pose.build(track, rules, ground)
    found = quality.checks(track, made, rules, run.kept)
    swum = evidence.swum(made, (options.from_s, options.to_s))
    found += evidence.stroke_check(swum)
    columns = pose.columns(made, track, rules)
    head = _metadata(run, ground, made.times) | metadata
    # a scale that is wrong by a factor shows as speeds no swimmer reaches
    shown = {name: columns[name] for name in UNIT_COLUMNS if name in columns}
    log.warn_units(Log(video.path, head, shown))
    painter = pictures.Painter(run, made)
    verdict = judged(evidence.answer(made, swum), found)
    proof = Evidence(
        verb="track video",
        title=f"Track of {video.path.name}",
        verdict=verdict,
        facts=evidence.facts(made, rules, swum),
        checks=found,
        tables=[evidence.table(swum, rules, ground.unit), evidence.segment_table(made)],
        figures=evidence.figures(made, rules, swum),
        images=painter.images(),
        notices=blocks.notices(notices),
        methods=evidence.methods(rules, made),
        references=evidence.REFERENCES,
        provenance=provenance.collect(
            [],
            digests=provenance.digest_together(video.path, video.files) | provenance.digests_of([source]),
            settings=options.settings(setup=rules.model_dump(mode="json", exclude_none=True)),
        ),
    )
    data = evidence.data(track, made, rules, swum) | {
        "verdict": verdict.model_dump(),
        "checks": [check.model_dump() for check in found],
    }
    document = Log(Path(f"{video.path.stem}.csv"), head, log.numeric(columns), None)
    return Track("track video", "", data, (), proof, document, columns, made, rules), painter


def _metadata(run: Run, ground: plane.Plane, times: NDArray[np.float64]) -> dict[str, Any]:
    """The comment lines of the log: the film, and what its pose is that of."""
    rules = run.setup
    head: dict[str, Any] = {
        "source": run.video.path.name,
        "made_by": "swimid track video",
        "frame_rate_hz": float(f"{1 / float(np.median(np.diff(times))):.6g}"),
    }
    if math.isfinite(run.video.first_stamp_s):
        head["first_stamp_s"] = run.video.first_stamp_s
    head |= {"image_size_px": [run.video.width, run.video.height], "plane": rules.plane}
    if rules.plane == "vertical":
        head["facing"] = "left" if ground.runs_left else "right"
    if rules.places is None:
        return head | {"reference": rules.head_name, "reference_offset_m": list(rules.reference_offset_m)}
    places = {name: list(place) for name, place in zip(rules.roles, rules.places, strict=True)}
    return head | {"reference": rules.robot or "robot", "markers_at_m": places}


def _demand_markers(run: Run) -> None:
    """Raise unless every marker the pose needs is seen often enough."""
    track = run.track
    total = len(track.times)
    if total < 2:
        raise InputError(
            f"has {total} frame; a track needs several",
            hint="is it a picture? Name its folder, or a pattern as %05d.png",
        )
    for name in run.setup.roles:
        row = track.row(name)
        count, cut = int(track.found[row].sum()), int(track.at_edge[row].sum())
        if count >= max(quality.LEAST_SHARE * total, pose.SHORTEST_SEGMENT):
            continue
        what = f"in {count} of {total} frames only" if count else f"in no frame of {total}"
        what += f" (in {cut} the edge of the picture cuts it)" if cut else ""
        raise NoTrustworthyResult(
            f"marker '{name}' was found {what}; that is no track. "
            f"{describe_colours(list(run.kept.values()))}",
            hint="'swimid track setup VIDEO -o setup.yaml' proposes markers from the video itself and draws "
            "them; or correct hsv and area_px in the setup",
        )
