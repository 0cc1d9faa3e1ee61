"""A ring of past values inside a state vector, for effects that look back in time."""

import numpy as np

from softrl.core.compiled import borrowing
from softrl.core.errors import ConfigError

CAPACITY = 4096  # past values a channel: 1 s at a step of 0.25 ms
REACH = CAPACITY - 2  # steps, of which ``look_back`` knows both ends
HEAD, COUNT, FIRST = 0, 1, 2


def empty_history(width: int) -> np.ndarray:
    """Return the state vector of a history of ``width`` channels that has seen nothing yet."""
    return np.zeros(FIRST + CAPACITY * width)


def check_reach(name: str, delay_s: float, dt_s: float) -> None:
    """Raise ``ConfigError`` if a history in steps of ``dt_s`` does not go back by the delay of the effect called ``name``."""
    if delay_s > REACH * dt_s * (1.0 + 1e-9):
        raise ConfigError(
            f"effect {name}.delay_s={delay_s:g} s is {delay_s / dt_s:.0f} steps of {dt_s:g} s; expected at most {REACH}: "
            f"take steps of {1.01 * delay_s / REACH:.2g} s or more"
        )


@borrowing
def push(state: np.ndarray, value: np.ndarray, before: bool) -> None:
    """Add ``value`` (width,); what came before the first value equals it if ``before``, else zero."""
    width = len(value)
    if state[COUNT] == 0.0 and before:
        for k in range(CAPACITY):
            for i in range(width):
                state[FIRST + k * width + i] = value[i]
    state[COUNT] += 1.0
    head = (int(state[HEAD]) + 1) % CAPACITY
    state[HEAD] = float(head)
    for i in range(width):
        state[FIRST + head * width + i] = value[i]


@borrowing
def look_back(state: np.ndarray, width: int, channel: int, steps: float) -> float:
    """Return a channel's value ``steps`` before the last one, interpolated linearly between samples."""
    steps = min(steps, float(REACH))
    whole = int(steps)
    share = steps - whole
    head = int(state[HEAD])
    near = state[FIRST + (head - whole) % CAPACITY * width + channel]
    far = state[FIRST + (head - whole - 1) % CAPACITY * width + channel]
    return (1.0 - share) * near + share * far
