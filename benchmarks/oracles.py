"""Do IDF1, MOTA and HOTA equal TrackEval's and py-motmetrics' on the same boxes? ``python -m benchmarks.oracles``.

The peers run in environments of their own (``benchmarks/environment.py``) on the same tables of boxes, with their own
overlaps. Ours must equal theirs to 1e-9; where the two peers differ from each other, it is listed to the vehicle.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.environment import pinned, run_peer
from benchmarks.page import SHARED
from vtrack_batch.evaluation.blocks import time_blocks
from vtrack_batch.evaluation.clear import carried, clear_matches, of_last_frame
from vtrack_batch.evaluation.params import EvaluationParams
from vtrack_batch.evaluation.tracked import Tracked
from vtrack_batch.evaluation.tracks import identity_scores

SAME = 1e-9
BOX = ["left", "top", "width", "height"]
NAMES = {
    "trackeval": {name: name for name in ("idf1", "mota", "id_switches", "hota", "deta", "assa")},
    "motmetrics": {"idf1": "idf1", "mota": "mota_carried", "id_switches": "id_switches_carried"},
}


def main() -> int:
    """Print our figures beside the peers', and where the peers differ; return 1 unless ours equal theirs."""
    worst = 0.0
    for name, truth, tracks in worlds():
        tracked = overlapping(truth, tracks)
        ours = our_scores(tracked)
        print(f"\n{name}: {len(truth)} boxes of {truth['id'].nunique()} vehicles, {len(tracks)} of tracks")
        for peer, names in NAMES.items():
            theirs = run_peer(peer, peer, {"truth": truth, "tracks": tracks})["scores"].iloc[0]
            for score, own in names.items():
                off = abs(ours[own] - theirs[score])
                worst = max(worst, off)
                print(f"  {pinned(peer):<18} {score:<12} {theirs[score]:>20.15g}  ours {ours[own]:>20.15g}  {off:.1e}")
        for line in between_readings(tracked, truth, tracks):
            print(line)
    print(f"\nlargest difference {worst:.1e}, allowed {SAME:.0e}")
    return int(worst > SAME)


def worlds() -> Iterator[tuple[str, pd.DataFrame, pd.DataFrame]]:
    """Yield name, true boxes and tracked boxes: made-up crowds, and real tracks with faults where they are at hand."""
    for seed in range(3):
        truth = crowd(np.random.default_rng(seed))
        yield f"crowd {seed}", truth, with_faults(truth, np.random.default_rng(100 + seed))
    kit, skysat = SHARED / "kit-ais" / "MunichStreet02" / "tracks.csv", SHARED / "skysat" / "tracks.csv"
    if kit.is_file():
        truth = pd.read_csv(kit)[["frame", "id", *BOX]]
        yield "MunichStreet02 with faults", truth, with_faults(truth, np.random.default_rng(7))
    if skysat.is_file():
        truth = pd.read_csv(skysat, header=None).iloc[:, :6].set_axis(["frame", "id", *BOX], axis=1)
        truth = truth[truth["frame"] % 15 == 0].astype(dict.fromkeys(BOX, float))
        yield "SkySat at 0.5 s with faults", truth, with_faults(truth, np.random.default_rng(8))


def crowd(rng: np.random.Generator, vehicles: int = 40, frames: int = 60) -> pd.DataFrame:
    """Return boxes of vehicles that wander close to each other, come, go, and are out of sight for a while."""
    start, speed = rng.uniform(0, 120, (vehicles, 2)), rng.normal(0, 1.5, (vehicles, 2))
    size = rng.uniform(8, 16, (vehicles, 2))
    frame, vehicle = (part.ravel() for part in np.meshgrid(np.arange(frames), np.arange(vehicles)))
    first, last = rng.integers(0, 20, vehicles), rng.integers(35, frames, vehicles)
    seen = (frame >= first[vehicle]) & (frame <= last[vehicle]) & (rng.random(len(frame)) > 0.1)
    centre = start[vehicle] + speed[vehicle] * frame[:, None] + 0.2 * rng.normal(size=(len(frame), 2))
    corner = centre - size[vehicle] / 2
    columns = {"frame": frame, "id": vehicle, "left": corner[:, 0], "top": corner[:, 1]}
    boxes = pd.DataFrame(columns | {"width": size[vehicle, 0], "height": size[vehicle, 1]})
    return boxes[seen].sort_values(["frame", "id"], ignore_index=True)


def with_faults(truth: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """Return the boxes as a poor tracker has them: off, missed, swapped, broken, doubled, and out of thin air."""
    kept = truth[rng.random(len(truth)) > 0.12]
    off = 0.08 * kept[["width", "height"]].to_numpy() * rng.normal(size=(len(kept), 2))
    kept = kept.assign(left=kept["left"] + off[:, 0], top=kept["top"] + off[:, 1], id=kept["id"] + 1000)
    swaps = rng.choice(kept["id"].unique(), (8, 2))
    middle = rng.integers(kept["frame"].min(), kept["frame"].max(), len(swaps))
    name = kept["id"].to_numpy().copy()
    for (a, b), since in zip(swaps, middle, strict=True):
        late = kept["frame"].to_numpy() >= since
        was = name.copy()
        name[late & (was == a)], name[late & (was == b)] = b, a
    broken = rng.random(kept["id"].max() + 1) < 0.3
    since = rng.integers(kept["frame"].min(), kept["frame"].max(), len(broken))
    name = name + np.where(broken[name] & (kept["frame"].to_numpy() > since[name]), 2000, 0)
    kept = kept.assign(id=name)
    double = kept[rng.random(len(kept)) < 0.1]
    double = double.assign(left=double["left"] + 0.1 * double["width"], id=5000 + double["id"] % 17)
    stray = kept.sample(frac=0.05, random_state=1).assign(left=lambda rows: rows["left"] + 300, id=9000)
    both = pd.concat([kept, double, stray]).drop_duplicates(["frame", "id"])
    return both.sample(frac=1, random_state=2).reset_index(drop=True)


def overlapping(truth: pd.DataFrame, tracks: pd.DataFrame) -> Tracked:
    """Return both sides with the overlap (intersection over union) of all pairs of boxes that touch."""
    truth, tracks = (side.sort_values(["frame", "id"], ignore_index=True) for side in (truth, tracks))
    pairs = truth[["frame"]].reset_index(names="i").merge(tracks[["frame"]].reset_index(names="j"), on="frame")
    i, j = pairs["i"].to_numpy(), pairs["j"].to_numpy()
    similarity = overlap(truth[BOX].to_numpy(float)[i], tracks[BOX].to_numpy(float)[j])
    keep = np.lexsort((j, i))
    keep = keep[similarity[keep] > 0]
    codes = (pd.factorize(side["id"], sort=True)[0].astype(np.int64) for side in (truth, tracks))
    start = min(truth["frame"].min(), tracks["frame"].min())
    vehicle, track = codes
    return Tracked(
        vehicle=vehicle,
        frame=truth["frame"].to_numpy(np.int64) - start,
        track=track,
        track_frame=tracks["frame"].to_numpy(np.int64) - start,
        i=i[keep],
        j=j[keep],
        similarity=similarity[keep],
    )


def overlap(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return intersection over union of boxes (n, 4): left, top, width, height."""
    low, high = np.maximum(a[:, :2], b[:, :2]), np.minimum(a[:, :2] + a[:, 2:], b[:, :2] + b[:, 2:])
    common = np.prod(np.maximum(high - low, 0), axis=1)
    return np.asarray(common / (np.prod(a[:, 2:], axis=1) + np.prod(b[:, 2:], axis=1) - common))


def our_scores(tracked: Tracked) -> dict[str, float]:
    """Return our figures as plain numbers."""
    blocks = time_blocks(np.arange(max(tracked.frame.max(), tracked.track_frame.max()) + 1.0), EvaluationParams())
    scores = identity_scores(tracked, blocks)
    return {name: float(score["value"] if isinstance(score, dict) else score) for name, score in scores.items()}


def between_readings(tracked: Tracked, truth: pd.DataFrame, tracks: pd.DataFrame) -> Iterator[str]:
    """Yield, frame by frame, vehicles whose partner differs between the two readings of CLEAR MOT."""
    vehicle, track = (np.unique(side["id"]) for side in (truth, tracks))
    partners = []
    for rule in (of_last_frame, carried):
        chosen, switched = clear_matches(tracked, rule)
        rows = {"frame": tracked.frame[tracked.i[chosen]], "vehicle": vehicle[tracked.vehicle[tracked.i[chosen]]]}
        named = pd.DataFrame(rows | {"track": track[tracked.track[tracked.j[chosen]]], "switch": switched})
        partners.append(named.set_index(["frame", "vehicle"]))
    both = partners[0].add_suffix("_te").join(partners[1].add_suffix("_mm"), how="outer")
    other = both["track_te"].fillna(-1) != both["track_mm"].fillna(-1)
    differ = both[other | (both["switch_te"] != both["switch_mm"])]
    yield f"  between the peers: {len(differ)} of {len(both)} sightings matched by either"
    for row in differ.head(12).reset_index().itertuples():
        said = (told(row.track_te, row.switch_te), told(row.track_mm, row.switch_mm))
        yield f"    frame {row.frame}, vehicle {row.vehicle}: TrackEval {said[0]}, motmetrics {said[1]}"


def told(track: float, switch: object) -> str:
    """Return a partner in words."""
    return "none" if np.isnan(track) else f"{track:.0f}{' (switch)' if switch else ''}"


if __name__ == "__main__":
    sys.exit(main())
