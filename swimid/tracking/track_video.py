"""``swimid track video``: a film and a setup give a log."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

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
from swimid.results import blocks, drawing, evidence
from swimid.results.evidence import Check
from swimid.tracking import checks, motion, pictures, plane, pose, reader, swim
from swimid.tracking import setup as setup_format
from swimid.tracking.colour import describe_colours
from swimid.tracking.options import TrackVideoOptions
from swimid.tracking.pose import Pose
from swimid.tracking.rawtrack import RawTrack
from swimid.tracking.run import Run, follow
from swimid.tracking.setup import Setup

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

    def save(self, path: str | Path) -> Self:
        """Write log, evidence and plot; what the evidence says of speeds no swimmer reaches names the file.

        Raises
        ------
        InputError
            When the folder does not exist or cannot be written.
        """
        old, named, proof = f"{self.log.name}, '", Path(path), self.evidence
        if proof is not None and any(notice.text.startswith(old) for notice in proof.notices):
            text = proof.model_dump_json().replace(old, f"{named.name}, '")
            proof = evidence.Evidence.model_validate_json(text)
        renamed = replace(self, document=replace(self.log, path=named), evidence=proof)
        return super(Track, renamed).save(path)

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
        Without it nothing is written; :meth:`Track.save` writes the same files later.
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
    made = Path(f"{video.stem}.csv") if output is None else output
    with recorded(repeat=True) as notices:
        with progress(f"tracking {video.name}") as step:
            run = follow(video, rules, step=step, file=str(provenance.path_of(source)))
        result, painter = _told(run, source, made, options, metadata or {}, notices)
        with atomic.together():
            result = result.saved(output)
            if overlay_path is not None:
                remark = painter.write(overlay_path, progress)
                text = f"{result.text}\nnote: {remark}" if remark else result.text
                result = replace(result, text=text, outputs=[*result.outputs, overlay_path])
    return result


def _told(
    run: Run,
    source: str | Path | Setup,
    made: Path,
    options: TrackVideoOptions,
    metadata: dict[str, Any],
    notices: list[Notice],
) -> tuple[Track, pictures.Painter]:
    """What was followed as a track, to be called ``made``, and what draws it into the film."""
    track, video, rules = run.track, run.video, run.setup
    ground = plane.build(rules, video.width, video.height, file=str(provenance.path_of(source)))
    _demand_markers(run)
    ground = pose.facing(track, rules, ground)
    result = pose.build(track, rules, ground)
    found = checks.run(track, result, rules, run.kept)
    swum = swim.find(result, rules.plane, (options.from_s, options.to_s))
    found += swum.checks()
    columns = pose.columns(result, track, rules)
    head = _metadata(run, ground, result.times) | metadata
    # a scale that is wrong by a factor shows as speeds no swimmer reaches
    log.warn_units(Log(made, head, {name: columns[name] for name in UNIT_COLUMNS if name in columns}))
    painter = pictures.Painter(run, result)
    facts = _facts(track, result)
    share = f"Markers found in {facts['found']} of {facts['frames']} frames"
    verdict = evidence.judged(f"{share}.{swum.headline()}", found)
    proof = evidence.Evidence(
        verb="track video",
        title=f"Track of {video.path.name}",
        verdict=verdict,
        checks=found,
        tables=[swum.table(), _segment_table(result)],
        figures=pictures.figures(track, result, rules, (swum.swimming.begin_s, swum.swimming.end_s)),
        images=painter.images(),
        notices=blocks.notices(notices),
        methods=_methods(rules, result),
        references=[
            "Rauch, H. E., Tung, F., Striebel, C. T. (1965). Maximum likelihood estimates of linear dynamic "
            "systems. AIAA Journal 3(8), 1445-1450. doi:10.2514/3.3166",
            swim.REFERENCE,
        ],
        provenance=provenance.collect(
            [],
            digests=provenance.digest_together(video.path, video.files) | provenance.digests_of([source]),
            settings=options.settings(setup=rules.model_dump(mode="json", exclude_none=True)),
        ),
    )
    data = facts | {
        "swimming": swum.to_dict(),
        "verdict": verdict.model_dump(),
        "checks": [check.model_dump() for check in found],
    }
    text = "\n".join([_summary(facts), *_listed(found), *swum.lines()])
    document = Log(made, head, log.numeric(columns), None)
    return Track("track video", text, data, (), proof, document, columns, result, rules), painter


def _facts(track: RawTrack, result: Pose) -> dict[str, Any]:
    """How much was found, and how well, for machines."""
    count, total, unit = int(result.measured.sum()), len(result.times), result.plane.unit
    span = checks.Presence.of(track, result)
    holes = [end - start for start, end in result.gaps]
    return {
        "frames": total,
        "found": count,
        "found_share": count / total,
        "first_seen_s": float(result.times[span.first]),
        "last_seen_s": float(result.times[span.last]),
        "duration_s": float(result.times[-1]),
        "interpolated": int(result.interpolated.sum()),
        "segments": int(result.segment.max()),
        "gaps": len(holes),
        "longest_gap_s": max(holes, default=0.0),
        "unit": unit,
        "markers": {
            name: {"found": int(track.found[i].sum()), "at_edge": int(track.at_edge[i].sum())}
            for i, name in enumerate(track.names)
        },
        "measurement_sd": {unit: result.path.measurement_sd}
        | ({} if result.angle is None else {"rad": result.angle.measurement_sd}),
        "process_noise": {"order": result.path.order, "value": result.path.process_noise},
    }


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
        if count >= max(motion.LEAST_SHARE * total, pose.SHORTEST_SEGMENT):
            continue
        what = f"in {count} of {total} frames only" if count else f"in no frame of {total}"
        what += f" (in {cut} the edge of the picture cuts it)" if cut else ""
        raise NoTrustworthyResult(
            f"marker '{name}' was found {what}; that is no track. "
            f"{describe_colours(list(run.kept.values()))}",
            hint="'swimid track setup VIDEO -o setup.yaml' proposes markers from the video itself and draws "
            "them; or correct hsv and area_px in the setup",
        )


def _segment_table(result: Pose) -> evidence.Table:
    rows = []
    for number in range(1, int(result.segment.max()) + 1):
        part = result.segment == number
        t = result.times[part]
        rows.append(
            {
                "segment": number,
                "from (s)": float(t[0]),
                "to (s)": float(t[-1]),
                "frames": int(part.sum()),
                "measured": int((part & result.measured).sum()),
                f"path length ({result.plane.unit})": float(
                    np.sum(np.hypot(*np.diff(result.path.position[:, part], axis=1)))
                ),
            }
        )
    return blocks.table("segments", "Segments", rows, "A gap longer than the limit ends a segment.")


def _methods(rules: Setup, result: Pose) -> list[str]:
    kinds = {2: "constant velocity with white acceleration", 3: "constant acceleration with white jerk"}
    markers = "a marker" if rules.tail is None else "two markers"
    rate, clock = "", ", and frames were timed by their own stamps"
    if rules.frame_rate_hz is not None:
        rate, clock = f" at {rules.frame_rate_hz:g} Hz", ""
    return [
        f"The robot's path was taken from video{rate} by tracking {markers} by colour; centroids were found "
        f"with sub-pixel resolution by soft membership{clock}.",
        f"Positions were smoothed with a Kalman filter ({kinds[result.path.order]}) and a Rauch-Tung-"
        "Striebel smoother whose noise powers maximise the likelihood of the innovations "
        f"(measurement noise {result.path.measurement_sd:.2g} {result.plane.unit}).",
        f"Dropouts up to {rules.max_gap_s:g} s were bridged by the smoother and are flagged; longer ones "
        "were left empty.",
        swim.METHODS,
    ]


def _summary(facts: dict[str, Any]) -> str:
    first, last, end = (facts[key] for key in ("first_seen_s", "last_seen_s", "duration_s"))
    seen = f", first seen at {first:.2f} s" if first > 0 else ""
    seen += f", last seen at {last:.2f} s of {end:.2f} s" if last < end else ""
    return (
        f"found {facts['found']} of {facts['frames']} frames ({100 * facts['found_share']:.1f} %){seen}, "
        f"{facts['interpolated']} bridged, {facts['gaps']} gaps (longest {facts['longest_gap_s']:.3f} s), "
        f"{facts['segments']} segment{'s' if facts['segments'] != 1 else ''}, unit {facts['unit']}"
    )


def _listed(found: list[Check]) -> list[str]:
    width = max(len(check.name) for check in found)
    return [
        f"  {check.verdict:4}  {check.name:{width}}  {check.value}"
        + (f"  ({check.limit})" if check.limit else "")
        for check in found
    ]
