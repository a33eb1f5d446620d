"""Microscopic traffic: the Intelligent Driver Model (Treiber, Hennecke, Helbing 2000) past a fixed-time signal.

A vehicle follows whatever is nearest ahead: a vehicle of its lane, one on its outgoing lane, or a red stop line. Green
is held back until no vehicle of another signal group is left in the box, so conflicting streams never meet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vtrack_batch.model.homography import Array
from vtrack_batch.simulation.fleet import Fleet, Ints
from vtrack_batch.simulation.network import GROUPS, Network
from vtrack_batch.simulation.params import Scenario

LONGEST_STEP_S = 0.1
AXLE = 0.3
"""Axles ride on the route, this share of the length before and behind the centre."""
STANDING_MPS = 0.3
GENTLE_MPS2 = 2.5
"""Whoever would have to brake harder than this for an amber light drives on."""

_WAITING, _DRIVING, _GONE = 0, 1, 2
_S, _V, _A, _STAND, _STATE, _COMMITTED = range(6)
MARKS = ("gate_in", "edge_in", "edge_out", "gate_out")
_IN, _OUT, _GROUP, _STOP, _BOX, _EXIT, _TURN, _LENGTH = range(8)


@dataclass(frozen=True)
class States:
    """Vehicles on the roads at the frames: (n,) arrays sorted by frame and vehicle.

    ``xy_m``, ``velocity_mps`` and ``forward`` (unit vector of the body) are (n, 2) in scene coordinates.
    ``passed_s`` (vehicles, 4) is when each vehicle's centre passed the marks of its route (see MARKS), in seconds since
    the first frame, NaN = never; ``passed_mps`` its speed there.
    """

    frame: NDArray[np.int64]
    vehicle: NDArray[np.int64]
    s_m: Array
    xy_m: Array
    velocity_mps: Array
    forward: Array
    accel_mps2: Array
    standing_s: Array
    passed_s: Array
    passed_mps: Array


def simulate_traffic(network: Network, fleet: Fleet, scenario: Scenario, *, marks_s: Array, offset_s: float) -> States:
    """Drive the *fleet* from the warm-up's begin to the last frame; *offset_s* shifts the signal program.

    *marks_s* (routes, 4) are the arc lengths at which passing times are wanted.
    """
    steps = int(np.ceil(scenario.interval_s / LONGEST_STEP_S - 1e-9))
    step_s = scenario.interval_s / steps
    warm_steps = int(np.ceil(scenario.warm_up_s / step_s))
    state = np.zeros((len(fleet), 6))
    passed = np.full((len(fleet), 2 * len(MARKS)), np.nan)
    roads, drivers, program = _road_table(network), _driver_table(fleet), _program(scenario)
    now_s = 0.0
    samples = []
    for frame in range(scenario.frame_count):
        for _ in range(warm_steps if frame == 0 else steps):
            _advance(state, passed, (roads, drivers, program, marks_s), now_s, step_s, offset_s)
            now_s += step_s
        driving = np.flatnonzero(state[:, _STATE] == _DRIVING)
        samples.append((np.full(len(driving), frame), driving, state[driving][:, [_S, _V, _A, _STAND]].copy()))
    first_s = warm_steps * step_s
    passed[:, : len(MARKS)] -= first_s
    return _states(network, fleet, samples, passed)


def cycle_s(scenario: Scenario) -> float:
    """Return the length of the signal program's cycle."""
    return float(_program(scenario)[-1, 2])


def green_groups(scenario: Scenario, t_s: Array, *, offset_s: float) -> NDArray[np.bool_]:
    """Return (n, 4) whether each signal group has nominal green or amber at *t_s* since the warm-up's begin."""
    program = _program(scenario)
    phase = np.mod(t_s + offset_s, program[-1, 2])
    return np.stack([(phase >= g[0]) & (phase < g[2]) for g in program[:GROUPS]], axis=1)


def _program(scenario: Scenario) -> Array:
    """Return (5, 3) begin of green, of amber and of red of each group; the last row ends with the cycle's length."""
    rows, t = [], 0.0
    for green in (scenario.green_through_s, scenario.green_left_s) * 2:
        rows.append((t, t + green, t + green + scenario.amber_s))
        t += green + scenario.amber_s + scenario.all_red_s
    return np.array([*rows, (0.0, 0.0, t)])


def _road_table(network: Network) -> Array:
    return np.array(
        [[r.in_lane, r.out_lane, r.group, r.stop_s, r.box_s, r.exit_s, r.turn_mps, r.length_m] for r in network.routes]
    )


def _driver_table(fleet: Fleet) -> Array:
    columns = (fleet.route, fleet.arrival_s, fleet.looks.length_m, fleet.speed_mps, fleet.accel_mps2)
    return np.stack([*columns, fleet.headway_s, fleet.gap_m, fleet.sway_rad], axis=1).astype(float)


@njit(cache=True, nogil=True)
def _advance(state, passed, tables, now, step, offset):  # type: ignore[no-untyped-def]
    """Move all vehicles by one step (ballistic update) and note what marks they pass."""
    roads, drivers, program, marks = tables
    n = len(state)
    active = np.flatnonzero(state[:, _STATE] == _DRIVING)
    light = _lights(state, roads, drivers, program, now + offset, active)
    accel = np.zeros(len(active))
    for k in range(len(active)):
        accel[k] = _acceleration(active[k], state, roads, drivers, light, now, active)
    for k in range(len(active)):
        i = active[k]
        road = roads[int(drivers[i, 0])]
        v = state[i, _V]
        a = accel[k]
        v_next = v + a * step
        if v_next < 0.0:
            moved = -0.5 * v * v / a if a < 0.0 else 0.0
            v_next = 0.0
        else:
            moved = 0.5 * (v + v_next) * step
        s, half = state[i, _S], drivers[i, 2] / 2
        for m in range(marks.shape[1]):
            rest = marks[int(drivers[i, 0]), m] - s
            if 0.0 < rest <= moved:
                at = np.sqrt(max(0.0, v * v + 2 * a * rest))
                passed[i, m] = now + 2 * rest / max(v + at, 1e-9)
                passed[i, m + marks.shape[1]] = at
        state[i, _S] = s + moved
        state[i, _V] = v_next
        state[i, _A] = (v_next - v) / step
        state[i, _STAND] = state[i, _STAND] + step if v_next < STANDING_MPS else 0.0
        if state[i, _S] > road[_LENGTH] - half:
            state[i, _STATE] = _GONE
    for i in range(n):
        if drivers[i, 1] > now + step:
            break
        if state[i, _STATE] == _WAITING:
            _enter(i, state, roads, drivers)


@njit(cache=True, nogil=True)
def _lights(state, roads, drivers, program, t, active):  # type: ignore[no-untyped-def]
    """Return per group 2 = green and box clear, 1 = amber, 0 = red; commit those that cannot stop at amber."""
    groups = len(program) - 1
    phase = t % program[groups, 2]
    light = np.zeros(groups, np.int64)
    inside = np.zeros(groups, np.int64)
    for i in active:
        road = roads[int(drivers[i, 0])]
        g = int(road[_GROUP])
        if g < 0:
            continue
        half = drivers[i, 2] / 2
        s = state[i, _S]
        to_line = road[_STOP] - s - half
        if to_line >= 0.0 and state[i, _COMMITTED] == 0.0:
            amber = program[g, 1] <= phase < program[g, 2]
            if amber and state[i, _V] > 1.0 and state[i, _V] ** 2 > 2 * GENTLE_MPS2 * to_line:
                state[i, _COMMITTED] = 1.0
        if (to_line < 0.0 or state[i, _COMMITTED] == 1.0) and s - half < road[_EXIT]:
            inside[g] += 1
    for g in range(groups):
        if program[g, 0] <= phase < program[g, 1]:
            light[g] = 2 if inside.sum() == inside[g] else 0
        elif program[g, 1] <= phase < program[g, 2]:
            light[g] = 1
    return light


@njit(cache=True, nogil=True)
def _acceleration(i, state, roads, drivers, light, now, active):  # type: ignore[no-untyped-def]
    """Return the IDM acceleration of vehicle *i* towards the most pressing thing ahead."""
    road = roads[int(drivers[i, 0])]
    s, v = state[i, _S], state[i, _V]
    length, a_max, headway, least = drivers[i, 2], drivers[i, 4], drivers[i, 5], drivers[i, 6]
    wish = drivers[i, 3] * (1 + 0.04 * np.sin(now / 5.0 + drivers[i, 7]) + 0.03 * np.sin(now / 2.1 + 3 * drivers[i, 7]))
    if s - length / 2 < road[_EXIT]:
        before = max(0.0, road[_BOX] - s - length / 2)
        wish = min(wish, np.sqrt(road[_TURN] ** 2 + 2 * 1.6 * before))
    comfort = 2.2
    pressing = 0.0
    for j in active:
        gap = _gap(i, j, state, roads, drivers)
        if gap < 200.0:
            dv = v - state[j, _V]
            wanted = least + max(0.0, v * headway + v * dv / (2 * np.sqrt(a_max * comfort)))
            pressing = max(pressing, (wanted / max(gap, 0.3)) ** 2)
    to_line = road[_STOP] - s - length / 2
    group = int(road[_GROUP])
    if group >= 0 and to_line >= 0.0 and light[group] != 2 and state[i, _COMMITTED] == 0.0:
        wanted = 0.5 + max(0.0, v * 0.5 + v * v / (2 * np.sqrt(a_max * comfort)))
        pressing = max(pressing, (wanted / max(to_line, 0.1)) ** 2)
    return min(a_max, max(-8.0, a_max * (1 - (v / wish) ** 4 - pressing)))


@njit(cache=True, nogil=True)
def _gap(i, j, state, roads, drivers):  # type: ignore[no-untyped-def]
    """Return the clear distance from *i*'s front to *j*'s rear where *j* is ahead on *i*'s way, else a large number."""
    if i == j:
        return 1e9
    ri, rj = int(drivers[i, 0]), int(drivers[j, 0])
    if roads[ri, _IN] != roads[rj, _IN] and roads[ri, _OUT] != roads[rj, _OUT]:
        return 1e9
    mine, other = roads[ri], roads[rj]
    halves = (drivers[i, 2] + drivers[j, 2]) / 2
    gap = 1e9
    ahead = state[j, _S] - state[i, _S]
    if mine[_IN] == other[_IN] and ahead > 0.0:
        # streams of one lane part in the box: a vehicle on another route is out of the way once its rear is well in
        rear_in_box = state[j, _S] - drivers[j, 2] / 2 - other[_BOX]
        if ri == rj or rear_in_box < 8.0:
            gap = ahead - halves
    if mine[_OUT] == other[_OUT] and ri != rj:
        beyond_j = state[j, _S] - other[_EXIT]
        ahead = beyond_j - (state[i, _S] - mine[_EXIT])
        if ahead > 0.0 and beyond_j + drivers[j, 2] / 2 > -2.0:
            gap = min(gap, ahead - halves)
    return gap


@njit(cache=True, nogil=True)
def _enter(i, state, roads, drivers):  # type: ignore[no-untyped-def]
    """Let the waiting vehicle *i* onto its lane if there is room."""
    lane = roads[int(drivers[i, 0]), _IN]
    room, speed = 1e9, drivers[i, 3]
    for j in range(len(state)):
        if state[j, _STATE] == _DRIVING and roads[int(drivers[j, 0]), _IN] == lane:
            gap = state[j, _S] - drivers[j, 2] / 2 - drivers[i, 2]
            if gap < room:
                room = gap
                if gap < 4 * drivers[i, 3]:
                    speed = min(drivers[i, 3], state[j, _V] + 0.1 * max(0.0, gap - drivers[i, 6]))
        elif j < i and state[j, _STATE] == _WAITING and roads[int(drivers[j, 0]), _IN] == lane:
            return
    if room > drivers[i, 6] + speed * drivers[i, 5]:
        state[i, _STATE] = _DRIVING
        state[i, _S] = drivers[i, 2] / 2
        state[i, _V] = speed


def _states(network: Network, fleet: Fleet, samples: list[tuple[Ints, Ints, Array]], passed: Array) -> States:
    frame = np.concatenate([s[0] for s in samples]).astype(np.int64)
    vehicle = np.concatenate([s[1] for s in samples]).astype(np.int64)
    s, v, accel, standing = np.concatenate([s[2] for s in samples]).T
    front, rear = np.zeros((len(s), 2)), np.zeros((len(s), 2))
    ahead, behind = np.zeros((len(s), 2)), np.zeros((len(s), 2))
    axle = AXLE * fleet.looks.length_m[vehicle]
    for k, route in enumerate(network.routes):
        on = fleet.route[vehicle] == k
        front[on], rear[on] = route.at(s[on] + axle[on]), route.at(s[on] - axle[on])
        # the 0.1 m polyline has constant direction within a piece: central differences over 0.1 m smooth it
        ahead[on] = route.at(s[on] + axle[on] + 0.05) - route.at(s[on] + axle[on] - 0.05)
        behind[on] = route.at(s[on] - axle[on] + 0.05) - route.at(s[on] - axle[on] - 0.05)
    velocity = (ahead + behind) / 0.2 * v[:, None]
    forward = front - rear
    forward /= np.hypot(*forward.T)[:, None]
    times, speeds = passed[:, : len(MARKS)], passed[:, len(MARKS) :]
    return States(frame, vehicle, s, (front + rear) / 2, velocity, forward, accel, standing, times, speeds)
