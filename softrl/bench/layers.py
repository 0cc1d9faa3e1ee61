"""How well the reduced body follows the full model where one layer of the wall is stiffer or softer than the snapshots'."""

import logging

import numpy as np

from softrl.core.errors import SolverError
from softrl.core.progress import progress
from softrl.fem.simulator import FemSimulator
from softrl.pod.simulator import RomSimulator

log = logging.getLogger(__name__)
SOFTEST, STIFFEST = 0.6, 1.7


def layer_metrics(rom: RomSimulator, fem: FemSimulator, trials: int, rng: np.random.Generator) -> dict[str, float]:
    """Return how far the tips and turns of ``trials`` equilibria under weight are apart, and beside it what the layers do.

    Each has one layer, its scale and pressures drawn; the baseline is the reduced body with its layers as they were. Where the
    full model finds no equilibrium, which is counted, it falls over.
    """
    errors, without, turned, lost = [], [], [], 0
    limits = rom.robot.pressure_min_pa, rom.robot.pressure_max_pa
    for _ in progress(range(trials), "layers"):
        scales = np.ones(rom.layers)
        scales[rng.integers(rom.layers)] = SOFTEST * (STIFFEST / SOFTEST) ** rng.random()
        pressure = rng.uniform(*limits, rom.robot.chambers)
        try:
            full = fem.with_layers(tuple(scales))
            tip, turn = full.observe(full.equilibrium(pressure))
        except SolverError as failure:
            log.warning("a trial with layers is left out: %s", failure)
            lost += 1
            continue
        soft = rom.with_layers(tuple(scales))
        told, orientation = soft.observe(soft.equilibrium(pressure))
        errors.append(told - tip)
        without.append(rom.observe(rom.equilibrium(pressure))[0] - tip)
        turned.append(2.0 * np.arccos(np.clip(abs(float(orientation @ turn)), 0.0, 1.0)))
    if not errors:
        return {"rom_layer_lost": lost}
    return {
        "rom_layer_tip_rms_mm": _rms_mm(errors),
        "baseline_no_layer_tip_rms_mm": _rms_mm(without),
        "rom_layer_orientation_rms_deg": float(np.rad2deg(np.sqrt(np.mean(np.square(turned))))),
        "rom_layer_lost": lost,
    }


def _rms_mm(errors: list[np.ndarray]) -> float:
    return 1e3 * float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))
