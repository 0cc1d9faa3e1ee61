"""The same commands in the twin and in PyBullet."""

import numpy as np

from softrl.artifacts.surrogate import Surrogate
from softrl.surrogate.simulator import SurrogateState, World
from softrl.surrogate.twin import Plane, Twin

SETTLE_S, TICK_S = 1.5, 0.1
DAMPING_PER_S = 30.0


def settle(
    world: World, theta: np.ndarray, force: np.ndarray | None = None, seconds: float = SETTLE_S
) -> SurrogateState:
    """Return where PyBullet comes to rest under the grouped command ``theta`` (3,) and a tip force (3,) N."""
    start = np.tile(theta, len(world.joints) // 3)
    state = SurrogateState(start, np.zeros_like(start))
    for _ in range(round(seconds / TICK_S)):
        state = world.advance(state, theta, TICK_S, force)
    return state


def parity(surrogate: Surrogate, theta: np.ndarray, force: np.ndarray) -> tuple[float, float]:
    """Return the largest distances in m between the tips of twin and PyBullet, free and under ``force`` (3,) N."""
    world, twin = World(surrogate, 1.0, DAMPING_PER_S, 1.0), Twin(surrogate)
    free = [np.linalg.norm(world.pose(settle(world, t, seconds=TICK_S))[0] - twin.tip(t)[0]) for t in theta]
    expected = twin.solve(theta, force).tip
    loaded = [np.linalg.norm(world.pose(settle(world, t, force))[0] - e) for t, e in zip(theta, expected, strict=True)]
    world.close()
    return float(max(free)), float(max(loaded))


def contact_parity(
    surrogate: Surrogate, theta: np.ndarray, plane: Plane, friction: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the contact forces (B,) N of PyBullet and of the twin under commands (B, 3) before ``plane``."""
    world, twin = World(surrogate, 1.0, DAMPING_PER_S, 1.0), Twin(surrogate)
    world.place_plane(*plane, friction)
    felt = []
    for command in theta:
        settle(world, command)
        felt.append(world.contact_force())
    world.close()
    return np.array(felt), twin.solve(theta, None, plane, friction).contact_force
