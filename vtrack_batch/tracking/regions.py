"""Region tracking: a master list of regions, each predicted by two Kalman filters, matched frame by frame.

Source: J. Badenas, J. M. Sanchiz and F. Pla, "Using Temporal Integration for Tracking Regions in Traffic Monitoring
Sequences" (ICPR 2000), sections 2 and 3: constant jerk per axis (eq. 5-8), place and, where the detector tells it,
velocity measured (eq. 12-14); unmatched regions enter the list, regions unmatched for several frames leave it. A
measurement off its prediction by more than two standard deviations is drawn to that bound: u_hat -+ 2 sigma, where the
paper prints u -+ 2 sigma, which would push it farther out. Two listed regions never take one region: the nearer has it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vtrack_batch.matching.candidates import Edges, candidates
from vtrack_batch.matching.decision import mutual
from vtrack_batch.matching.params import RegionParams
from vtrack_batch.matching.regions import Features, expected, features_of, region_labels
from vtrack_batch.matching.relaxation import Labels
from vtrack_batch.matching.vehicles import measured_velocity
from vtrack_batch.tracking.link import Chains
from vtrack_batch.tracking.params import RegionTrackParams, TrackingParams
from vtrack_batch.tracking.sightings import Array, Index, Sightings


@dataclass
class MasterList:
    """Regions that are followed.

    ``mean`` (n, 2, 4) place, velocity, acceleration, jerk of both axes; ``cov`` (n, 4, 4) of either axis; ``last``
    (n,) the newest sighting, ``grey`` (n,) its running mean, ``missed`` (n,) frames since.
    """

    mean: Array
    cov: Array
    last: Index
    grey: Array
    missed: Index

    def select(self, keep: NDArray[np.bool_]) -> MasterList:
        """Return the regions picked by a mask."""
        return MasterList(self.mean[keep], self.cov[keep], self.last[keep], self.grey[keep], self.missed[keep])

    def joined(self, new: MasterList) -> MasterList:
        """Return this list with *new* regions behind."""
        return MasterList(
            np.concatenate([self.mean, new.mean]),
            np.concatenate([self.cov, new.cov]),
            np.concatenate([self.last, new.last]),
            np.concatenate([self.grey, new.grey]),
            np.concatenate([self.missed, new.missed]),
        )


def chain_regions(s: Sightings, matching: RegionParams, params: TrackingParams) -> Chains:
    """Return the chains of one sequence, frame by frame, without looking ahead."""
    own = params.regions
    values = features_of(s.xy, s.rgb, measured_velocity(s.rows))
    chains = Chains(np.full(len(s), -1), np.full(len(s), -1), np.ones(len(s)), np.ones(len(s)))
    listed, before_s = _new(np.zeros(0, np.int64), values, s.sigma_m, own), 0.0
    for f, now_s in enumerate(s.frame_s):
        rows = np.arange(s.first[f], s.first[f + 1])
        listed = predicted(listed, float(now_s) - before_s, own)
        edges, labels = _compared(listed, values[rows], s.sigma_m[rows], matching, params)
        picked = mutual(edges, labels)
        i, k = edges.i[picked], rows[edges.k[picked]]
        just = listed.missed == 0
        chains.probability[listed.last[just]] = labels.p_none[just]
        chains.none_before[rows] = labels.q_none
        chains.after[listed.last[i]], chains.before[k] = k, listed.last[i]
        chains.probability[listed.last[i]] = labels.p[picked]
        _correct(listed, i, values[k], s.sigma_m[k], own)
        listed.missed += 1
        listed.last[i], listed.missed[i] = k, 0
        stays = (listed.missed <= own.forget_frames) | (now_s - s.t[listed.last] <= own.forget_s)
        listed = listed.select(stays).joined(_new(np.setdiff1d(rows, k), values, s.sigma_m, own))
        before_s = float(now_s)
    return chains


def predicted(listed: MasterList, dt_s: float, params: RegionTrackParams) -> MasterList:
    """Return the list *dt_s* later (eq. 5-8, 10): constant jerk, and the noise of a snap that is white."""
    step, noise = motion_model(dt_s, params.snap_density)
    return MasterList(listed.mean @ step.T, step @ listed.cov @ step.T + noise, listed.last, listed.grey, listed.missed)


def motion_model(dt_s: float, snap_density: float) -> tuple[Array, Array]:
    """Return the transition matrix (4, 4) of constant jerk (eq. 13, for any time step) and its process noise (4, 4)."""
    power = np.arange(4)[None, :] - np.arange(4)[:, None]
    factorial = np.array([1.0, 1.0, 2.0, 6.0])
    step = np.where(power >= 0, dt_s ** np.maximum(power, 0) / factorial[np.maximum(power, 0)], 0.0)
    left = 3 - np.arange(4)
    total = left[:, None] + left[None, :] + 1
    noise = snap_density * dt_s**total / (factorial[left][:, None] * factorial[left][None, :] * total)
    return step, noise


def clamped(measured: Array, expected_at: Array, sigma: Array, sigmas: float) -> Array:
    """Return measurements drawn to within *sigmas* of what was expected: gross errors disturb no more than that."""
    return np.asarray(np.clip(measured, expected_at - sigmas * sigma, expected_at + sigmas * sigma))


def _compared(
    listed: MasterList, values: Array, sigma: Array, matching: RegionParams, params: TrackingParams
) -> tuple[Edges, Labels]:
    """Compare the predicted list with the regions of one frame, those within reach of each."""
    own, variance = params.regions, listed.cov[:, 0, 0]
    noise = float(np.median(sigma)) ** 2 if len(sigma) else 0.0
    reach = np.minimum(own.gate_sigmas * np.sqrt(variance + noise), own.gate_max_m)
    edges = candidates(listed.mean[:, :, 0], values[:, :2], float(reach.max(initial=0.0)))
    edges = edges.select(np.hypot(*edges.displacement.T) <= reach[edges.i])
    velocity = listed.mean[:, :, 1].copy()
    velocity[listed.cov[:, 1, 1] > (0.5 * own.start_speed_mps) ** 2] = np.nan  # not known yet
    spread = np.sqrt(np.median(variance) + noise) if len(listed.last) else 1.0
    first, floor = expected(float(spread), own.speed_sigma_mps, matching)
    features = Features(np.column_stack([listed.mean[:, :, 0], listed.grey, velocity]), first, floor)
    return edges, region_labels(edges, features, values, matching)


def _correct(listed: MasterList, i: Index, seen: Array, sigma: Array, own: RegionTrackParams) -> None:
    """Kalman update of the regions *i* by what was *seen* of them (n, 5), gross errors clamped; in place."""
    mean, cov = listed.mean[i], listed.cov[i]
    noise = np.column_stack([sigma**2, np.full(len(i), own.speed_sigma_mps**2)])
    measured = np.stack([seen[:, :2], seen[:, 3:]], axis=2)  # (n, axis, place or velocity)
    error = np.sqrt(np.einsum("nhh->nh", cov[:, :2, :2]) + noise)[:, None, :]
    measured = clamped(measured, mean[:, :, :2], error, own.clamp_sigmas)
    for h in range(2):
        known = np.asarray(np.isfinite(measured[:, :, h]).all(axis=1))
        gain = cov[:, :, h] / (cov[:, h, h] + noise[:, h])[:, None] * known[:, None]
        residual = np.where(known[:, None], measured[:, :, h] - mean[:, :, h], 0.0)
        mean = mean + residual[:, :, None] * gain[:, None, :]
        cov = cov - gain[:, :, None] * cov[:, None, h, :]
    listed.mean[i], listed.cov[i] = mean, 0.5 * (cov + cov.transpose(0, 2, 1))
    listed.grey[i] = np.where(
        np.isfinite(seen[:, 2]), listed.grey[i] + own.grey_gain * (seen[:, 2] - listed.grey[i]), listed.grey[i]
    )


def _new(rows: Index, values: Array, sigma: Array, own: RegionTrackParams) -> MasterList:
    """Return list entries for the regions *rows*: at rest where no velocity was measured, and little sure of it."""
    seen, moving = values[rows], np.asarray(np.isfinite(values[rows, 3:]).all(axis=1))
    mean, cov = np.zeros((len(rows), 2, 4)), np.zeros((len(rows), 4, 4))
    mean[:, :, 0], mean[:, :, 1] = seen[:, :2], np.where(moving[:, None], seen[:, 3:], 0.0)
    cov[:, 0, 0] = sigma[rows] ** 2
    cov[:, 1, 1] = np.where(moving, own.speed_sigma_mps, own.start_speed_mps) ** 2
    cov[:, 2, 2], cov[:, 3, 3] = own.start_accel_mps2**2, own.start_jerk_mps3**2
    return MasterList(mean, cov, rows.copy(), seen[:, 2].copy(), np.zeros(len(rows), np.int64))
