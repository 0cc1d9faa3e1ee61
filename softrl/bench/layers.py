"""How well the reduced body follows the full model where one layer of the wall is stiffer or softer than the snapshots'."""

import numpy as np

from softrl.bench.resting import apart_at_rest, rms_deg, rms_mm
from softrl.core.progress import progress
from softrl.fem.simulator import FemSimulator
from softrl.pod.simulator import RomSimulator

SOFTEST, STIFFEST = 0.6, 1.7


def layer_metrics(rom: RomSimulator, fem: FemSimulator, trials: int, rng: np.random.Generator) -> dict[str, float]:
    """Return how far the tips and turns of ``trials`` equilibria under weight are apart, and beside it what the layers do.

    Each has one layer, its scale and pressures drawn; the baseline is the reduced body with its layers as they were. Where the
    full model finds no equilibrium, which is counted, it falls over.
    """
    found, without = [], []
    limits = rom.robot.pressure_min_pa, rom.robot.pressure_max_pa
    for _ in progress(range(trials), "layers"):
        scales = np.ones(rom.layers)
        scales[rng.integers(rom.layers)] = SOFTEST * (STIFFEST / SOFTEST) ** rng.random()
        pressure = rng.uniform(*limits, rom.robot.chambers)
        pair = apart_at_rest(fem.with_layers(tuple(scales)), rom.with_layers(tuple(scales)), pressure)
        if pair is not None:
            found.append(pair)
            without.append(rom.observe(rom.equilibrium(pressure))[0] - pair.tip)
    if not found:
        return {"rom_layer_lost": trials}
    return {
        "rom_layer_tip_rms_mm": rms_mm([pair.missed for pair in found]),
        "baseline_no_layer_tip_rms_mm": rms_mm(without),
        "rom_layer_orientation_rms_deg": rms_deg([pair.turned for pair in found]),
        "rom_layer_lost": trials - len(found),
    }
