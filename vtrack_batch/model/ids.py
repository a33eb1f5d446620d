"""Stable ids made from content, never from counters: the same archive gives the same ids in any order of work.

Ids are short texts, because readers turn nullable integer columns into floats and lose the last digits.
"""

from __future__ import annotations

import base64
import hashlib


def frame_id(path: str) -> str:
    """Return the id of the frame at the archive-relative *path*: 12 letters and digits (60 bits of SHA-256)."""
    digest = hashlib.sha256(path.encode("utf-8", "surrogateescape")).digest()
    return base64.b32encode(digest[:8]).decode("ascii").lower()[:12]


def detection_id(of_frame: str, rank: int) -> str:
    """Return the id of the *rank*-th detection (by place, row then column) of the frame with id *of_frame*."""
    return f"{of_frame}-{rank:04d}"


def vehicle_id(first_detection: str) -> str:
    """Return the id of the vehicle whose first sighting is *first_detection*; tracks share no detection."""
    return f"v-{first_detection}"


def match_id(from_detection: str | None, to_detection: str | None) -> str:
    """Return the id of the link between two detections; one side is None where a vehicle appeared or disappeared."""
    return f"{from_detection or ''}>{to_detection or ''}"
