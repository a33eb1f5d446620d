"""The directories of a TIFF or BigTIFF file, read with limits: GDAL is only asked about files that pass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.errors import UnusableFrame

_MAX_PAGES, _MAX_TAGS = 64, 4096
_TYPES = {1: "u1", 3: "u2", 4: "u4", 13: "u4", 16: "u8", 18: "u8"}

_NEW_SUBFILE, _SUBFILE, _WIDTH, _HEIGHT, _BITS, _COMPRESSION, _PHOTOMETRIC = 254, 255, 256, 257, 258, 259, 262
_STRIPS, _SAMPLES, _STRIP_BYTES = 273, 277, 279
_TILE_WIDTH, _TILE_HEIGHT, _TILES, _TILE_BYTES, _SAMPLE_FORMAT = 322, 323, 324, 325, 339
_WANTED = frozenset(range(_NEW_SUBFILE, _PHOTOMETRIC + 1)) | {_STRIPS, _SAMPLES, _STRIP_BYTES}
_WANTED |= {_TILE_WIDTH, _TILE_HEIGHT, _TILES, _TILE_BYTES, _SAMPLE_FORMAT}


class TiffPage(NamedTuple):
    """One image of a TIFF file; ``bits`` and ``sample_formats`` have one entry a sample."""

    width_px: int
    height_px: int
    bits: tuple[int, ...]
    sample_formats: tuple[int, ...]
    photometric: int
    compression: int
    tile_pixels: int
    reduced: bool
    mask: bool
    unwritten: bool
    """Parts of the picture have no data in the file: a sparse file, or a writer that never came to its end."""


def tiff_pages(data: bytes) -> list[TiffPage]:
    """Return the pages of the TIFF file *data* in their order, overviews and masks among them.

    Raises UnusableFrame: truncated if a directory or picture data lie beyond the end of the file; malformed if
    directories go in a circle, are too many, too long, or lack what a picture needs.
    """
    layout = _Layout.of(data)
    at = layout.number(4 if layout.offset_bytes == 4 else 8, layout.offset_bytes)
    pages: list[TiffPage] = []
    visited: set[int] = set()
    while at:
        if at in visited or len(pages) == _MAX_PAGES:
            raise UnusableFrame("malformed", "its directories go in a circle, or are too many")
        visited.add(at)
        tags, at = layout.directory(at)
        pages.append(_page(tags, len(data)))
    if not pages:
        raise UnusableFrame("malformed", "it holds no picture")
    return pages


@dataclass(frozen=True)
class _Layout:
    """Byte order and widths of numbers: classic TIFF or BigTIFF."""

    data: bytes
    order: str
    offset_bytes: int

    @classmethod
    def of(cls, data: bytes) -> _Layout:
        order = "<" if data[:2] == b"II" else ">"
        return cls(data, order, 8 if data[2:4] in (b"+\0", b"\0+") else 4)

    def number(self, at: int, size: int) -> int:
        if at + size > len(self.data):
            raise UnusableFrame(
                "truncated", f"the file ends after {len(self.data)} bytes, before byte {at} it points to"
            )
        return int.from_bytes(self.data[at : at + size], "little" if self.order == "<" else "big")

    def directory(self, at: int) -> tuple[dict[int, NDArray[np.int64]], int]:
        """Return the wanted tags of the directory at byte *at*, and where the next one is (0 = none)."""
        wide = self.offset_bytes == 8
        count = self.number(at, 8 if wide else 2)
        if count > _MAX_TAGS:
            raise UnusableFrame("malformed", f"a directory of {count} tags")
        first, size = at + (8 if wide else 2), 20 if wide else 12
        tags = {}
        for entry in range(first, first + count * size, size):
            tag = self.number(entry, 2)
            if tag in _WANTED:
                tags[tag] = self.values(entry)
        return tags, self.number(first + count * size, self.offset_bytes)

    def values(self, entry: int) -> NDArray[np.int64]:
        """Return the whole numbers of the tag at byte *entry*; none if they are of another type."""
        kind = _TYPES.get(self.number(entry + 2, 2))
        if kind is None:
            return np.zeros(0, np.int64)
        count = self.number(entry + 4, self.offset_bytes)
        at = entry + 4 + self.offset_bytes
        if count * int(kind[1]) > self.offset_bytes:
            at = self.number(at, self.offset_bytes)
        if at + count * int(kind[1]) > len(self.data):
            raise UnusableFrame(
                "truncated", f"the file ends after {len(self.data)} bytes, before the values it points to"
            )
        return np.frombuffer(self.data, self.order + kind, count, at).astype(np.int64)


def _page(tags: dict[int, NDArray[np.int64]], file_bytes: int) -> TiffPage:
    def one(tag: int, default: int) -> int:
        values = tags.get(tag)
        return int(values[0]) if values is not None and len(values) else default

    samples = one(_SAMPLES, 1)
    if not 1 <= samples <= 4096:
        raise UnusableFrame("malformed", f"{samples} samples a pixel")
    _check_data_inside(tags, file_bytes)
    subfile = one(_NEW_SUBFILE, 0)
    return TiffPage(
        width_px=one(_WIDTH, 0),
        height_px=one(_HEIGHT, 0),
        bits=_per_sample(tags.get(_BITS), samples),
        sample_formats=_per_sample(tags.get(_SAMPLE_FORMAT), samples),
        photometric=one(_PHOTOMETRIC, 1),
        compression=one(_COMPRESSION, 1),
        tile_pixels=one(_TILE_WIDTH, 0) * one(_TILE_HEIGHT, 0),
        reduced=bool(subfile & 1) or one(_SUBFILE, 1) == 2,
        mask=bool(subfile & 4),
        unwritten=any((tags[sizes] == 0).any() for sizes in (_STRIP_BYTES, _TILE_BYTES) if sizes in tags),
    )


def _per_sample(values: NDArray[np.int64] | None, samples: int) -> tuple[int, ...]:
    """Return one value a sample; a single one stands for all, and none means 1, the default of TIFF."""
    if values is None or not len(values):
        return (1,) * samples
    if len(values) < samples:
        return (int(values[0]),) * samples
    return tuple(int(value) for value in values[:samples])


def _check_data_inside(tags: dict[int, NDArray[np.int64]], file_bytes: int) -> None:
    for where, sizes in ((_STRIPS, _STRIP_BYTES), (_TILES, _TILE_BYTES)):
        if where not in tags:
            continue
        starts, lengths = tags[where], tags.get(sizes, np.zeros(0, np.int64))
        if len(starts) != len(lengths) or (starts < 0).any() or (lengths < 0).any():
            raise UnusableFrame("malformed", "places and sizes of the picture data do not fit together")
        if (starts > file_bytes - lengths).any():
            raise UnusableFrame("truncated", f"the file ends after {file_bytes} bytes, within the picture")
        return
    raise UnusableFrame("malformed", "it holds no picture data")
