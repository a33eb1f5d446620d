"""What surely is traffic: straight, fast, nothing in its way."""

from __future__ import annotations

import numpy as np
import pytest

from vtrack_batch.detection.chains import Chains, Kind, Sightings, find_chains, kinds_of, supported
from vtrack_batch.detection.params import DetectionParams

PARAMS = DetectionParams()
TIMES = np.arange(6) * 0.5


def sightings(rows: list[tuple[float, float, float, float]]) -> Sightings:
    """Make sightings 4.5 m long from (x_m, y_m, angle_deg, grey)."""
    x, y, angle, grey = np.array(rows, float).reshape(-1, 4).T
    turn = np.radians(angle)
    axis = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return Sightings(np.stack([x, y], axis=1), axis, np.full(len(x), 4.5), np.repeat(grey[:, None], 3, axis=1))


def chains(frames: list[Sightings], *, links: int = 4, least_mps: float = 3.0) -> Chains:
    return find_chains(frames, TIMES, Kind(links, least_mps), params=PARAMS)


@pytest.mark.parametrize(("speed", "count"), [(2.0, 0), (4.0, 3), (55.0, 3), (70.0, 0)])
def test_speed_of_a_chain(speed: float, count: int) -> None:
    frames = [sightings([(5 + speed * t, 3.0, 0.0, 90.0)]) for t in TIMES]
    assert len(chains(frames).rows) == count


def test_what_goes_to_and_fro_is_no_chain() -> None:
    going = [sightings([(5 + 1.6 * t, 3.0, 0.0, 90.0)]) for t in TIMES]
    swaying = [sightings([(5 + 0.8 * (n % 2), 3.0, 0.0, 90.0)]) for n in range(6)]
    assert len(chains(going, links=6, least_mps=1.5).rows) == 1
    assert len(chains(swaying, links=6, least_mps=1.5).rows) == 0


def test_what_begins_fast_and_then_drifts_like_a_roof_is_no_chain() -> None:
    places = [0.0, 0.9, 1.0, 1.1, 1.2, 1.3]
    frames = [sightings([(5 + x, 3.0, 0.0, 90.0)]) for x in places]
    assert len(chains(frames, links=6, least_mps=1.5).rows) == 0


def test_paint_may_flicker_but_not_change() -> None:
    for change, count in ((80.0, 3), (110.0, 0)):
        frames = [sightings([(5 + 6 * t, 3.0, 0.0, 60 + change * (n % 2))]) for n, t in enumerate(TIMES)]
        assert len(chains(frames).rows) == count


@pytest.mark.parametrize(
    ("interval_s", "links"),
    [(0.1, [4, 6, 3]), (0.5, [4, 6, 3]), (1.0, [4, 3, 6, 4]), (1.5, [4, 3, 6, 3]), (4.0, [4, 3, 6, 3])],
)
def test_fewer_sightings_make_a_chain_where_frames_are_far_apart(interval_s: float, links: list[int]) -> None:
    kinds = kinds_of(np.arange(9) * interval_s, PARAMS)
    assert [kind.links for kind in kinds] == links
    spans = {3.0: PARAMS.chain_span_s, 1.5: PARAMS.slow_chain_span_s, PARAMS.short_chain_speed_mps: 0.0}
    for kind in kinds:
        assert kind.loose == (kind.links in (PARAMS.chain_links, PARAMS.slow_chain_links) and kind.misfit == np.inf)
        if not kind.loose:
            assert (kind.links - 1) * interval_s >= spans[kind.least_mps]


@pytest.mark.parametrize(("speed", "seen", "found"), [(20.0, 3, True), (20.0, 2, False), (7.0, 3, False)])
def test_what_is_fast_need_only_be_seen_three_times(speed: float, seen: int, found: bool) -> None:
    passing = [[(5 + speed * t, 3.0, 0.0, 90.0)] if n < seen else [] for n, t in enumerate(TIMES)]
    frames = [sightings(rows) for rows in passing]
    rows = sum(len(find_chains(frames, TIMES, kind, params=PARAMS).rows) for kind in kinds_of(TIMES, PARAMS))
    assert (rows > 0) == found


@pytest.mark.parametrize(("turn_deg", "repaint", "bend_m"), [(20, 0, 0), (0, 75, 0), (0, 0, 0.85), (14, 50, 0.5)])
def test_few_sightings_must_fit_closely(turn_deg: float, repaint: float, bend_m: float) -> None:
    times = np.arange(3) * 1.5
    close = [sightings([(5 + 8 * t, 3.0, 4.0, 90.0 + 5 * n)]) for n, t in enumerate(times)]
    askew = [
        sightings([(5 + 8 * t, 3.0 + bend_m * (n == 2), turn_deg * (n == 1), 90.0 + repaint * (n == 2))])
        for n, t in enumerate(times)
    ]
    loose, short = Kind(3, 3.0), Kind(3, 3.0, misfit=0.6)
    assert len(find_chains(close, times, loose, params=PARAMS).rows) == 1
    assert len(find_chains(close, times, short, params=PARAMS).rows) == 1
    assert len(find_chains(askew, times, loose, params=PARAMS).rows) == 1
    assert len(find_chains(askew, times, short, params=PARAMS).rows) == 0


def lane_and_roof(dormers: int) -> list[Sightings]:
    """A car at 12 m/s along y = 3, and things on a roof along y = 40 of which chance makes a fast chain."""
    frames = []
    for n, t in enumerate(TIMES):
        rows = [(12 * t, 3.0, 0.0, 90.0)]
        rows += [(6.0 * k, 40.0, 0.0, 90.0) for k in range(dormers)]
        frames.append(sightings(rows if dormers else [*rows, (6.0 * n, 40.0, 0.0, 90.0)]))
    return frames


def test_a_lane_with_nothing_in_the_way_is_kept_and_so_is_one_beside_a_parked_car() -> None:
    free = lane_and_roof(dormers=0)
    (kept,) = supported([chains(free)], free, TIMES, params=PARAMS)
    assert len(kept.rows) == len(chains(free).rows) == 6
    parked = [sightings([(12 * t, 3.0, 0.0, 90.0), (15.0, 5.0, 0.0, 200.0)]) for t in TIMES]
    (kept,) = supported([chains(parked)], parked, TIMES, params=PARAMS)
    assert len(kept.rows) == 3


def test_the_crowd_around_a_lone_chain_outvotes_it() -> None:
    rng = np.random.default_rng(5)
    crowd = [(x, y, 90.0, 90.0) for x, y in rng.uniform((0, 2), (30, 4), (40, 2))]
    frames = [sightings([(12 * t, 3.0, 0.0, 90.0), *crowd]) for t in TIMES]
    found = chains(frames)
    assert len(found.rows) >= 3
    (kept,) = supported([found], frames, TIMES, params=PARAMS)
    assert len(kept.rows) == 0


def test_nothing_seen_is_no_chain() -> None:
    frames = [sightings([]) for _ in TIMES]
    (kept,) = supported([chains(frames)], frames, TIMES, params=PARAMS)
    assert kept.rows.shape == (0, 4)


def test_order_of_sightings_and_frames_does_not_matter() -> None:
    frames = lane_and_roof(dormers=7)
    turned = [Sightings(seen.xy[::-1], seen.axis[::-1], seen.length[::-1], seen.colour[::-1]) for seen in frames]
    (one,) = supported([chains(frames)], frames, TIMES, params=PARAMS)
    (other,) = supported([chains(turned)], turned, TIMES, params=PARAMS)
    assert sorted(map(str, one.lines)) == sorted(map(str, other.lines))
