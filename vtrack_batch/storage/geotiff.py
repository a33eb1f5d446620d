"""GeoTIFF: the georeference of a frame in, pictures of the ground out."""

from __future__ import annotations

import errno
import secrets
import shutil
import warnings
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.errors import UnusableData, UnusableFrame
from vtrack_batch.model.geotags import GeoTags
from vtrack_batch.model.ground_grid import MOST_PIXELS, GroundGrid

_NOTHING_LEVEL = 235
_TILE_PX = 512
_IDENTITY = (0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def read_geotags(data: bytes) -> GeoTags | None:
    """Return the georeference in the bytes *data* of a TIFF, None if it has none.

    Raises `UnusableFrame` (``malformed``) where it is no TIFF. Only GDAL's GeoTIFF driver is asked.
    """
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    if not data:
        raise UnusableFrame("malformed", "the file is empty")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        try:
            with rasterio.MemoryFile(data) as memory, memory.open(driver="GTiff") as dataset:
                # GDAL has already moved the reference of PixelIsPoint files to the corner.
                x, across_x, down_x, y, across_y, down_y = (float(number) for number in dataset.transform.to_gdal())
                crs = dataset.crs
        except RasterioError as problem:
            raise UnusableFrame("malformed", f"its georeference cannot be read ({problem})") from None
    geotransform = (x, across_x, down_x, y, across_y, down_y)
    if geotransform == _IDENTITY:
        return None
    authority = crs.to_authority() if crs else None
    name = ":".join(authority) if authority else (crs.to_wkt() if crs else None)
    return GeoTags(geotransform, name)


def write_geotiff(path: Path, pixels: NDArray[np.uint8], valid: NDArray[np.bool_], grid: GroundGrid) -> None:
    """Write *pixels* (rows, columns, 3) uint8 RGB on *grid* to *path*, with an alpha band that is 0 where not *valid*.

    The same input gives the same bytes; the file appears whole or not at all. Raises `OSError`.
    """
    # GDAL would stretch a picture of another size without a word.
    if pixels.shape != (*grid.shape, 3) or valid.shape != grid.shape:
        raise ValueError(f"pixels {pixels.shape} and valid {valid.shape} do not fit a grid of {grid.shape}")
    with _created(path, grid) as dataset:
        for band in range(3):
            dataset.write(pixels[:, :, band], band + 1)
        dataset.write(valid.astype(np.uint8) * np.uint8(255), 4)


def merge_geotiffs(paths: Sequence[Path], path: Path) -> None:
    """Write the union of pictures that `write_geotiff` made on grids of one CRS and pixel size to *path*.

    Where they overlap the first one that is valid shows. Nothing is written for no pictures. Worked in strips, so that
    memory does not grow with the area. Raises `UnusableData` where the grids do not match or too much would be
    covered, and `OSError`.
    """
    import rasterio

    if not paths:
        return
    if len(paths) == 1:
        _copy(paths[0], path)
        return
    with ExitStack() as stack:
        pictures = [stack.enter_context(rasterio.open(source, driver="GTiff")) for source in paths]
        grids = [_grid_of(picture) for picture in pictures]
        union = _union(grids)
        with _created(path, union) as dataset:
            for top in range(0, union.shape[0], _TILE_PX):
                rows = min(_TILE_PX, union.shape[0] - top)
                strip = np.zeros((4, rows, union.shape[1]), np.uint8)
                for picture, grid in zip(pictures, grids, strict=True):
                    _lay_below(strip, top, picture, _offset(grid, union))
                dataset.write(strip, window=((top, top + rows), (0, union.shape[1])))


def read_reduced(path: Path, most_px: int) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return a picture that `write_geotiff` made, no side longer than *most_px*, and where it lies on the ground.

    Pixels (H, W, 3) uint8, light grey where there are none, and the map (3, 3) from them to ground metres.
    """
    import rasterio

    with rasterio.open(path, driver="GTiff") as picture:
        grid, step = _grid_of(picture), max(1, -(-max(picture.shape) // most_px))
        shape = tuple(max(1, side // step) for side in picture.shape)
        bands = picture.read(out_shape=(4, *shape), resampling=rasterio.enums.Resampling.average)
    pixels = np.ascontiguousarray(bands[:3].transpose(1, 2, 0))
    pixels[bands[3] < 128] = _NOTHING_LEVEL
    rows, columns = grid.shape[0] / shape[0], grid.shape[1] / shape[1]
    whole = np.array([[columns, 0, (columns - 1) / 2], [0, rows, (rows - 1) / 2], [0, 0, 1.0]])
    return pixels, grid.to_ground @ whole


def _copy(source: Path, path: Path) -> None:
    with _replaced(path) as temporary:
        shutil.copyfile(source, temporary)


@contextmanager
def _replaced(path: Path) -> Iterator[Path]:
    """Give the name of an empty file; it takes the name *path* when the block ends well."""
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")
    # Fails with a plain OSError where the folder cannot be written, which GDAL does not.
    temporary.write_bytes(b"")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        with suppress(FileNotFoundError):
            temporary.unlink()


@contextmanager
def _created(path: Path, grid: GroundGrid) -> Iterator[Any]:
    """Open a new RGBA GeoTIFF on *grid*; it takes the name *path* when the block ends well."""
    import rasterio
    from rasterio.errors import RasterioError
    from rasterio.transform import from_origin

    with _replaced(path) as temporary:
        try:
            with rasterio.open(
                temporary,
                "w",
                driver="GTiff",
                width=grid.shape[1],
                height=grid.shape[0],
                count=4,
                dtype="uint8",
                crs=grid.crs,
                transform=from_origin(grid.x_min_m, grid.y_max_m, grid.gsd_m, grid.gsd_m),
                photometric="RGB",
                alpha="YES",
                tiled=True,
                blockxsize=_TILE_PX,
                blockysize=_TILE_PX,
                compress="deflate",
                predictor=2,
                zlevel=2,  # files a tenth larger than with the usual 6, in a quarter of the time
                bigtiff="IF_SAFER",
            ) as dataset:
                yield dataset
            _require_whole(temporary)
        except RasterioError as problem:
            raise OSError(f"{path}: {problem}") from problem


def _require_whole(path: Path) -> None:
    """Raise `OSError` if tiles of the file just written are not in it: on a full disk GDAL only grumbles to stderr."""
    import rasterio

    size = path.stat().st_size
    with rasterio.open(path, driver="GTiff") as picture:
        for (row, column), _ in picture.block_windows(1):
            offset, length = (
                int(picture.get_tag_item(f"BLOCK_{what}_{column}_{row}", "TIFF", bidx=1) or 0)
                for what in ("OFFSET", "SIZE")
            )
            if not offset or offset + length > size:
                raise OSError(errno.ENOSPC, f"tile {row}, {column} is not in the file: is the disk full?")


def _grid_of(picture: Any) -> GroundGrid:
    transform = picture.transform
    crs = picture.crs.to_wkt() if picture.crs else None
    return GroundGrid(crs, transform.c, transform.f, transform.a, (picture.height, picture.width))


def _union(grids: Sequence[GroundGrid]) -> GroundGrid:
    first = grids[0]
    if any(grid.crs != first.crs or abs(grid.gsd_m - first.gsd_m) > 1e-9 for grid in grids):
        kinds = sorted({f"{grid.gsd_m:g} m in {grid.crs or 'no CRS'}"[:80] for grid in grids})
        raise UnusableData(
            "pictures of the ground in different CRS or of different pixel size cannot be merged: "
            f"{'; '.join(kinds)}; set georeference.gsd_m, and give all frames one CRS"
        )
    left, top = min(grid.x_min_m for grid in grids), max(grid.y_max_m for grid in grids)
    corner = GroundGrid(first.crs, left, top, first.gsd_m, (0, 0))
    places = [(*_offset(grid, corner), *grid.shape) for grid in grids]
    rows, columns = max(row + r for row, _, r, _ in places), max(column + c for _, column, _, c in places)
    if rows * columns > MOST_PIXELS:
        raise UnusableData(f"the ground mosaic would have {columns} x {rows} px; set a larger georeference.gsd_m")
    return GroundGrid(first.crs, left, top, first.gsd_m, (rows, columns))


def _offset(grid: GroundGrid, union: GroundGrid) -> tuple[int, int]:
    """Return the row and column of *union* at which *grid* begins."""
    return round((union.y_max_m - grid.y_max_m) / union.gsd_m), round((grid.x_min_m - union.x_min_m) / union.gsd_m)


def _lay_below(strip: NDArray[np.uint8], strip_top: int, picture: Any, offset: tuple[int, int]) -> None:
    """Fill what is still empty of *strip* (4, rows, columns), which begins at row *strip_top* of the union."""
    top, bottom = max(strip_top, offset[0]), min(strip_top + strip.shape[1], offset[0] + picture.height)
    if top >= bottom:
        return
    found = picture.read(window=((top - offset[0], bottom - offset[0]), (0, picture.width)))
    part = strip[:, top - strip_top : bottom - strip_top, offset[1] : offset[1] + picture.width]
    free = (part[3] == 0) & (found[3] > 0)
    part[:, free] = found[:, free]
