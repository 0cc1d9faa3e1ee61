"""The same commands in the twin and in PyBullet."""

import numpy as np
from scipy.optimize import minimize

from softrl.artifacts.surrogate import Surrogate
from softrl.surrogate.fit import Fit
from softrl.surrogate.twin import Twin
from softrl.surrogate.world import Rayleigh, SurrogateState, World

SETTLE_S, TICK_S = 1.5, 0.1
SETTLING = Rayleigh(30.0, 0.0)  # where it comes to rest does not depend on it
DIFFERENCE = 1e-4  # of the joints' range: PyBullet's poses are too coarse for SciPy's own 1e-8


def settle(
    world: World, theta: np.ndarray, force: np.ndarray | None = None, seconds: float = SETTLE_S
) -> SurrogateState:
    """Return where PyBullet comes to rest under the grouped command ``theta`` (3,) and a tip force (3,) N.

    A ``force`` of (6,) N and N m is one with a moment.
    """
    start = np.tile(theta, len(world.joints) // 3)
    state = SurrogateState(start, np.zeros_like(start))
    for _ in range(round(seconds / TICK_S)):
        state = world.advance(state, theta, TICK_S, force)
    return state


def parity(surrogate: Surrogate, theta: np.ndarray, force: np.ndarray) -> tuple[float, float]:
    """Return the largest distances in m between the tips of twin and PyBullet, free and under ``force`` (3,) N."""
    world, twin = World(surrogate, 1.0, SETTLING, 1.0), Twin(surrogate)
    free = [np.linalg.norm(world.pose(settle(world, t, seconds=TICK_S))[0] - twin.tip(t)[0]) for t in theta]
    expected = twin.solve(theta, force).tip
    loaded = [np.linalg.norm(world.pose(settle(world, t, force))[0] - e) for t, e in zip(theta, expected, strict=True)]
    world.close()
    return float(max(free)), float(max(loaded))


def fit_joints_by_simulation(surrogate: Surrogate, tip: np.ndarray) -> Fit:
    """Return the commands within the limits that reach tips (B, 3) m by Algorithm 1 as the paper runs it: for comparison.

    Notes
    -----
    L-BFGS-B asks PyBullet for the tip and takes its gradient by differences. Departures: the links are put where the
    joints say instead of driven there, and the best tip counts, not the last.
    """
    world, low, high = World(surrogate, 1.0, SETTLING, 1.0), surrogate.joint_low, surrogate.joint_high
    span, gaps = high - low, surrogate.gaps

    def tip_at(x: np.ndarray) -> np.ndarray:
        joints = np.tile(low + x * span, gaps)
        return world.pose(SurrogateState(joints, np.zeros_like(joints)))[0]

    def objective(x: np.ndarray, target: np.ndarray) -> float:
        return float(np.sum((1e3 * (tip_at(x) - target)) ** 2))

    start, box, options = np.clip(-low / span, 0.0, 1.0), [(0.0, 1.0)] * 3, {"eps": DIFFERENCE}
    found = [minimize(objective, start, (target,), "L-BFGS-B", bounds=box, options=options).x for target in tip]
    residual = np.array([np.linalg.norm(tip_at(x) - target) for x, target in zip(found, tip, strict=True)])
    world.close()
    return Fit(low + np.array(found) * span, residual)
