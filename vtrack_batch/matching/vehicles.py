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
        ids, numbers = _read(detections, name)
        xy = np.column_stack([numbers["x_m"], numbers["y_m"]])
        # in strips, so that what is near on the ground is near in memory
        keys = xy[:, 1], xy[:, 0], np.floor(xy[:, 1] / STRIP_M)
        order = np.lexsort(keys)
        if (xy[order[1:]] == xy[order[:-1]]).all(axis=1).any():
            order = np.lexsort((pd.factorize(ids, sort=True)[0], *keys))
        xy = xy[order]
        rgb = np.column_stack([numbers[c] for c in COLOUR])[order] if len(numbers) > 2 else None
        refuse_heaps(xy, np.zeros(len(xy), np.int64), name)
        velocity = measured_velocity(detections)
        return cls(pd.Series(ids.array.take(order)), xy, rgb, None if velocity is None else velocity[order])


def refuse_heaps(xy: Array, frame: NDArray[np.int64], name: str) -> None:
    """Raise ``UnusableData`` where more points (n, 2) of one frame (n,) lie together than vehicles can.

    Such heaps come of wrong units, and the work on them grows with the fourth power of their size.
    """
    if len(xy) <= HEAP_MOST:
        return
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
    ids = _read(detections, name, extra)[0]
    return detections if ids is detections["detection_id"] else detections.assign(detection_id=ids)


def _read(detections: pd.DataFrame, name: str, extra: tuple[str, ...] = ()) -> tuple[pd.Series[Any], dict[str, Array]]:
    """Return ids, integers as nullable ones, and the columns of numbers; raise ``UnusableData`` with all faults."""
    missing = [c for c in ("detection_id", "x_m", "y_m", *extra) if c not in detections.columns]
    if missing:
        raise UnusableData(f"{name}: the columns {', '.join(missing)} are missing")
    faults, numbers = [], {}
    for column in ("x_m", "y_m", *(COLOUR if set(COLOUR) <= set(detections.columns) else [])):
        values = detections[column]
        if not pd.api.types.is_numeric_dtype(values.dtype):
            faults.append(f"{column} is not numeric")
            continue
        numbers[column] = values.to_numpy(float, na_value=np.nan)
        bad = len(values) - int(np.isfinite(numbers[column]).sum())
        if bad:
            faults.append(f"{column} is missing or not finite in {bad} rows")
    ids = detections["detection_id"]
    absent, repeated = int(ids.isna().sum()), len(ids) - len(pd.unique(ids))
    if absent:
        faults.append(f"detection_id is missing in {absent} rows")
    if repeated:
        faults.append(f"detection_id is repeated in {repeated} rows, first {ids[ids.duplicated()].iloc[0]!r}")
    if faults:
        raise UnusableData(f"{name}: " + "; ".join(faults))
    return ids.astype("Int64") if pd.api.types.is_integer_dtype(ids.dtype) else ids, numbers
