"""A platform that flies along a street: blocks are cut, joined, and vehicles go on from one to the next."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest

import vtrack_batch as vt
from vtrack_batch.pipeline.blocks import cut_blocks
from vtrack_batch.pipeline.plan import FrameRef, Unit
from vtrack_batch.registration.params import RegistrationParams

WIDTH, HEIGHT, GSD_M, EVERY_S = 420, 260, 0.3, 2.0
FRAMES, FLIGHT_PX = 60, 12  # to the right, a frame
LANES = ((110, 20, (200, 30, 30)), (140, 7, (40, 60, 200)))  # row, px to the right a frame, colour
EVERY_PX = 130  # from one vehicle to the next


def ground(width: int) -> np.ndarray:
    """Return a street along a strip with something to hold on to on both sides."""
    rng = np.random.default_rng(8)
    small = rng.integers(40, 200, (HEIGHT // 8, width // 8, 3)).astype(np.uint8)
    picture = cv2.resize(small, (width, HEIGHT), interpolation=cv2.INTER_CUBIC)
    picture = cv2.add(picture, rng.integers(0, 25, picture.shape).astype(np.uint8))
    for _ in range(width // 4):
        corner = rng.integers(0, (width - 20, HEIGHT - 20))
        if not 70 < corner[1] < 170:
            far = (corner + rng.integers(5, 20, 2)).tolist()
            cv2.rectangle(picture, corner.tolist(), far, rng.integers(0, 255, 3).tolist(), -1)
    picture[95:155] = 105 + rng.integers(0, 8, (60, width, 3)).astype(np.uint8)
    return picture


def vehicles(number: int) -> list[tuple[float, int, tuple[int, int, int]]]:
    """Return column on the strip, row and colour of all vehicles at a frame."""
    starts = range(-20 * EVERY_PX, 20 * EVERY_PX, EVERY_PX)
    return [(start + 37 * row % 90 + speed * number, row, rgb) for row, speed, rgb in LANES for start in starts]


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flight")
    (folder / "frames").mkdir()
    strip = ground(WIDTH + FRAMES * FLIGHT_PX + 40)
    start = pd.Timestamp("2026-05-17T06:00:00Z")
    for number in range(FRAMES):
        picture = strip.copy()
        for col, row, rgb in vehicles(number):
            at = round(col)
            if -20 < at < strip.shape[1]:
                cv2.rectangle(picture, (max(at - 8, 0), row - 3), (at + 8, row + 3), rgb, -1)
        left = number * FLIGHT_PX
        name = f"{start + pd.Timedelta(seconds=number * EVERY_S):%Y%m%dT%H%M%S}.png"
        cv2.imwrite(str(folder / "frames" / name), picture[:, left : left + WIDTH, ::-1])
    (folder / "survey.yaml").write_text(
        "archive: {root: frames, time_zone: UTC}\ngeoreference: {gsd_m: 0.3}\nexecution: {unit_s: 600}\n"
    )
    vt.run_survey(vt.load_survey(folder / "survey.yaml"))
    return folder / "results" / "current"


class Film:
    """Frames of a street as a reader would give them; those that are *black*, or *lost*, show nothing."""

    def __init__(self, count: int, flight_px: int, black: tuple[int, ...] = (), lost: tuple[int, ...] = ()) -> None:
        strip = ground(WIDTH + count * flight_px)
        self.pictures = {f"{n:03d}.png": strip[:, n * flight_px :][:, :WIDTH].copy() for n in range(count)}
        for number in black:
            self.pictures[f"{number:03d}.png"][:] = 0
        self.lost = {f"{number:03d}.png" for number in lost}
        refs = tuple(FrameRef(path, np.datetime64(2 * n, "s"), path) for n, path in enumerate(self.pictures))
        self.unit = Unit("main", "2026-05-17", 0.0, refs, (), refs[:1])

    def pixels(self, ref: FrameRef, expected: object = None) -> np.ndarray | None:
        return None if ref.path in self.lost else self.pictures[ref.path]

    def cut(self) -> list[tuple[int, int]]:
        parts = cut_blocks(self.unit, self, RegistrationParams())  # type: ignore[arg-type]
        return [(int(part.frames[0].path[:3]), int(part.frames[-1].path[:3]) + 1) for part in parts]


@pytest.mark.parametrize(
    "bad", [{"black": (10,)}, {"black": (0,)}, {"black": (19,)}, {"black": (4, 5)}, {"lost": (0, 5, 10, 15)}]
)
def test_bad_frames_cut_nothing_where_the_platform_hovers(bad: dict[str, tuple[int, ...]]) -> None:
    assert Film(20, 0, **bad).cut() == [(0, 20)]


@pytest.mark.parametrize(
    "bad", [{}, {"black": (0,)}, {"black": (0, 1)}, {"black": (14, 15)}, {"black": (20,)}, {"lost": (7, 13, 20, 39)}]
)
def test_a_flight_is_cut_though_some_frames_are_bad(bad: dict[str, tuple[int, ...]]) -> None:
    # 40 % of a frame have passed after 14 frames of 12 px
    found = Film(40, 12, **bad).cut()
    assert found[0][0] == 0
    assert found[-1][1] == 40
    assert all(end == begin for (_, end), (begin, _) in pairwise(found))
    assert len(found) in (3, 4)
    assert all(7 <= end - begin <= 20 for begin, end in found)


@pytest.mark.parametrize("count", [36, 42, 47])
def test_the_last_two_blocks_share_what_is_left(count: int) -> None:
    # a seventh of a frame passes from each to the next: blocks of eight, as short as they may be
    lengths = [end - begin for begin, end in Film(count, 60).cut()]
    assert sum(lengths) == count
    assert lengths[:-2] == [8] * (len(lengths) - 2)
    assert max(lengths) - 8 <= 0 < min(lengths)


def table(snapshot: Path, name: str) -> pd.DataFrame:
    return pd.read_parquet(snapshot / name)


def test_a_unit_is_cut_where_the_overlap_falls_and_every_frame_is_used(flown: Path) -> None:
    assert (table(flown, "frames")["status"] == "used").all()
    references = table(flown, "references")
    # 720 px of flight over frames of 420: blocks of no more than 40 % of a frame, none of fewer than eight frames
    assert 4 <= len(references) <= FRAMES // 8
    assert set(table(flown, "registrations")["reference_frame_id"]) == set(references["reference_frame_id"])


def test_every_block_lies_where_it_is_on_the_ground(flown: Path) -> None:
    frames = table(flown, "frames").sort_values("t_utc", ignore_index=True)
    number = dict(zip(frames["frame_id"], range(FRAMES), strict=True))
    for reference in table(flown, "references").itertuples():
        flown_m = number[reference.reference_frame_id] * FLIGHT_PX * GSD_M
        assert reference.g13 == pytest.approx(flown_m, abs=0.25)
        assert reference.g11 == pytest.approx(GSD_M, rel=2e-3)


def test_vehicles_are_found_and_go_on_from_block_to_block(flown: Path) -> None:
    detections = table(flown, "detections")
    frames = table(flown, "frames").sort_values("t_utc", ignore_index=True)
    found = true = 0
    for number, frame in enumerate(frames["frame_id"]):
        seen = detections[detections["frame_id"] == frame]
        for col, row, _ in vehicles(number):
            if 25 < col - number * FLIGHT_PX < WIDTH - 25:
                true += 1
                off = np.hypot(seen["x_m"] - col * GSD_M, seen["y_m"] + row * GSD_M)
                found += bool((off < 1.0).any())
    assert 0.85 < found / true <= 1
    assert len(detections) < 1.15 * true


def test_a_vehicle_has_one_track_through_all_blocks_that_see_it(flown: Path) -> None:
    trajectories, points = table(flown, "trajectories"), table(flown, "track_points").dropna(subset=["detection_id"])
    blocks = table(flown, "registrations").set_index("frame_id")["reference_frame_id"]
    of = points.assign(block=points["detection_id"].str[:12].map(blocks)).groupby("vehicle_id")["block"].nunique()
    assert of.max() >= 4
    first, last = np.array(vehicles(0), object), np.array(vehicles(FRAMES - 1), object)
    number = np.arange(FRAMES)[:, None]
    col = first[:, 0].astype(float) + number * (last[:, 0] - first[:, 0]).astype(float) / (FRAMES - 1)
    in_view = (col > number * FLIGHT_PX + 10) & (col < number * FLIGHT_PX + WIDTH - 10)
    spans = [col[in_view[:, v], v] for v in range(col.shape[1]) if in_view[:, v].any()]
    long = sum(np.ptp(span) * GSD_M > 150 for span in spans)
    assert long >= 4
    assert abs(int((trajectories["path_m"] > 150).sum()) - long) <= 1
