"""Command ``track camera``, which calibrates a camera from pictures of a checkerboard."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import cv2
import numpy as np
from pydantic import Field

from swimid.errors import InputError, NoTrustworthyResult
from swimid.files import provenance, yamlio
from swimid.notices import Progress, record_warnings, silent, warn
from swimid.options import takes
from swimid.points.scale import Camera
from swimid.results import evidence as ev
from swimid.results import numbers
from swimid.results.result import FileResult
from swimid.tracking import frames
from swimid.tracking.frames import Array
from swimid.tracking.options import TrackCameraOptions

#: Minimum number of pictures for a calibration (MIN_PICTURES), and for an accurate one (GOOD_PICTURES;
#: OpenCV's tutorial on camera calibration).
MIN_PICTURES, GOOD_PICTURES = 3, 10
#: Minimum angle between two boards, degrees. At 5 degrees and less the equations of Zhang are nearly
#: singular. At 20 degrees the error of the focal length is a quarter of the error at 5 degrees (Zhang 2000,
#: doi:10.1109/34.888718, figure 3).
MIN_TILT_DEG = 20.0
#: MAX_ERROR_PX is the maximum root-mean-square reprojection error, px. The picture is divided into 16 parts,
#: and MIN_PARTS is the minimum number of parts that must contain corners of a board.
MAX_ERROR_PX, MIN_PARTS = 1.0, 12
#: Maximum relative standard error of a focal length: half of the maximum error of a length for which the
#: check of a track passes.
MAX_FOCAL_SE = 0.01
#: Maximum distance between corresponding corners of two pictures that count as the same picture, px.
SAME_PX = 1.0
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
FIND = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY


class CameraFile(yamlio.ResultFile):
    """Content of a camera file. Its ``camera`` is that of a setup file or a points file."""

    kind: ClassVar[str] = "camera"
    format: Literal["swimid-camera/1"] = "swimid-camera/1"
    camera: Camera
    reprojection_error_px: float
    #: Standard error of each parameter, by its name in OpenCV.
    standard_errors: dict[str, float]
    pictures: list[str]
    provenance: yamlio.Provenance = Field(default_factory=dict)


class Calibration(FileResult[CameraFile]):
    """Result of ``track_camera``: matrix and distortion of a camera, with their standard errors.

    Attributes
    ----------
    file : CameraFile
        Camera, errors and pictures. :meth:`save` writes it.
    """

    file_type = CameraFile


@takes(TrackCameraOptions)
def track_camera(
    pictures: Sequence[str | Path],
    *,
    options: TrackCameraOptions,
    output: Path | None = None,
    progress: Progress = silent,
) -> Calibration:
    """Calibrate a camera and its lens from pictures of a checkerboard.

    Parameters
    ----------
    pictures : sequence of paths
        Pictures, or folders of pictures. At least three of them show the whole board, at different tilts.
    output : path, optional
        Camera file to write. ``track_setup`` copies it into a setup (``camera``).
    progress : Progress
        Shows the progress over the pictures.

    Returns
    -------
    Calibration
        ``.file.camera`` has the matrix (px), the size of the pictures and the distortion.

    Raises
    ------
    InputError
        A file cannot be read.
    NoTrustworthyResult
        Fewer than three different pictures show the board.

    References
    ----------
    Zhang, Z. (2000). A flexible new technique for camera calibration. IEEE Transactions on Pattern Analysis
    and Machine Intelligence 22(11), 1330-1334. doi:10.1109/34.888718

    Examples
    --------
    >>> made = track_camera(["board"], squares="9x6", square_mm=25.0)  # doctest: +SKIP
    >>> draft = track_setup("pool.mp4", camera=made.file.camera)  # doctest: +SKIP
    """
    files, board = list(_files(pictures)), options.board
    with record_warnings(repeat=True) as notices, progress("finding the board", len(files)) as step:
        seen, size = _corners(files, board, step)
    if len(seen) < MIN_PICTURES:
        text = f"{len(seen)} of {len(files)} pictures show a board of {options.squares} squares; at least "
        hint = f"tilt the board to all sides, in all parts of the picture; if {options.squares} counts "
        hint += f"inner corners, give --squares {board[0] + 2}x{board[1] + 2}"
        raise NoTrustworthyResult(f"{text}{MIN_PICTURES} at different tilts are needed", hint=hint)
    fit = _calibrate(seen, size, board, 1e-3 * options.square_mm)
    values, errors = fit.values, fit.errors
    document = CameraFile(
        camera=Camera(matrix=fit.matrix.tolist(), size_px=size, distortion=tuple(values[4:])),
        reprojection_error_px=fit.rms_px,
        standard_errors=dict(zip(NAMES, errors, strict=True)),
        pictures=list(seen),
        provenance=provenance.collect(files, settings=options.settings()),
    )
    evidence = _make_evidence(fit, seen, f"{len(seen)} of {len(files)}, {size[0]} x {size[1]} px", size)
    update = {"notices": list(notices), "provenance": document.provenance}
    return Calibration.of(document, evidence.model_copy(update=update)).write_output(output)


class _CameraFit(NamedTuple):
    """Camera that OpenCV fits to the corners of a board.

    ``values`` and ``errors`` are the parameters listed in :data:`NAMES` and their standard errors,
    ``tilt_deg`` is the largest angle between two boards, and ``each_px`` the reprojection error of each
    picture.
    """

    matrix: Array
    values: list[float]
    errors: list[float]
    tilt_deg: float
    rms_px: float
    each_px: list[float]


def _calibrate(
    seen: dict[str, Array], size: tuple[int, int], board: tuple[int, int], square_m: float
) -> _CameraFit:
    """Fit camera and lens to the corners of the board in each picture."""
    corner = np.zeros((board[0] * board[1], 3), np.float32)
    corner[:, :2] = square_m * np.mgrid[: board[0], : board[1]].T.reshape(-1, 2)
    world, image = [corner] * len(seen), [one.astype(np.float32) for one in seen.values()]
    rms, matrix, lens, turns, _, errors, _, each = cv2.calibrateCameraExtended(world, image, size, None, None)
    values = np.r_[matrix[0, 0], matrix[1, 1], matrix[:2, 2], lens.ravel()[:5]].tolist()
    normals = [cv2.Rodrigues(turn)[0][:, 2] for turn in turns]
    cosine = min(abs(float(one @ other)) for one, other in combinations(normals, 2))
    tilt = float(np.degrees(np.arccos(min(cosine, 1.0))))
    return _CameraFit(matrix, values, errors.ravel()[:9].tolist(), tilt, float(rms), each.ravel().tolist())


def _make_evidence(
    fit: _CameraFit, seen: dict[str, Array], pictures: str, size: tuple[int, int]
) -> ev.Evidence:
    """Return the evidence of a calibration, with checks and tables."""
    values, errors = fit.values, fit.errors
    parts = np.unique((4 * np.concatenate(list(seen.values())) // size).astype(int), axis=0)
    checks = _checks(len(seen), fit.tilt_deg, len(parts), fit.rms_px, fit.each_px)
    focal = 100 * max(errors[0] / values[0], errors[1] / values[1])
    value, limit, passed = f"± {focal:.2g} %", f"± {MAX_FOCAL_SE:.0%}", focal <= 100 * MAX_FOCAL_SE
    reason = f"the focal length has a standard error of {focal:.2g} %, above {MAX_FOCAL_SE:.0%}"
    checks.append(ev.make_check("Focal length", value, passed, limit, reason=reason))
    rows: list[dict[str, Any]] = [
        {"parameter": name, "value": value, "standard error": error}
        for name, value, error in zip(NAMES, values, errors, strict=True)
    ]
    caption = "Focal lengths and centre in px, distortion of OpenCV."
    focal_px = numbers.format_estimate(values[0], errors[0])
    answer = f"Focal length {focal_px} px, reprojection error {fit.rms_px:.2g} px."
    return ev.Evidence(
        command="track camera",
        title=f"Calibration of a camera from {len(seen)} pictures",
        verdict=ev.make_verdict(answer, checks),
        facts={"Pictures": pictures},
        checks=checks,
        tables=[
            ev.make_table("parameters", "Camera", rows, caption),
            ev.leaf_table("pictures", "Reprojection errors, px", dict(zip(seen, fit.each_px, strict=True))),
        ],
        methods=["The camera was calibrated with OpenCV from pictures of a checkerboard (Zhang 2000)."],
    )


def _files(given: Sequence[str | Path]) -> Iterator[Path]:
    """Yield the pictures among files and folders."""
    for path in map(Path, given):
        if not path.exists():
            raise InputError("cannot be read: no such file", file=path, hint="check the path")
        inside = sorted(path.iterdir()) if path.is_dir() else [path]
        yield from (one for one in inside if one.suffix.lower() in frames.PICTURE_EXTENSIONS or one == path)


def _corners(
    files: list[Path], board: tuple[int, int], step: Any
) -> tuple[dict[str, Array], tuple[int, int]]:
    """Return the corners of the board in each picture that shows it, px, and the size of the pictures.

    A warning names each picture that does not show the board, with the reason.
    """
    seen: dict[str, Array] = {}
    size = (0, 0)
    for file in files:
        step()
        picture: Any = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        if picture is None:
            reason = "cannot be decoded"
        elif seen and picture.shape[::-1] != size:
            first = f"but the first picture with the board has {size[0]} x {size[1]}"
            reason = f"has {picture.shape[1]} x {picture.shape[0]} pixels, {first}"
        else:
            found, corners = cv2.findChessboardCornersSB(picture, board, flags=FIND)
            reason = f"does not show the whole board of {board[0]} x {board[1]} inner corners"
            if found:
                here = np.asarray(corners, float).reshape(-1, 2)
                same = [name for name, there in seen.items() if np.abs(here - there).max() < SAME_PX]
                reason = f"shows the board in the same place as {' and '.join(same)}" * bool(same)
                if not same:
                    seen[str(file)], size = here, (picture.shape[1], picture.shape[0])
        if reason:
            warn("SWM174", f"{file} {reason}: it is not used")
    return seen, size


def _checks(count: int, tilt: float, parts: int, rms: float, each: list[float]) -> list[ev.Check]:
    """Return the checks of the pictures of a calibration."""
    error = f"{rms:.2g} px, pictures {min(each):.2g} to {max(each):.2g} px"
    flat = f"the boards are tilted against each other by {tilt:.0f} degrees at most: pictures in one plane"
    name, flat = "Tilt between pictures", f"{flat} do not determine the focal length"
    rows: list[tuple[str, str, bool, str, Any, str]] = [
        (name, f"{tilt:.0f}°", tilt >= MIN_TILT_DEG, f">= {MIN_TILT_DEG:g}°", "fail", flat),
        ("Pictures", f"{count}", count >= GOOD_PICTURES, f">= {GOOD_PICTURES}", "warn",
         f"only {count} different pictures show the board"),
        ("Parts of the picture", f"{parts} of 16", parts >= MIN_PARTS, f">= {MIN_PARTS}", "warn",
         f"the board covers only {parts} of 16 parts of the picture, and the lens is unknown in the others"),
        ("Reprojection error", error, rms <= MAX_ERROR_PX, f"<= {MAX_ERROR_PX:g} px", "warn",
         f"the corners fit no camera within {MAX_ERROR_PX:g} px: {error}"),
    ]  # fmt: skip
    return [ev.make_check(*row[:4], otherwise=row[4], reason=row[5]) for row in rows]
