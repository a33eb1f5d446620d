"""What colour says before any motion is looked at: the paper's initial probabilities, and a likelihood ratio."""

from __future__ import annotations

import numpy as np
from numba import njit

from vtrack_batch.matching.candidates import Array, Edges, Index, bell
from vtrack_batch.matching.params import ColourParams
from vtrack_batch.matching.relaxation import Labels

NO_MATCH_DISTANCE = 3 * (255.0 / 3) ** 2
"""Expected squared colour distance of no match (Fuse & Shimizu, eq. 8)."""
FLOOR = 1e-6
"""Least initial probability of a candidate: the updates multiply, so that nothing returns from exactly zero."""
FARTHEST = 80.0
"""Squared distance, in standard deviations, from which on a colour adds nothing to a density."""


def equal_labels(edges: Edges) -> Labels:
    """Start with equal probabilities, no match included: 1 / (L + 1), methods (a) and (c)."""
    labels_i = np.bincount(edges.i, minlength=edges.n) + 1.0
    labels_k = np.bincount(edges.k, minlength=edges.m) + 1.0
    return Labels(1 / labels_i[edges.i], 1 / labels_k[edges.k], 1 / labels_i, 1 / labels_k)


def colour_labels(edges: Edges, earlier_rgb: Array, later_rgb: Array) -> Labels:
    """Start with the paper's colour probabilities (eq. 7-11), methods (b) and (d); colours (n, 3), (m, 3) in 0-255."""
    distance = ((earlier_rgb[edges.i] - later_rgb[edges.k]) ** 2).sum(axis=1)
    p, p_none = _complement(distance, edges.i, edges.n)
    q, q_none = _complement(distance, edges.k, edges.m)
    return Labels(p, q, p_none, q_none)


def _complement(distance: Array, owner: Index, size: int) -> tuple[Array, Array]:
    """Eq. 9-11: one minus the share of the distance, shared among the L + 1 labels; certain no match where L = 0."""
    total = np.bincount(owner, weights=distance, minlength=size) + NO_MATCH_DISTANCE
    count = np.bincount(owner, minlength=size)
    some = np.maximum(count, 1)
    none = np.where(count == 0, 1.0, (1 - NO_MATCH_DISTANCE / total) / some)
    p = (1 - distance / total[owner]) / some[owner]
    return np.maximum(p, FLOOR), np.maximum(none, FLOOR)


class Paint:
    """Likelihood ratio of "one vehicle" against "two at random", given how colours are spread in the place.

    Red beside red says much, white beside white little: the density of *population* (s, 3) RGB says which is which.
    """

    def __init__(self, population_rgb: Array, params: ColourParams, *, sample: int = 256) -> None:
        every = max(1, len(population_rgb) // sample)
        # sorted, so that the sample does not depend on the order of rows
        ordered = population_rgb[np.lexsort(population_rgb.T)] if len(population_rgb) else np.zeros((1, 3))
        self._sampled = ordered[::every]
        self._population = opponent(self._sampled)
        self.params = params
        clean, outlier = np.log1p(-params.outlier_share) - 1.5 * np.log(2 * np.pi), np.log(params.outlier_share)
        self.noise = np.array(
            [params.brightness_sigma, params.gain_sigma, params.chroma_sigma, params.outlier_share, clean, outlier]
        )
        """What ``log_same_paint`` needs to know of the noise."""

    def under(self, params: ColourParams) -> Paint:
        """Return the same population judged under other spreads."""
        return Paint(self._sampled, params, sample=len(self._sampled))

    def log_density(self, rgb: Array) -> Array:
        """Return the log density (n,) of the colours *rgb* (n, 3) in the population, in opponent axes."""
        return np.asarray(_log_mixture(opponent(rgb), self._population, self.noise))

    def log_ratio(self, first_rgb: Array, second_rgb: Array, log_random: Array) -> Array:
        """Return log p(same) / p(random) (n,) of pairs of colours, each of one sighting; symmetric.

        *log_random* (n,) is half the sum of their log densities in the population.
        """
        return np.asarray(_log_ratios(opponent(first_rgb), opponent(second_rgb), log_random, self.noise))


def opponent(rgb: Array) -> Array:
    """Return brightness, R - G and (R + G) / 2 - B, (n, 3): the axes in which light and paint vary apart."""
    r, g, b = np.asarray(rgb, float).reshape(-1, 3).T
    return np.column_stack([(r + g + b) / 3, r - g, (r + g) / 2 - b])


def learned_noise(first_rgb: Array, second_rgb: Array, params: ColourParams) -> ColourParams:
    """Return *params* with the spreads that pairs of colours (n, 3) of the same vehicles show, robustly.

    Brightness and chroma are scaled apart, by the median of their differences in units of the assumed spread; a few
    pairs move the assumption little, many replace it.
    """
    first, second = opponent(first_rgb), opponent(second_rgb)
    off = np.abs(first - second) / np.sqrt(2)
    brightness = 0.5 * (first[:, 0] + second[:, 0])
    light = _spread(off[:, 0] / np.hypot(params.brightness_sigma, params.gain_sigma * brightness))
    chroma = _spread(off[:, 1:].ravel() / params.chroma_sigma)
    return params.model_copy(
        update={
            "brightness_sigma": params.brightness_sigma * light,
            "gain_sigma": params.gain_sigma * light,
            "chroma_sigma": params.chroma_sigma * chroma,
        }
    )


def _spread(ratios: Array, assumed: float = 20.0) -> float:
    """Return the standard deviation that the median of absolute values tells, drawn to 1 as if by *assumed* values."""
    if not len(ratios):
        return 1.0
    found = max(float(np.median(ratios)) / 0.6745, 0.5)
    share = len(ratios) / (len(ratios) + assumed)
    return float(np.exp(share * np.log(found)))


@njit(cache=True, nogil=True)
def log_same_paint(first, a, second, b, variance, log_random, noise):  # type: ignore[no-untyped-def]
    """Log-likelihood ratio of the mean colours ``first[a]`` and ``second[b]``, opponent axes, being one vehicle's.

    *variance* is that of their difference in units of one sighting's: 1 / n_first + 1 / n_second.
    """
    brightness = 0.5 * (first[a, 0] + second[b, 0])
    v_light = (noise[0] ** 2 + (noise[1] * brightness) ** 2) * variance
    v_chroma = noise[2] ** 2 * variance
    z = (first[a, 0] - second[b, 0]) ** 2 / v_light
    z += ((first[a, 1] - second[b, 1]) ** 2 + (first[a, 2] - second[b, 2]) ** 2) / v_chroma
    log_same = noise[4] - 0.5 * (z + np.log(v_light * v_chroma * v_chroma)) - log_random
    off = log_same - noise[5]
    return max(log_same, noise[5]) + np.log1p(np.exp(-abs(off)))


@njit(cache=True, nogil=True)
def _log_ratios(first, second, log_random, noise):  # type: ignore[no-untyped-def]
    out = np.empty(len(first))
    for n in range(len(first)):
        out[n] = log_same_paint(first, n, second, n, 2.0, log_random[n], noise)
    return out


@njit(cache=True, nogil=True)
def _log_mixture(seen, population, noise):  # type: ignore[no-untyped-def]
    """Log density (n,) of colours *seen* (n, 3) among those of a *population* (s, 3), both in opponent axes."""
    size = len(population)
    light, red, blue = population[:, 0].copy(), population[:, 1].copy(), population[:, 2].copy()
    out, near = np.empty(len(seen)), np.zeros(size + 4)
    per_chroma = 1 / (2 * noise[2] ** 2)
    for n in range(len(seen)):
        v_light, (x, y, z) = 2 * (noise[0] ** 2 + (noise[1] * seen[n, 0]) ** 2), seen[n]
        per_light = 1 / v_light
        for s in range(size):
            square = (light[s] - x) ** 2 * per_light + ((red[s] - y) ** 2 + (blue[s] - z) ** 2) * per_chroma
            close = bell(min(square, FARTHEST))
            near[s] = close if square < FARTHEST else 0.0
        sums = (0.0, 0.0, 0.0, 0.0)
        for s in range(0, size, 4):  # four sums beside one another need not wait for each other
            sums = (sums[0] + near[s], sums[1] + near[s + 1], sums[2] + near[s + 2], sums[3] + near[s + 3])
        total = 1e-12 + sums[0] + sums[1] + sums[2] + sums[3]
        log_peak = -0.5 * np.log(v_light) + np.log(per_chroma) - 1.5 * np.log(2 * np.pi)
        out[n] = np.log(total / size) + log_peak
    return out
