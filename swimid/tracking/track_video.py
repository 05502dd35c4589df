"""``swimid track video``: a film and a setup give a log."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from swimid.errors import InputError, NoTrustworthyResult, UsageError
from swimid.files import atomic, provenance
from swimid.logs import log
from swimid.logs.log import Log
from swimid.logs.logged import Logged
from swimid.notices import Notice, recorded, warn
from swimid.options import takes
from swimid.progress import Progress, silent
from swimid.results import evidence
from swimid.results.evidence import Check
from swimid.tracking import checks, overlay, pictures, plane, pose, stills, swim
from swimid.tracking import setup as setup_format
from swimid.tracking.census import describe_colours
from swimid.tracking.options import TrackVideoOptions
from swimid.tracking.pose import Pose
from swimid.tracking.rawtrack import RawTrack
from swimid.tracking.run import follow
from swimid.tracking.setup import Setup

#: Fewer frames found than this share are no track.
LEAST_FOUND = 0.05
#: Columns a wrong scale shows in.
POSE = ("t_s", "x_m", "y_m", "z_m", "u_m_s", "v_m_s", "w_m_s")


@dataclass(frozen=True, eq=False)
class Track(Logged):
    """The track of a film, as ``track_video`` gives it.

    Attributes
    ----------
    pose : Pose
        Path and heading with their standard deviations; None where the log was read from a file.
    setup : Setup
        How the film was read, with what was left out in a second look.
    heading : str
        Title of the plot.
    """

    pose: Pose | None = None
    setup: Setup | None = None
    heading: str = ""

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
        if self.pose is None or self.setup is None or not path.is_file():
            return written
        plot = path.with_suffix(".png")
        pictures.save_plot(plot, self.pose, self.setup, self.heading)
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
    setup, overlay_path, fps, max_gap_s = options.setup, options.overlay_path, options.fps, options.max_gap_s
    if fps is not None and not (math.isfinite(fps) and fps > 0):
        raise UsageError(f"--fps {fps:g} must be above 0")
    if max_gap_s is not None and not (math.isfinite(max_gap_s) and max_gap_s >= 0):
        raise UsageError(f"--max-gap {max_gap_s:g} must not be negative")
    window_s = (options.from_s, options.to_s)
    swim.check_window(window_s)
    video = Path(video)
    if output is not None:
        output = atomic.check_writable(output, inputs=(video, setup))
        stills.check_output(video, output)
    if overlay_path is not None:
        overlay_path = atomic.check_writable(overlay_path, inputs=(video, setup, output))
    rules = setup_format.of(setup)
    changed = {"frame_rate_hz": fps, "max_gap_s": max_gap_s}
    source = setup if isinstance(setup, str | Path) else rules
    rules = rules.model_copy(update={k: v for k, v in changed.items() if v is not None})
    made = Path(f"{video.stem}.csv") if output is None else output
    with recorded() as notices:
        result, painter = _track(video, rules, source, made, window_s, metadata or {}, progress, notices)
        if output is not None:
            result = result.save(output)
        if overlay_path is not None:
            assert result.setup is not None
            remark = overlay.write(
                overlay_path, video, painter, result.setup, result.log.time_s, progress=progress
            )
            text = f"{result.text}\nnote: {remark}" if remark else result.text
            result = replace(result, text=text, outputs=[*result.outputs, overlay_path])
    for notice in notices:
        warn(notice.code, notice.text)
    return result


def _track(
    video: Path,
    rules: Setup,
    source: str | Path | Setup,
    made: Path,
    window_s: tuple[float | None, float | None],
    metadata: dict[str, Any],
    progress: Progress,
    notices: list[Notice],
) -> tuple[Track, pictures.Painter]:
    """The track, to be called ``made``, and what draws it into the film."""
    with progress(f"tracking {video.name}") as step:
        run = follow(video, rules, step=step)
    track, info, rules = run.track, run.info, run.setup
    ground = plane.build(rules, info.width, info.height, file=str(provenance.path_of(source)))
    _demand_markers(track, rules, run.kept)
    ground = pose.facing(track, rules, ground)
    result = pose.build(track, rules, ground)
    found = checks.run(track, result, rules, run.kept)
    swum = swim.find(result, rules.plane, window_s)
    found += swum.checks()
    count, total = int(result.measured.sum()), len(result.times)

    columns = pose.columns(result, track, rules)
    head = {
        "source": video.name,
        "made_by": "swimid track video",
        "frame_rate_hz": _rounded(1 / float(np.median(np.diff(result.times)))) if total > 1 else None,
        **({"first_stamp_s": run.first_stamp_s} if math.isfinite(run.first_stamp_s) else {}),
        "image_size_px": [info.width, info.height],
        "plane": rules.plane,
        **_reference(rules, ground),
        **metadata,
    }
    # a scale that is wrong by a factor shows as speeds no swimmer reaches
    log.warn_units(Log(made, head, {name: columns[name] for name in POSE if name in columns}))
    painter = pictures.Painter(track, result, rules)
    share = f"found in {count} of {total} frames"
    drawn = pictures.figures(track, result, rules)
    swum.mark(drawn)
    passed = "every self-check passes"
    verdict = evidence.judged(found, f"Markers {share}", more=swum.headline(), passed=passed)
    proof = evidence.Evidence(
        verb="track video",
        title=f"Track of {video.name}",
        verdict=verdict,
        checks=found,
        tables=[swum.table(), _segment_table(result)],
        figures=drawn,
        images=pictures.images(painter, run.kept),
        notices=[evidence.NoticeRecord(code=n.code, text=n.text) for n in notices],
        methods=_methods(rules, result),
        references=[
            "Rauch, H. E., Tung, F., Striebel, C. T. (1965). Maximum likelihood estimates of linear dynamic "
            "systems. AIAA Journal 3(8), 1445-1450. doi:10.2514/3.3166",
            swim.REFERENCE,
        ],
        provenance=provenance.collect(
            [],
            digests=provenance.digest_together(video, info.files) | provenance.digests_of([source]),
            settings=rules.model_dump(mode="json", exclude_none=True),
        ),
    )
    data = _facts(track, result, rules) | {
        "swimming": swum.to_dict(),
        "verdict": verdict.model_dump(),
        "checks": [check.model_dump() for check in found],
    }
    made_track = Track(
        "track video",
        _summary(data, found, swum.lines()),
        data,
        evidence=proof,
        document=Log(made, head, log.numeric(columns), None),
        table=columns,
        pose=result,
        setup=rules,
        heading=f"{video.name}: {share}",
    )
    return made_track, painter


def _facts(track: RawTrack, result: Pose, rules: Setup) -> dict[str, Any]:
    """How much was found, and how well, for machines."""
    count, total, unit = int(result.measured.sum()), len(result.times), result.plane.unit
    span = checks.presence(track, result, rules)
    holes = [end - start for start, end in checks.gaps(result.measured, result.times)]
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


def _reference(rules: Setup, ground: plane.Plane) -> dict[str, Any]:
    """What the pose in the log is that of."""
    found: dict[str, Any] = {}
    if rules.plane == "vertical":
        found["facing"] = "left" if ground.runs_left else "right"
    if rules.places is None:
        return found | {"reference": rules.head_name, "reference_offset_m": list(rules.reference_offset_m)}
    names = (rules.head_name, rules.tail)
    places = {str(name): list(place) for name, place in zip(names, rules.places, strict=True)}
    return found | {"reference": rules.robot or "robot", "markers_at_m": places}


def _demand_markers(track: RawTrack, rules: Setup, kept: dict[int, Any]) -> None:
    """Raise unless every marker the pose needs is seen often enough."""
    total = len(track.times)
    if total < 2:
        raise InputError(
            f"has {total} frame; a track needs several",
            hint="is it a picture? Name its folder, or a pattern as %05d.png",
        )
    for name in dict.fromkeys(n for n in (rules.head_name, rules.tail) if n is not None):
        count = int(track.found[track.names.index(name)].sum())
        if count >= max(LEAST_FOUND * total, pose.SHORTEST_SEGMENT):
            continue
        seen = describe_colours(list(kept.values()))
        what = (
            f"was found in no frame of {total}"
            if not count
            else f"was found in {count} of {total} frames only"
        )
        cut = int(track.at_edge[track.names.index(name)].sum())
        if cut:
            what += f" (in {cut} the edge of the picture cuts it)"
        raise NoTrustworthyResult(
            f"marker '{name}' {what}; that is no track. {seen}",
            hint="'swimid track setup VIDEO -o setup.yaml' proposes markers from the video itself and draws "
            "them; or correct hsv and area_px in the setup",
        )


def _segment_table(result: pose.Pose) -> evidence.Table:
    rows: list[list[str | float | int | bool | None]] = []
    for number in range(1, int(result.segment.max()) + 1):
        part = result.segment == number
        t = result.times[part]
        path = result.path.position[:, part]
        length = float(np.sum(np.hypot(*np.diff(path, axis=1))))
        rows.append(
            [number, float(t[0]), float(t[-1]), int(part.sum()), int((part & result.measured).sum()), length]
        )
    unit = result.plane.unit
    return evidence.Table(
        id="segments",
        title="Segments",
        columns=["segment", "from (s)", "to (s)", "frames", "measured", f"path length ({unit})"],
        rows=rows,
        caption="A gap longer than the limit ends a segment.",
    )


def _methods(rules: Setup, result: pose.Pose) -> list[str]:
    kinds = {2: "constant velocity with white acceleration", 3: "constant acceleration with white jerk"}
    markers = "a marker" if rules.tail is None else "two markers"
    return [
        f"The robot's path was taken from video by tracking {markers} by colour; centroids were found with "
        "sub-pixel resolution by soft membership, and frames were timed by their own stamps."
        if rules.frame_rate_hz is None
        else f"The robot's path was taken from video at {rules.frame_rate_hz:g} Hz by tracking {markers} by "
        "colour; centroids were found with sub-pixel resolution by soft membership.",
        f"Positions were smoothed with a Kalman filter ({kinds[result.path.order]}) and a Rauch-Tung-"
        "Striebel smoother whose noise powers maximise the likelihood of the innovations "
        f"(measurement noise {result.path.measurement_sd:.2g} {result.plane.unit}).",
        f"Dropouts up to {rules.max_gap_s:g} s were bridged by the smoother and are flagged; longer ones "
        "were left empty.",
        swim.METHODS,
    ]


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")


def _summary(data: dict[str, Any], found: list[Check], swum: list[str]) -> str:
    first, last, end = (data[key] for key in ("first_seen_s", "last_seen_s", "duration_s"))
    seen = f", first seen at {first:.2f} s" if first > 0 else ""
    seen += f", last seen at {last:.2f} s of {end:.2f} s" if last < end else ""
    lines = [
        f"found {data['found']} of {data['frames']} frames "
        f"({100 * data['found_share']:.1f} %){seen}, {data['interpolated']} bridged, "
        f"{data['gaps']} gaps (longest {data['longest_gap_s']:.3f} s), "
        f"{data['segments']} segment{'s' if data['segments'] != 1 else ''}, unit {data['unit']}"
    ]
    width = max(len(check.name) for check in found)
    lines += [
        f"  {check.verdict:4}  {check.name:{width}}  {check.value}"
        + (f"  ({check.limit})" if check.limit else "")
        for check in found
    ]
    return "\n".join([*lines, *swum])
