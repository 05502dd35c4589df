"""``swimid track video``: a film and a setup give a log."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from swimid.errors import InputError, NoTrustworthyResult, UsageError
from swimid.files import atomic, provenance
from swimid.logs import log
from swimid.notices import Notice, recorded, warn
from swimid.progress import Progress, silent
from swimid.results import evidence
from swimid.results.result import Result
from swimid.tracking import checks, overlay, pictures, plane, pose, stills, track_video_figures
from swimid.tracking import setup as setup_format
from swimid.tracking.census import describe_colours
from swimid.tracking.rawtrack import RawTrack
from swimid.tracking.run import follow
from swimid.tracking.setup import Setup

#: Fewer frames found than this share are no track.
LEAST_FOUND = 0.05
#: Columns a wrong scale shows in.
POSE = ("t_s", "x_m", "y_m", "z_m", "u_m_s", "v_m_s", "w_m_s")


def track_video(
    video: str | Path,
    *,
    setup: str | Path,
    output: str | Path,
    overlay_path: str | Path | None = None,
    fps: float | None = None,
    max_gap_s: float | None = None,
    window_s: tuple[float | None, float | None] = (None, None),
    metadata: dict[str, Any] | None = None,
    progress: Progress = silent,
) -> Result:
    """Track the markers of a video and write the log.

    Parameters
    ----------
    video : path
        The film; or a folder of pictures, or a pattern of their names (``%05d.png``).
    setup : path
        ``swimid-setup/1`` file.
    output : path
        The log, CSV or Parquet by its ending. Beside it go ``<stem>.evidence.json`` and
        ``<stem>.png``.
    overlay_path : path, optional
        Video with the track drawn in.
    fps : float, optional
        True frame rate, Hz, over the container's and the setup's.
    max_gap_s : float, optional
        Over the setup's.
    window_s : (float or None, float or None)
        From and to, s from the first frame: what speeds and stroke of the result are over. The log
        holds every frame. Default: the steady part.
    metadata : dict, optional
        Further ``# key: value`` lines of the log.
    progress : Progress
        Shows the passes over the video.

    Raises
    ------
    InputError
        The video or the setup cannot be used.
    NoTrustworthyResult
        No marker, or hardly any frame with one.
    """
    if fps is not None and not (math.isfinite(fps) and fps > 0):
        raise UsageError(f"--fps {fps:g} must be above 0")
    if max_gap_s is not None and not (math.isfinite(max_gap_s) and max_gap_s >= 0):
        raise UsageError(f"--max-gap {max_gap_s:g} must not be negative")
    track_video_figures.check_window(window_s)
    output = atomic.check_writable(output, inputs=(video, setup))
    stills.check_output(Path(video), output)
    if overlay_path is not None:
        overlay_path = atomic.check_writable(overlay_path, inputs=(video, setup, output))
    rules = setup_format.read(setup)
    changed = {"frame_rate_hz": fps, "max_gap_s": max_gap_s}
    rules = rules.model_copy(update={k: v for k, v in changed.items() if v is not None})
    with recorded() as notices:
        result = _track(
            Path(video), rules, setup, output, overlay_path, window_s, metadata or {}, progress, notices
        )
    for notice in notices:
        warn(notice.code, notice.text)
    return result


def _track(
    video: Path,
    rules: Setup,
    setup_path: str | Path,
    output: Path,
    overlay_path: Path | None,
    window_s: tuple[float | None, float | None],
    metadata: dict[str, Any],
    progress: Progress,
    notices: list[Notice],
) -> Result:
    with progress(f"tracking {video.name}") as step:
        run = follow(video, rules, step=step)
    track, info, rules = run.track, run.info, run.setup
    ground = plane.build(rules, info.width, info.height, file=str(setup_path))
    _demand_markers(track, rules, run.kept)
    ground = pose.facing(track, rules, ground)
    result = pose.build(track, rules, ground)
    found_checks = checks.run(track, result, rules, run.kept)
    swum = track_video_figures.find(result, window_s)
    found_checks += track_video_figures.stroke_check(swum)
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
    log.write(output, columns, head)
    # a scale that is wrong by a factor shows as speeds no swimmer reaches
    log.warn_units(log.Log(output, head, {name: columns[name] for name in POSE if name in columns}))
    painter = pictures.Painter(track, result, rules)
    proof = evidence.sidecar(output)
    plot = output.with_suffix(".png")
    pictures.save_plot(plot, result, rules, f"{video.name}: found in {count} of {total} frames")
    outputs = [output, proof, plot]
    remark = ""
    if overlay_path is not None:
        remark = overlay.write(overlay_path, video, painter, rules, result.times, progress=progress)
        outputs.append(overlay_path)
    block = provenance.collect(
        [],
        digests=provenance.digest_together(video, info.files) | provenance.digests_of([setup_path]),
        settings=rules.model_dump(mode="json", exclude_none=True),
    )
    verdict = _verdict(found_checks, count, total, track_video_figures.headline(swum, ground.unit))
    drawn = pictures.figures(track, result, rules)
    track_video_figures.mark(drawn, swum)
    record = evidence.Evidence(
        verb="track video",
        title=f"Track of {video.name}",
        verdict=verdict,
        checks=found_checks,
        tables=[track_video_figures.table(swum, rules, ground.unit), _segment_table(result)],
        figures=drawn,
        images=pictures.images(painter, run.kept),
        notices=[evidence.NoticeRecord(code=n.code, text=n.text) for n in notices],
        methods=_methods(rules, result),
        references=[
            "Rauch, H. E., Tung, F., Striebel, C. T. (1965). Maximum likelihood estimates of linear dynamic "
            "systems. AIAA Journal 3(8), 1445-1450. doi:10.2514/3.3166",
            track_video_figures.REFERENCE,
        ],
        provenance=block,
    )
    evidence.write(proof, record)
    span = checks.presence(track, result, rules)
    holes = [end - start for start, end in checks.gaps(result.measured, result.times)]
    machine = {
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
        "unit": ground.unit,
        "markers": {
            name: {"found": int(track.found[i].sum()), "at_edge": int(track.at_edge[i].sum())}
            for i, name in enumerate(track.names)
        },
        "measurement_sd": {ground.unit: result.path.measurement_sd}
        | ({} if result.angle is None else {"rad": result.angle.measurement_sd}),
        "process_noise": {"order": result.path.order, "value": result.path.process_noise},
        "swimming": track_video_figures.machine(swum, rules, ground.unit),
        "verdict": verdict.model_dump(),
        "checks": [check.model_dump() for check in found_checks],
    }
    swim_lines = track_video_figures.lines(swum, rules, ground.unit)
    return Result("track video", _summary(machine, found_checks, swim_lines, remark), machine, outputs)


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


def _verdict(found: list[evidence.Check], count: int, total: int, headline: str) -> evidence.Verdict:
    share = f"Markers found in {count} of {total} frames"
    failed = [c.name.lower() for c in found if c.verdict == "fail"]
    doubted = [c.name.lower() for c in found if c.verdict == "warn"]
    if failed:
        return evidence.Verdict(level="bad", text=f"{share}; failed: {', '.join(failed)}.")
    if doubted:
        return evidence.Verdict(level="caution", text=f"{share}; look at: {', '.join(doubted)}.{headline}")
    return evidence.Verdict(level="good", text=f"{share}; every self-check passes.{headline}")


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
        track_video_figures.METHODS,
    ]


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")


def _summary(machine: dict[str, Any], found: list[evidence.Check], swum: list[str], remark: str) -> str:
    first, last, end = (machine[key] for key in ("first_seen_s", "last_seen_s", "duration_s"))
    seen = f", first seen at {first:.2f} s" if first > 0 else ""
    seen += f", last seen at {last:.2f} s of {end:.2f} s" if last < end else ""
    lines = [
        f"found {machine['found']} of {machine['frames']} frames "
        f"({100 * machine['found_share']:.1f} %){seen}, {machine['interpolated']} bridged, "
        f"{machine['gaps']} gaps (longest {machine['longest_gap_s']:.3f} s), "
        f"{machine['segments']} segment{'s' if machine['segments'] != 1 else ''}, unit {machine['unit']}"
    ]
    width = max(len(check.name) for check in found)
    lines += [
        f"  {check.verdict:4}  {check.name:{width}}  {check.value}"
        + (f"  ({check.limit})" if check.limit else "")
        for check in found
    ]
    lines += swum
    if remark:
        lines.append(f"note: {remark}")
    return "\n".join(lines)
