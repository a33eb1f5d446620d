"""The georeference that a GeoTIFF carries."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class GeoTags:
    """What the tags of a GeoTIFF say.

    ``geotransform``: six numbers in GDAL's order, x0, dx/dcol, dx/drow, y0, dy/dcol, dy/drow, for coordinates that are
    0 at the outer **corner** of the first pixel, whether the file counts from corners (PixelIsArea) or from centres
    (PixelIsPoint). ``crs``: authority and code, or WKT; None if the file names none.
    """

    geotransform: tuple[float, float, float, float, float, float]
    crs: str | None
