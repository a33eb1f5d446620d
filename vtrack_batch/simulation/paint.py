"""Painting vehicles and their shadows into an image, anti-aliased by supersampling, at sub-pixel places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from vtrack_batch.model.homography import Array
from vtrack_batch.simulation.fleet import Looks

SUB = 5
"""Sub-samples per pixel and axis."""
SHADOW_RATIO = np.array([0.46, 0.48, 0.52])
"""What is left of the ground's red, green and blue in shadow: the sky still lights it, a little bluish."""

TRAM, PERSON = 4, 5
"""Kinds of body beside those of the fleet."""

_COL, _ROW, _A11, _A12, _A21, _A22, _L, _W, _DU, _DV, _KIND, _R, _BODY_R, _GLASS, _SUN_U, _SUN_V, _LIGHT = (
    0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 14, 17, 18, 19, 20,
)  # fmt: skip


@dataclass(frozen=True)
class Sun:
    """``away_m`` (2,): ground shift of a shadow per metre of height; ``towards`` (2,): unit vector to the sun."""

    away_m: Array
    towards: Array


def sun(azimuth_deg: float, elevation_deg: float) -> Sun:
    """Return the sun as seen from the ground, from its compass direction and height."""
    a = np.deg2rad(azimuth_deg)
    towards = np.array([np.sin(a), np.cos(a)])
    return Sun(-towards / np.tan(np.deg2rad(elevation_deg)), towards)


def sprites(looks: Looks, *, centre_px: Array, axes_px: Array, forward: Array, light: Sun) -> Array:
    """Return what the painters need of n vehicles, (n, 21) float64.

    ``centre_px`` (n, 2); ``axes_px`` (n, 2, 2), columns = image of one metre forward and one metre to the left;
    ``forward`` (n, 2) unit vector of the body on the ground.
    """
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    table = np.zeros((len(forward), 21))
    table[:, :2] = centre_px
    table[:, _A11 : _A22 + 1] = axes_px.reshape(-1, 4)
    table[:, _L], table[:, _W], table[:, _KIND] = looks.length_m, looks.width_m, looks.kind
    table[:, _DU] = forward @ light.away_m * looks.height_m
    table[:, _DV] = left @ light.away_m * looks.height_m
    table[:, _R : _R + 3], table[:, _BODY_R : _BODY_R + 3] = looks.paint_rgb, looks.body_rgb
    table[:, _GLASS] = looks.glass
    table[:, _SUN_U], table[:, _SUN_V] = forward @ light.towards, left @ light.towards
    table[:, _LIGHT] = 1.0
    return table


def dimmed(table: Array, light: Array) -> Array:
    """Return the painter's *table* with the sun on each vehicle reduced to the share *light* (n,)."""
    table = table.copy()
    table[:, _LIGHT] = light
    return table


def moved_up(table: Array, rows: float) -> Array:
    """Return the painter's *table* for an image that begins *rows* lower."""
    table = table.copy()
    table[:, _ROW] -= rows
    return table


def body_points(table: Array, across: int = 9, aside: int = 5) -> Array:
    """Return pixels (n, k, 2) all over each body of the painter's *table*: its centre first, a corner last."""
    u, v = np.meshgrid(np.linspace(-0.47, 0.47, across), np.linspace(-0.45, 0.45, aside))
    along = table[:, _L, None] * np.append(0.0, u)
    side = table[:, _W, None] * np.append(0.0, v)
    col = table[:, _COL, None] + table[:, _A11, None] * along + table[:, _A12, None] * side
    row = table[:, _ROW, None] + table[:, _A21, None] * along + table[:, _A22, None] * side
    return np.stack([col, row], axis=2)


def brightened(table: Array, gain: Array) -> Array:
    """Return the painter's *table* with the paint of each vehicle multiplied by *gain* (n,)."""
    table = table.copy()
    table[:, _R : _BODY_R + 3] *= gain[:, None]
    return table


@njit(cache=True, nogil=True)
def cast_shadows(shade, table):  # type: ignore[no-untyped-def]
    """Raise ``shade`` (H, W) float32, the share of each pixel in shadow, by the shadows of the vehicles in *table*."""
    for sprite in table:
        _cover(shade, sprite)


@njit(cache=True, nogil=True)
def paint_vehicles(image, table):  # type: ignore[no-untyped-def]
    """Paint the bodies of the vehicles in *table* over ``image`` (H, W, 3) float32."""
    colour = np.zeros(3)
    for sprite in table:
        top, bottom, first, last = _bounds(sprite, image.shape[0], image.shape[1], 0.0, 0.0)
        b = _inverse(sprite)
        for row in range(top, bottom):
            for col in range(first, last):
                hits = 0
                red, green, blue = 0.0, 0.0, 0.0
                for k in range(SUB * SUB):
                    x = col + (k % SUB + 0.5) / SUB - 0.5 - sprite[_COL]
                    y = row + (k // SUB + 0.5) / SUB - 0.5 - sprite[_ROW]
                    u, v = b[0] * x + b[1] * y, b[2] * x + b[3] * y
                    if _in_body(u, v, sprite):
                        body_colour(u, v, sprite, colour)
                        hits += 1
                        red += colour[0]
                        green += colour[1]
                        blue += colour[2]
                if hits:
                    rest = 1.0 - hits / (SUB * SUB)
                    image[row, col, 0] = image[row, col, 0] * rest + red / (SUB * SUB)
                    image[row, col, 1] = image[row, col, 1] * rest + green / (SUB * SUB)
                    image[row, col, 2] = image[row, col, 2] * rest + blue / (SUB * SUB)


@njit(cache=True, nogil=True)
def mean_colours(table):  # type: ignore[no-untyped-def]
    """Return the mean colour (n, 3) of the bodies in *table* as painted."""
    result = np.zeros((len(table), 3))
    colour = np.zeros(3)
    for i in range(len(table)):
        hits = 0
        for k in range(40 * 16):
            u = ((k % 40 + 0.5) / 40 - 0.5) * table[i, _L]
            v = ((k // 40 + 0.5) / 16 - 0.5) * table[i, _W]
            if _in_body(u, v, table[i]):
                body_colour(u, v, table[i], colour)
                result[i] += colour
                hits += 1
        result[i] /= hits
    return result


@njit(cache=True, nogil=True)
def _cover(shade, sprite):  # type: ignore[no-untyped-def]
    """Cover the ground from a body's foot print to where the shadow of its roof falls."""
    du, dv = sprite[_DU], sprite[_DV]
    top, bottom, first, last = _bounds(sprite, shade.shape[0], shade.shape[1], du, dv)
    b = _inverse(sprite)
    for row in range(top, bottom):
        for col in range(first, last):
            hits = 0
            for k in range(SUB * SUB):
                x = col + (k % SUB + 0.5) / SUB - 0.5 - sprite[_COL]
                y = row + (k // SUB + 0.5) / SUB - 0.5 - sprite[_ROW]
                u, v = b[0] * x + b[1] * y, b[2] * x + b[3] * y
                if _in_swept(u, v, du, dv, sprite[_L] / 2, sprite[_W] / 2):
                    hits += 1
            if hits:
                shade[row, col] = max(shade[row, col], hits / (SUB * SUB))


@njit(cache=True, nogil=True)
def _in_swept(u, v, du, dv, half_l, half_w):  # type: ignore[no-untyped-def]
    """Return whether the line from (u, v) back along the shadow meets the rectangle (slab test)."""
    low, high = 0.0, 1.0
    for p, d, half in ((u, du, half_l), (v, dv, half_w)):
        if abs(d) < 1e-9:
            if abs(p) > half:
                return False
        else:
            t1, t2 = (p - half) / d, (p + half) / d
            low, high = max(low, min(t1, t2)), min(high, max(t1, t2))
    return low <= high


@njit(cache=True, nogil=True)
def _bounds(sprite, height, width, du, dv):  # type: ignore[no-untyped-def]
    """Return rows and columns that body and shadow may touch, clipped to the image."""
    left, right, up, down = 1e9, -1e9, 1e9, -1e9
    for k in range(8):
        u = (0.5 if k & 1 else -0.5) * sprite[_L] + (du if k & 4 else 0.0)
        v = (0.5 if k & 2 else -0.5) * sprite[_W] + (dv if k & 4 else 0.0)
        x = sprite[_COL] + sprite[_A11] * u + sprite[_A12] * v
        y = sprite[_ROW] + sprite[_A21] * u + sprite[_A22] * v
        left, right, up, down = min(left, x), max(right, x), min(up, y), max(down, y)
    top, bottom = max(0, int(np.floor(up)) - 1), min(height, int(np.ceil(down)) + 2)
    first, last = max(0, int(np.floor(left)) - 1), min(width, int(np.ceil(right)) + 2)
    return top, bottom, first, last


@njit(cache=True, nogil=True)
def _inverse(sprite):  # type: ignore[no-untyped-def]
    det = sprite[_A11] * sprite[_A22] - sprite[_A12] * sprite[_A21]
    return sprite[_A22] / det, -sprite[_A12] / det, -sprite[_A21] / det, sprite[_A11] / det


@njit(cache=True, nogil=True)
def _in_body(u, v, sprite):  # type: ignore[no-untyped-def]
    """Return whether (u, v), metres forward and left of the centre, lies in the rounded rectangle of the body."""
    radius = 0.55 if sprite[_KIND] < 1.5 else 0.2
    if sprite[_KIND] == PERSON:
        radius = sprite[_L] / 2
    du = abs(u) - sprite[_L] / 2 + radius
    dv = abs(v) - sprite[_W] / 2 + radius
    if du > 0.0 and dv > 0.0:
        return du * du + dv * dv <= radius * radius
    return du <= radius and dv <= radius


@njit(cache=True, nogil=True)
def body_colour(u, v, sprite, out):  # type: ignore[no-untyped-def]
    """Write into *out* (3,) the colour of a body at (u, v): roof, glass, bonnet, box and edges in sun or shade."""
    kind = int(sprite[_KIND])
    f = u / sprite[_L] + 0.5
    side = 2 * v / sprite[_W]
    g = abs(side)
    gain, paint, glass = 1.0, _R, False
    if kind == 0:
        glass = (0.585 < f < 0.715 and g < 0.82) or (0.13 < f < 0.22 and g < 0.78)
        if 0.24 < f < 0.60:
            gain = 0.55 if 0.80 < g < 0.92 else 1.06
        elif f > 0.72:
            gain = 0.97
    elif kind == 1:
        glass = 0.80 < f < 0.89 and g < 0.85
        gain = 1.04 if f < 0.8 else 0.96
    elif kind == 2:
        if f < 0.765:
            paint = _BODY_R
            gain = 1.0 if int(f * sprite[_L] / 1.1) % 2 else 0.97
        elif f < 0.79:
            gain = 0.3
        glass = 0.945 < f < 0.985 and g < 0.9
    elif kind == TRAM:
        # roof equipment on the middle of each section, bellows at its ends
        gain = 0.72 if (0.2 < f < 0.42 or 0.55 < f < 0.8) and g < 0.6 else 1.0
        if f < 0.04 or f > 0.96:
            gain = 0.35
    elif kind == PERSON:
        # a dark head over the shoulders
        gain = 0.45 if (f - 0.5) ** 2 + (side / 2) ** 2 < 0.07 else 1.0
    else:
        glass = f > 0.965 and g < 0.9
        gain = 0.75 if (0.24 < f < 0.30 or 0.64 < f < 0.70) and g < 0.45 else 1.02
    if f < 0.03 or f > 0.97:
        gain *= 0.82
    if g > 0.86:
        gain *= 1.0 + (0.10 if side * sprite[_SUN_V] > 0.0 else -0.22) * abs(sprite[_SUN_V])
    gain *= 1.0 + 0.05 * sprite[_SUN_U] * (2 * f - 1) + 0.04 * sprite[_SUN_V] * side
    for c in range(3):
        if glass:
            out[c] = sprite[_LIGHT] * sprite[_GLASS] * (36.0 + 7.0 * c)
        else:
            out[c] = sprite[_LIGHT] * min(252.0, gain * sprite[paint + c])
