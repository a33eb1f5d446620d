"""Coordinate reference systems: which may be computed in, and how points get from one to another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError

from vtrack_batch.errors import ConfigError


def projected_crs(text: str) -> str:
    """Return the name of the projected metric CRS that *text* (authority code, WKT or PROJ) means.

    The name is ``authority:code`` where there is one, else WKT. Raises `ValueError` saying what is wrong and what to
    give instead.
    """
    crs = _parsed(text)
    if crs.is_geographic:
        raise ValueError(
            f"{crs.name} is in degrees, in which nothing can be measured; give a projected CRS in metres, "
            "such as the UTM zone of the place (EPSG:32601-32660 north, EPSG:32701-32760 south)"
        )
    if not crs.is_projected:
        raise ValueError(f"{crs.name} is not a projected CRS; give one in metres, such as EPSG:26913")
    units = {axis.unit_name for axis in crs.axis_info[:2]}
    if units != {"metre"}:
        raise ValueError(f"{crs.name} is in {' and '.join(sorted(units))}; give a projected CRS in metres")
    return _name(crs)


def is_projected_metric(text: str) -> bool:
    """Say whether results can be computed in the CRS *text*."""
    try:
        projected_crs(text)
    except ValueError:
        return False
    return True


def same_crs(one: str, other: str) -> bool:
    """Say whether two texts mean the same CRS, whatever the order of axes they declare."""
    return bool(_parsed(one).equals(_parsed(other), ignore_axis_order=True))


def transformed(xy: NDArray[np.float64], source: str, target: str) -> NDArray[np.float64]:
    """Return the points *xy* (n, 2), x before y whatever the CRS declares, moved from *source* to *target*.

    Raises `ConfigError` where the transformation is not defined there.
    """
    moved = Transformer.from_crs(_parsed(source), _parsed(target), always_xy=True).transform(xy[:, 0], xy[:, 1])
    result = np.column_stack(moved)
    if not np.isfinite(result).all():
        raise ConfigError(f"the frame lies where {target} is not defined; choose a CRS for the place")
    return result


def utm_crs(xy: NDArray[np.float64], source: str) -> str:
    """Return the UTM zone (``EPSG:32601`` ...) in which the point *xy* (2,) of the CRS *source* lies."""
    longitude, latitude = transformed(xy.reshape(1, 2), source, "EPSG:4326")[0]
    zone = int((longitude + 180) // 6) % 60 + 1
    return f"EPSG:{32600 + zone if latitude >= 0 else 32700 + zone}"


def crs_title(text: str) -> str:
    """Return what people call the CRS *text*."""
    return str(_parsed(text).name)


def _name(crs: CRS) -> str:
    authority = crs.to_authority(min_confidence=70)
    return ":".join(authority) if authority else str(crs.to_wkt())


def _parsed(text: str) -> CRS:
    try:
        crs = CRS.from_user_input(text)
    except CRSError:
        raise ValueError(f"{text!r} is not a coordinate reference system; give a code such as EPSG:26913") from None
    return crs.sub_crs_list[0] if crs.is_compound else crs
