"""Every file is decoded whole, or refused with a word that says why."""

import io
import struct
import zlib

import numpy as np
import pytest
import rasterio
from PIL import Image

from vtrack_batch.archive.decode import decode
from vtrack_batch.archive.headers import read_header
from vtrack_batch.errors import UnusableFrame

LIMIT = 200_000_000


def picture(width=161, height=97, seed=3):
    """A lopsided coloured picture with detail, so that swapped axes or colours show."""
    rng = np.random.default_rng(seed)
    rows, cols = np.mgrid[:height, :width]
    smooth = np.stack([40 + cols, 200 - rows, 90 + (rows + cols) // 4], -1)
    return np.clip(smooth + rng.integers(-9, 10, (height, width, 3)), 0, 255).astype(np.uint8)


def encoded(image, kind="JPEG", **options):
    out = io.BytesIO()
    (image if isinstance(image, Image.Image) else Image.fromarray(image)).save(out, kind, **options)
    return out.getvalue()


def tiff(image, **options):
    """Write bands (count, H, W) as GDAL does."""
    bands = image.transpose(2, 0, 1) if image.ndim == 3 else image[None]
    profile = {"driver": "GTiff", "count": bands.shape[0], "height": bands.shape[1], "width": bands.shape[2]}
    with rasterio.MemoryFile() as memory:
        with memory.open(**{**profile, "dtype": bands.dtype, **options}) as dataset:
            dataset.write(bands)
        return memory.read()


def refusal(data, limit=LIMIT):
    with pytest.raises(UnusableFrame) as caught:
        decode(data, max_pixels=limit)
    return caught.value.reason


def outcome_of(data):
    try:
        return decode(data, max_pixels=1_000_000)
    except UnusableFrame as error:
        return error


def png_header(width, height):
    body = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + struct.pack(">I", 13)
        + body
        + struct.pack(">I", zlib.crc32(body))
        + b"\0\0\0\0IEND\xaeB`\x82"
    )


LOSSLESS = {
    "png": lambda image: encoded(image, "PNG"),
    "tiff": lambda image: tiff(image),
    "tiff lzw": lambda image: tiff(image, compress="lzw", predictor=2),
    "tiff deflate tiled": lambda image: tiff(image, compress="deflate", tiled=True, blockxsize=64, blockysize=64),
    "tiff zstd": lambda image: tiff(image, compress="zstd"),
    "tiff planar": lambda image: tiff(image, interleave="band"),
    "tiff big": lambda image: tiff(image, BIGTIFF="YES"),
    "tiff big-endian": lambda image: tiff(image, ENDIANNESS="BIG"),
    "tiff min-is-black": lambda image: tiff(image, photometric="MINISBLACK"),
}


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
class TestWhole:
    @pytest.mark.parametrize("name", LOSSLESS)
    def test_lossless_formats_give_the_same_pixels(self, name):
        image = picture()
        found = decode(LOSSLESS[name](image), max_pixels=LIMIT)
        np.testing.assert_array_equal(found.pixels, image)
        assert (found.width_px, found.height_px, found.bit_depth) == (161, 97, 8)
        assert found.pixels.flags.c_contiguous
        assert found.notes == ()

    @pytest.mark.parametrize("options", [{}, {"progressive": True}, {"subsampling": 0}, {"restart_marker_rows": 1}])
    def test_jpeg_is_what_a_second_decoder_sees(self, options):
        data = encoded(picture(), quality=92, **options)
        found = decode(data, max_pixels=LIMIT)
        second = np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)
        # Colours that are stored at half the resolution are not smoothed.
        assert np.abs(found.pixels - second).mean() < (1.5 if "subsampling" in options else 6.0)
        luminance = np.array([0.299, 0.587, 0.114])
        assert np.abs(found.pixels @ luminance - second @ luminance).mean() < 1.0
        assert found.format == "jpeg"

    def test_header_tells_width_before_height(self):
        for data in (encoded(picture()), encoded(picture(), "PNG"), tiff(picture())):
            header = read_header(data)
            assert (header.width_px, header.height_px) == (161, 97)

    def test_grey_becomes_equal_colours(self):
        grey = picture()[:, :, 0]
        for data in (encoded(grey, "PNG"), tiff(grey)):
            found = decode(data, max_pixels=LIMIT)
            np.testing.assert_array_equal(found.pixels, np.repeat(grey[:, :, None], 3, 2))
            assert found.notes == ("grey_to_rgb",)
        assert decode(encoded(grey), max_pixels=LIMIT).notes == ("grey_to_rgb",)

    def test_white_is_zero_is_turned_round(self):
        grey = picture()[:, :, 0]
        found = decode(tiff(grey, photometric="MINISWHITE"), max_pixels=LIMIT)
        np.testing.assert_array_equal(found.pixels[:, :, 1], 255 - grey)

    def test_palette_gives_its_colours(self):
        image = Image.fromarray(picture()).quantize(64)
        for kind in ("PNG", "TIFF"):
            found = decode(encoded(image, kind), max_pixels=LIMIT)
            np.testing.assert_array_equal(found.pixels, np.asarray(image.convert("RGB")))
            assert found.notes == ("palette_to_rgb",)

    def test_one_bit_png_is_black_and_white(self):
        image = Image.fromarray(picture()).convert("1")
        found = decode(encoded(image, "PNG"), max_pixels=LIMIT)
        np.testing.assert_array_equal(found.pixels, np.asarray(image.convert("RGB")))
        assert found.bit_depth == 1

    @pytest.mark.parametrize("kind", ["PNG", "TIFF"])
    def test_alpha_is_dropped_and_what_it_hides_is_black(self, kind):
        image = picture()
        alpha = np.full(image.shape[:2], 255, np.uint8)
        alpha[:, 150:] = 0
        found = decode(encoded(np.dstack([image, alpha]), kind), max_pixels=LIMIT)
        np.testing.assert_array_equal(found.pixels, np.where(alpha[:, :, None] > 0, image, 0))
        assert "no_data_black" in found.notes

    def test_no_data_of_a_tiff_is_black(self):
        image = np.minimum(picture(), 254)
        image[:20] = 255
        found = decode(tiff(image, nodata=255), max_pixels=LIMIT)
        np.testing.assert_array_equal(found.pixels[20:], image[20:])
        assert not found.pixels[:20].any()
        assert found.notes == ("no_data_black",)

    def test_fourth_band_is_dropped_and_noted(self):
        image = picture()
        infrared = tiff(np.dstack([image, image[:, :, :1]]), photometric="MINISBLACK")
        found = decode(infrared, max_pixels=LIMIT)
        np.testing.assert_array_equal(found.pixels, image)
        assert "extra_bands_dropped" in found.notes

    def test_exif_orientation_is_ignored(self):
        exif = Image.Exif()
        exif[0x0112] = 6
        for kind in ("JPEG", "PNG", "TIFF"):
            found = decode(encoded(picture(), kind, exif=exif), max_pixels=LIMIT)
            assert found.pixels.shape == (97, 161, 3)

    def test_bytes_after_the_end_are_noted(self):
        for kind in ("JPEG", "PNG"):
            found = decode(encoded(picture(), kind) + b"camera maker's trailer", max_pixels=LIMIT)
            assert found.notes == ("trailing_bytes",)

    def test_surplus_bytes_before_the_end_mark_do_no_harm(self):
        data = encoded(picture())
        found = decode(data[:-2] + bytes(40) + data[-2:], max_pixels=LIMIT)
        np.testing.assert_array_equal(found.pixels, decode(data, max_pixels=LIMIT).pixels)
        assert found.notes == ("surplus_bytes",)

    def test_overviews_are_no_pages(self, tmp_path):
        path = tmp_path / "frame.tif"
        path.write_bytes(tiff(picture(300, 200)))
        with rasterio.open(path, "r+") as dataset:
            dataset.build_overviews([2, 4])
        assert decode(path.read_bytes(), max_pixels=LIMIT).pixels.shape == (200, 300, 3)


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
class TestRefused:
    @pytest.mark.parametrize("share", [0.05, 0.5, 0.99])
    @pytest.mark.parametrize("options", [{}, {"progressive": True}])
    def test_truncated_jpeg_is_never_a_half_grey_picture(self, share, options):
        data = encoded(picture(640, 300), quality=90, **options)
        assert refusal(data[: int(share * len(data))]) == "truncated"

    def test_truncated_jpeg_with_an_end_mark_pasted_on(self):
        data = encoded(picture(640, 300), quality=90)
        assert refusal(data[: len(data) // 2] + b"\xff\xd9") == "truncated"

    def test_jpeg_cut_at_any_of_many_places_is_refused(self):
        data = encoded(picture(48, 40))
        reasons = {refusal(data[:length]) for length in range(3, len(data))}
        assert reasons <= {"truncated", "malformed"}

    @pytest.mark.parametrize("name", ["png", "tiff", "tiff lzw", "tiff deflate tiled", "tiff big"])
    @pytest.mark.parametrize("share", [0.05, 0.5, 0.99])
    def test_other_truncated_files(self, name, share):
        data = LOSSLESS[name](picture(640, 300))
        assert refusal(data[: int(share * len(data))]) == "truncated"

    def test_parts_of_a_tiff_never_written(self):
        image = picture(128, 128)
        options = {"tiled": True, "blockxsize": 64, "blockysize": 64, "SPARSE_OK": "TRUE"}
        image[:64, :64] = 0
        assert refusal(tiff(image, **options)) == "truncated"
        assert not decode(tiff(image, **options, nodata=0), max_pixels=LIMIT).pixels[:64, :64].any()

    def test_empty(self):
        assert refusal(b"") == "empty"

    def test_text_named_jpg_shows_its_first_bytes_escaped(self):
        with pytest.raises(UnusableFrame) as caught:
            decode(b"<html>\x1b[31m\n<body>not found", max_pixels=LIMIT)
        assert caught.value.reason == "not_an_image"
        assert "<html>\\x1b[31m\\n" in caught.value.detail
        assert caught.value.detail.isprintable()

    @pytest.mark.parametrize("kind", ["WEBP", "BMP", "GIF", "JPEG2000"])
    def test_other_formats_reach_no_decoder(self, kind):
        assert refusal(encoded(picture(), kind)) == "unsupported_format"

    def test_bomb_is_refused_by_its_header(self):
        assert refusal(png_header(16000, 16000)) == "too_large"
        assert refusal(png_header(2**31 - 1, 2**31 - 1)) == "too_large"
        assert refusal(encoded(picture()), limit=161 * 97 - 1) == "too_large"

    def test_size_at_the_limit_passes(self):
        assert decode(encoded(picture()), max_pixels=161 * 97).width_px == 161

    def test_sixteen_bits_and_floats_are_never_scaled(self):
        deep = picture()[:, :, 0].astype(np.uint16) * 200
        assert refusal(tiff(deep)) == "unsupported_samples"
        assert refusal(encoded(deep, "PNG")) == "unsupported_samples"
        assert refusal(tiff(deep.astype(np.float32))) == "unsupported_samples"
        assert refusal(tiff(picture()[:, :, 0].astype(np.int8))) == "unsupported_samples"

    def test_advice_comes_with_the_refusal(self):
        with pytest.raises(UnusableFrame, match="gdal_translate"):
            decode(tiff(picture()[:, :, 0].astype(np.uint16)), max_pixels=LIMIT)

    def test_cmyk(self):
        image = Image.fromarray(picture()).convert("CMYK")
        assert refusal(encoded(image)) == "unsupported_samples"
        assert refusal(encoded(image, "TIFF")) == "unsupported_samples"

    def test_many_bands(self):
        assert refusal(tiff(np.dstack([picture(), picture()]), photometric="MINISBLACK")) == "unsupported_samples"

    def test_twelve_bit_and_lossless_jpeg_by_their_headers(self):
        data = encoded(picture())
        at = data.index(b"\xff\xc0")
        assert refusal(data[: at + 4] + b"\x0c" + data[at + 5 :]) == "unsupported_samples"
        assert refusal(data[: at + 1] + b"\xc3" + data[at + 2 :]) == "unsupported_samples"

    def test_multi_page(self):
        pages = [Image.fromarray(picture(seed=seed)) for seed in (1, 2, 3)]
        assert refusal(encoded(pages[0], "TIFF", save_all=True, append_images=pages[1:])) == "multi_page"
        assert refusal(encoded(pages[0], "PNG", save_all=True, append_images=pages[1:])) == "multi_page"

    def test_directories_in_a_circle(self):
        data = bytearray(encoded(picture(), "TIFF"))
        at = int.from_bytes(data[4:8], "little")
        after = at + 2 + 12 * int.from_bytes(data[at : at + 2], "little")
        data[after : after + 4] = at.to_bytes(4, "little")
        assert refusal(bytes(data)) == "malformed"

    def test_flipped_bits_in_png_are_found(self):
        data = encoded(picture(), "PNG")
        rng = np.random.default_rng(5)
        for at in rng.integers(45, len(data) - 16, 40):
            damaged = bytearray(data)
            damaged[at] ^= 16
            assert refusal(bytes(damaged)) in {"malformed", "truncated"}

    @pytest.mark.parametrize("name", ["jpeg", "png", "tiff", "tiff lzw", "tiff deflate tiled", "tiff big"])
    def test_any_damage_gives_pixels_or_a_typed_refusal(self, name):
        data = encoded(picture()) if name == "jpeg" else LOSSLESS[name](picture())
        rng = np.random.default_rng(11)
        for _ in range(120):
            damaged = bytearray(data)
            for at in rng.integers(0, [400, len(data)][rng.integers(2)], 4):
                damaged[at] = rng.integers(256)
            outcome = outcome_of(bytes(damaged))
            if isinstance(outcome, UnusableFrame):
                assert outcome.reason.replace("_", "").isalpha()
                assert "/vsimem" not in outcome.detail
            else:
                assert outcome.pixels.shape == (outcome.height_px, outcome.width_px, 3)
                assert outcome.pixels.dtype == np.uint8
