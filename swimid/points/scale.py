"""Scale and calibration of a camera, as setup files and points files state them (``docs/tracking.md``)."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from swimid.files.yamlio import Document

Positive = Annotated[float, Field(gt=0)]
Point = tuple[float, float]
Points = tuple[Point, ...]
_Row = tuple[float, float, float]


class Heights(Document):
    """Heights of the camera and of the markers above the plane in which the scale was measured, m."""

    camera_m: Positive
    marker_m: float

    @model_validator(mode="after")
    def _below(self) -> Heights:
        if self.marker_m >= self.camera_m:
            raise ValueError(f"marker_m {self.marker_m:g} must be below camera_m {self.camera_m:g}")
        return self


class Scale(Document):
    """Scale from pixels to metres.

    The scale is stated as a factor, as two points and their distance, or as at least four points with their
    coordinates in metres.
    """

    metres_per_pixel: Positive | None = None
    points_px: Points | None = None
    distance_m: Positive | None = None
    points_m: Points | None = None
    heights: Heights | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> Scale:
        given = {key for key, value in self if value is not None and key != "heights"}
        if given not in ({"metres_per_pixel"}, {"points_px", "distance_m"}, {"points_px", "points_m"}):
            raise ValueError(
                "the scale is incomplete or contradicts itself: give metres_per_pixel, or points_px with "
                "distance_m, or points_px with points_m"
            )
        points = self.points_px or ()
        count = len(points)
        if self.distance_m is not None and count != 2:
            raise ValueError(f"distance_m needs two points_px, not {count}")
        if self.distance_m is not None and points[0] == points[1]:
            raise ValueError(f"both points_px are {list(points[0])}: give two different points")
        if self.points_m is not None and (count < 4 or count != len(self.points_m)):
            text = f"{count} points_px and {len(self.points_m)} points_m; four or more of each are needed"
            raise ValueError(text)
        return self


class Camera(Document):
    """Calibration of the camera and its lens, with the conventions of OpenCV."""

    matrix: tuple[_Row, _Row, _Row]
    #: Width and height of the calibration pictures, px. The camera matrix is scaled to the pictures of the
    #: film.
    size_px: tuple[Positive, Positive]
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _shapes(self) -> Camera:
        if self.matrix[0][0] <= 0 or self.matrix[1][1] <= 0 or self.matrix[2] != (0.0, 0.0, 1.0):
            raise ValueError("matrix must be [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] with fx, fy above 0")
        if len(self.distortion) not in (4, 5, 8, 12, 14):
            raise ValueError(f"distortion has {len(self.distortion)} numbers; OpenCV knows 4, 5, 8, 12 or 14")
        return self
