"""Frames are straightened where plane poses do not fit a block, and left alone where they do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from registration_scenes import COLUMNS, ROWS, motion, view, wave

from vtrack_batch.model import homography
from vtrack_batch.pipeline.laying import lay_samples
from vtrack_batch.registration.alignment import register
from vtrack_batch.registration.params import RegistrationParams
from vtrack_batch.registration.reference import prepare_reference

PARAMS = RegistrationParams()
GRID = np.stack(np.meshgrid(np.arange(30.0, COLUMNS - 30, 16), np.arange(30.0, ROWS - 30, 16)), axis=-1).reshape(-1, 2)
SIZES = (-3.0, -2.0, -1.2, 1.2, 2.0, 3.0)


def block(bent, params=PARAMS):
    """Return the samples of a block, straight or *bent*, laid on the reference, and how it lays others."""
    frames = [
        view(motion(shift=(3.0 * size, 2.0)), wave(size if bent else 0.0), seed=n) for n, size in enumerate(SIZES, 2)
    ]
    reference = view()
    rough = prepare_reference(reference, params=params)
    laid = [register(frame, rough, params=params) for frame in frames]
    return lay_samples([reference, *frames], laid, rough, keep=lambda pixels: pixels, params=params), frames


def off_px(laid, size):
    """Return the error of a frame's ground over the whole frame."""
    shift, seen = wave(size), GRID + wave(size)(GRID)
    # A bent frame shows at p what the straight one shows at p - shift(p): go back to find p.
    for _ in range(20):
        seen = GRID + shift(seen)
    straight = seen if laid.bend is None else laid.bend.to_straight(seen)
    true = homography.apply(motion(shift=(3.0 * size, 2.0)), GRID)
    error = homography.apply(laid.registration.frame_to_reference, straight) - true
    return float(np.sqrt((error**2).sum(axis=1).mean()))


def test_a_block_that_fits_is_left_as_it_is():
    (samples, references), frames = block(bent=False)
    assert references.picture is None
    assert all(sample.pixels is frame for sample, frame in zip(samples[1:], frames, strict=True))
    laid = references.lay(frames[0], PARAMS)
    assert laid.bend is None
    assert laid.pixels is frames[0]
    assert 0.0 < laid.registration.residual_px < 0.15


def test_a_block_that_bends_is_straightened():
    (samples, references), frames = block(bent=True)
    (_, plane), _ = block(bent=True, params=PARAMS.model_copy(update={"bend": "never"}))
    assert references.picture is not None
    assert plane.picture is None
    assert not any(sample.pixels is frame for sample, frame in zip(samples[1:], frames, strict=True))
    for frame, size in zip(frames, SIZES, strict=True):
        straight, rigid = references.lay(frame, PARAMS), plane.lay(frame, PARAMS)
        assert 0.02 < off_px(straight, size) < 0.6 * off_px(rigid, size)
        assert 0.01 < straight.registration.residual_px < rigid.registration.residual_px


@pytest.mark.parametrize("reason", ["blank", "strange"])
def test_a_frame_that_is_refused_is_not_straightened(reason):
    (_, references), _ = block(bent=True)
    strange = np.random.default_rng(9).integers(0, 255, (ROWS, COLUMNS, 3), dtype=np.uint8)
    frame = np.full_like(strange, 80) if reason == "blank" else strange
    laid = references.lay(frame, PARAMS)
    assert not laid.registration.accepted
    assert laid.bend is None


def test_one_frame_alone_is_its_own_block():
    reference = view()
    rough = prepare_reference(reference, params=PARAMS)
    samples, references = lay_samples([reference], [], rough, keep=lambda pixels: pixels, params=PARAMS)
    assert len(samples) == 1
    assert references.picture is None
    np.testing.assert_array_equal(replace(samples[0]).frame_to_reference, np.eye(3))
