"""bench=rom: the reduced bodies beside the full model, on motions that no fit has seen."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from softrl.artifacts.snapshots import Snapshots
from softrl.bench.figures import draw_motions
from softrl.bench.layers import layer_metrics
from softrl.bench.operator_inference import others_foretell
from softrl.bench.resting import resting_metrics
from softrl.bench.watch import Watch, timing
from softrl.core.errors import ArtifactError, ConfigError, SolverError
from softrl.core.progress import progress
from softrl.core.tracking import Tracker
from softrl.effects.chain import chain_of
from softrl.effects.effect import Effect
from softrl.fem.sampling import step_program
from softrl.fem.simulator import FemSimulator
from softrl.pcc.simulator import PccSimulator
from softrl.pod.galerkin.simulator import GalerkinSimulator
from softrl.pod.rom import roll
from softrl.pod.simulator import RomSimulator
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
LABELS = {"rom": "energy ROM", "galerkin": "POD Galerkin"}
STREAM = 7001  # keeps these motions apart from those that stage=fem draws with the same seed


class Path(NamedTuple):
    """A motion: tips (steps, 3) m, quaternions (steps, 4) w x y z, volume changes (steps, n) m^3."""

    tip: np.ndarray
    quaternion: np.ndarray
    volume: np.ndarray


@dataclass(frozen=True)
class RomBench:
    """The energy ROM, POD Galerkin and the full model, under weight, through the interface that every stage uses.

    Attributes
    ----------
    rom, galerkin, fem : the bodies; the full model takes its damping from what the reduced model was made with, and its material
        and elements from the ``snapshots``; ``galerkin`` may be left out
    lumped : the lumped body, for its speed
    motions : unseen ones of ``duration_s`` with pressures and tip forces held ``hold_s``, on the time step ``dt_s``
    resting : equilibria under unseen pressures and tip forces within the robot's limits
    layered : equilibria with one layer of the wall stiffer or softer, see ``bench.layers``
    violent : further ones, in which every pressure jumps between the robot's limits, beside the largest tip force
    effects : on the body, whose cost in a step is told
    rate_steps : of a timed run of the ROM
    batch, batch_steps : trajectories and their steps in a timed batch
    snapshots : those that the reduced model was made of
    """

    rom: RomSimulator
    galerkin: GalerkinSimulator | None
    fem: FemSimulator
    lumped: PccSimulator
    motions: int
    resting: int
    violent: int
    layered: int
    effects: dict[str, Effect]
    duration_s: float
    hold_s: float
    dt_s: float
    rate_steps: int
    batch: int
    batch_steps: int
    snapshots: Snapshots

    def __post_init__(self) -> None:
        for name in ("motions", "duration_s", "hold_s", "dt_s", "rate_steps", "batch", "batch_steps"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"bench.rom.{name}={getattr(self, name):g} must be positive")
        for name in ("resting", "violent", "layered"):
            if getattr(self, name) < 0:
                raise ConfigError(f"bench.rom.{name}={getattr(self, name)} must not be negative")
        if round(self.duration_s / self.dt_s) < 2:
            raise ConfigError(
                f"bench.rom.duration_s={self.duration_s:g} must be two steps of dt_s={self.dt_s:g} or more: nothing moves in one"
            )
        seen, reduced = self.snapshots.youngs_modulus_pa, self.rom.reduced_model.youngs_modulus_pa
        if not np.isclose(seen, reduced, rtol=1e-6):
            raise ArtifactError(
                f"the Snapshots have a Young's modulus of {seen:g} Pa, the ReducedModel {reduced:g} Pa: the full model would be "
                "another body; give the snapshots that the reduced model was made of in inputs.snapshots, or run stage=pod"
            )

    def measure(self, watch: Watch, seed: int, tracker: Tracker) -> dict[str, float]:
        """Return the metrics; those of the violent motions begin with ``violent_``."""
        rng = np.random.default_rng([seed, STREAM])
        clock = np.arange(1, round(self.duration_s / self.dt_s) + 1) * self.dt_s
        loads = [step_program(self.rom.robot, clock, self.hold_s, rng) for _ in range(self.motions)]
        loads += [violent_program(self.rom.robot, clock, self.hold_s, rng) for _ in range(self.violent)]
        full, taken = [], []
        rest = self._full_model.observe(self._full_model.reset())[0]  # what is built once, and the rest, do not count
        for load in progress(loads, "full model"):
            began = watch.now()
            full.append(self._follow(self._full_model, load))
            taken.append(watch.now() - began)
        bodies: dict[str, list[Path | None]] = {"rom": [self._follow(self.rom, load) for load in loads]}
        metrics = timing(taken).rate("fem_steps", len(clock))
        if self.galerkin is not None:
            bodies["galerkin"], more = self._galerkin(watch, loads)
            metrics |= more
        for part, rows in (("", slice(0, self.motions)), ("violent_", slice(self.motions, None))):
            if full[rows]:
                for name, paths in bodies.items():
                    pairs = [(path, true) for path, true in zip(paths[rows], full[rows], strict=True) if path is not None]
                    metrics |= errors(f"{part}{name}", pairs) if pairs else {}
                if len(full[rows]) > 1:
                    metrics[f"{part}baseline_inferred_tip_rms_mm"] = _rms_mm(self._inferred(loads[rows], full[rows]))
                metrics[f"{part}baseline_rest_tip_rms_mm"] = _rms_mm([path.tip - rest for path in full[rows]])
        nowhere = np.full((len(clock), 3), np.nan)
        tips = {LABELS[name]: [path.tip if path else nowhere for path in paths] for name, paths in bodies.items()}
        tracker.figure("unseen_motions", draw_motions(clock, [path.tip for path in full], tips))
        if self.resting:
            metrics |= resting_metrics(self.rom, self._full_model, self.resting, np.random.default_rng([seed, STREAM, 2]))
        if self.layered:
            metrics |= layer_metrics(self.rom, self._full_model, self.layered, np.random.default_rng([seed, STREAM, 1]))
        return metrics | self._rates(watch, rng)

    def _galerkin(self, watch: Watch, loads: list[np.ndarray]) -> tuple[list[Path | None], dict[str, float]]:
        """Return the Galerkin body's motions, None where it is lost, and its rate and size.

        Building it does not count there; how long that takes is told where it was not read back.
        """
        assert self.galerkin is not None
        read_back, began = self.galerkin.is_built, watch.now()
        body = self.galerkin.body
        taken_to_build = {} if read_back else {"galerkin_build_s": watch.now() - began}
        paths: list[Path | None] = []
        taken = []
        self._follow(self.galerkin, loads[0][:2])  # rest
        for load in loads:
            began = watch.now()
            try:
                paths.append(self._follow(self.galerkin, load))
                taken.append(watch.now() - began)
            except SolverError as error:
                log.warning("POD Galerkin is lost in one of the motions: %s", error)
                paths.append(None)
        rate = timing(taken).rate("galerkin_steps", len(loads[0])) if taken else {}
        return paths, rate | taken_to_build | {
            "galerkin_lost": float(len(loads) - len(taken)),
            "galerkin_modes": body.slope.shape[3], "galerkin_elements": body.elements,
            "galerkin_sampling_error_pct": 100.0 * body.sampling_error,
        }  # fmt: skip

    def _inferred(self, loads: list[np.ndarray], full: list[Path]) -> list[np.ndarray]:
        """Return by how much operator inference from all other motions misses the tips (steps, 3) m of each."""
        motions = [(load, np.hstack([path.volume, path.tip])) for load, path in zip(loads, full, strict=True)]
        return [told[:, -3:] - path.tip for told, path in zip(others_foretell(motions), full, strict=True)]

    @cached_property
    def _full_model(self) -> FemSimulator:
        model = self.rom.reduced_model
        damping = {name: getattr(model, name) for name in ("rayleigh_mass_per_s", "rayleigh_stiffness_s")}
        made = {name: getattr(self.snapshots, name) for name in ("law", "poisson", "element_order", "mean_dilatation")}
        return replace(self.fem, **damping, **made, moduli_pa=tuple(map(float, self.snapshots.moduli_pa)))

    def _follow(self, body: Any, load: np.ndarray) -> Path:
        """Return the motion of a simulator from its rest under ``load`` (steps, n + 3)."""
        n, state = body.robot.chambers, body.reset()
        rows = []
        for row in load:
            state = body.step(state, row[:n], self.dt_s, row[n:])
            rows.append((*body.observe(state), volumes_of(body, state)))
        return Path(*(np.stack(values) for values in zip(*rows, strict=True)))

    def _rates(self, watch: Watch, rng: np.random.Generator) -> dict[str, float]:
        model, robot = self.rom.reduced_model, self.rom.robot
        clock = np.arange(1, self.rate_steps + 1) * self.dt_s
        load = step_program(robot, clock, self.hold_s, rng)
        starts = rng.integers(0, max(1, len(load) - self.batch_steps), self.batch)
        batch = np.stack([load[s : s + self.batch_steps] for s in starts])
        works = (*self._replays(self.rom, clock, load), *self._replays(self.lumped, clock, load),
                 lambda: roll(model, self.dt_s, batch))  # fmt: skip
        for work in works:  # compiles
            work()
        single, slowed, lumped, lumped_slowed, many = watch.time(*works)
        metrics = single.rate("rom_steps", len(load)) | many.rate("rom_batch_steps", batch.shape[0] * batch.shape[1])
        metrics |= slowed.rate("rom_effects_steps", len(load)) | {"rom_effects_over_bare": slowed.median / single.median}
        metrics["rom_batch_over_single"] = metrics["rom_batch_steps_per_s"] / metrics["rom_steps_per_s"]
        replays = {"rom": single, "rom_effects": slowed, "lumped": lumped, "lumped_effects": lumped_slowed}
        return metrics | {f"{name}_replay_60s_ms": float(6e4 / clock[-1] * taken.median) for name, taken in replays.items()}

    def _replays(
        self, body: RomSimulator | PccSimulator, clock: np.ndarray, load: np.ndarray
    ) -> tuple[Callable[[], object], Callable[[], object]]:
        """Return what moves ``body`` under ``load`` (steps, n + 3): bare, and with the effects."""
        chain, (pressure, force) = chain_of(body.robot, self.effects.values()), np.split(load, [body.robot.chambers], axis=1)
        return (
            lambda: body.simulate(clock, pressure, force),
            lambda: body.simulate(clock, pressure, force, chain.hooks("body"), chain.hooks("load")),
        )


def violent_program(robot: Robot, time: np.ndarray, hold_s: float, rng: np.random.Generator) -> np.ndarray:
    """Return loads (steps, chambers + 3), Pa and N: every pressure at a limit of the robot, any slew, each ``hold_s``.

    The largest tip force, in a random direction, acts in every second hold.
    """
    index = ((time - time[0] + 1e-9) // hold_s).astype(int)
    holds = int(index.max()) + 1
    level = rng.choice([robot.pressure_min_pa, robot.pressure_max_pa], (holds, robot.chambers))
    force = rng.standard_normal((holds, 3))
    force *= robot.tip_force_max_n / np.linalg.norm(force, axis=1, keepdims=True)
    force[::2] = 0.0
    return np.hstack([level, force])[index]


def volumes_of(body: Any, state: Any) -> np.ndarray:
    """Return the changes (n,) m^3 of the chambers' volumes from the stress-free rest."""
    if isinstance(body, FemSimulator):
        return body.model.volumes(state.body.pose) - body.model.rest_volume
    return np.asarray(state.coordinates[: body.robot.chambers])


def errors(name: str, pairs: list[tuple[Path, Path]]) -> dict[str, float]:
    """Return the metrics of ``pairs`` of a motion and the full model's: of all together, and the tip's rms in single ones."""
    tip = [np.linalg.norm(a.tip - b.tip, axis=1) for a, b in pairs]
    turn = [2.0 * np.arccos(np.minimum(1.0, np.abs((a.quaternion * b.quaternion).sum(axis=1)))) for a, b in pairs]
    missed, moved = (np.concatenate(rows) for rows in ([a.volume - b.volume for a, b in pairs], [b.volume for _, b in pairs]))
    single = [_rms_mm([a.tip - b.tip]) for a, b in pairs]
    return {
        f"{name}_tip_rms_mm": _rms_mm([a.tip - b.tip for a, b in pairs]),
        f"{name}_motion_median_mm": float(np.median(single)),
        f"{name}_motion_worst_mm": max(single),
        f"{name}_tip_max_mm": 1e3 * float(np.concatenate(tip).max()),
        f"{name}_orientation_rms_deg": float(np.rad2deg(np.sqrt((np.concatenate(turn) ** 2).mean()))),
        f"{name}_volume_err_pct": 100.0 * float(np.sqrt((missed**2).mean() / (moved**2).mean())),
    }


def _rms_mm(differences: list[np.ndarray]) -> float:
    return 1e3 * float(np.sqrt((np.concatenate(differences) ** 2).sum(axis=1).mean()))
