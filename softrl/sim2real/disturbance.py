"""An air line is pulled off during a rollout and put back on, and the time until the tip is back."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from softrl.core.errors import ConfigError
from softrl.sim2real.rollout import Rollout

BACK = 1.5  # an error of this many times the one before counts as recovered
QUIET_STEPS = 3  # it has to stay so for this many commands
NEAR_MM = 2.0  # counts as back whichever controller it is: what the one that errs most leaves without a fault


@dataclass(frozen=True)
class Disturbance:
    """An air line that is off for a while.

    Attributes
    ----------
    course : during which;  chamber : whose line, from 0
    cut_share : of the course that goes before
    cut_s : time without it
    """

    course: str
    chamber: int
    cut_share: float
    cut_s: float

    def __post_init__(self) -> None:
        if not 0.0 < self.cut_share < 1.0 or self.cut_s <= 0.0:
            raise ConfigError(
                f"stage.disturbance: cut_share={self.cut_share:g} must lie between 0 and 1, cut_s={self.cut_s:g} above 0"
            )

    def steps(self, count: int, period_s: float) -> tuple[int, int]:
        """Return before which commands of ``count`` the line goes off and comes back.

        Raises
        ------
        ConfigError
            If too few commands are left to see a recovery in.
        """
        cut = max(round(self.cut_share * count), 1)
        back = cut + max(round(self.cut_s / period_s), 1)
        left = max(count - back, 0)
        if left < QUIET_STEPS:
            raise ConfigError(
                f"stage.disturbance: cut_share={self.cut_share:g}, cut_s={self.cut_s:g} leave {left} of the course's {count} "
                f"commands after the line is back; expected {QUIET_STEPS} or more, to see a recovery in: lower one of the "
                "two, or raise stage.shape_steps"
            )
        return cut, back


@runtime_checkable
class Breakable(Protocol):
    """A driver whose robot can lose an air line."""

    def cut(self, chamber: int | None) -> None:
        """Pull the line of a chamber off; None puts all back on."""
        ...


class Recovery(NamedTuple):
    """What a cut did.

    Attributes
    ----------
    before_mm : rms error before it;  worst_mm : largest error from the cut on
    back_s : from the reconnection until the rms error of three commands in a row is at most 1.5 times that before
    each_s : until each of the three is
    near_s : until each of the three is at most 2 mm, the same for every controller

    Notes
    -----
    A time that was never reached is infinite. Single readings carry the camera's noise: of a controller that leaves hardly
    more than that, one reading in twelve exceeds 1.5 times the rms whether or not a line was off, and ``each_s`` then tells
    when there happened to be three quiet ones.
    """

    before_mm: float
    worst_mm: float
    back_s: float
    each_s: float
    near_s: float


def recovery(rollout: Rollout, cut: int, back: int, period_s: float) -> Recovery:
    """Return how a rollout came through a line that was off from step ``cut`` to step ``back``."""
    error = 1e3 * rollout.course.position_error(rollout.reached)
    before = float(np.sqrt(np.mean(error[:cut] ** 2)))
    window = np.lib.stride_tricks.sliding_window_view(error[back:], QUIET_STEPS)
    judged = (np.sqrt(np.mean(window**2, axis=1)) <= BACK * before, window.max(axis=1) <= BACK * before,
              window.max(axis=1) <= NEAR_MM)  # fmt: skip
    return Recovery(before, float(error[cut:].max()), *(_first_s(quiet, period_s) for quiet in judged))


def _first_s(quiet: np.ndarray, period_s: float) -> float:
    """Return the end in s of the first period that is ``quiet`` (windows,): the error of a step is that at its period's end."""
    return (int(np.argmax(quiet)) + 1) * period_s if quiet.any() else float("inf")
