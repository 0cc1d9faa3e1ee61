"""Samples whose motion was lost, while what was commanded then is known."""

from dataclasses import replace
from typing import Any

import numpy as np

from softrl.recordings.run import Recording

MOTION = "position", "quaternion", "bend_angle"
LOST_MOST = 0.5  # of a run's rows may lack their motion


def is_seen(run: Recording) -> bool:
    """Return whether no more of the motion of ``run`` was lost than may be."""
    return bool(np.mean(~run.seen) <= LOST_MOST)


def lost(run: Recording, unseen: np.ndarray) -> Recording:
    """Return ``run`` with its motion ``unseen`` (steps,) at some samples, besides any before: it is bridged evenly there."""
    unseen = unseen | ~run.seen
    changed: dict[str, Any] = {
        name: bridged(run.time, getattr(run, name), unseen) for name in MOTION if getattr(run, name) is not None
    }
    if "quaternion" in changed:
        changed["quaternion"] /= np.linalg.norm(changed["quaternion"], axis=1, keepdims=True)
    markers = {name: bridged(run.time, values, unseen) for name, values in run.markers.items()}
    return replace(run, markers=markers, unseen=unseen, **changed)


def bridged(time: np.ndarray, values: np.ndarray, unseen: np.ndarray) -> np.ndarray:
    """Return ``values`` (steps, ...) that change evenly between the nearest samples wherever they are ``unseen`` (steps,)."""
    columns = values.reshape(len(values), -1).T
    filled = [np.where(unseen, np.interp(time, time[~unseen], column[~unseen]), column) for column in columns]
    return np.stack(filled, axis=1).reshape(values.shape)
