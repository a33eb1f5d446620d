"""Whether two clocks agree: the times that a survey goes by, and those that cameras wrote into the frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pandas as pd

from vtrack_batch.archive.exif import exif_stamp
from vtrack_batch.archive.names import unescape
from vtrack_batch.archive.params import LOCAL
from vtrack_batch.archive.stamps import stamp_from_text
from vtrack_batch.config.survey import Survey
from vtrack_batch.errors import UnusableFrame

TOLERANCE_S = 2.0
ZONE_STEP_S = 900.0
"""Offsets of time zones from UTC are multiples of it."""


def disagreements(survey: Survey, files: pd.DataFrame) -> Iterator[str]:
    """Yield, for people, how the times in the EXIF of *files* (path, t_utc) differ from the survey's; none if not.

    EXIF without an offset is read in the zone of the survey's own stamps. Frames without it say nothing.
    """
    if survey.archive.exif:
        return
    root = survey.resolve(survey.archive.root)
    zone = survey.survey.time_zone if survey.archive.time_zone == LOCAL else survey.archive.time_zone
    later_s = []
    for path, t_utc in files[["path", "t_utc"]].itertuples(index=False):
        try:
            stamp = stamp_from_text(exif_stamp(root, unescape(path)))
        except UnusableFrame:
            continue
        if stamp is not None:
            offset_s = pd.Timedelta(seconds=stamp.offset_s or 0)
            clock = pd.Timestamp(stamp.clock_us, unit="us") - offset_s
            meant = "UTC" if stamp.offset_s is not None else zone or "UTC"
            taken = clock.tz_localize(meant, ambiguous=True, nonexistent="shift_forward")
            later_s.append((taken - t_utc).total_seconds())
    if later_s:
        yield from _told(later_s)


def _told(later_s: Sequence[float]) -> Iterator[str]:
    middle_s = sorted(later_s)[len(later_s) // 2]
    off = [abs(each) > TOLERANCE_S for each in later_s]
    if not any(off):
        return
    steady = max(later_s) - min(later_s) <= TOLERANCE_S
    whole = abs(middle_s - ZONE_STEP_S * round(middle_s / ZONE_STEP_S)) <= TOLERANCE_S
    why = "probably a time zone or summer time" if steady and whole else "one of the two clocks is wrong"
    yield (
        f"times: in {sum(off)} of {len(off)} frames looked into, EXIF says another time than the survey goes "
        f"by ({middle_s:+.0f} s in the middle): {why}; EXIF is not used"
    )
