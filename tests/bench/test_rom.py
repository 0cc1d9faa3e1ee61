"""The bench of the reduced body: it stands beside the full model that it was made of."""

import itertools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from softrl.bench.rom import STREAM, RomBench
from softrl.bench.watch import Watch
from softrl.core.config import build_target
from softrl.core.errors import ArtifactError, ConfigError
from softrl.core.tracking import NullTracker
from softrl.fem.continuation import follow
from softrl.fem.sampling import step_program
from softrl.pod.simulator import RomSimulator
from tests.bench.full import full_simulator
from tests.fem.bodies import box_robot, hollow_box
from tests.pod.conftest import fitted


def test_the_full_model_has_material_and_elements_of_the_snapshots() -> None:
    robot, snapshots, model = fitted(2)
    rom = RomSimulator(robot, model, 1.0, 1.0, 1.0)
    fem = full_simulator(box_robot(2), hollow_box(chambers=2), moduli_pa=[2.1e6], poisson=0.4)
    seen = replace(
        snapshots, law="mooney_rivlin", moduli_pa=(1e5, 2e5), poisson=0.47, element_order=1, mean_dilatation=False
    )
    bench = RomBench(rom, None, fem, None, 1, 0, 0, 0, {}, 0.2, 0.1, 0.01, 10, 1, 10, seen)  # type: ignore[arg-type]
    full = bench._full_model
    assert (full.law, full.moduli_pa, full.poisson) == ("mooney_rivlin", (1e5, 2e5), 0.47)
    assert (full.element_order, full.mean_dilatation) == (1, False)
    assert full.rayleigh_stiffness_s == model.rayleigh_stiffness_s
    with pytest.raises(ArtifactError, match=r"Young's modulus of 2e\+06 Pa, the ReducedModel 1e\+06 Pa"):
        replace(bench, snapshots=replace(snapshots, youngs_modulus_pa=2e6))


def test_motions_of_less_than_two_steps_are_refused() -> None:
    bodies: Any = (None, None, None, None)
    with pytest.raises(ConfigError, match=r"bench.rom.duration_s=0.01 must be two steps of dt_s=0.01 or more"):
        RomBench(*bodies, 1, 0, 0, 0, {}, 0.01, 0.01, 0.01, 10, 2, 5, None)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Counting(Watch):
    """A clock that goes on by a second whenever it is read, and by a thousand with each equilibrium of the full model."""

    reads: Any = None
    rests: Any = None

    def now(self) -> float:
        return next(self.reads) + 1e3 * len(self.rests)


def test_rest_of_the_full_model_is_not_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, snapshots, model = fitted(1)
    rests: list[None] = []

    def followed(*arguments: Any) -> Any:
        rests.append(None)
        return follow(*arguments)

    monkeypatch.setattr("softrl.fem.simulator.follow", followed)
    lumped = yaml.safe_load((Path(__file__).parents[2] / "conf" / "simulator" / "pcc.yaml").read_text())
    bench = RomBench(
        RomSimulator(robot, model, 1.0, 1.0, 1.0), None, full_simulator(box_robot(1), hollow_box()),
        build_target(lumped, "simulator", lambda hint: robot), 2, 0, 0, 0, {}, 0.02, 0.01, 0.002, 10, 2, 5, snapshots,
    )  # fmt: skip
    metrics = bench.measure(Counting(1, "wall", itertools.count(), rests), 0, NullTracker())
    assert len(rests) == 1
    assert metrics["fem_steps_per_s"] == 10.0


def test_the_baseline_of_motions_is_the_body_at_rest() -> None:
    """Not its first step, after which a jump of pressure has moved it already."""
    robot, snapshots, model = fitted(1)
    lumped = yaml.safe_load((Path(__file__).parents[2] / "conf" / "simulator" / "pcc.yaml").read_text())
    bench = RomBench(
        RomSimulator(robot, model, 1.0, 1.0, 1.0), None, full_simulator(box_robot(1), hollow_box()),
        build_target(lumped, "simulator", lambda hint: robot), 1, 0, 0, 0, {}, 0.04, 0.04, 0.02, 10, 2, 5, snapshots,
    )  # fmt: skip
    metrics = bench.measure(Watch(1), 0, NullTracker())
    full, load = bench._full_model, step_program(robot, 0.02 * np.arange(1, 3), 0.04, np.random.default_rng([0, STREAM]))
    moved = bench._follow(full, load).tip - full.observe(full.reset())[0]
    assert metrics["baseline_rest_tip_rms_mm"] == pytest.approx(1e3 * np.sqrt(np.mean(np.sum(moved**2, axis=1))))
