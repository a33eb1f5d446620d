"""Where the site frame of a sequence lies on the ground: reads what the file itself and the files beside it say."""

from __future__ import annotations

from collections.abc import Container
from pathlib import Path

from vtrack_batch.archive.names import unescape
from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import ConfigError
from vtrack_batch.georeference.fix import GroundFix, WorldFile, find_fix
from vtrack_batch.pipeline.plan import FrameRef

_TIFF_MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def fix_ground(survey: Survey, root: Path, ref: FrameRef, data: bytes, width_px: int, height_px: int) -> GroundFix:
    """Return the ground fix of the frame *ref* with the bytes *data*; raises ``ConfigError`` where none can be had."""
    tags = None
    if data[:4] in _TIFF_MAGIC:
        from vtrack_batch.storage.geotiff import read_geotags

        tags = read_geotags(data)
    beside = next(iter(world_files(root, ref.path)), None)
    world_file = WorldFile(beside.name, beside.read_text("ascii", "replace")) if beside else None
    fix = find_fix(survey.georeference, width_px, height_px, tags=tags, world_file=world_file)
    if fix.method == "scale" and "gsd_m" not in survey.georeference.model_fields_set:
        raise ConfigError(
            "georeference.gsd_m: how many metres a pixel is cannot be told from the frames and is never guessed; "
            "write it into the survey file, as `gsd_m: 0.33`, or give control points, world files or GeoTIFF"
        )
    return fix


def mosaic_gsd_m(survey: Survey, found_m: tuple[float, float]) -> float:
    """Return the pixel size of ground pictures: as set, or that of the frames to two digits."""
    if "gsd_m" in survey.georeference.model_fields_set:
        return survey.georeference.mosaic_gsd_m
    return float(f"{min(found_m):.2g}")


def world_files(root: Path, path: str, listed: Container[Path] | None = None) -> list[Path]:
    """Return the world files beside the frame *path*: ``.jgw``, ``.jpgw`` or ``.wld`` for ``.jpg``, and so on.

    *listed* = the files of its folder, where they are known, so that the disk need not be asked.
    """
    frame = root / unescape(path)
    suffix = frame.suffix.lstrip(".")
    if len(suffix) < 2:
        return []
    endings = [f"{suffix[0]}{suffix[-1]}w", f"{suffix}w", "wld"]
    candidates = [frame.with_suffix(f".{ending}") for ending in endings]
    return [path for path in candidates if (path.is_file() if listed is None else path in listed)]
