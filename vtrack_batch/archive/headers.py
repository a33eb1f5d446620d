"""What a file holds, told from its bytes before any decoder sees them: JPEG, PNG or TIFF of eight-bit samples.

Formats are known by their magic numbers, never by the file's name. What is allowed:

    JPEG    8 bits; grey, YCbCr or RGB; baseline, progressive, arithmetic
    PNG     1 to 8 bits; grey, RGB, palette, with or without alpha; one frame
    TIFF    8 bits unsigned; grey, RGB, palette, JPEG's YCbCr; one full page (overviews and masks are no pages)

Sources: ITU-T T.81 annex B; W3C PNG (third edition) 5 and 11; TIFF 6.0 and BigTIFF.
"""

from __future__ import annotations

import struct
import zlib
from typing import Literal, NamedTuple

from vtrack_batch.archive.names import escape_bytes
from vtrack_batch.archive.tiff import TiffPage, tiff_pages
from vtrack_batch.errors import UnusableFrame

Format = Literal["jpeg", "png", "tiff"]

_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_STRANGERS = (
    (0, b"GIF8", "GIF"),
    (0, b"BM", "BMP"),
    (8, b"WEBP", "WebP"),
    (4, b"ftyp", "HEIF, AVIF or a film"),
    (0, b"\0\0\0\x0cjP  ", "JPEG 2000"),
    (0, b"\xff\x4f\xff\x51", "JPEG 2000"),
    (0, b"\0\0\0\x0cJXL ", "JPEG XL"),
    (0, b"\xff\x0a", "JPEG XL"),
    (0, b"\x59\xa6\x6a\x95", "Sun raster"),
    (0, b"%PDF", "PDF"),
    (0, b"8BPS", "Photoshop"),
    (0, b"\x76\x2f\x31\x01", "OpenEXR"),
    (0, b"PK\x03\x04", "a ZIP archive"),
    (0, b"\x1f\x8b", "gzip"),
)
_JPEG_GREY_OR_COLOUR = (1, 3)
_JPEG_LOSSY_FRAMES = frozenset((0xC0, 0xC1, 0xC2, 0xC9, 0xCA))
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_PNG_COLOURS = {0: "grey", 2: "rgb", 3: "palette", 4: "grey+alpha", 6: "rgb+alpha"}
_TIFF_COLOURS = {0: "inverted grey", 1: "grey", 2: "rgb", 3: "palette", 6: "ycbcr"}
_TIFF_JPEG = 7


class Header(NamedTuple):
    """Size in pixels, format, bits per sample, and how samples make colours (``rgb``, ``grey+alpha``, ``palette``)."""

    width_px: int
    height_px: int
    format: Format
    bit_depth: int
    colours: str
    block_pixels: int = 0
    """Pixels that a decoder must hold at least at once (a TIFF's tile may exceed its picture)."""
    unwritten: bool = False
    """Parts of a TIFF's picture are not in the file: decoders fill them."""


def read_header(data: bytes) -> Header:
    """Return the header of the image file *data*.

    Raises UnusableFrame with reason empty, not_an_image, unsupported_format, unsupported_samples, multi_page, truncated
    or malformed.
    """
    if not data:
        raise UnusableFrame("empty", "a file of 0 bytes")
    if data.startswith(b"\xff\xd8\xff"):
        return _jpeg(data)
    if data.startswith(_PNG):
        return _png(data)
    if data[:4] in _TIFF:
        return _tiff(data)
    for offset, magic, what in _STRANGERS:
        if data.startswith(magic, offset):
            raise UnusableFrame("unsupported_format", f"{what}; frames are JPEG, PNG or TIFF")
    raise UnusableFrame("not_an_image", f"it begins with '{escape_bytes(data)}'")


def _jpeg(data: bytes) -> Header:
    at = 2
    while True:
        if at + 4 > len(data):
            raise UnusableFrame("truncated", f"the file ends after {len(data)} bytes, within the header")
        marker = data[at + 1]
        if data[at] != 0xFF:
            raise UnusableFrame("malformed", f"no marker at byte {at} of the header")
        if marker == 0xFF:
            at += 1
            continue
        length = int.from_bytes(data[at + 2 : at + 4], "big")
        if marker in _JPEG_FRAMES:
            return _jpeg_frame(marker, data[at + 4 : at + 2 + length])
        if marker == 0xDA or marker == 0xD9 or length < 2:
            raise UnusableFrame("malformed", "no size before the picture")
        at += 2 + length


def _jpeg_frame(marker: int, body: bytes) -> Header:
    if len(body) < 6:
        raise UnusableFrame("truncated", "the file ends within the header")
    bits, height, width, components = struct.unpack(">BHHB", body[:6])
    if marker not in _JPEG_LOSSY_FRAMES:
        raise UnusableFrame("unsupported_samples", "lossless or hierarchical JPEG")
    if bits != 8:
        raise UnusableFrame("unsupported_samples", f"{bits} bits a sample; {_ADVICE}")
    if components not in _JPEG_GREY_OR_COLOUR:
        raise UnusableFrame("unsupported_samples", f"{components} colour components (CMYK?); convert to RGB")
    return _sized(Header(width, height, "jpeg", bits, "grey" if components == 1 else "rgb"))


def _png(data: bytes) -> Header:
    if len(data) < 33:
        raise UnusableFrame("truncated", f"the file ends after {len(data)} bytes, within the header")
    width, height, bits, colour = struct.unpack(">IIBB", data[16:26])
    if data[12:16] != b"IHDR" or colour not in _PNG_COLOURS:
        raise UnusableFrame("malformed", "its first chunk is no header")
    header = _sized(Header(width, height, "png", bits, _PNG_COLOURS[colour]))
    if bits > 8:
        raise UnusableFrame("unsupported_samples", f"{bits} bits a sample; {_ADVICE}")
    _check_png_chunks(data)
    return header


def _check_png_chunks(data: bytes) -> None:
    """Walk the chunks up to the end mark: all there, each with its checksum; libpng would complain to stderr first."""
    at, kind = 8, b""
    while kind != b"IEND":
        kind, length = data[at + 4 : at + 8], int.from_bytes(data[at : at + 4], "big")
        end = at + 8 + length
        if end + 4 > len(data):
            raise UnusableFrame("truncated", f"the file ends after {len(data)} bytes, before its end mark")
        if zlib.crc32(memoryview(data)[at + 4 : end]) != int.from_bytes(data[end : end + 4], "big"):
            raise UnusableFrame("malformed", f"the checksum of the chunk at byte {at} is wrong")
        if kind == b"acTL" and int.from_bytes(data[at + 8 : at + 12], "big") > 1:
            raise UnusableFrame("multi_page", "an animated PNG")
        at = end + 4


def _tiff(data: bytes) -> Header:
    pages = tiff_pages(data)
    full = [page for page in pages if not page.reduced and not page.mask]
    first = pages[0]
    if len(full) > 1:
        raise UnusableFrame("multi_page", f"{len(full)} pages; a frame is one file of one page")
    colours = _tiff_colours(first)
    header = Header(
        first.width_px, first.height_px, "tiff", max(first.bits), colours, first.tile_pixels, first.unwritten
    )
    return _sized(header)


def _tiff_colours(page: TiffPage) -> str:
    """Return how the samples of *page* make colours; UnusableFrame if they are none of the allowed."""
    if set(page.sample_formats) - {1, 4}:
        kind = {2: "signed integer", 3: "floating point"}.get(max(page.sample_formats), "complex")
        raise UnusableFrame("unsupported_samples", f"{kind} samples of {max(page.bits)} bits; {_ADVICE}")
    if set(page.bits) != {8}:
        raise UnusableFrame("unsupported_samples", f"{max(page.bits)} bits a sample; {_ADVICE}")
    colours = _TIFF_COLOURS.get(page.photometric)
    samples = len(page.bits)
    if colours is None or (colours == "ycbcr" and page.compression != _TIFF_JPEG):
        raise UnusableFrame("unsupported_samples", f"colour space {page.photometric} of TIFF; convert to RGB")
    if colours == "grey" and samples in (3, 4):
        return "rgb"  # written without saying so, as GDAL and others do
    if samples > 4 or (colours == "rgb" and samples < 3):
        raise UnusableFrame("unsupported_samples", f"{samples} bands; write a file of three, red, green and blue")
    return colours


def _sized(header: Header) -> Header:
    if header.width_px < 1 or header.height_px < 1:
        raise UnusableFrame("malformed", f"a size of {header.width_px} x {header.height_px} pixels")
    return header


_ADVICE = (
    "only 8 bits are read, for a scale chosen frame by frame would change brightness from frame to frame; "
    "convert the whole archive with one scale, e.g. gdal_translate -ot Byte -scale 0 65535 0 255"
)
