"""Roads as routes: where vehicles can drive, in which lanes, past which signals.

Scene coordinates are metres about the middle of the scene; ``Stage.scene_to_ground`` takes them to the ground.
The crossing copies a four-leg SUMO network: per arm three lanes in (right and through, through, left) and two lanes
out, 3.2 m wide, connectors across a box of 27.2 m. Traffic keeps to the right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vtrack_batch.model.homography import Array

LANE_M = 3.2
EDGE_M = 17.8
"""Distance from the middle of the crossing at which approach areas end: between zebra and stop line."""
BOX_M = 13.6
"""Distance from the middle of the crossing at which lanes end and connectors begin."""
STOP_M = 19.0
"""Distance of the stop line from the middle of the crossing."""
ARMS = ("E", "N", "W", "S")
IN_OFFSETS_M = (8.0, 4.8, 1.6)
OUT_OFFSETS_M = (-4.8, -1.6)
RIGHT_TURN_MPS = 6.0
LEFT_TURN_MPS = 9.0
GROUPS = 4
"""Signal groups in order of the program: E-W through and right, E-W left, N-S through and right, N-S left."""

_SAMPLE_M = 0.1


@dataclass(frozen=True)
class Route:
    """One way through the scene: ``xy_m`` (n, 2) in scene metres, sampled every 0.1 m of arc length.

    ``group`` is the signal group, -1 = none; ``stop_s``, ``box_s``, ``exit_s`` are the arc lengths of the stop line, of
    the beginning of the connector and of the outgoing lane.
    """

    origin: str
    destination: str
    movement: str | None
    in_lane: int
    out_lane: int
    group: int
    stop_s: float
    box_s: float
    exit_s: float
    turn_mps: float
    xy_m: Array

    @property
    def length_m(self) -> float:
        """Arc length of the whole route."""
        return (len(self.xy_m) - 1) * _SAMPLE_M

    def at(self, s_m: Array) -> Array:
        """Return the points (n, 2) at the arc lengths *s_m* (n,); straight on beyond the ends."""
        last = len(self.xy_m) - 2
        k = np.clip((s_m / _SAMPLE_M).astype(np.int64), 0, last)
        part = (s_m / _SAMPLE_M - k)[:, None]
        return np.asarray(self.xy_m[k] * (1 - part) + self.xy_m[k + 1] * part)


@dataclass(frozen=True)
class Network:
    """All routes of a scene; ``choices`` maps each origin to its routes, ``arm_m`` is how far the arms reach."""

    routes: tuple[Route, ...]
    arm_m: float

    def marks_s(self, gate_m: dict[str, float]) -> Array:
        """Return (routes, 4) arc lengths: gate of the origin, edges of its approach and of the exit, gate there.

        *gate_m* is the distance of each arm's gate from the middle of the scene.
        """
        rows = []
        for route in self.routes:
            if route.movement is None:
                gate_in, gate_out = self.arm_m - gate_m[route.origin], self.arm_m + gate_m[route.destination]
                rows.append((gate_in, np.inf, np.inf, gate_out))
            else:
                gate_in, edge_in = self.arm_m - gate_m[route.origin], self.arm_m - EDGE_M
                edge_out = route.exit_s + EDGE_M - BOX_M
                rows.append((gate_in, edge_in, edge_out, edge_out - EDGE_M + gate_m[route.destination]))
        return np.array(rows)

    @property
    def origins(self) -> tuple[str, ...]:
        """Origins in order of their first route."""
        return tuple(dict.fromkeys(route.origin for route in self.routes))


def crossing(*, arm_m: float) -> Network:
    """Return the signalised four-leg crossing with arms of *arm_m*: 16 routes."""
    routes = []
    for arm in range(4):
        for movement, lane_in, lane_out, quarter in (
            ("right", 0, 0, 1),
            ("through", 0, 0, 2),
            ("through", 1, 1, 2),
            ("left", 2, 1, 3),
        ):
            routes.append(_through_crossing(arm, movement, (lane_in, lane_out), quarter, arm_m))
    return Network(tuple(routes), arm_m)


def street(*, arm_m: float) -> Network:
    """Return a straight two-way road along the scene's x axis, reaching *arm_m* to both sides."""
    routes = []
    for index, (origin, destination, sign) in enumerate((("A", "B", 1.0), ("B", "A", -1.0))):
        ends = np.array([[-sign * arm_m, -sign * LANE_M / 2], [sign * arm_m, -sign * LANE_M / 2]])
        xy = _resampled(ends)
        far = 1e9
        routes.append(Route(origin, destination, None, index, index, -1, far, far, far, far, xy))
    return Network(tuple(routes), arm_m)


def _through_crossing(arm: int, movement: str, lanes: tuple[int, int], quarter: int, arm_m: float) -> Route:
    to = (arm + quarter) % 4
    lane_in, lane_out = lanes
    start = _turned(np.array([arm_m, IN_OFFSETS_M[lane_in]]), arm)
    enter = _turned(np.array([BOX_M, IN_OFFSETS_M[lane_in]]), arm)
    leave = _turned(np.array([BOX_M, OUT_OFFSETS_M[lane_out]]), to)
    end = _turned(np.array([arm_m, OUT_OFFSETS_M[lane_out]]), to)
    inward, outward = _turned(np.array([-1.0, 0.0]), arm), _turned(np.array([1.0, 0.0]), to)
    # handles of 0.55 of the legs make a Bézier curve close to a circle's quarter
    reach = 0.4 if movement == "through" else 0.55
    leg_in, leg_out = abs((leave - enter) @ inward) * reach, abs((leave - enter) @ outward) * reach
    t = np.linspace(0, 1, 400)[:, None]
    first, second = enter + inward * leg_in, leave - outward * leg_out
    curve = (1 - t) ** 3 * enter + 3 * t * (1 - t) ** 2 * first + 3 * t**2 * (1 - t) * second + t**3 * leave
    connector_m = float(np.hypot(*np.diff(curve, axis=0).T).sum())
    group = (0 if arm % 2 == 0 else 2) + (1 if movement == "left" else 0)
    box_s = arm_m - BOX_M
    speed = {"right": RIGHT_TURN_MPS, "through": 1e9, "left": LEFT_TURN_MPS}[movement]
    return Route(
        ARMS[arm], ARMS[to], movement, arm * 3 + lane_in, to * 2 + lane_out, group,
        arm_m - STOP_M, box_s, box_s + connector_m, speed, _resampled(np.vstack([start, curve, end])),
    )  # fmt: skip


def _turned(xy: Array, quarters: int) -> Array:
    """Turn the point (2,) counter-clockwise by quarter turns."""
    c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarters % 4]
    return np.array([c * xy[0] - s * xy[1], s * xy[0] + c * xy[1]])


def _resampled(xy: Array) -> Array:
    """Sample the polyline (n, 2) every 0.1 m of its arc length; less than one step of the end is cut off."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    at = np.arange(int(s[-1] / _SAMPLE_M) + 1) * _SAMPLE_M
    return np.stack([np.interp(at, s, xy[:, 0]), np.interp(at, s, xy[:, 1])], axis=1)
