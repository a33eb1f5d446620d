"""The tables of a unit that has been detected: what became of its frames, and what its blocks hold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from vtrack_batch.model.tables import TABLES
from vtrack_batch.pipeline.block import Block
from vtrack_batch.pipeline.parts import matrix_columns
from vtrack_batch.pipeline.reading import FrameLog
from vtrack_batch.storage.parquet import empty_frame


def unit_tables(log: FrameLog, blocks: Sequence[tuple[Block, pd.DataFrame]]) -> dict[str, pd.DataFrame]:
    """Return the tables of the step ``detect``, by name; *blocks* come with their detections."""
    return {
        "frames": _frames(log),
        "registrations": _joined("registrations", [_registrations(log, block) for block, _ in blocks]),
        "references": _joined("references", [_references(block) for block, _ in blocks]),
        "detections": _joined("detections", [found for _, found in blocks]),
        "quarantine": _quarantine(log),
    }


def _joined(name: str, tables: list[pd.DataFrame]) -> pd.DataFrame:
    """Return the rows of all blocks."""
    filled = [table for table in tables if len(table)]
    return pd.concat(filled, ignore_index=True) if filled else empty_frame(TABLES[name])


def _frames(log: FrameLog) -> pd.DataFrame:
    refs = log.unit.frames
    sizes = [log.size.get(ref.frame_id, (None, None)) for ref in refs]
    problems = [log.refused.get(ref.frame_id) for ref in refs]
    return pd.DataFrame(
        {
            "frame_id": [ref.frame_id for ref in refs],
            "sequence": log.unit.sequence,
            "path": [ref.path for ref in refs],
            "t_utc": pd.DatetimeIndex(np.array([ref.t_utc for ref in refs]), tz="UTC"),
            "width_px": pd.array([width for width, _ in sizes], dtype="Int32"),
            "height_px": pd.array([height for _, height in sizes], dtype="Int32"),
            "sha256": [ref.sha256 for ref in refs],
            "status": ["quarantined" if problem else "used" for problem in problems],
            "reason": [problem.reason if problem else None for problem in problems],
        }
    )


def _registrations(log: FrameLog, block: Block) -> pd.DataFrame:
    done = [(ref, log.pose[ref.frame_id]) for ref in block.unit.frames if ref.frame_id in log.pose]
    if not done:
        return empty_frame(TABLES["registrations"])
    poses = [pose for _, pose in done]
    residual_px = np.array([pose.residual_px if np.isfinite(pose.residual_px) else np.nan for pose in poses])
    return pd.DataFrame(
        {
            "frame_id": [ref.frame_id for ref, _ in done],
            "reference_frame_id": block.ref.frame_id,
            **matrix_columns("h", np.array([pose.frame_to_reference for pose in poses])),
            "inliers": np.array([pose.inliers for pose in poses], "int32"),
            "residual_px": residual_px,
            "residual_m": residual_px * float(np.mean(block.metres_per_px)),
            "accepted": [pose.accepted for pose in poses],
        }
    )


def _references(block: Block) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "reference_frame_id": [block.ref.frame_id],
            **matrix_columns("g", block.fix.reference_to_ground[None]),
            "method": [block.fix.method],
            "residual_m": [np.nan if block.fix.residual_m is None else block.fix.residual_m],
            "crs": [block.fix.crs],
        }
    )


def _quarantine(log: FrameLog) -> pd.DataFrame:
    own = [(ref, log.refused[ref.frame_id]) for ref in log.unit.frames if ref.frame_id in log.refused]
    return pd.DataFrame(
        {
            "path": [ref.path for ref, _ in own],
            "reason": [problem.reason for _, problem in own],
            "detail": [problem.detail or None for _, problem in own],
        },
        dtype=object,
    )
