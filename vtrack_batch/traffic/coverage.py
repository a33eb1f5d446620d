"""What was in view, place by place: the ground under every count."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd
import shapely
from shapely.geometry import LineString, Polygon

from vtrack_batch.model.views import Views
from vtrack_batch.traffic.bins import SECOND_US, Bins
from vtrack_batch.traffic.params import TrafficParams
from vtrack_batch.traffic.paths import Floats, Ints, Mask
from vtrack_batch.traffic.places import Place


@dataclass(frozen=True)
class Coverage:
    """The imaged time in slices during which nothing changes, and how much of each place each slice shows.

    ``bin`` (m,) int64 ascending; ``duration_s`` (m,); ``share`` (m, p) of each place within the footprint (of two
    platforms the better one); ``in_view`` (m, p) bool, the share suffices for counting; ``frames`` (b, p) frames that
    showed the place, by bin.
    """

    bins: Bins
    bin: Ints
    duration_s: Floats
    share: Floats
    in_view: Mask
    frames: Ints

    def seconds(self, *places: int) -> Floats:
        """Return per bin (b,) the time during which all these places were in view at once; of none, any ground."""
        shown = self.in_view[:, list(places)].all(axis=1)
        return np.bincount(self.bin, self.duration_s * shown, len(self.bins)).astype(float)

    def pair_seconds(self) -> Floats:
        """Return (b, p + 1, p + 1) the time during which two places were in view at once; index p = any ground."""
        shown = np.c_[self.in_view, np.ones(len(self.bin))].astype(float)
        border = np.searchsorted(self.bin, np.arange(len(self.bins) + 1))
        out = np.zeros((len(self.bins), shown.shape[1], shown.shape[1]))
        for b, (start, stop) in enumerate(pairwise(border)):
            out[b] = (shown[start:stop] * self.duration_s[start:stop, None]).T @ shown[start:stop]
        return out

    def share_seconds(self, place: int) -> Floats:
        """Return per bin (b,) the time integral of the visible share of a place."""
        return np.bincount(self.bin, self.duration_s * self.share[:, place], len(self.bins)).astype(float)


def coverage_of(views: Mapping[str, Views], places: Sequence[Place], *, bins: Bins, params: TrafficParams) -> Coverage:
    """Return what the frames showed of the places.

    A frame speaks for the ground in its footprint until the next frame of its sequence, at most ``max_gap_s``; the last
    frame of a sequence ends it. A line is in view where ``min_share_visible`` of it is; an area where that much of the
    most that any frame shows is, for areas are drawn generously beyond the view.
    """
    ordered = [views[name] for name in sorted(views) if len(views[name])]
    starts = [view.t_utc.astype("datetime64[us]").astype(np.int64) for view in ordered]
    shares = [shares_visible(view.corners_m, places) for view in ordered]
    need = _needed(shares, places, params)
    frames = np.zeros((len(bins), len(places)), np.int64)
    for start, share in zip(starts, shares, strict=True):
        frame, place = np.nonzero(share >= need)
        of_bin = bins.index(start[frame])
        np.add.at(frames, (of_bin[of_bin >= 0], place[of_bin >= 0]), 1)
    edge, share, imaged = _slices(starts, shares, len(places), bins, params)
    of_bin = bins.index(edge[:-1])
    keep = imaged & (of_bin >= 0)
    share = share[keep]
    return Coverage(bins, of_bin[keep], (np.diff(edge) / SECOND_US)[keep], share, share >= need, frames)


def coverage_table(coverage: Coverage, places: Sequence[Place]) -> pd.DataFrame:
    """Return the table ``coverage``: a row per place and bin; ``share_visible`` is the mean over the imaged time."""
    imaged = coverage.seconds()
    parts = []
    for number, place in enumerate(places):
        share = np.divide(coverage.share_seconds(number), imaged, out=np.zeros(len(imaged)), where=imaged > 0)
        columns = {
            "place": place.id,
            "bin_start_utc": coverage.bins.start_utc,
            "bin_s": coverage.bins.length_s,
            "observed_s": coverage.seconds(number),
            "frames": coverage.frames[:, number],
            "share_visible": np.minimum(share, 1.0),
        }
        parts.append(pd.DataFrame(columns))
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


def status_of(observed_s: Floats, bin_s: Floats, counted: Mask, *, params: TrafficParams) -> np.ndarray:
    """Return observed, partial or not_observed; where something was counted, at least partial."""
    partial = np.where((observed_s > 0) | counted, "partial", "not_observed")
    # Times are sums of many slices: a microsecond must not turn a fully observed bin into a partial one.
    return np.where(observed_s >= params.observed_share * bin_s - 1e-6, "observed", partial)


def shares_visible(corners_m: Floats, places: Sequence[Place]) -> Floats:
    """Return (n, p) the share of each place within each footprint (n, 4, 2): of length for lines, of area for areas."""
    shares = np.zeros((len(corners_m), len(places)))
    footprints, of_frame = np.unique(np.round(corners_m, 3), axis=0, return_inverse=True)
    hulls = shapely.convex_hull(shapely.multipoints(footprints)) if len(footprints) else np.empty(0, object)
    for number, place in enumerate(places):
        shares[:, number] = _share(hulls, place.shape)[of_frame.reshape(-1)]
    return shares


def _share(hulls: np.ndarray, shape: LineString | Polygon) -> Floats:
    """Return the share of one shape inside each convex footprint; only those it straddles need an intersection."""
    share = np.zeros(len(hulls))
    shapely.prepare(shape)
    meets = shapely.intersects(shape, hulls)
    whole = np.zeros(len(hulls), bool)
    whole[meets] = shapely.covers(hulls[meets], shape)
    share[whole] = 1.0
    partly = np.flatnonzero(meets & ~whole)
    inside = shapely.intersection(hulls[partly], shape)
    share[partly] = shapely.area(inside) / shape.area if shape.area > 0 else shapely.length(inside) / shape.length
    return share


def _needed(shares: list[Floats], places: Sequence[Place], params: TrafficParams) -> Floats:
    """Return the share (p,) from which each place counts as in view."""
    most = np.max([share.max(axis=0, initial=0.0) for share in shares], axis=0) if shares else np.zeros(len(places))
    relative = np.where([place.is_line for place in places], 1.0, most)
    return np.maximum(params.min_share_visible * relative, 1e-9)


def _slices(
    starts: list[Ints], shares: list[Floats], many: int, bins: Bins, params: TrafficParams
) -> tuple[Ints, Floats, Mask]:
    """Cut time wherever a frame or a bin begins or ends; return edges, shares of the places, and what is imaged."""
    longest = round(params.max_gap_s * SECOND_US)
    ends = [np.minimum(np.r_[start[1:], start[-1]], start + longest) for start in starts]
    edge = np.unique(np.concatenate([*starts, *ends, bins.start_us, bins.end_us]).astype(np.int64))
    share = np.zeros((max(len(edge) - 1, 0), many))
    imaged = np.zeros(len(share), bool)
    for start, end, shown in zip(starts, ends, shares, strict=True):
        frame = np.searchsorted(start, edge[:-1], "right") - 1
        on = (frame >= 0) & (edge[:-1] < end[frame])
        share[on] = np.maximum(share[on], shown[frame[on]])
        imaged |= on
    return edge, share, imaged
