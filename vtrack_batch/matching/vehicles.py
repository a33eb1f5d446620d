"""What matching reads from a table of detections: checked, and in an order that does not depend on the rows'."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from vtrack_batch.errors import UnusableData
from vtrack_batch.matching.candidates import Array

COLOUR = ["red", "green", "blue"]


@dataclass(frozen=True)
class Vehicles:
    """Vehicles of one image: ``ids`` (n,), ``xy`` (n, 2) float64 metres, ``rgb`` (n, 3) float64 or None; sorted."""

    ids: pd.Series[Any]
    xy: Array
    rgb: Array | None

    def __len__(self) -> int:
        return len(self.xy)

    @classmethod
    def of(cls, detections: pd.DataFrame, name: str) -> Vehicles:
        """Read and check *detections*; sort by x, y, id. Raises ``UnusableData`` on what cannot be used."""
        checked = check(detections, name)
        rows = checked.sort_values(["x_m", "y_m", "detection_id"], kind="stable", ignore_index=True)
        rgb = rows[COLOUR].to_numpy(float) if set(COLOUR) <= set(rows.columns) else None
        return cls(rows["detection_id"], rows[["x_m", "y_m"]].to_numpy(float), rgb)


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
