"""What is logged of f_RS: its reach, and its errors on held-out holds and motions, beside baselines."""

import logging

import numpy as np

from softrl.artifacts.calibration import Calibration
from softrl.calibration.figures import draw_pressure_map
from softrl.calibration.holds import Holds, loaded_from_n, moving_rows, revisited, unseen_since
from softrl.calibration.inversion import has_exact_inverse, pressure_by_reduced_model
from softrl.calibration.pressure_map import TOLERANCE_PA, PressureMap
from softrl.calibration.replay import Stepping, replay_errors
from softrl.core.tracking import Tracker
from softrl.effects.chain import Plant
from softrl.recordings.recording import RecordingSet

log = logging.getLogger(__name__)
MOVING_ROWS = 400  # that f_RS is judged on beside the settled holds


def report_reach(holds: Holds, every: Holds, pressure_sim: np.ndarray, tracker: Tracker) -> None:
    """Log how many of the settled tips the simulator reaches, and what visits of one pressure differ by."""
    tracker.metric("settled_tips_reached_pct", 100.0 * len(holds) / len(every))
    differ_pa, pressures = revisited(holds.pressure, pressure_sim)
    tracker.metric("revisited_pressures_count", pressures)
    if pressures:
        tracker.metric("revisited_pressure_rms_kpa", differ_pa / 1e3)
        log.info("visits of one pressure differ by %.3g kPa rms from their mean: no static map does better", differ_pa / 1e3)


def report_map(calibration: Calibration, tracker: Tracker) -> None:
    """Log the error of f_RS on held-out holds beside the identity and an affine map, and of its inverse where there is one."""
    c, pressure_map = calibration, PressureMap(calibration)
    real, sim, held = c.pressure_real, c.pressure_sim, c.heldout
    mapped, spread = pressure_map.real_to_sim(real), pressure_map.spread(real)
    ones = np.ones((len(real), 1))
    affine = np.hstack([real, ones]) @ np.linalg.lstsq(np.hstack([real, ones])[~held], sim[~held], rcond=None)[0]
    inverse, left = pressure_map.sought(sim[held])
    found = left < TOLERANCE_PA
    tracker.metric("train/pressure_map_rms_kpa", _rms_kpa(mapped[~held] - sim[~held]))
    tracker.metric("heldout/pressure_map_rms_kpa", _rms_kpa(mapped[held] - sim[held]))
    tracker.metric("heldout/pressure_map_pct", 1e5 * _rms_kpa(mapped[held] - sim[held]) / np.ptp(sim, axis=0).max())
    tracker.metric("heldout/pressure_map_identity_rms_kpa", _rms_kpa(real[held] - sim[held]))
    tracker.metric("heldout/pressure_map_affine_rms_kpa", _rms_kpa(affine[held] - sim[held]))
    tracker.metric("heldout/pressure_map_without_inverse_pct", 100.0 * float(np.mean(~found)))
    if found.any():
        tracker.metric("heldout/pressure_map_inverse_rms_kpa", _rms_kpa((inverse - real[held])[found]))
    if not found.all():
        log.warning(
            "f_RS has no inverse at %d of %d held-out holds: no command brings the simulator's pressure about there; a supply "
            "that ends below the largest command has none, else record more holds or raise stage.weight_decays",
            (~found).sum(), len(found),
        )  # fmt: skip
    tracker.metric("heldout/pressure_map_spread_kpa", _rms_kpa(spread[held]))
    tracker.metric("train/holds_count", int((~held).sum()))
    tracker.metric("heldout/holds_count", int(held.sum()))
    tracker.figure("pressure_map", draw_pressure_map(real, sim, mapped, spread, held))


def report_moving(
    calibration: Calibration,
    plant: Plant,
    recordings: RecordingSet,
    holds: Holds,
    hold_min_s: float,
    residual_max_m: float,
    tracker: Tracker,
) -> None:
    """Log the error of f_RS in held-out rows that move: P_S is there the pressure at which the simulator would rest.

    It has in it all that a static map cannot know, the lags of valves and body first of all. Only a reduced model that
    inverts at once is asked for it.

    Parameters
    ----------
    hold_min_s : after a change of the command the body moves for this long
    residual_max_m : tips that the simulator cannot reach within this distance are left out
    """
    simulator, robot = plant.simulator, plant.chain.robot
    if plant.chain.effects or not has_exact_inverse(simulator, robot):
        return
    since = unseen_since(holds, calibration.heldout)
    moving = moving_rows(recordings, since, hold_min_s, MOVING_ROWS, loaded_from_n(robot))
    if moving is None:
        return
    pressure, miss = pressure_by_reduced_model(simulator, robot, moving.position)
    reached = np.isfinite(pressure).all(axis=1) & (miss < residual_max_m)
    if not reached.any():
        return
    real, sim = moving.pressure[reached], pressure[reached]
    tracker.metric("heldout/pressure_map_moving_rms_kpa", _rms_kpa(PressureMap(calibration).real_to_sim(real) - sim))
    tracker.metric("heldout/pressure_map_moving_identity_rms_kpa", _rms_kpa(real - sim))
    tracker.metric("heldout/pressure_map_moving_rows_count", int(reached.sum()))


def report_replay(
    calibration: Calibration,
    plant: Plant,
    recordings: RecordingSet,
    holds: Holds,
    stepping: Stepping,
    tracker: Tracker,
) -> None:
    """Log errors of tip, arc length, curvature, orientation and velocity on held-out rows, with and without f_RS."""
    judged, since = holds.where(calibration.heldout), unseen_since(holds, calibration.heldout)
    with_map = replay_errors(plant, recordings, judged, since, PressureMap(calibration).real_to_sim, stepping)
    without = replay_errors(plant, recordings, judged, since, lambda pressure: pressure, stepping)
    for name, value in with_map.items():
        tracker.metric(f"heldout/{name}", value)
        tracker.metric(f"heldout/uncalibrated_{name}", without[name])


def _rms_kpa(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2)) / 1e3)
