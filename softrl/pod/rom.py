"""The energy ROM from Python: equilibria, inverse statics, trajectories."""

import logging
from typing import NamedTuple

import numpy as np

from softrl.artifacts.reduced_model import SHAPES, ReducedModel
from softrl.core.errors import SolverError
from softrl.effects.call import pack
from softrl.pod.lanes.batch import run_batch
from softrl.pod.step.inverse import solve_pressures
from softrl.pod.step.kernel import run_kernel
from softrl.pod.step.pose import tip_pose
from softrl.pod.step.potential import Tables
from softrl.pod.step.reach import reach, warn_beyond
from softrl.pod.step.tables import tables_of

log = logging.getLogger(__name__)

FAILED_SHARE = 0.01  # of the steps: more that do not converge are no motion
FEW = 5  # trajectories that are faster one by one than in step
QUASI_STATIC_S = 1e6  # one implicit step of this length is an equilibrium
LOAD_STEPS = 4  # an equilibrium is approached in this many equal steps of the load
NO_HOOKS = (pack(()), pack(()))  # on the body, on the load
STILL = np.zeros((2, SHAPES))  # an inside that gives to nothing
EMPTY = (np.empty((0, 3)), np.empty((0, 4)))


def static_coordinates(model: ReducedModel, loads: np.ndarray, gravity_m_s2: np.ndarray | None = None) -> np.ndarray:
    """Return the coordinates z (S, n + 3) m^3 and m at rest under ``loads`` (S, n + 3) Pa and N.

    Weight acts besides the loads: that of ``gravity_m_s2``, or of the model's own gravity if None.

    Raises
    ------
    SolverError
        If an equilibrium is not found.
    """
    found, failed = static_points(tables_of(model, gravity_m_s2), loads)
    if failed.any():
        first = np.array2string(loads[int(np.argmax(failed))], precision=4)
        raise SolverError(
            f"{int(failed.sum())} of {len(loads)} equilibria of the reduced model were not found, the first under "
            f"{first} (Pa, N); keep the loads within the range of the snapshots"
        )
    warn_beyond(model, reach(found), "equilibria")
    return found @ model.frame.T


def static_points(tables: Tables, loads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the equilibria y (S, r) under ``loads`` (S, r), and which of them (S,) were not found."""
    r = len(tables.frame)
    found, failed = np.empty((len(loads), r)), np.zeros(len(loads), dtype=bool)
    ramp = np.linspace(0.0, 1.0, LOAD_STEPS + 1)[1:, None]
    for s, load in enumerate(np.asarray(loads, dtype=float)):
        y, velocity = np.zeros(r), np.zeros(r)
        path = np.empty((LOAD_STEPS, r))
        run_kernel(
            y,
            velocity,
            STILL.copy(),
            np.zeros(r),
            QUASI_STATIC_S,
            np.ascontiguousarray(ramp * load),
            tables,
            NO_HOOKS,
            path,
            *EMPTY,
        )
        again = y.copy()
        still = np.zeros(r), STILL.copy(), np.zeros(r)
        missed, *_ = run_kernel(again, *still, QUASI_STATIC_S, load[None].copy(), tables, NO_HOOKS, path[:0], *EMPTY)
        found[s], failed[s] = again, missed > 0 or not np.isfinite(again).all()
    return found, failed


def tip_poses(
    model: ReducedModel, coordinate: np.ndarray, gravity_m_s2: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return tip positions (S, 3) m and quaternions (S, 4) w x y z at coordinates z (S, n + 3).

    The model's own gravity turns the tip a little, unless another is given.
    """
    tables = tables_of(model, gravity_m_s2)
    position, quaternion = np.empty((len(coordinate), 3)), np.empty((len(coordinate), 4))
    values, point = np.empty(len(tables.parent)), np.empty(model.order)
    points = coordinate @ tables.inverse.T
    warn_beyond(model, reach(points), "tip's poses")
    for k, y in enumerate(points):
        tip_pose(y, STILL[0], tables.gravity, tables, values, point, position[k], quaternion[k])
    return position, quaternion


def pressure_for_tip(
    model: ReducedModel, tip: np.ndarray, gravity_m_s2: np.ndarray | None = None, tables: Tables | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pressures (S, n) Pa that bring the tip nearest to ``tip`` (S, 3) m, and the distance left (S,) m.

    Pressures stay within the robot's limits. Gauss-Newton on the distance, along the compliance of each equilibrium;
    the model's own gravity acts unless another is given, or ``tables`` of a retuned body.
    """
    tables = tables_of(model, gravity_m_s2) if tables is None else tables
    limits = np.array([model.pressure_min_pa, model.pressure_max_pa])
    goal = np.ascontiguousarray(tip, dtype=float) - model.rest_tip
    pressure, distance = np.empty((len(goal), model.chambers)), np.empty(len(goal))
    solve_pressures(goal, limits, tables, NO_HOOKS, QUASI_STATIC_S, pressure, distance)
    if not np.isfinite(distance).all():
        raise SolverError(f"inverse statics diverged for {int((~np.isfinite(distance)).sum())} of {len(goal)} tips")
    return pressure, distance


class Rolled(NamedTuple):
    """Trajectories: coordinates z (B, T, n + 3) m^3 and m, and the tip's quaternion (B, T, 4) w x y z."""

    coordinate: np.ndarray
    quaternion: np.ndarray


def roll_poses(
    model: ReducedModel,
    dt_s: float,
    loads: np.ndarray,
    start: np.ndarray | None = None,
    velocity: np.ndarray | None = None,
    gravity_m_s2: np.ndarray | None = None,
) -> Rolled:
    """Return trajectories under ``loads`` (B, T, n + 3) Pa and N, held over each step.

    Parameters
    ----------
    start, velocity : (B, n + 3) z and its rate before the first step; zero if None
    gravity_m_s2 : (3,); the model's own if None
    """
    tables = tables_of(model, gravity_m_s2)
    batch, steps, r = loads.shape
    path, position, quaternion = np.empty((batch, steps, r)), np.empty((steps, 3)), np.empty((batch, steps, 4))
    first = np.zeros((batch, r)) if start is None else start @ tables.inverse.T
    rate = np.zeros((batch, r)) if velocity is None else velocity @ tables.inverse.T
    held = np.ascontiguousarray(loads, dtype=float)
    failed, farthest = 0, 0.0
    for b in range(batch):
        moving = first[b].copy(), rate[b].copy(), STILL.copy(), np.zeros(r)
        missed, far, _ = run_kernel(*moving, dt_s, held[b], tables, NO_HOOKS, path[b], position, quaternion[b])
        failed, farthest = failed + missed, max(farthest, far)
    _check(path, failed, farthest, model, dt_s)
    return Rolled(path @ model.frame.T, quaternion)


def roll(
    model: ReducedModel,
    dt_s: float,
    loads: np.ndarray,
    start: np.ndarray | None = None,
    velocity: np.ndarray | None = None,
    gravity_m_s2: np.ndarray | None = None,
) -> np.ndarray:
    """Return the coordinates z (B, T, n + 3) m^3 and m of ``roll_poses``, many trajectories at once on all cores."""
    if len(loads) <= FEW:
        return roll_poses(model, dt_s, loads, start, velocity, gravity_m_s2).coordinate
    tables, batch = tables_of(model, gravity_m_s2), len(loads)
    first, rate = (
        np.zeros((batch, model.order)) if given is None else given @ tables.inverse.T for given in (start, velocity)
    )
    held = np.ascontiguousarray(loads, dtype=float)
    path, failed, farthest = run_batch(first, rate, dt_s, held, tables)
    _check(path, failed, farthest, model, dt_s)
    return np.asarray(path @ model.frame.T)


def _check(path: np.ndarray, failed: int, farthest: float, model: ReducedModel, dt_s: float) -> None:
    """Refuse a motion (B, T, n + 3) that is none, and warn of one beyond the samples."""
    steps = path.shape[0] * path.shape[1]
    if failed > FAILED_SHARE * steps or not np.isfinite(path).all():
        raise SolverError(
            f"reduced model of {model.robot_name}: {failed} of {steps} steps of {dt_s:g} s did not converge; try a smaller "
            "dt_s, or pressures and forces within the snapshots' range"
        )
    if failed:
        log.warning("reduced model of %s: %d of %d steps did not converge to the last digit", model.robot_name, failed, steps)
    warn_beyond(model, farthest)
