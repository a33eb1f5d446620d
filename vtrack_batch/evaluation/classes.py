"""Are cars told from vans, lorries and buses? The class of each track beside that of the vehicle it mostly follows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from vtrack_batch.evaluation.blocks import Blocks
from vtrack_batch.evaluation.pairing import Paired
from vtrack_batch.evaluation.sides import Result, Truth

CLASSES = ("car", "van", "lorry", "bus", "unknown")


def class_scores(result: Result, truth: Truth, paired: Paired, blocks: Blocks) -> dict[str, Any] | None:
    """Return the share of tracks with the right class and, for each true class, the share of tracks taken for each.

    A track that follows no one vehicle in more than half of its sightings is left out; it belongs to the block in which
    it is first seen. None where either side tells no classes.
    """
    if not {"vehicle_id", "vehicle_class"} <= set(truth.trajectories) or truth.trajectories.empty:
        return None
    found = paired.found[paired.found["vehicle_id"].notna()]
    seen = found[(found["row"] >= 0).to_numpy()]
    together = seen.groupby(["vehicle_id", "vehicle"]).agg(sightings=("frame", "size"), frame=("frame", "min"))
    together = together.reset_index().sort_values(["vehicle_id", "sightings", "vehicle"])
    most = together.drop_duplicates("vehicle_id", keep="last").set_index("vehicle_id")
    most = most[2 * most["sightings"] > found.groupby("vehicle_id").size().reindex(most.index)]
    told = most.assign(
        true=most["vehicle"].map(_classes(truth.trajectories)),
        found=_classes(result.trajectories).reindex(most.index),
    )
    told = told[told[["true", "found"]].isin(CLASSES).all(axis=1)]
    if told.empty:
        return None
    frame = told["frame"].to_numpy(np.int64)
    counts = pd.crosstab(told["true"], told["found"]).reindex(index=list(CLASSES), columns=list(CLASSES), fill_value=0)
    taken = {name: row for name, row in counts.iterrows() if row.sum()}
    return {
        "tracks": len(told),
        "right_class": blocks.ratio(
            blocks.totals(frame, (told["true"] == told["found"]).to_numpy(float)), blocks.totals(frame)
        ),
        "true": {
            str(name): {"tracks": int(row.sum())}
            | {f"taken_for_{c}": float(row[c] / row.sum()) for c in CLASSES if row[c]}
            for name, row in taken.items()
        },
    }


def _classes(trajectories: pd.DataFrame) -> pd.Series[str]:
    """Return the class of each vehicle by its id."""
    return trajectories.drop_duplicates("vehicle_id").set_index("vehicle_id")["vehicle_class"].astype("str")
