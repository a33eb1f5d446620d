"""Parameters of matching: the paper's A, B, C, T, R, D in metres and seconds, and those of the untrained default."""

from __future__ import annotations

from typing import Literal, get_args

from pydantic import Field

from vtrack_batch.model.params import Params

Method = Literal[
    "default", "untrained", "original", "colour", "opposite", "proposed", "regions", "assignment", "nearest"
]
METHODS: tuple[str, ...] = get_args(Method)
DecisionRule = Literal["method", "argmax", "mutual", "one_to_one", "most_right"]


class RelaxationParams(Params):
    """Constants of the relaxation (Fuse & Shimizu, eq. 15-24); the paper's symbols stand in brackets."""

    a_delay: float = Field(0.5, ge=0, description="[A] delays the suppression of unlikely labels")
    b_neighbours: float = Field(1.0, ge=0, description="[B] weight of the support by neighbours")
    c_opposite: float = Field(1.0, ge=0, description="[C] weight of the same label seen from the other image")
    consistency_mps: float = Field(
        4.4, gt=0, description="[T] displacements agree within this times the interval (20 px of 0.33 m at 1.5 s)"
    )
    consistency_min_m: float = Field(1.0, ge=0, description="[T] is never less than this: noise of four positions")
    max_speed_mps: float = Field(
        33.0, gt=0, description="[D] partners are sought within this times the interval along x and y (150 px)"
    )
    neighbourhood_m: float = Field(66.0, gt=0, description="[R] neighbours are within this distance (200 px)")
    iterations: int = Field(50, ge=0, description="rounds at most")
    stop_change: float = Field(1e-3, ge=0, description="stop when no probability changes by more; 0 = never")

    def consistency_m(self, elapsed_s: float) -> float:
        """Return T for an interval: it grows with time, because differences of speed do."""
        return max(self.consistency_mps * elapsed_s, self.consistency_min_m)


class NeighbourParams(Params):
    """Parameters of the untrained default: what neighbours say about a displacement."""

    spread_mps: float = Field(1.5, gt=0, description="spread of velocities in one stream; times the interval, per axis")
    spread_min_m: float = Field(0.8, gt=0, description="the spread of displacements is never less: noise of positions")
    along_m: float = Field(60.0, gt=0, description="how far along its motion a vehicle has neighbours (Gaussian sigma)")
    across_m: float = Field(8.0, gt=0, description="how far across its motion (Gaussian sigma)")
    prior_weight: float = Field(2.0, gt=0, description="[kappa] weight of the prior, in neighbours")
    rounds: int = Field(8, ge=0, description="rounds of substitution")

    def spread_m(self, elapsed_s: float) -> float:
        """Return the spread of displacements of one stream for an interval."""
        return max(self.spread_mps * elapsed_s, self.spread_min_m)


class ColourParams(Params):
    """How much the paint of one vehicle differs between two sightings (0-255 levels, per sighting)."""

    brightness_sigma: float = Field(6.0, gt=0, description="spread of brightness, additive part")
    gain_sigma: float = Field(0.05, ge=0, description="spread of brightness, as a share of brightness")
    chroma_sigma: float = Field(5.0, gt=0, description="spread of the two colour differences R-G and (R+G)/2-B")
    first_guess: float = Field(
        2.5, ge=1, description="spreads are taken this much wider until the data have told them; 1 = keep them as set"
    )
    outlier_share: float = Field(0.05, gt=0, lt=1, description="share of sightings in shadow, glare or badly cut out")

    def wide(self) -> ColourParams:
        """Return the cautious spreads with which learning them begins."""
        return self.model_copy(
            update={
                "brightness_sigma": self.brightness_sigma * self.first_guess,
                "gain_sigma": self.gain_sigma * self.first_guess,
                "chroma_sigma": self.chroma_sigma * self.first_guess,
            }
        )


class RegionParams(Params):
    """Constants of region matching (Badenas et al.): what differences of features are expected before any match."""

    start_speed_mps: float = Field(10.0, gt=0, description="spread of unknown velocities, per axis")
    grey_sigma: float = Field(12.0, gt=0, description="expected difference of grey, 0-255")
    position_floor_m: float = Field(0.3, gt=0, description="differences of place count as at least this: noise")
    grey_floor: float = Field(3.0, gt=0, description="differences of grey count as at least this, 0-255")
    speed_floor_mps: float = Field(0.5, gt=0, description="differences of velocity count as at least this, per axis")
    cutoff_sigmas: float = Field(10.0, gt=0, description="regions less alike than this, in the mean, never match")
    rounds: int = Field(10, ge=1, description="rounds of matching and weighing at most")


class MatchingParams(Params):
    """Parameters of matching two images."""

    method: Method = Field("default", description="what decides: see the chapter's page")
    max_speed_mps: float = Field(
        50.0, gt=0, description="partners are sought within this times the interval along x and y, but see paper"
    )
    reach_min_m: float = Field(2.0, ge=0, description="partners are sought at least this far")
    model: str | None = Field(
        None,
        description="model of links that the default scores with, made by `calibrate --train`; without it the one that "
        "comes with the program",
    )
    decision: DecisionRule = Field(
        "method",
        description="how labels become links; 'method' = argmax for a, b; mutual for c, d; most right labels for the "
        "default; else one to one",
    )
    paper: RelaxationParams = Field(RelaxationParams(), description="constants of the printed methods (a)-(d)")
    neighbours: NeighbourParams = Field(NeighbourParams(), description="the untrained default")
    colour: ColourParams = Field(ColourParams(), description="paint of one vehicle in two sightings")
    missed_share: float = Field(0.1, gt=0, lt=1, description="prior share of vehicles without a partner")
    standing_share: float = Field(0.1, ge=0, lt=1, description="prior share of vehicles that stand still")
    standing_m: float = Field(0.7, gt=0, description="spread of the displacement of standing vehicles, per axis")
    regions: RegionParams = Field(RegionParams(), description="region matching")
    max_candidate_pairs: int = Field(
        20_000_000, gt=0, description="more candidate pairs than this between two images is refused"
    )

    def reach_m(self, elapsed_s: float, *, printed: bool = False) -> float:
        """Return half the side of the box in which partners are sought; *printed*: D of the methods (a)-(d)."""
        speed = self.paper.max_speed_mps if printed else self.max_speed_mps
        return max(speed * elapsed_s, self.reach_min_m)
