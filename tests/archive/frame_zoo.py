"""The frame zoo: 500 files and more that are broken in every way, made here.

Formats × truncation × bit flips × wrong extensions × bombs × malformed tags, and what becomes of each: its outcome, and
the memory that took.
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from vtrack_batch.archive.decode import decode
from vtrack_batch.archive.params import ArchiveParams
from vtrack_batch.errors import UnusableFrame

MAX_PIXELS = ArchiveParams().max_pixels
SHAPE = (61, 97)
KEPT = (0, 1, 2, 3, 4, 10, 33, 50, 75, 90, 99)


def picture() -> np.ndarray:
    rng = np.random.default_rng(11)
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    smooth = np.stack([60 + cols, 220 - 2 * rows, 90 + (rows + cols) // 3], -1)
    return np.clip(smooth + rng.integers(-20, 21, (*SHAPE, 3)), 0, 255).astype(np.uint8)


def encoded(kind: str, image: Image.Image | None = None, **options: object) -> bytes:
    out = io.BytesIO()
    (image or Image.fromarray(picture())).save(out, kind, **options)
    return out.getvalue()


def formats() -> dict[str, bytes]:
    colour = Image.fromarray(picture())
    return {
        "jpeg": encoded("JPEG", quality=90),
        "jpeg progressive": encoded("JPEG", progressive=True),
        "jpeg grey": encoded("JPEG", colour.convert("L")),
        "jpeg restart": cv2.imencode(".jpg", picture(), [cv2.IMWRITE_JPEG_RST_INTERVAL, 2])[1].tobytes(),
        "jpeg exif": encoded("JPEG", exif=b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"),
        "png": encoded("PNG"),
        "png palette": encoded("PNG", colour.quantize(16)),
        "png alpha": encoded("PNG", colour.convert("RGBA")),
        "tiff": encoded("TIFF"),
        "tiff lzw": encoded("TIFF", compression="tiff_lzw"),
        "tiff deflate": encoded("TIFF", compression="tiff_deflate"),
        "tiff packbits": encoded("TIFF", compression="packbits"),
    }


def strangers() -> Iterator[tuple[str, bytes]]:
    colour = Image.fromarray(picture())
    for kind in ("GIF", "BMP", "WEBP", "PPM", "TGA", "ICO", "PCX", "SGI", "JPEG2000", "MPO"):
        yield f"stranger {kind}", encoded(kind, colour if kind != "GIF" else colour.quantize(16))
    for extension in (".hdr", ".ras", ".pfm"):
        yield f"stranger {extension}", cv2.imencode(extension, picture().astype(np.float32))[1].tobytes()
    yield from (("html", b"<html>404</html>"), ("text", b"no frame"), ("zip", b"PK\x03\x04" + bytes(40)))
    yield from (("zeros", bytes(5000)), ("ones", b"\xff" * 5000), ("empty", b""), ("pdf", b"%PDF-1.7\n"))
    yield "script", b"#!/bin/sh\nrm -rf /\n"
    yield (
        "vrt",
        b'<VRTDataset rasterXSize="9" rasterYSize="9"><SourceFilename>/etc/passwd</SourceFilename></VRTDataset>',
    )


def bombs() -> Iterator[tuple[str, bytes]]:
    for width, height in ((16_000, 16_000), (2**31 - 1, 1), (1, 2**31 - 1), (65_535, 65_535), (0, 9), (9, 0)):
        yield f"png bomb {width}x{height}", png_of(width, height)
    jpeg = formats()["jpeg"]
    at = jpeg.index(b"\xff\xc0") + 5
    for height, width in ((65_535, 65_535), (0, 97), (61, 0), (20_000, 97)):
        yield f"jpeg bomb {width}x{height}", jpeg[:at] + struct.pack(">HH", height, width) + jpeg[at + 4 :]
    for tag, value in ((256, 2**31 - 1), (257, 2**31 - 1), (256, 0), (258, 64), (277, 65_535), (259, 9), (262, 77)):
        yield f"tiff tag {tag}={value}", tiff_with(tag, value)
    yield "tiff cycle", b"II*\0\x08\0\0\0" + struct.pack("<H", 0) + struct.pack("<I", 8) + bytes(20)
    yield "tiff many tags", b"II*\0\x08\0\0\0" + struct.pack("<H", 65_535) + bytes(12 * 65_535)
    yield "tiff far", b"II*\0\xff\xff\xff\x7f"
    yield "tiff two pages", encoded("TIFF", save_all=True, append_images=[Image.fromarray(picture())])
    yield "png animated", encoded("PNG", save_all=True, append_images=[Image.fromarray(picture()[::-1])])
    yield "png 16 bits", encoded("PNG", Image.fromarray(picture()[:, :, 0].astype(np.uint16) * 200))
    yield "tiff float", encoded("TIFF", Image.fromarray(picture()[:, :, 0].astype(np.float32)))
    yield "tiff 1 bit", encoded("TIFF", Image.fromarray(picture()).convert("1"))
    yield "jpeg cmyk", encoded("JPEG", Image.fromarray(picture()).convert("CMYK"))
    yield "tiff cmyk", encoded("TIFF", Image.fromarray(picture()).convert("CMYK"))


def png_of(width: int, height: int) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = zlib.compress(bytes(1_000_000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def tiff_with(tag: int, value: int) -> bytes:
    """A plain TIFF whose *tag* says *value*."""
    data = bytearray(formats()["tiff"])
    start = int.from_bytes(data[4:8], "little")
    for entry in range(int.from_bytes(data[start : start + 2], "little")):
        at = start + 2 + 12 * entry
        if int.from_bytes(data[at : at + 2], "little") == tag:
            data[at + 2 : at + 12] = struct.pack("<HII", 4, 1, value)
    return bytes(data)


def zoo() -> Iterator[tuple[str, bytes]]:
    rng = np.random.default_rng(7)
    for name, data in formats().items():
        for share in KEPT:
            yield f"{name} cut {share}", data[: len(data) * share // 100]
        yield from ((f"{name} short {n}", data[:-n]) for n in (1, 2, 3, 20))
        yield f"{name} trailer", data + b"\0\0trailing bytes of a camera"
        for number in range(26):
            flipped = bytearray(data)
            for place in rng.integers(0, len(data), 1 + number % 5):
                flipped[place] ^= 1 << int(rng.integers(8))
            yield f"{name} flipped {number}", bytes(flipped)
    yield from strangers()
    yield from bombs()


ZOO = dict(zoo())


def outcome(data: bytes) -> str:
    """Return the reason why the file is refused, "whole" if it is not."""
    try:
        found = decode(data, max_pixels=MAX_PIXELS)
    except UnusableFrame as problem:
        return problem.reason
    assert found.pixels.dtype == np.uint8
    assert found.pixels.shape == (found.height_px, found.width_px, 3)
    return "whole"


def memory_mb(action: Callable[[], object]) -> float:
    """Return how much more memory of the system this process held while *action* went on than before it."""
    Path("/proc/self/clear_refs").write_text("5")  # the highest mark begins anew
    before_kb = _status_kb("VmRSS")
    action()
    return (_status_kb("VmHWM") - before_kb) / 1024


def _status_kb(name: str) -> int:
    found = re.search(rf"^{name}:\s+(\d+) kB$", Path("/proc/self/status").read_text(), re.MULTILINE)
    assert found is not None
    return int(found[1])
