"""The bench of the reduced body: it stands beside the full model that it was made of."""

from dataclasses import replace

import pytest

from softrl.bench.rom import RomBench
from softrl.core.errors import ArtifactError
from softrl.pod.simulator import RomSimulator
from tests.bench.full import full_simulator
from tests.fem.bodies import box_robot, hollow_box
from tests.pod.conftest import fitted


def test_the_full_model_has_the_material_of_the_snapshots() -> None:
    robot, snapshots, model = fitted(2)
    rom = RomSimulator(robot, model, 1.0, 1.0, 1.0)
    fem = full_simulator(box_robot(2), hollow_box(chambers=2), moduli_pa=[2.1e6], poisson=0.4)
    seen = replace(snapshots, law="mooney_rivlin", moduli_pa=(1e5, 2e5), poisson=0.47)
    bench = RomBench(rom, None, fem, None, 1, 0, 0, 0, {}, 0.2, 0.1, 0.01, 10, 1, 10, seen)  # type: ignore[arg-type]
    full = bench._full_model
    assert (full.law, full.moduli_pa, full.poisson) == ("mooney_rivlin", (1e5, 2e5), 0.47)
    assert full.rayleigh_stiffness_s == model.rayleigh_stiffness_s
    with pytest.raises(ArtifactError, match=r"Young's modulus of 2e\+06 Pa, the ReducedModel 1e\+06 Pa"):
        replace(bench, snapshots=replace(snapshots, youngs_modulus_pa=2e6))
