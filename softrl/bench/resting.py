"""How well the reduced body follows the full model at rest, under pressures and tip forces within the robot's limits."""

import logging
from typing import NamedTuple

import numpy as np

from softrl.core.errors import SolverError
from softrl.core.progress import progress
from softrl.fem.sampling import sobol_loads
from softrl.fem.simulator import FemSimulator
from softrl.pod.simulator import RomSimulator

log = logging.getLogger(__name__)


class Apart(NamedTuple):
    """Where the full model's tip rests, (3,) m, by how much the reduced body's is off, (3,) m, and by what angle, rad."""

    tip: np.ndarray
    missed: np.ndarray
    turned: float


def apart_at_rest(
    fem: FemSimulator, rom: RomSimulator, pressure: np.ndarray, tip_force: np.ndarray | None = None
) -> Apart | None:
    """Return how far apart they rest under ``pressure`` (n,) Pa and ``tip_force`` (3,) N; None where the full one falls over."""
    try:
        tip, turn = fem.observe(fem.equilibrium(pressure, tip_force))
    except SolverError as failure:
        log.warning("an equilibrium is left out: %s", failure)
        return None
    told, orientation = rom.observe(rom.equilibrium(pressure, tip_force))
    return Apart(tip, told - tip, 2.0 * np.arccos(np.clip(abs(float(orientation @ turn)), 0.0, 1.0)))


def resting_metrics(rom: RomSimulator, fem: FemSimulator, trials: int, rng: np.random.Generator) -> dict[str, float]:
    """Return how far the tips and turns of ``trials`` equilibria under weight are apart; the baseline is rest itself.

    Those that the full model does not find are counted.
    """
    loads = sobol_loads(rom.robot, trials, 0.0, np.zeros(3), int(rng.integers(2**31)))
    pairs = [apart_at_rest(fem, rom, *np.split(load, [rom.robot.chambers])) for load in progress(loads, "at rest")]
    found = [pair for pair in pairs if pair is not None]
    if not found:
        return {"rom_static_lost": trials}
    missed, rest = [pair.missed for pair in found], fem.observe(fem.reset())[0]
    return {
        "rom_static_tip_rms_mm": rms_mm(missed),
        "rom_static_tip_max_mm": 1e3 * float(np.linalg.norm(missed, axis=1).max()),
        "rom_static_orientation_rms_deg": rms_deg([pair.turned for pair in found]),
        "baseline_rest_static_tip_rms_mm": rms_mm([pair.tip - rest for pair in found]),
        "rom_static_lost": trials - len(found),
    }


def rms_mm(differences: list[np.ndarray]) -> float:
    """Return the rms length, mm, of ``differences`` (3,) m."""
    return 1e3 * float(np.sqrt(np.mean(np.sum(np.square(differences), axis=1))))


def rms_deg(angles: list[float]) -> float:
    """Return the rms, degrees, of ``angles`` in rad."""
    return float(np.rad2deg(np.sqrt(np.mean(np.square(angles)))))
