"""The building blocks of a program: each begins at rest and ends there."""

import logging
from dataclasses import dataclass

import numpy as np

from softrl.core.errors import ConfigError
from softrl.recordings.program import limited, multisine, random_steps, staircase, steps_and_holds, triangles
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
HIGHEST_HZ = {  # tones that need more than two steps a period, or they would be others, or nothing
    "fast multisine": 5.0,
    "small multisine": 2.0,
    "slow multisine": 0.5,
    "triangles of 1 s": 1.0,
    "triangles of 2 and 20 s": 0.5,
}


@dataclass(frozen=True)
class Block:
    """A piece of a program: what it is, and its pressures (steps, chambers) Pa."""

    label: str
    pressure: np.ndarray


def blocks(robot: Robot, dt_s: float, rest_s: float, seed: int) -> list[Block]:
    """Return the candidates for this robot, each followed by ``rest_s`` at zero pressure.

    Long holds show creep and leaks, the same triangle at rates decades apart tells rate from amplitude, rising maxima
    with repeats tell softening from drift, fast squares tell a delay from a lag, small amplitudes show play and
    friction, single chambers and then several at once show what chambers do to each other. Those too quick for steps of ``dt_s``
    are left out.

    Raises
    ------
    ConfigError
        If the robot has no pressures above the room's.
    """
    if robot.pressure_max_pa <= 0.0:
        raise ConfigError(f"robot.pressure_max_pa={robot.pressure_max_pa:g}: programs are planned of pressures above 0 only")
    found: list[tuple[str, np.ndarray]] = []
    for chamber in range(robot.chambers):
        name = f"chamber {chamber + 1}"
        found += [(f"{kind}, {name}", pressure) for kind, pressure in _of_one(robot, chamber, dt_s)]
    found += _of_all(robot, dt_s, np.random.default_rng(seed))
    quick = [kind for kind, highest_hz in HIGHEST_HZ.items() if highest_hz >= 0.5 / dt_s]
    if quick:
        told = ", ".join(f"{kind} (below {0.5 / HIGHEST_HZ[kind]:g} s)" for kind in quick)
        log.warning("too quick for steps of %g s and left out of the plan: %s", dt_s, told)
        found = [(label, pressure) for label, pressure in found if label.partition(",")[0] not in quick]
    rest = np.zeros((max(round(rest_s / dt_s), 1), robot.chambers))
    return [Block(label, limited(robot, np.vstack([pressure, rest]), dt_s)) for label, pressure in found]


def _of_one(robot: Robot, chamber: int, dt_s: float) -> list[tuple[str, np.ndarray]]:
    full = robot.pressure_max_pa

    def levels(shares: list[float], hold_s: float) -> np.ndarray:
        rows = np.zeros((len(shares), robot.chambers))
        rows[:, chamber] = full * np.array(shares)
        return steps_and_holds(robot, rows, hold_s, dt_s)[1]

    def waves(share: float, periods_s: tuple[float, ...], cycles: int) -> np.ndarray:
        return triangles(robot, chamber, share * full, periods_s, cycles, dt_s)[1]

    cycles = waves(1.0, (4.0,), 6)
    found = [
        ("hold of 60 s at full pressure", levels([1.0], 60.0)),
        ("hold of 15 s at full pressure", levels([1.0], 15.0)),
        ("hold of 15 s at a third", levels([0.33], 15.0)),
        ("triangles of 2 and 20 s", waves(1.0, (2.0, 20.0), 1)),
        ("triangle of 60 s", waves(1.0, (60.0,), 1)),
        ("triangles of 1 s", waves(1.0, (1.0,), 6)),
        ("triangles of 10 s to a third", waves(0.33, (10.0,), 2)),
        ("triangles of falling height", np.vstack([waves(a, (6.0,), 1) for a in (1.0, 0.8, 0.6, 0.4, 0.2)])),
        ("rising maxima, each twice", staircase(robot, chamber, 4, 2, 4.0, dt_s)[1]),
        ("cycles, 15 s of rest, cycles", np.vstack([cycles, levels([0.0], 15.0), cycles[: len(cycles) // 3]])),
        ("squares of rising height", levels([0.1, 0.0, 0.2, 0.0, 0.4, 0.0, 0.7, 0.0, 1.0], 2.0)),
        ("squares of 1 s", levels([1.0, 0.0] * 4, 0.5)),
    ]
    if robot.pressure_min_pa < 0.0:
        below = robot.pressure_min_pa / full
        found.append(("pressure and suction", levels([1.0, below, 0.5, 0.5 * below], 3.0)))
    return found


def _of_all(robot: Robot, dt_s: float, rng: np.random.Generator) -> list[tuple[str, np.ndarray]]:
    n, full = robot.chambers, robot.pressure_max_pa

    def even(shares: list[float], hold_s: float) -> np.ndarray:
        return steps_and_holds(robot, full * np.outer(shares, np.ones(n)), hold_s, dt_s)[1]

    found = [
        ("slow multisine", multisine(robot, 30.0, (0.05, 0.5), 0.9, dt_s, rng)[1]),
        ("fast multisine", multisine(robot, 15.0, (0.5, 5.0), 0.9, dt_s, rng)[1]),
        ("small multisine", multisine(robot, 20.0, (0.1, 2.0), 0.3, dt_s, rng)[1]),
        *(
            (f"random steps of {hold_s:g} s ({name})", random_steps(robot, round(24.0 / hold_s), hold_s, dt_s, rng)[1])
            for hold_s in (0.5, 1.0, 2.0, 5.0)
            for name in "abcdef"
        ),
        ("rest of 20 s", np.zeros((round(20.0 / dt_s), n))),
    ]
    if n > 1:
        alone = 0.7 * full * np.eye(n)
        pairs = np.array([alone[i] + alone[j] for i in range(n) for j in range(i)])
        found += [
            ("all chambers, rising levels", even([0.25, 0.5, 0.75, 1.0], 4.0)),
            ("all chambers, hold of 20 s", even([1.0], 20.0)),
            ("single chambers, then pairs", steps_and_holds(robot, np.vstack([alone, pairs]), 3.0, dt_s)[1]),
        ]
    return found


def joined(chosen: list[Block]) -> np.ndarray:
    """Return the pressures (steps, chambers) Pa of blocks one after the other."""
    return np.vstack([block.pressure for block in chosen])
