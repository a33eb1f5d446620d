"""Parameters of georeferencing: what is known about where the reference frame lies on the ground."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from vtrack_batch.model.params import Params

Gsd = Annotated[float, Field(gt=0.0, le=100.0)]
Source = Literal["auto", "scale", "control_points", "world_file", "geotiff"]


class Origin(Params):
    """Ground coordinates of the top-left corner (not the pixel's centre) of the reference frame."""

    x_m: float = Field(description="easting, or right in the local frame")
    y_m: float = Field(description="northing, or up in the local frame")


class ControlPoint(Params):
    """A point that is known in the reference frame and on the ground."""

    col_px: float = Field(description="to the right; 0 is the centre of the first pixel")
    row_px: float = Field(description="downwards; 0 is the centre of the first pixel")
    x_m: float = Field(description="easting, or right in the local frame")
    y_m: float = Field(description="northing, or up in the local frame")


class GeoreferenceParams(Params):
    """How the reference frame's pixels become metres; contradictions are refused.

    ``auto`` takes the first that is there: control points, the tags of a GeoTIFF frame, a world file beside the frame,
    else scale, origin and rotation.
    """

    gsd_m: Gsd | tuple[Gsd, Gsd] = Field(
        0.33, description="ground sampling distance; a pair means along columns and along rows (anamorphic video)"
    )
    crs: str | None = Field(
        None, description="projected metric CRS of all results, such as EPSG:26913; null = a local frame in metres"
    )
    origin: Origin | None = Field(None, description="ground coordinates of the reference frame's top-left corner")
    rotation_deg: float = Field(
        0.0, ge=-360.0, le=360.0, description="from grid north clockwise to the frame's upward direction"
    )
    control_points: tuple[ControlPoint, ...] | None = Field(
        None, description="at least 3 points known in the reference frame and on the ground, not on one line"
    )
    source: Source = Field("auto", description="where the georeference comes from")
    reference_frame: str | None = Field(
        None, description="path of the frame to which origin or control points refer; null = the sequence's first"
    )

    @property
    def gsd_xy_m(self) -> tuple[float, float]:
        """Ground sampling distance along columns and along rows."""
        return self.gsd_m if isinstance(self.gsd_m, tuple) else (self.gsd_m, self.gsd_m)

    @property
    def mosaic_gsd_m(self) -> float:
        """Ground sampling distance of mosaics, whose pixels are square: the finer of the two."""
        return min(self.gsd_xy_m)

    @field_validator("crs")
    @classmethod
    def _is_projected_and_metric(cls, crs: str | None) -> str | None:
        if crs is None:
            return None
        # Imported here: only surveys that name a CRS pay for loading it.
        from vtrack_batch.georeference.crs import projected_crs

        return projected_crs(crs)

    @field_validator("control_points")
    @classmethod
    def _span_a_plane(cls, points: tuple[ControlPoint, ...] | None) -> tuple[ControlPoint, ...] | None:
        if points is None:
            return None
        if len(points) < 3:
            raise ValueError(f"{len(points)} control points are given, at least 3 are needed")
        pixels = np.array([(point.col_px, point.row_px) for point in points])
        ground = np.array([(point.x_m, point.y_m) for point in points])
        for name, places in (("in the frame", pixels), ("on the ground", ground)):
            longest, shortest = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
            if shortest < 1e-3 * longest or longest == 0:
                raise ValueError(f"the control points lie on one line {name}: add one beside it")
        return points

    @model_validator(mode="after")
    def _no_contradictions(self) -> GeoreferenceParams:
        placed = [name for name in ("origin", "rotation_deg") if getattr(self, name)]
        if self.control_points is not None and placed:
            raise ValueError(f"control_points and {' and '.join(placed)} contradict each other: give one or the other")
        if self.source == "control_points" and self.control_points is None:
            raise ValueError("source is control_points, but none are given")
        if self.control_points is not None and self.source not in ("auto", "control_points"):
            raise ValueError(f"control_points are given, but source is {self.source}")
        if self.source in ("world_file", "geotiff") and placed:
            raise ValueError(f"{' and '.join(placed)} would not be used, because source is {self.source}")
        return self
