"""Bins follow the wall clock of the survey."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vtrack_batch.traffic.bins import clock_bins, to_us


def _every_minute(start: str, end: str, zone: str):
    return to_us(pd.date_range(start, end, freq="1min", tz=zone, inclusive="left"))


def _bins_of(t_us, **how):
    return clock_bins(t_us, t_us, **how)


@pytest.mark.parametrize(
    ("date", "following", "quarters"),
    [("2026-03-29", "2026-03-30", 92), ("2026-05-17", "2026-05-18", 96), ("2026-10-25", "2026-10-26", 100)],
)
def test_days_of_clock_changes_have_92_or_100_quarter_hours(date, following, quarters):
    bins = _bins_of(_every_minute(date, following, "Europe/Berlin"), time_zone="Europe/Berlin", bin_s=900)
    assert len(bins) == quarters
    assert set(bins.length_s) == {900}
    assert bins.start_us[0] == to_us(pd.DatetimeIndex([pd.Timestamp(date, tz="Europe/Berlin")]))[0]


@pytest.mark.parametrize("zone", ["Europe/Berlin", "Asia/Kolkata", "Australia/Lord_Howe", "America/Havana", "UTC"])
@pytest.mark.parametrize("bin_s", [300, 900, 3600, 7200, 50000])
def test_every_bin_begins_at_a_multiple_on_the_clock_and_none_straddles_midnight(zone, bin_s):
    for start in ("2026-03-07", "2026-03-28", "2026-04-04", "2026-10-03", "2026-10-24", "2026-10-31"):
        t_us = _every_minute(start, str(pd.Timestamp(start) + pd.Timedelta(days=3))[:10], zone)
        bins = _bins_of(t_us, time_zone=zone, bin_s=bin_s)
        clock = bins.start_utc.tz_convert(zone)
        of_day = clock.hour * 3600 + clock.minute * 60 + clock.second
        put_forward = np.diff([stamp.utcoffset().total_seconds() for stamp in clock], prepend=np.nan) > 0
        assert (((of_day % bin_s) == 0) | put_forward).all()
        last = pd.DatetimeIndex(bins.start_utc + pd.to_timedelta(bins.length_s, unit="s") - pd.Timedelta("1us"))
        assert (last.tz_convert(zone).date == clock.date).all()
        assert (bins.index(t_us) >= 0).all()
        assert (bins.start_us[1:] == bins.end_us[:-1]).all()


@given(st.lists(st.integers(0, 10 * 86400 * 10**6), min_size=1, max_size=20))
def test_each_time_lies_in_its_bin_in_any_order(offsets):
    t_us = np.array(offsets) + to_us(pd.DatetimeIndex(["2026-10-20T00:00:00Z"]))[0]
    bins = _bins_of(t_us, time_zone="Europe/Berlin", bin_s=900)
    of_time = bins.index(t_us)
    assert ((bins.start_us[of_time] <= t_us) & (t_us < bins.end_us[of_time])).all()
    again = _bins_of(t_us[::-1], time_zone="Europe/Berlin", bin_s=900)
    assert (again.start_us == bins.start_us).all()


def test_nights_between_survey_days_hold_no_bins():
    t_us = to_us(pd.DatetimeIndex(["2026-05-17T08:01Z", "2026-05-17T08:59Z", "2026-05-20T10:00Z"]))
    bins = _bins_of(t_us, time_zone="UTC", bin_s=900)
    assert [str(start)[:16] for start in bins.start_utc] == [
        "2026-05-17 08:00",
        "2026-05-17 08:15",
        "2026-05-17 08:30",
        "2026-05-17 08:45",
        "2026-05-20 10:00",
    ]
    assert bins.index(to_us(pd.DatetimeIndex(["2026-05-18T00:00Z", "2026-05-17T07:59Z"]))).tolist() == [-1, -1]


def test_no_times_no_bins():
    bins = _bins_of(np.empty(0, np.int64), time_zone="UTC", bin_s=900)
    assert len(bins) == 0
    assert bins.index(np.array([5])).tolist() == [-1]


def test_a_span_over_midnight_holds_every_bin_of_its_time():
    start, end = to_us(pd.DatetimeIndex(["2026-05-17T21:40Z", "2026-05-17T22:20Z"]))
    bins = clock_bins(np.array([start]), np.array([end]), time_zone="Europe/Berlin", bin_s=900)
    assert [str(at)[11:16] for at in bins.start_utc] == ["21:30", "21:45", "22:00", "22:15"]
