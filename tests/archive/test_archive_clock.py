"""Stamps: what names say, and what UTC that is, both nights of summer time included."""

import re
from datetime import UTC, datetime

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from vtrack_batch.archive.clock import to_utc
from vtrack_batch.archive.params import ArchiveParams
from vtrack_batch.archive.patterns import AmbiguousNameError, IsoLikeNames, compile_pattern
from vtrack_batch.archive.stamps import stamp_from_text

BERLIN = "Europe/Berlin"


def clock(stamp):
    return str(np.datetime64(stamp.clock_us, "us"))


PATTERNS = [
    ("{time:%Y%m%dT%H%M%S}.jpg", "20260517T060001.jpg", "2026-05-17T06:00:01.000000", None, None),
    ("{time:%Y%m%dT%H%M%S.%f}.jpg", "20260517T060001.25.jpg", "2026-05-17T06:00:01.250000", None, None),
    ("{time:%Y%m%d_%H%M%S%f}.jpg", "20260517_060001007.jpg", "2026-05-17T06:00:01.007000", None, None),
    ("{time:%Y%m%dT%H%M%SZ}.jpg", "20260517T060001Z.jpg", "2026-05-17T06:00:01.000000", 0, None),
    ("{time:%Y-%m-%d %H-%M-%S%z}.png", "2026-05-17 06-00-01+0200.png", "2026-05-17T06:00:01.000000", 7200, None),
    ("{time:%Y-%m-%dT%H:%M:%S%z}.png", "2026-05-17T06:00:01-05:30.png", "2026-05-17T06:00:01.000000", -19800, None),
    (
        "{camera}_{time:%Y%m%d%H%M%S}_{frame}.jpg",
        "north_20260517060001_0007.jpg",
        "2026-05-17T06:00:01.000000",
        None,
        "north",
    ),
    ("{platform}/{time:%Y%m%d/%H%M%S}.tif", "dji 2/20260517/060001.tif", "2026-05-17T06:00:01.000000", None, "dji 2"),
    ("*/{camera}/{time:epoch_ms}.jpg", "x/b/1779000001250.jpg", "2026-05-17T06:40:01.250000", 0, "b"),
    ("{time:epoch_s}.jpg", "1779000001.5.jpg", "2026-05-17T06:40:01.500000", 0, None),
    ("{time:epoch_us}.jpg", "1779000001000007.jpg", "2026-05-17T06:40:01.000007", 0, None),
    ("img {time:%y%m%d %I%M%S%p}.jpg", "img 260517 120001AM.jpg", "2026-05-17T00:00:01.000000", None, None),
    ("img {time:%y%m%d %I%M%S%p}.jpg", "img 260517 120001pm.jpg", "2026-05-17T12:00:01.000000", None, None),
    ("{time:%-d_%-m_%Y}_{time:%-H_%-M_%-S}.jpg", "7_5_2026_6_0_1.jpg", "2026-05-07T06:00:01.000000", None, None),
    ("{time:%d%b%Y %H%M%S}.jpg", "17May2026 060001.jpg", "2026-05-17T06:00:01.000000", None, None),
    ("{time:%Y%j%H%M%S}.jpg", "2026137060001.jpg", "2026-05-17T06:00:01.000000", None, None),
    ("{camera}/{camera}_{time:%Y%m%dT%H%M%S}.jpg", "a/a_20260517T060001.jpg", "2026-05-17T06:00:01.000000", None, "a"),
    ("{time:%Y%m%dT%H%M%S}.jpg", "20260517T060060.JPG", "2026-05-17T06:00:59.999999", None, None),
]


@pytest.mark.parametrize(("pattern", "name", "reading", "offset_s", "platform"), PATTERNS)
def test_pattern_reads(pattern, name, reading, offset_s, platform):
    found = compile_pattern(pattern).read(name)
    assert clock(found.stamp) == reading
    assert found.stamp.offset_s == offset_s
    assert found.platform == platform


@pytest.mark.parametrize(
    ("pattern", "name"),
    [
        ("{time:%Y%m%dT%H%M%S}.jpg", "a20260517T060001.jpg"),
        ("{time:%Y%m%dT%H%M%S}.jpg", "20260517T060001.jpg.bak"),
        ("{time:%Y%m%dT%H%M%S}.jpg", "20260517T060001xjpg"),
        ("{time:%Y%m%dT%H%M%S}.jpg", "20260517T060001.jpg\n"),
        ("{camera}/{time:%Y%m%dT%H%M%S}.jpg", "20260517T060001.jpg"),
        ("{camera}/{time:%Y%m%dT%H%M%S}.jpg", "a/b/20260517T060001.jpg"),
        ("{camera}/{camera}_{time:%Y%m%dT%H%M%S}.jpg", "a/b_20260517T060001.jpg"),
    ],
)
def test_pattern_describes_the_whole_name(pattern, name):
    assert compile_pattern(pattern).read(name) is None


@pytest.mark.parametrize("digits", ["20261317T060001", "20260230T060001", "20260517T250001", "20260517T066001"])
def test_digits_that_are_no_time(digits):
    assert compile_pattern("{time:%Y%m%dT%H%M%S}.jpg").read(digits + ".jpg").stamp is None


@pytest.mark.parametrize(
    ("pattern", "complaint"),
    [
        ("frame_{n}.jpg", "needs {time"),
        ("{time:%Y%m%d}.jpg", "an hour"),
        ("{time:%H%M%S}.jpg", "a year"),
        ("{time:%Y%m%dT%H%M%S%Q}.jpg", "%Q is not understood"),
        ("{time:%Y%m%dT%H%M%S.jpg", "brace"),
        ("{time:epoch_s}{time:%Y}.jpg", "one pattern"),
        ("{camera:%Y}{time:epoch_s}", "takes a format"),
    ],
)
def test_wrong_pattern_is_explained(pattern, complaint):
    with pytest.raises(ValidationError, match=re.escape(complaint)):
        ArchiveParams(pattern=pattern)


ISO_LIKE = [
    ("2026-05-17T06:00:01.jpg", "2026-05-17T06:00:01.000000", None),
    ("cam3_20260517_060001.jpg", "2026-05-17T06:00:01.000000", None),
    ("20260517060001.jpg", "2026-05-17T06:00:01.000000", None),
    ("DJI_20260517060001_0001_V.JPG", "2026-05-17T06:00:01.000000", None),
    ("PXL_20260517_060001123.jpg", "2026-05-17T06:00:01.123000", None),
    ("2026-05-17_06-00-01.5Z.tif", "2026-05-17T06:00:01.500000", 0),
    ("2026.05.17-06.00.01+02:00.png", "2026-05-17T06:00:01.000000", 7200),
    ("20260517T060001Z_3.png", "2026-05-17T06:00:01.000000", 0),
]


@pytest.mark.parametrize(("name", "reading", "offset_s"), ISO_LIKE)
def test_iso_like_names_need_no_pattern(name, reading, offset_s):
    stamp = IsoLikeNames().read("some/dir/" + name).stamp
    assert clock(stamp) == reading
    assert stamp.offset_s == offset_s


@pytest.mark.parametrize(
    "name", ["001.png", "1779000001.jpg", "17052026060001.jpg", "2026-05-17.jpg", "120260517060001.jpg"]
)
def test_names_without_iso_like_time(name):
    assert IsoLikeNames().read(name) is None


@pytest.mark.parametrize("name", ["20260517T060001_20260518T060001.jpg", "20260517T060001-0500.jpg"])
def test_ambiguous_names_are_never_guessed(name):
    with pytest.raises(AmbiguousNameError):
        IsoLikeNames().read(name)


@given(st.datetimes(datetime(1990, 1, 1), datetime(2060, 1, 1)))
def test_iso_text_reads_back(moment):
    stamp = stamp_from_text(moment.isoformat() + "Z")
    assert (
        stamp.clock_us == round(moment.replace(tzinfo=UTC).timestamp() * 1e6)
        or abs(stamp.clock_us / 1e6 - moment.replace(tzinfo=UTC).timestamp()) < 1e-6
    )
    assert stamp.offset_s == 0


@pytest.mark.parametrize("text", ["", "yesterday", "2026-05-17", "17.05.2026 06:00:01", "12", "2026-02-30T00:00:00Z"])
def test_text_that_is_no_time(text):
    assert stamp_from_text(text) is None


def utc_of(texts, *, zone=BERLIN, platform=None, max_gap_s=30.0):
    stamps = [stamp_from_text(text) for text in texts]
    clock_us = np.array([stamp.clock_us for stamp in stamps], np.int64)
    offset_s = np.array([np.nan if stamp.offset_s is None else stamp.offset_s for stamp in stamps], float)
    names = pd.Series(platform or ["main"] * len(texts), dtype="str")
    return to_utc(clock_us, offset_s, names, time_zone=zone, max_gap_s=max_gap_s)


def times(found):
    return [str(t)[11:19] if not np.isnat(t) else None for t in found.t_utc]


class TestSummerTime:
    def test_ordinary_days(self):
        assert times(utc_of(["2026-07-01T12:00:00", "2026-12-01T12:00:00"])) == ["10:00:00", "11:00:00"]

    def test_offset_in_the_stamp_wins(self):
        assert times(utc_of(["2026-07-01T12:00:00-03:00", "2026-07-01T12:00:00"])) == ["15:00:00", "10:00:00"]

    def test_naive_without_zone_is_refused(self):
        with pytest.raises(ValueError, match="time zone"):
            utc_of(["2026-07-01T12:00:00"], zone=None)

    def test_spring_hour_does_not_exist(self):
        found = utc_of(["2026-03-29T01:59:59", "2026-03-29T02:30:00", "2026-03-29T03:00:00"])
        assert times(found) == ["00:59:59", None, "01:00:00"]
        assert found.nonexistent.tolist() == [False, True, False]

    def test_autumn_hour_is_told_by_the_clock_falling_back(self):
        found = utc_of(
            [f"2026-10-25T{t}" for t in ("01:59:58", "02:00:00", "02:59:59", "02:00:01", "02:59:58", "03:00:00")]
        )
        assert times(found) == ["23:59:58", "00:00:00", "00:59:59", "01:00:01", "01:59:58", "02:00:00"]
        assert not found.ambiguous.any()

    def test_autumn_hour_follows_the_frame_before_or_after(self):
        assert times(utc_of(["2026-10-25T01:59:59", "2026-10-25T02:00:01"])) == ["23:59:59", "00:00:01"]
        assert times(utc_of(["2026-10-25T02:59:59", "2026-10-25T03:00:01"])) == ["01:59:59", "02:00:01"]

    def test_autumn_hour_that_cannot_be_told_is_not_guessed(self):
        alone = utc_of(["2026-10-25T02:30:00", "2026-10-25T02:30:02"])
        assert times(alone) == [None, None]
        assert alone.ambiguous.all()
        both = utc_of(["2026-10-25T01:59:59", "2026-10-25T02:30:00", "2026-10-25T03:00:00"], max_gap_s=1860)
        assert both.ambiguous.tolist() == [False, True, False]
        twice = utc_of([f"2026-10-25T02:{m}:00" for m in ("10", "05", "10", "05")])
        assert twice.ambiguous.all()

    def test_platforms_are_judged_apart(self):
        texts = ["2026-10-25T01:59:59", "2026-10-25T02:59:59", "2026-10-25T02:00:01", "2026-10-25T03:00:01"]
        assert times(utc_of(texts, platform=["a", "b", "a", "b"])) == ["23:59:59", "01:59:59", "00:00:01", "02:00:01"]

    def test_none(self):
        assert len(utc_of([]).t_utc) == 0


def test_unknown_zone_suggests_a_known_one():
    with pytest.raises(ValidationError, match="did you mean 'Europe/Berlin'"):
        ArchiveParams(time_zone="Europe/Berlim")


def test_one_source_of_time_only():
    with pytest.raises(ValidationError, match="one source"):
        ArchiveParams(index="times.csv", exif=True)
