"""Pixels of one frame from the bytes of its file: whole or not at all.

What becomes what, always the same way and never by the frame's own range of values:

    8-bit grey            the same value in red, green and blue
    palette               its colours
    white-is-zero grey    255 - value
    alpha, fourth band    dropped; where alpha is 0, or the TIFF says no data, all is black, as beside an orthophoto
    EXIF orientation      ignored: pixel coordinates are those of the frame as stored
    bytes after the end   ignored and noted

JPEG: libjpeg-turbo stopping at its first warning, for a decoder that goes on paints the missing part grey; its fast
transform, without smoothing of colours, changes levels by about one. The one warning let pass is of surplus bytes
before the end mark, where the whole picture has been read. PNG: libpng, with checksums. TIFF: GDAL's GTiff driver
alone, from memory, with no access to other files or the network.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.archive.headers import Format, Header, read_header
from vtrack_batch.errors import UnusableFrame

# Read once, when OpenCV is loaded: a second limit behind our own, should a header have lied.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**29))

import cv2
import simplejpeg

_TRUNCATED = ("premature end",)
_HARMLESS = "extraneous bytes before marker 0xd9"


@dataclass(frozen=True)
class Decoded:
    """A decoded frame.

    ``pixels`` (H, W, 3) uint8 RGB, black where the file says that there is no picture; ``bit_depth`` of the samples as
    stored; ``notes``: conversions made, short words.
    """

    pixels: NDArray[np.uint8]
    format: Format
    width_px: int
    height_px: int
    bit_depth: int
    notes: tuple[str, ...] = ()


def decode(data: bytes, *, max_pixels: int) -> Decoded:
    """Decode the image file *data* of at most *max_pixels* pixels.

    Raises UnusableFrame with reason empty, not_an_image, unsupported_format, unsupported_samples, multi_page,
    truncated, malformed or too_large; the size is judged by the header, before any memory is taken.
    """
    header = read_header(data)
    if max(header.width_px * header.height_px, header.block_pixels) > max_pixels:
        size = f"{header.width_px} x {header.height_px} pixels"
        raise UnusableFrame("too_large", f"{size}; archive.max_pixels allows {max_pixels}")
    pixels, valid, notes = {"jpeg": _jpeg, "png": _png, "tiff": _tiff}[header.format](data, header)
    if pixels.shape != (header.height_px, header.width_px, 3):
        raise UnusableFrame("malformed", f"decoded to {pixels.shape[1]} x {pixels.shape[0]}, unlike its header")
    if valid is not None and not valid.all():
        pixels[~valid] = 0
        notes.append("no_data_black")
    notes += [note for colours, note in _NOTES.items() if colours in header.colours]
    return Decoded(
        pixels, header.format, header.width_px, header.height_px, header.bit_depth, tuple(sorted(set(notes)))
    )


_NOTES = {"grey": "grey_to_rgb", "palette": "palette_to_rgb", "alpha": "alpha_dropped", "inverted": "grey_inverted"}
_Parts = tuple[NDArray[np.uint8], NDArray[np.bool_] | None, list[str]]
"""Pixels, where the file says there is a picture (None = everywhere), notes."""


def _jpeg(data: bytes, header: Header) -> _Parts:
    notes = [] if data.endswith(b"\xff\xd9") else ["trailing_bytes"]
    try:
        return simplejpeg.decode_jpeg(data, "RGB", fastdct=True, fastupsample=True, strict=True), None, notes
    except ValueError as error:
        message = str(error)
    if message.endswith(_HARMLESS):
        pixels = simplejpeg.decode_jpeg(data, "RGB", fastdct=True, fastupsample=True, strict=False)
        return pixels, None, [*notes, "surplus_bytes"]
    if any(text in message.lower() for text in _TRUNCATED):
        raise UnusableFrame("truncated", f"the picture ends before its last row: {message}")
    raise UnusableFrame("malformed", message)


def _png(data: bytes, header: Header) -> _Parts:
    alpha = header.colours == "rgb+alpha"
    flags = cv2.IMREAD_UNCHANGED if alpha else cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise UnusableFrame("malformed", "libpng refuses it") from error
    if image is None:
        raise UnusableFrame("malformed", "libpng refuses it: a checksum or the compressed data are wrong")
    notes = [] if data.rstrip(b"\0").endswith(b"IEND\xaeB`\x82") else ["trailing_bytes"]
    if alpha:
        return _bytes(cv2.cvtColor(image, cv2.COLOR_BGRA2RGB)), image[:, :, 3] > 0, notes
    return _bytes(image), None, notes


def _tiff(data: bytes, header: Header) -> _Parts:
    import rasterio  # 0.4 s and 100 MB that an archive of JPEGs need not pay

    options = {"GDAL_NUM_THREADS": "1", "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR", "GDAL_PAM_ENABLED": "NO"}
    try:
        with warnings.catch_warnings(), rasterio.Env(**options), rasterio.MemoryFile(data) as memory:
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            with memory.open(driver="GTiff", sharing=False) as dataset:
                bands = dataset.read(list(range(1, min(dataset.count, 3) + 1)))
                everywhere = all(rasterio.enums.MaskFlags.all_valid in flags for flags in dataset.mask_flag_enums)
                if header.unwritten and everywhere:
                    raise UnusableFrame(
                        "truncated", "parts of the picture were never written, and no no-data value says so"
                    )
                valid = None if everywhere else dataset.dataset_mask() > 0
                colours = dataset.colormap(1) if header.colours == "palette" else None
                notes = ["extra_bands_dropped"] if dataset.count > 3 else []
    except (rasterio.errors.RasterioError, rasterio.errors.RasterioIOError, ValueError) as error:
        # GDAL's own words hold the random name of the memory file: kept as cause, not in the table.
        raise UnusableFrame("malformed", "GDAL cannot read it: damaged, or of an unknown compression") from error
    if bands.dtype != np.uint8:
        raise UnusableFrame("unsupported_samples", f"samples of type {bands.dtype}")
    if colours is not None:
        table = np.array([colours.get(value, (0, 0, 0, 255))[:3] for value in range(256)], np.uint8)
        return table[bands[0]], valid, notes
    if header.colours == "inverted grey":
        bands = 255 - bands[:1]
    if len(bands) < 3:
        bands = np.repeat(bands[:1], 3, axis=0)
    return np.ascontiguousarray(bands.transpose(1, 2, 0)), valid, notes


def _bytes(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return *image*, of which OpenCV's types say only that it holds numbers, as the bytes that it is."""
    return image.astype(np.uint8, copy=False)
