"""Material and pressure calibration: tensile curve -> hyperelastic law; holds of the robot -> f_RS: P_R -> P_S."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softrl.artifacts.calibration import Calibration
from softrl.calibration.figures import draw_tensile
from softrl.calibration.holds import AGAIN, Holds, loaded_from_n, record_holds, settled_holds, split_holds
from softrl.calibration.inversion import has_exact_inverse, pressure_by_reduced_model, pressure_by_simulator
from softrl.calibration.material_fit import as_record, best_fit, fit_materials, held_out, in_words
from softrl.calibration.mlp import Ensemble, EnsembleSettings, fit_ensemble
from softrl.calibration.plausible import look_over
from softrl.calibration.pressure_map import PressureMap
from softrl.calibration.replay import PressureOf, Stepping, simulated_holds
from softrl.calibration.report import report_map, report_moving, report_reach, report_replay
from softrl.calibration.tensile import read_tensile
from softrl.core.driver import Driver
from softrl.core.errors import ConfigError, RecordingError
from softrl.core.simulator import Simulator
from softrl.core.tracking import Tracker
from softrl.effects.chain import EffectChain, Plant
from softrl.recordings.keep import keeping
from softrl.recordings.marked import DISTURBED, OUTSIDE, without
from softrl.recordings.recording import Recording, RecordingSet
from softrl.robots.robot import Robot

log = logging.getLogger(__name__)
STREAM = 7101  # keeps the noise of a rig apart from that which other stages meet, and from these programs
REFINEMENTS = 2  # of f_RS through a simulator with effects, which has a past
ROOTS = Path(__file__).resolve().parents[1:3]  # assets/ lies in the installed package, or beside it


@dataclass(frozen=True)
class Config:
    """Material law from a tensile curve, and f_RS from settled holds.

    Attributes
    ----------
    material_curve : CSV of a tensile test, absolute, or relative to the working directory or the project; null for none
    stretch_max : the laws are fitted below this stretch
    curve_bins : equal bins of stretch that the curve is averaged over;  curve_blocks : every second one is held out
    runs, holds_per_run, hold_s, dt_s : random holds recorded on the driver when no recordings are given; ``dt_s`` is the
        simulator's step, too, whatever recordings are given
    visit_again : whether one more run visits the pressures of the first in another order: what two visits differ by no
        static map can tell
    hold_min_s, average_s, drift_max_mm : a hold counts from this duration on; its tip is averaged over the last
        ``average_s`` and may drift by this much meanwhile
    residual_max_mm : holds whose tip the simulator cannot reach within this distance are left out
    settle_s : duration simulated per constant pressure where no reduced model inverts the tip
    stood_s : a run that does not begin at rest is replayed from where this long under its first row leads
    heldout_share : share of the runs that training never sees
    members, hidden, epochs, learning_rate, weight_decays : the ensemble of networks and its training; of the
        decays that is kept which is best on holds that members left out
    """

    material_curve: str | None
    stretch_max: float
    curve_bins: int
    curve_blocks: int
    runs: int
    holds_per_run: int
    hold_s: float
    dt_s: float
    visit_again: bool
    hold_min_s: float
    average_s: float
    drift_max_mm: float
    residual_max_mm: float
    settle_s: float
    stood_s: float
    heldout_share: float
    members: int
    hidden: int
    epochs: int
    learning_rate: float
    weight_decays: tuple[float, ...]
    seed: int

    def __post_init__(self) -> None:
        positive = ("runs", "hold_s", "dt_s", "hold_min_s", "average_s", "drift_max_mm", "residual_max_mm", "settle_s",
                    "hidden", "epochs", "learning_rate")  # fmt: skip
        for name in positive:
            if not 0 < getattr(self, name) < np.inf:
                raise ConfigError(f"stage.{name}={getattr(self, name):g} must be positive")
        if round(self.settle_s / self.dt_s) < 2:
            raise ConfigError(f"stage.settle_s={self.settle_s:g} ; expected two steps or more of stage.dt_s={self.dt_s:g}")
        if not 0.0 <= self.stood_s < np.inf:
            raise ConfigError(f"stage.stood_s={self.stood_s:g} must not be negative")
        if not 0.0 < self.heldout_share < 1.0:
            raise ConfigError(f"stage.heldout_share={self.heldout_share:g}; expected a share between 0 and 1")
        if self.members < 2:
            raise ConfigError(f"stage.members={self.members}; expected 2 or more, their spread is the uncertainty")
        if not self.weight_decays or not all(0.0 <= decay < np.inf for decay in self.weight_decays):
            raise ConfigError(f"stage.weight_decays={list(self.weight_decays)}; expected one or more, none negative")
        if not 1.05 < self.stretch_max < np.inf:
            raise ConfigError(f"stage.stretch_max={self.stretch_max:g}; expected a stretch above 1.05")
        if self.curve_blocks < 2 or self.curve_bins < 2 * self.curve_blocks:
            raise ConfigError(
                f"stage.curve_bins={self.curve_bins} in curve_blocks={self.curve_blocks}; expected 2 blocks or more, every "
                "second one held out, of 2 bins each"
            )
        if self.holds_per_run < 3:
            raise ConfigError(f"stage.holds_per_run={self.holds_per_run}; expected 3 or more, the first and the last are at rest")
        if self.hold_min_s > self.hold_s or self.average_s > self.hold_min_s:
            raise ConfigError(
                f"stage.average_s={self.average_s:g}, hold_min_s={self.hold_min_s:g}, "
                f"hold_s={self.hold_s:g}; expected them rising"
            )
        if self.runs * self.holds_per_run < 8:
            raise ConfigError(
                f"stage.runs={self.runs} with holds_per_run={self.holds_per_run} gives too few holds; expected 8"
            )

    @property
    def stepping(self) -> Stepping:
        """How recordings are replayed."""
        return Stepping(self.dt_s, self.stood_s)


def run(
    config: Config,
    robot: Robot,
    simulator: Simulator,
    effects: EffectChain,
    driver: Driver,
    recordings: RecordingSet | None,
    *,
    tracker: Tracker,
) -> Calibration:
    """Return the material's law and f_RS with its held-out errors logged beside identity and affine baselines.

    With ``effects`` (those that a diagnosis found) f_RS maps what the simulator with them leaves: valves and walls with a
    memory are theirs, and no static map could do it. Recordings that were disturbed or are out of distribution are left out,
    and so are holds with a force on the tip; columns that cannot be what they are called are refused.
    """
    rng = np.random.default_rng(config.seed)
    material = _fit_material(config, tracker) if config.material_curve else {}
    plant = Plant(simulator, effects)
    if recordings is not None:
        return _calibrated(config, plant, recordings, material, rng, tracker)
    made: list[Recording] = []
    with keeping(made, driver, robot, tracker):  # whatever is wrong with a session is found out while its recordings are kept
        recordings = record_holds(
            driver, robot, config.runs, config.holds_per_run, config.hold_s, config.dt_s, rng, config.visit_again, made
        )
        calibration = _calibrated(config, plant, recordings, material, rng, tracker)
    return calibration


def _calibrated(
    config: Config, plant: Plant, recordings: RecordingSet, material: dict[str, object], rng: np.random.Generator,
    tracker: Tracker,
) -> Calibration:  # fmt: skip
    """Return f_RS of the holds in ``recordings``, trained and reported, beside the material's law."""
    simulator, robot = plant.simulator, plant.chain.robot
    recordings = _fit_for_training(recordings)
    drift_max_m, residual_max_m = 1e-3 * config.drift_max_mm, 1e-3 * config.residual_max_mm
    look_over(recordings, plant, config.stepping, residual_max_m)
    every = settled_holds(recordings, config.hold_min_s, config.average_s, drift_max_m, loaded_from_n(robot))
    rest = _resting(config, plant, every)
    holds, rest, pressure_sim = _invert(config, plant, recordings, every, rest)
    inverted_by = "reduced model" if has_exact_inverse(simulator, robot) else "simulator"
    report_reach(holds, every, pressure_sim, tracker)
    first = holds.run < len(recordings.recordings) - (recordings.recordings[-1].name == AGAIN)
    holds, rest, pressure_sim = holds.where(first), rest.where(first), pressure_sim[first]
    heldout = split_holds(holds, config.heldout_share, rng)
    if (~heldout).sum() < 2:
        raise RecordingError(
            f"{(~heldout).sum()} of {len(heldout)} settled holds trains f_RS, the others are held out; expected 2 or more: "
            "record more holds in every run, or change stage.heldout_share"
        )
    ensemble = _train(config, holds.pressure[~heldout], pressure_sim[~heldout])
    calibration = _assemble(plant, ensemble, holds, pressure_sim, heldout, material, inverted_by, every.position)
    for _ in range(REFINEMENTS if plant.chain.effects else 0):
        pressure_sim = _refined(config, plant, recordings, holds, rest, calibration)
        ensemble = _train(config, holds.pressure[~heldout], pressure_sim[~heldout])
        calibration = _assemble(plant, ensemble, holds, pressure_sim, heldout, material, inverted_by, every.position)
    tracker.metric("train/weight_decay", ensemble.weight_decay)
    report_map(calibration, tracker)
    report_moving(calibration, plant, recordings, holds, config.hold_min_s, residual_max_m, tracker)
    report_replay(calibration, plant, recordings, holds, config.stepping, tracker)
    return calibration


class Rest(NamedTuple):
    """Where the body alone rests at holds' tips: pressures (holds, n) Pa, and the distances left (holds,) m."""

    pressure: np.ndarray
    miss: np.ndarray

    def where(self, keep: np.ndarray) -> "Rest":
        """Return what belongs to the holds at which ``keep`` (holds,) bool is true."""
        return Rest(self.pressure[keep], self.miss[keep])


def _fit_for_training(recordings: RecordingSet) -> RecordingSet:
    """Return the recordings but those that their dataset marks as disturbed or as out of distribution."""
    left = without(recordings, DISTURBED, OUTSIDE)
    out = [run.name for run in recordings.recordings if run.name not in {kept.name for kept in left.recordings}]
    if out:
        log.warning("left out as disturbed or out of distribution: %s", ", ".join(out))
    return left


def _fit_material(config: Config, tracker: Tracker) -> dict[str, object]:
    path = Path(str(config.material_curve))
    if not path.exists():
        path = next((root / path for root in ROOTS if (root / path).is_file()), path)
    curve = read_tensile(path, config.curve_bins, config.stretch_max)
    fits = fit_materials(curve, config.curve_blocks)
    for fit in fits:
        tracker.metric(f"heldout/{fit.law}_stress_kpa", fit.heldout_rms_pa / 1e3)
        tracker.metric(f"heldout/{fit.law}_extrapolated_stress_kpa", fit.extrapolation_rms_pa / 1e3)
    tracker.metric("train/initial_youngs_modulus_kpa", best_fit(fits).initial_youngs_modulus_pa / 1e3)
    tracker.figure("tensile_fits", draw_tensile(curve, fits, held_out(curve, config.curve_blocks)))
    sentence = in_words(curve, fits)
    log.info("%s: %s", path.name, sentence)
    return as_record(fits) | {"sentence": sentence}


def _invert(
    config: Config, plant: Plant, recordings: RecordingSet, holds: Holds, rest: Rest
) -> tuple[Holds, Rest, np.ndarray]:
    """Return the holds that the simulator can reach, where it rests there, and P_S (holds, n) Pa there."""
    pressure, miss = rest
    if plant.chain.effects:
        pressure, miss = _led(config, plant, recordings, holds, rest, lambda pressure: pressure)
    reached = np.isfinite(pressure).all(axis=1) & (miss < 1e-3 * config.residual_max_mm)
    if reached.sum() < 4:
        raise RecordingError(
            f"the simulator reaches {reached.sum()} of {len(holds)} recorded tips within "
            f"{config.residual_max_mm:g} mm (median miss {1e3 * np.median(miss):.3g} mm); expected 4 or more: "
            "check frame and units, or raise stage.residual_max_mm"
        )
    if not reached.all():
        log.warning(
            "%d of %d recorded tips are out of the simulator's reach and left out", (~reached).sum(), len(holds)
        )
    return holds.where(reached), rest.where(reached), pressure[reached]


def _refined(
    config: Config, plant: Plant, recordings: RecordingSet, holds: Holds, rest: Rest, calibration: Calibration
) -> np.ndarray:
    """Return P_S (holds, n) Pa anew, from where the simulator comes with the f_RS found so far.

    A wall that creeps is stiffer at first than the body at rest by which a distance is told in Pa.
    """
    pressure, miss = _led(config, plant, recordings, holds, rest, PressureMap(calibration).real_to_sim)
    return np.where((miss < 1e-3 * config.residual_max_mm)[:, None], pressure, calibration.pressure_sim)


def _led(
    config: Config, plant: Plant, recordings: RecordingSet, holds: Holds, rest: Rest, pressure_of: PressureOf
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pressures (holds, n) Pa that lead a simulator with effects to the holds' tips, and the distances left, m.

    Effects have a past: the pressures are ``pressure_of`` the commanded ones, with which the recordings are replayed, and
    what leads the body alone from where that came to where the robot is (``rest``, the same whatever the pressures).
    """
    came = simulated_holds(plant, recordings, holds, pressure_of, config.average_s, config.stepping)
    here = _resting(config, plant, came)
    return pressure_of(holds.pressure) + rest.pressure - here.pressure, np.maximum(rest.miss, here.miss)


def _resting(config: Config, plant: Plant, holds: Holds) -> Rest:
    """Return where the body alone rests at the holds' tips."""
    simulator, robot = plant.simulator, plant.chain.robot
    if has_exact_inverse(simulator, robot):
        return Rest(*pressure_by_reduced_model(simulator, robot, holds.position))
    return Rest(*pressure_by_simulator(simulator, holds.position, holds.pressure, config.settle_s, config.dt_s))


def _train(config: Config, pressure_real: np.ndarray, pressure_sim: np.ndarray) -> Ensemble:
    settings = EnsembleSettings(
        config.members, config.hidden, config.epochs, config.learning_rate, config.weight_decays, config.seed
    )
    return fit_ensemble(pressure_real, pressure_sim, settings)


def _assemble(
    plant: Plant,
    ensemble: Ensemble,
    holds: Holds,
    pressure_sim: np.ndarray,
    heldout: np.ndarray,
    material: dict[str, object],
    inverted_by: str,
    settled_tip: np.ndarray,
) -> Calibration:
    seen = holds.pressure[~heldout]
    return Calibration(
        weights=ensemble.weights,
        members=len(ensemble.weights["skip"]),
        pressure_mean=ensemble.pressure.mean,
        pressure_spread=ensemble.pressure.spread,
        correction_spread=ensemble.correction_spread,
        pressure_low=seen.min(axis=0),
        pressure_high=seen.max(axis=0),
        pressure_real=holds.pressure,
        pressure_sim=pressure_sim,
        heldout=heldout,
        inverted_by=inverted_by,
        material=material,
        robot_name=plant.chain.robot.name,
        settled_tip=settled_tip,
        effects=tuple(effect.name() for effect in plant.chain.ordered),
    )
