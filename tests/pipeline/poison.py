"""Work that some frames are the end of: what an attacker's file or a decoder's bug would do, done on purpose."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial
from typing import Any
from unittest import mock

from vtrack_batch.pipeline import reading
from vtrack_batch.pipeline.parts import Context
from vtrack_batch.pipeline.plan import Piece
from vtrack_batch.pipeline.workers import Work


def _hoard() -> None:
    hoard = []
    while True:
        hoard.append(bytearray(64 << 20))


HARM: dict[str, Callable[[], object]] = {
    "abort": os.abort,
    "hang": partial(time.sleep, 600),
    "memory": _hoard,
    "exit": partial(os._exit, 0),
}


def poisoned(harms: dict[bytes, str], work: Work, piece: Piece, context: Context) -> None:
    """Do *work* on a unit; decoding a frame of one of these contents does its harm."""
    real = reading.decode

    def decode(data: bytes, **options: Any) -> Any:
        if data in harms:
            HARM[harms[data]]()
        return real(data, **options)

    with mock.patch.object(reading, "decode", decode):
        work(piece, context)
