"""Times from EXIF: DateTimeOriginal with its fraction and offset, from the header alone. No other tag is looked at."""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any

from PIL import Image

from vtrack_batch.archive.names import escape
from vtrack_batch.archive.read import open_regular, unreadable
from vtrack_batch.errors import UnusableFrame

_EXIF_IFD = 0x8769
_DATE_TIME_ORIGINAL, _SUB_SECOND, _OFFSET = 0x9003, 0x9291, 0x9011
_CALENDAR = re.compile(r"(\d{4}):(\d\d):(\d\d) (\d\d:\d\d:\d\d)", re.ASCII)
_OFFSET_TEXT = re.compile(r"Z|[+-]\d\d:\d\d", re.ASCII)


def exif_stamp(root: Path, name: str) -> str:
    """Return when the frame *name* below *root* was taken, as ISO 8601 text, with an offset only if EXIF has one.

    Raises UnusableFrame with reason no_exif_time, not_an_image, malformed, or what opening the file may give.
    """
    try:
        with open_regular(root, name) as file, Image.open(file, formats=("JPEG", "PNG", "TIFF")) as image:
            tags: Any = image.getexif().get_ifd(_EXIF_IFD)
    except OSError as error:
        if error.errno is not None:
            raise unreadable(error, root / name) from error
        raise UnusableFrame("not_an_image", "its header is of no JPEG, PNG or TIFF") from error
    except (ValueError, SyntaxError, TypeError, KeyError, struct.error, Image.DecompressionBombError) as error:
        raise UnusableFrame("malformed", f"its header cannot be read: {escape(str(error))[:200]}") from error
    taken = _CALENDAR.fullmatch(_text(tags.get(_DATE_TIME_ORIGINAL)))
    if taken is None:
        raise UnusableFrame("no_exif_time", "EXIF holds no DateTimeOriginal")
    fraction = _text(tags.get(_SUB_SECOND))
    offset = _text(tags.get(_OFFSET))
    text = f"{taken[1]}-{taken[2]}-{taken[3]}T{taken[4]}"
    if fraction.isascii() and fraction.isdigit():
        text += "." + fraction[:9]
    return text + (offset if _OFFSET_TEXT.fullmatch(offset) else "")


def _text(value: object) -> str:
    return str(value).strip("\0 ") if isinstance(value, str) else ""
