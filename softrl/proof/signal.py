"""How loud a hidden effect is: what is left of it after the nominal simulator was retuned, over the noise."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from softrl.pcc.simulator import PccSimulator
from softrl.proof.generator import laws
from softrl.proof.generator.catalogue import Hidden, sticking
from softrl.proof.generator.plant import Body, Motion, simulate
from softrl.proof.generator.program import Session
from softrl.proof.generator.sensing import reported

GRID_S = 0.005  # step of the nominal simulator's replays here
TUNING_STEPS = 12
CLOSE = 0.15  # a ratio within this share of its target is close enough
ATTEMPTS = 7
MAP_LIMIT = 0.5  # bound of the static map's coefficients about the identity


@dataclass(frozen=True)
class Truth:
    """The robot of one case.

    Attributes
    ----------
    body : its numbers, nuisances included
    gain : of every chamber, a nuisance
    hidden, amplitudes : what acts in it
    seed : of the times at which a valve sticks
    step_s : of the integrator
    """

    body: Body
    gain: float
    hidden: tuple[Hidden, ...]
    amplitudes: tuple[float, ...]
    seed: int
    step_s: float

    @property
    def table(self) -> np.ndarray:
        """The laws' table."""
        table = laws.neutral_table()
        for law, amplitude in zip(self.hidden, self.amplitudes, strict=True):
            law.into(table, amplitude)
        return table

    def moved(self, session: Session, number: int) -> Motion:
        """Return the motion in a session; ``number`` draws the times at which a valve sticks."""
        stuck = None
        for law, amplitude in zip(self.hidden, self.amplitudes, strict=True):
            if law.name == "stick":
                rng = np.random.default_rng([self.seed, number])
                stuck = sticking(session.time[-1], session.command.shape[1], amplitude, rng)
        time, command = np.r_[0.0, session.time], np.vstack([np.zeros_like(session.command[:1]), session.command])
        force = np.vstack([np.zeros((1, 3)), session.tip_force])
        made = simulate(self.body, self.table, time, self.gain * command, self.step_s, force, stuck)
        return Motion(made.position[1:], made.rotation[1:], made.pressure[1:] / self.gain)

    def seen(self, session: Session, number: int) -> np.ndarray:
        """Return the tip (ticks, 3) m as a sensor without noise reports it."""
        return reported(self.table, session.time, self.moved(session, number), self.body.length_m)[0]


def nominal_tip(simulator: PccSimulator, session: Session, command: np.ndarray | None = None) -> np.ndarray:
    """Return what ``simulator`` predicts (ticks, 3) m at the session's ticks."""
    held = session.command if command is None else command
    grid = GRID_S * np.arange(1, int(np.ceil(session.time[-1] / GRID_S)) + 1)
    row = np.searchsorted(session.time, grid - 1e-6).clip(max=len(held) - 1)
    position = simulator.simulate(grid, held[row], session.tip_force[row]).position
    return np.stack([np.interp(session.time, grid, column) for column in position.T], axis=1)


def tuned(
    simulator: PccSimulator, runs: Sequence[Session], seen: Sequence[np.ndarray], commands: Sequence[np.ndarray]
) -> PccSimulator:
    """Return the simulator with its tunable parameters fitted to ``seen`` motion."""
    start = simulator.parameters

    def scaled(u: np.ndarray) -> PccSimulator:
        return simulator.with_parameters(**{n: v * np.exp(x) for (n, v), x in zip(start.items(), u, strict=True)})

    def residual(u: np.ndarray) -> np.ndarray:
        body = scaled(u)
        apart = [nominal_tip(body, run, c) - tip for run, tip, c in zip(runs, seen, commands, strict=True)]
        return np.asarray(1e3 * np.concatenate(apart).ravel())

    bound = np.log(4.0)
    found = least_squares(residual, np.zeros(len(start)), bounds=(-bound, bound), diff_step=1e-4, max_nfev=TUNING_STEPS)
    return scaled(found.x)


def left_over(
    simulator: PccSimulator, truth: Truth, runs: Sequence[Session], map_command: Callable[[np.ndarray], np.ndarray]
) -> float:
    """Return the rms error, m, on the second half of ``runs`` of the simulator retuned on the first half.

    Infinite if the robot is not stable.
    """
    seen = [truth.seen(run, number) for number, run in enumerate(runs)]
    if not all(np.isfinite(tip).all() for tip in seen):
        return np.inf
    commands = [map_command(run.command) for run in runs]
    half = (len(runs) + 1) // 2
    fitted = tuned(simulator, runs[:half], seen[:half], commands[:half])
    apart = [
        nominal_tip(fitted, run, c) - tip for run, tip, c in zip(runs[half:], seen[half:], commands[half:], strict=True)
    ]
    return float(np.sqrt(np.mean(np.sum(np.concatenate(apart) ** 2, axis=1))))


def same(command: np.ndarray) -> np.ndarray:
    """Return the command: no map."""
    return command


def to_level(
    simulator: PccSimulator, bare: Truth, law: Hidden, runs: Sequence[Session], floor: float, level: float
) -> float:
    """Return the amplitude at which ``law`` alone leaves ``level`` times the ``floor`` (m), or its largest.

    ``bare`` is the same robot without hidden laws; what is left of it is taken out in squares.
    """
    mine = left_over(simulator, bare, runs, same)
    largest = abs(law.largest)
    amplitude, low, high = largest / 3.0, 1e-4 * largest, np.inf
    best = (np.inf, amplitude)
    for _ in range(ATTEMPTS):
        alone = replace(bare, hidden=(law,), amplitudes=(float(np.copysign(amplitude, law.largest)),))
        left = left_over(simulator, alone, runs, same)
        ratio = float(np.sqrt(max(left**2 - mine**2, 1e-4 * floor**2)) / floor / level)
        best = min(best, (abs(np.log(ratio)), amplitude))
        if abs(ratio - 1.0) < CLOSE or (ratio < 1.0 and amplitude == largest):
            break
        low, high = (amplitude, high) if ratio < 1.0 else (low, amplitude)
        wanted = amplitude / float(np.clip(ratio, 0.2, 5.0))
        amplitude = wanted if low < wanted < high else float(np.sqrt(low * high))
        amplitude = min(amplitude, largest)
    return float(np.copysign(best[1], law.largest))


@dataclass(frozen=True)
class StaticMap:
    """A calibration from real to simulated pressure, static and through zero: linear with cross terms, and squares.

    Attributes
    ----------
    linear : (chambers, chambers)
    square : (chambers,) per unit of the largest pressure
    low_pa, high_pa : limits
    """

    linear: np.ndarray
    square: np.ndarray
    low_pa: float
    high_pa: float

    def __call__(self, command: np.ndarray) -> np.ndarray:
        """Return the mapped command (ticks, chambers) Pa."""
        mapped = command @ self.linear.T + self.square * command * np.abs(command) / self.high_pa
        return np.clip(mapped, self.low_pa, self.high_pa)


def calibrated(simulator: PccSimulator, truth: Truth, runs: Sequence[Session]) -> StaticMap:
    """Return the static map with which the nominal simulator comes closest to the robot's motion."""
    robot = simulator.robot
    n = robot.chambers
    seen = [truth.seen(run, 100 + number) for number, run in enumerate(runs)]

    def mapping(u: np.ndarray) -> StaticMap:
        return StaticMap(np.eye(n) + u[: n * n].reshape(n, n), u[n * n :], robot.pressure_min_pa, robot.pressure_max_pa)

    def residual(u: np.ndarray) -> np.ndarray:
        made = mapping(u)
        apart = [nominal_tip(simulator, run, made(run.command)) - tip for run, tip in zip(runs, seen, strict=True)]
        return np.asarray(1e3 * np.concatenate(apart).ravel())

    start = np.zeros(n * n + n)
    found = least_squares(residual, start, bounds=(-MAP_LIMIT, MAP_LIMIT), diff_step=1e-3, max_nfev=TUNING_STEPS)
    return mapping(found.x)
