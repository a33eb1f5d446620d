"""What matching reads from a table of detections: checked, and in an order that does not depend on the rows'."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vtrack_batch.errors import UnusableData
from vtrack_batch.matching.candidates import Array

COLOUR = ["red", "green", "blue"]
VELOCITY = ["vx_mps", "vy_mps"]
STRIP_M = 60.0
HEAP_M, HEAP_MOST = 10.0, 64  # about 12 cars stand on 10 m x 10 m; the rest is room for false alarms


@dataclass(frozen=True)
class Vehicles:
    """Vehicles of one image: ``ids`` (n,), ``xy`` (n, 2) float64 metres, ``rgb`` (n, 3) float64 or None; sorted.

    ``velocity`` (n, 2) float64 m/s as the detector measured it, NaN where it did not; None if it never did.
    """

    ids: pd.Series[Any]
    xy: Array
    rgb: Array | None
    velocity: Array | None = None

    def __len__(self) -> int:
        return len(self.xy)

    @classmethod
    def of(cls, detections: pd.DataFrame, name: str) -> Vehicles:
        """Read and check *detections*; sort by place and id. Raises ``UnusableData`` on what cannot be used."""
        checked = check(detections, name)
        xy = np.column_stack([checked["x_m"].to_numpy(float), checked["y_m"].to_numpy(float)])
        rank = pd.factorize(checked["detection_id"], sort=True)[0]
        # in strips, so that what is near on the ground is near in memory
        order = np.lexsort((rank, xy[:, 1], xy[:, 0], np.floor(xy[:, 1] / STRIP_M)))
        xy = xy[order]
        coloured = set(COLOUR) <= set(checked.columns)
        rgb = np.column_stack([checked[c].to_numpy(float) for c in COLOUR])[order] if coloured else None
        refuse_heaps(xy, np.zeros(len(xy), np.int64), name)
        velocity = measured_velocity(checked)
        ids = checked["detection_id"].iloc[order].reset_index(drop=True)
        return cls(ids, xy, rgb, None if velocity is None else velocity[order])


def refuse_heaps(xy: Array, frame: NDArray[np.int64], name: str) -> None:
    """Raise ``UnusableData`` where more points (n, 2) of one frame (n,) lie together than vehicles can.

    Such heaps come of wrong units, and the work on them grows with the fourth power of their size.
    """
    cells = np.column_stack([frame, np.floor(xy / HEAP_M).astype(np.int64)])
    found, at, count = np.unique(cells, axis=0, return_index=True, return_counts=True)
    if len(found) and count.max() > HEAP_MOST:
        x, y = xy[at[count.argmax()]]
        raise UnusableData(
            f"{name}: {count.max()} detections of one frame lie within {HEAP_M:.0f} m of one another, near "
            f"({x:.6g}, {y:.6g}); no vehicles stand so close: is the unit of the coordinates metres?"
        )


def measured_velocity(rows: pd.DataFrame) -> Array | None:
    """Return velocities (n, 2) in m/s, NaN where the detector measured none; None if it never did."""
    if not set(VELOCITY) <= set(rows.columns):
        return None
    velocity = rows[VELOCITY].apply(pd.to_numeric, errors="coerce").to_numpy(float, na_value=np.nan)
    known = np.isfinite(velocity).all(axis=1)
    return np.where(known[:, None], velocity, np.nan) if known.any() else None


def check(detections: pd.DataFrame, name: str, extra: tuple[str, ...] = ()) -> pd.DataFrame:
    """Return *detections* with integer ids as nullable integers; raise ``UnusableData`` with all that is wrong."""
    missing = [c for c in ("detection_id", "x_m", "y_m", *extra) if c not in detections.columns]
    if missing:
        raise UnusableData(f"{name}: the columns {', '.join(missing)} are missing")
    colours = [c for c in COLOUR if c in detections.columns]
    faults = []
    for column in ("x_m", "y_m", *(colours if len(colours) == len(COLOUR) else [])):
        if not pd.api.types.is_numeric_dtype(detections[column]):
            faults.append(f"{column} is not numeric")
            continue
        bad = int((~np.isfinite(detections[column].to_numpy(float, na_value=np.nan))).sum())
        if bad:
            faults.append(f"{column} is missing or not finite in {bad} rows")
    ids = detections["detection_id"]
    if ids.isna().any():
        faults.append(f"detection_id is missing in {int(ids.isna().sum())} rows")
    repeated = int(ids.duplicated().sum())
    if repeated:
        faults.append(f"detection_id is repeated in {repeated} rows, first {ids[ids.duplicated()].iloc[0]!r}")
    if faults:
        raise UnusableData(f"{name}: " + "; ".join(faults))
    if pd.api.types.is_integer_dtype(ids.dtype):
        return detections.assign(detection_id=ids.astype("Int64"))
    return detections
