"""What ``vtrack-batch inspect`` shows: a table, what became of a frame, a frame on the ground grid."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vtrack_batch.archive.decode import decode
from vtrack_batch.archive.read import read_bytes
from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import CannotCreate, ConfigError, UnusableData
from vtrack_batch.georeference.fix import scale_at
from vtrack_batch.georeference.ortho import orthorectify
from vtrack_batch.model import homography
from vtrack_batch.model.ground_grid import GroundGrid
from vtrack_batch.pipeline.ground import mosaic_gsd_m
from vtrack_batch.pipeline.parts import matrices_of
from vtrack_batch.storage.geotiff import write_geotiff
from vtrack_batch.storage.results import Results, open_results


def inspect_table(survey: Survey, name: str, rows: int) -> tuple[Any, str]:
    """Return the first *rows* of a published table as records and as text."""
    table = _results(survey)[name]
    head = table.head(rows).drop(columns="geometry", errors="ignore")
    text = f"{name}: {len(table)} rows\n{head.to_string(index=False, max_colwidth=28)}"
    return head.to_dict("records"), text


def inspect_frame(survey: Survey, what: str) -> tuple[Any, str]:
    """Return what became of the frame with this path or id."""
    results = _results(survey)
    frames = results["frames"]
    found = _frame(frames, what)
    if found is None:
        quarantine = results["quarantine"]
        rows = quarantine.loc[quarantine["path"] == what]
        if rows.empty:
            raise ConfigError(
                f"{what!r} is neither a table, nor the path or id of a frame of this survey; "
                "`inspect SURVEY frames` lists its frames"
            )
        facts = dict(rows.iloc[0])
    else:
        facts = {key: value for key, value in found.items() if key != "sha256"}
        pose = results["registrations"].loc[lambda t: t["frame_id"] == found["frame_id"]]
        facts |= (
            pose[["reference_frame_id", "inliers", "residual_px", "residual_m"]].iloc[0].to_dict() if len(pose) else {}
        )
        facts["detections"] = int((results["detections"]["frame_id"] == found["frame_id"]).sum())
    return facts, "\n".join(f"{key}: {value}" for key, value in facts.items() if not pd.isna(value))


def write_ortho(survey: Survey, what: str, to: Path | None) -> Path:
    """Write the frame with this path or id as GeoTIFF at the set ground sampling distance; returns the file."""
    results = _results(survey)
    found = _frame(results["frames"], what)
    if found is None:
        raise ConfigError(
            f"{what!r} is not the path or id of a frame of this survey; `inspect SURVEY frames` lists its frames"
        )
    pose = results["registrations"].merge(results["references"], on="reference_frame_id")
    pose = pose.loc[(pose["frame_id"] == found["frame_id"]) & pose["accepted"]]
    if pose.empty:
        raise UnusableData(f"{found['path']}: it was not registered ({found['reason']}), so its ground is not known")
    to_ground = (matrices_of("g", pose) @ matrices_of("h", pose))[0]
    pixels = decode(
        read_bytes(survey.resolve(survey.archive.root), found["path"]), max_pixels=survey.archive.max_pixels
    ).pixels
    corners_m = homography.apply(to_ground, homography.corners(pixels.shape[1], pixels.shape[0]))
    crs = pose["crs"].iloc[0]
    grid = GroundGrid.covering(
        corners_m,
        mosaic_gsd_m(survey, scale_at(to_ground, pixels.shape[1], pixels.shape[0])),
        crs=None if pd.isna(crs) else str(crs),
    )
    target = to or Path(Path(found["path"]).stem + "-ortho.tif")
    try:
        write_geotiff(target, *orthorectify(pixels, to_ground, grid), grid)
    except OSError as problem:
        raise CannotCreate(f"{target}: cannot be written ({problem.strerror or problem})") from None
    return target


def _results(survey: Survey) -> Results:
    return open_results(survey.resolve(survey.output.root))


def _frame(frames: pd.DataFrame, what: str) -> pd.Series | None:
    rows = frames.loc[np.logical_or(frames["path"] == what, frames["frame_id"] == what)]
    return None if rows.empty else rows.iloc[0]
