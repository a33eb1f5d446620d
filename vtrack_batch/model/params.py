"""Parameters: frozen, typed, documented beside the algorithm that reads them, and closed to strangers."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Params(BaseModel):
    """Base of every chapter's parameters: immutable, refuses unknown keys and NaN."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True)
