"""Whether the air lines do what they were told, by the pressure sensors: what is felt in a fault is not to be learnt from."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softrl.core.driver import Sample
from softrl.core.errors import ConfigError


@dataclass(frozen=True)
class Watch:
    """What a healthy air line does.

    A valve without overshoot stays between the lowest and the highest of the pressures that it was lately told.

    Attributes
    ----------
    settle_s : time after which a command no longer shows in the pressure
    fault_kpa : pressure beyond that range by which a line counts as broken
    after_s : time after a fault in which the tip is still on its way
    afresh_steps : readings after that time which count wholly, since what was learnt before no longer holds
    """

    settle_s: float
    fault_kpa: float
    after_s: float
    afresh_steps: int

    def __post_init__(self) -> None:
        for name in ("settle_s", "fault_kpa"):
            if getattr(self, name) <= 0:
                raise ConfigError(f"stage.planning.watch.{name}={getattr(self, name):g} must be positive")
        for name in ("after_s", "afresh_steps"):
            if getattr(self, name) < 0:
                raise ConfigError(f"stage.planning.watch.{name}={getattr(self, name):g} must not be negative")


class LineWatch:
    """The running judgement of one robot's lines.

    Attributes
    ----------
    trusted : whether all lines are whole, and the tip has forgotten that they were not
    off : (n,) bool, lines that did not do what they were told in the last period
    """

    def __init__(self, settings: Watch) -> None:
        self._settings = settings
        self._told: deque[tuple[float, np.ndarray]] = deque()
        self._usual: np.ndarray | float = 0.0
        self._broken_s = -np.inf
        self.trusted = True
        self.off = np.zeros(1, dtype=bool)

    def advance(self, arrived: Sequence[Sample], healthy: bool = False) -> None:
        """Judge by the samples of one period.

        While the robot is known to be ``healthy``, its sensors show how far each is from the truth; only what goes
        beyond that counts later.
        """
        settings, now = self._settings, arrived[-1].time_s
        self._told.extend((sample.time_s, sample.commanded) for sample in arrived)
        # the last command before the window was still held when the window began
        while len(self._told) > 1 and self._told[1][0] < now - settings.settle_s:
            self._told.popleft()
        told = np.stack([commanded for _, commanded in self._told])
        # of the second half: a line takes a moment to empty; the median, since one sample may be wrong
        pressure = _median([sample.pressure for sample in arrived[len(arrived) // 2 :]])
        beyond = np.maximum(pressure - told.max(axis=0), told.min(axis=0) - pressure)
        # a robot without pressure sensors reports none: nothing speaks against its lines
        departure = np.nan_to_num(beyond)
        if healthy:
            self._usual = np.maximum(self._usual, departure)
        self.off = departure > self._usual + 1e3 * settings.fault_kpa
        if self.off.any():
            self._broken_s = now
        self.trusted = now - self._broken_s > settings.after_s


def _median(readings: Sequence[np.ndarray]) -> np.ndarray:
    """Return the median (n,) of what was measured in readings (n,); not a number where nothing was."""
    known = [column[np.isfinite(column)] for column in np.stack(readings).T]
    return np.array([np.median(column) if len(column) else np.nan for column in known])
