"""Numbers of rollouts, disturbance and bandwidth, baselines beside them."""

import logging

import numpy as np

from softrl.core.tracking import Tracker
from softrl.rl.filter import moving_average
from softrl.sim2real.bandwidth import Response
from softrl.sim2real.disturbance import Disturbance, recovery
from softrl.sim2real.rollout import Rollout

log = logging.getLogger(__name__)


def report_rollouts(rollouts: dict[str, dict[str, Rollout]], window: int, tracker: Tracker) -> None:
    """Log each course's error beside those of the other controllers, and against what the moving average asked for."""
    for course, runs in rollouts.items():
        for controller, rollout in runs.items():
            name = course if controller == "policy" else f"{course}_{controller}"
            tracker.metric(f"{name}_mm", 1e3 * rollout.error_m())
            told = f"{1e3 * rollout.error_m():.2f} mm rms"
            if rollout.course.frame is not None:
                tracker.metric(f"{name}_force_n", rollout.force_error_n())
                told += f", {rollout.force_error_n():.3f} N"
            log.info("%s, %s: %s", course, controller.replace("_", " "), told)
        averaged = moving_average(runs["policy"].course.position, window)
        tracker.metric(f"{course}_to_average_mm", 1e3 * runs["policy"].error_m(averaged))
    for controller, name in (("policy", "inference_hz"), ("planned", "planned_inference_hz")):
        decisions = np.concatenate([runs[controller].decision_s for runs in rollouts.values()])
        tracker.metric(name, 1.0 / float(np.mean(decisions)))


def report_recovery(
    rollouts: dict[str, Rollout], disturbance: Disturbance, period_s: float, tracker: Tracker
) -> None:
    """Log how long each controller took to come back, and whether it did: one that did not has no such time."""
    for controller, rollout in rollouts.items():
        cut, back = disturbance.steps(len(rollout.reached), period_s)
        found = recovery(rollout, cut, back, period_s)
        name = "recovery" if controller == "policy" else f"recovery_{controller}"
        tracker.metric(f"{name}_before_mm", found.before_mm)
        tracker.metric(f"{name}_worst_mm", found.worst_mm)
        tracker.metric(f"{name}/recovered_share", float(np.isfinite(found.back_s)))
        for label, seconds in (("", found.back_s), ("_each", found.each_s), ("_near", found.near_s)):
            if np.isfinite(seconds):
                tracker.metric(f"{name}{label}_s", seconds)
        if not np.isfinite(found.back_s):
            log.warning("%s: the error did not come back after the air line was put back on", controller)


def report_bandwidth(measured: Response, predicted: dict[str, Response], tracker: Tracker) -> None:
    """Log where the amplitude falls by 3 dB, measured and predicted, and whether it does: beyond the last tone has no number."""
    for name, found in {"measured": measured, **predicted}.items():
        metric = "bandwidth" if name == "measured" else f"bandwidth_{name}"
        tracker.metric(f"{metric}/found_share", float(np.isfinite(found.knee_hz)))
        if np.isfinite(found.knee_hz):
            tracker.metric(f"{metric}_hz", found.knee_hz)
        elif np.isinf(found.knee_hz):
            log.info("bandwidth, %s: above %g Hz", name, found.frequency_hz[-1])
        else:
            log.warning(
                "bandwidth, %s: unknown, since the tip's motion at %g Hz cannot be told from noise; look at the air line of "
                "the chamber, or raise stage.bandwidth.amplitude_kpa", name, found.frequency_hz[0],
            )  # fmt: skip
