"""One recorded run in SI units."""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Recording:
    """One run of a robot; channels that were not recorded are None.

    Attributes
    ----------
    name, session : the run, and the session (day, mounting) that it belongs to
    time : (steps,) s, increasing, not necessarily uniform
    pressure_cmd : (steps, chambers) Pa, what was commanded (``robot.command_to_pa`` times the command
        channel)
    pressure_meas : (steps, chambers) Pa gauge at the chamber
    position : (steps, 3) m, tip in the base frame
    quaternion : (steps, 4) w x y z
    bend_angle : (steps,) rad
    tip_force : (steps, 3) N on the tip, base frame
    markers : name -> (steps, 3) m
    temperature : (steps,) degree Celsius
    unseen : (steps,) where the motion was lost, and what stands in its channels is what its neighbours make likely; None where
        all of it was seen
    gone_s : how long the run it was cut from, its session, and all sessions had gone on at its first sample, see
        ``recordings.gone``
    """

    name: str
    session: str
    time: np.ndarray
    pressure_cmd: np.ndarray
    pressure_meas: np.ndarray | None = None
    position: np.ndarray | None = None
    quaternion: np.ndarray | None = None
    bend_angle: np.ndarray | None = None
    tip_force: np.ndarray | None = None
    markers: dict[str, np.ndarray] = field(default_factory=dict)
    temperature: np.ndarray | None = None
    gone_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    unseen: np.ndarray | None = None

    @property
    def seen(self) -> np.ndarray:
        """Whether the motion (steps,) was seen."""
        return np.ones(len(self.time), dtype=bool) if self.unseen is None else ~self.unseen

    def channels(self) -> Iterator[tuple[str, np.ndarray]]:
        """Yield the recorded channels by name, markers by their own."""
        for entry in fields(self):
            values = getattr(self, entry.name)
            if isinstance(values, np.ndarray) and entry.name != "unseen":
                yield entry.name, values
        yield from self.markers.items()

    def part(self, which: slice | np.ndarray) -> dict[str, Any]:
        """Return the fields of the run's samples ``which``, for ``dataclasses.replace``."""
        markers = {name: values[which] for name, values in self.markers.items()}
        found = {name: values[which] for name, values in self.channels() if name not in markers}
        return {**found, "markers": markers, "unseen": None if self.unseen is None else self.unseen[which]}
