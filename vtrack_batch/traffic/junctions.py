"""The shape of junctions: which arms they have, and what going from one arm to another is called."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from vtrack_batch.model.zones import Zone
from vtrack_batch.traffic.paths import Floats
from vtrack_batch.traffic.places import Place

_THROUGH_DEG, _U_TURN_DEG, _ALIKE_DEG = 45.0, 155.0, 20.0
_SLENDER = 1.5
_PULL = 0.05


@dataclass(frozen=True)
class Junction:
    """A junction: its ``arms`` as indices into the places, its centre (x_m, y_m), and the ``movement`` between arms.

    ``movement[entry, exit]`` is left, through, right, u_turn or ``exit:<id>``, for the pairs of arms that traffic may
    use.
    """

    id: str
    arms: tuple[int, ...]
    centre: tuple[float, float]
    movement: dict[tuple[int, int], str]


def junctions_of(zones: Iterable[Zone], places: Sequence[Place]) -> list[Junction]:
    """Return the junctions named by the places, sorted by id.

    The arms of a junction are the approaches that name it; where there are none, the gates and zones that do.
    Its centre is the property ``junction_centre_m`` of any arm; else where the arms' axes meet.
    """
    given = {
        zone.junction: tuple(map(float, zone.properties["junction_centre_m"]))
        for zone in zones
        if zone.junction is not None and "junction_centre_m" in zone.properties
    }
    out = []
    for name in sorted({place.junction for place in places if place.junction is not None}):
        near = [i for i, place in enumerate(places) if place.junction == name]
        arms = [i for i in near if places[i].role == "approach"]
        arms = arms or [i for i in near if places[i].role in ("gate", "zone")]
        if arms:
            centre = np.array(given[name]) if name in given else axes_meet([places[i] for i in arms])
            movement = _movements([places[i] for i in arms], centre)
            by_place = {(arms[a], arms[b]): label for (a, b), label in movement.items()}
            out.append(Junction(name, tuple(arms), (float(centre[0]), float(centre[1])), by_place))
    return out


def axes_meet(arms: Sequence[Place]) -> Floats:
    """Return the point (2,) nearest, in least squares, to the axes of the arms, weakly pulled to their mean centre.

    The axis of a line is its normal, for it is drawn across its road; that of a slender area is its longer side. The
    mean centre alone would lie beside the junction where arms differ in length or one is missing.
    """
    middles = np.array([place.shape.centroid.coords[0] for place in arms])
    mean = middles.mean(axis=0)
    matrix, target = _PULL * np.eye(2), _PULL * mean
    for place, middle in zip(arms, middles, strict=True):
        axis = _axis(place)
        if axis is not None:
            across = np.eye(2) - np.outer(axis, axis)
            matrix, target = matrix + across, target + across @ middle
    return np.asarray(np.linalg.solve(matrix, target))


def _axis(place: Place) -> Floats | None:
    """Return the unit direction (2,) of the road at an arm, none where its shape does not say."""
    if place.is_line:
        ends = shapely.get_coordinates(place.shape)[[0, -1]]
        along = ends[1] - ends[0]
        return np.array([-along[1], along[0]]) / np.hypot(*along)
    sides = np.diff(shapely.get_coordinates(shapely.minimum_rotated_rectangle(place.shape)), axis=0)[:2]
    length = np.hypot(*sides.T)
    if length.max() < _SLENDER * length.min():
        return None
    return np.asarray(sides[np.argmax(length)] / length.max())


def _movements(arms: Sequence[Place], centre: Floats) -> dict[tuple[int, int], str]:
    """Return the movement of each pair (entry, exit) of arms that traffic may use."""
    out_of = np.array([place.shape.centroid.coords[0] for place in arms]) - centre
    bearing = np.degrees(np.arctan2(out_of[:, 0], out_of[:, 1]))
    exits = [b for b, place in enumerate(arms) if place.traffic != "in"]
    labels = {}
    for a, place in enumerate(arms):
        if place.traffic != "out":
            turn = {b: (bearing[b] - bearing[a]) % 360 - 180 for b in exits if b != a}
            names = _named(turn, [place.id for place in arms])
            labels.update({(a, b): name for b, name in names.items()})
            if a in exits:
                labels[a, a] = "u_turn"
    return labels


def _named(turn_deg: dict[int, float], ids: Sequence[str]) -> dict[int, str]:
    """Name the exits by their turn (0 = straight on, right positive).

    The straightest within 45 degrees is through, and so is any other as straight to 20 degrees; those back along the
    entry are u_turn, the others left or right. Exits that share a name are named by their id instead.
    """
    straightest = min(turn_deg, key=lambda b: (abs(turn_deg[b]), b), default=None)
    names = {}
    for b, turn in turn_deg.items():
        if abs(turn) >= _U_TURN_DEG:
            names[b] = "u_turn"
        elif b == straightest and abs(turn) < _THROUGH_DEG:
            names[b] = "through"
        else:
            names[b] = "left" if turn < 0 else "right"
    if straightest in names and names[straightest] == "through":
        rivals = [b for b in names if b != straightest and _rivals(turn_deg[b], turn_deg[straightest])]
        names.update(dict.fromkeys(rivals, "through"))
    many = Counter(names.values())
    doubtful = {b for b, name in names.items() if name != "u_turn" and many[name] > 1}
    return {b: f"exit:{ids[b]}" if b in doubtful else name for b, name in names.items()}


def _rivals(turn_deg: float, straightest_deg: float) -> bool:
    """Return whether a fork leaves open which of two exits is straight on."""
    return abs(turn_deg) < _THROUGH_DEG and abs(turn_deg) - abs(straightest_deg) < _ALIKE_DEG
