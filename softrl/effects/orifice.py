"""A narrow place that air passes: flow grows with the root of a small pressure difference, and chokes at a large one."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.core.compiled import borrowing, standing_as
from softrl.effects.effect import SIGNAL_KERNEL, Effect, parameter
from softrl.robots.robot import Robot

ATMOSPHERE_PA = 101325.0
CRITICAL = 0.3  # ratio of pressures below which the flow is choked; fittings and tubes have 0.2 to 0.5
_WAY = 1.0 - CRITICAL
_LEAST_PA = 1e3  # absolute: no pump draws less


@borrowing
def _filled(here: float, source: float, share: float) -> float:
    """Return the absolute pressure after ``share`` of the time constant of filling from a constant ``source``; exact."""
    z = (1.0 - here / source) / _WAY
    choked = min(share, max(z - 1.0, 0.0))
    z -= choked
    if z > 1.0:
        return source * (1.0 - _WAY * z)
    angle = max(2.0 * math.asin(math.sqrt(0.5 * z)) - (share - choked), 0.0)
    return source * (1.0 - 2.0 * _WAY * math.sin(0.5 * angle) ** 2)


@borrowing
def _vented(here: float, sink: float, share: float) -> float:
    """Return the absolute pressure after ``share`` of the time constant of venting to a constant ``sink``; of second order."""
    if here * CRITICAL > sink:
        choked = min(share, math.log(here * CRITICAL / sink) / _WAY)
        here, share = here * math.exp(-_WAY * choked), share - choked
        if share <= 0.0:
            return here
    angle = 2.0 * math.asin(math.sqrt(min(0.5 * (1.0 - sink / here) / _WAY, 1.0)))
    middle = max(angle - 0.5 * share * (1.0 - 2.0 * _WAY * math.sin(0.5 * angle) ** 2), 0.0)
    angle = max(angle - share * (1.0 - 2.0 * _WAY * math.sin(0.5 * middle) ** 2), 0.0)
    return sink / (1.0 - 2.0 * _WAY * math.sin(0.5 * angle) ** 2)


@standing_as(SIGNAL_KERNEL)
def orifice_kernel(parameters: np.ndarray, state: np.ndarray, value: np.ndarray, dt: float) -> None:
    """Let the pressure behind the narrow place follow the one before it; its mean by Simpson's rule."""
    fill_s, vent_s, chamber = parameters[0], parameters[1], int(parameters[2])
    for i in range(len(value)):
        if chamber < 0 or chamber == i:
            before, here = max(value[i] + ATMOSPHERE_PA, _LEAST_PA), max(state[i] + ATMOSPHERE_PA, _LEAST_PA)
            slow_s = fill_s if here < before else vent_s
            if here == before or slow_s <= 0.0:
                state[i] = value[i]
                continue
            if dt <= 0.0:
                value[i] = state[i]
                continue
            share = 0.5 * dt / slow_s
            if here < before:
                middle = _filled(here, before, share)
                end = _filled(middle, before, share)
            else:
                middle = _vented(here, before, share)
                end = _vented(middle, before, share)
            value[i] = (here + 4.0 * middle + end) / 6.0 - ATMOSPHERE_PA
            state[i] = end - ATMOSPHERE_PA


@dataclass(frozen=True)
class Orifice(Effect):
    """A chamber of constant volume behind a narrow place: a thin tube, a fitting, a valve that opens a little.

    ``dp/dt = (1 - b) / tau p_1 phi(p_2 / p_1)`` with absolute pressures upstream (1) and downstream (2), ``phi = 1`` where
    ``p_2 / p_1`` is at most ``b`` and ``sqrt(1 - ((p_2 / p_1 - b) / (1 - b))^2)`` above. ``fill_s`` is the time in which the
    robot's largest pressure is filled from none; a quarter of that takes half as long where it is far below the room's, and
    longer above (0.69 at 250 kPa). ``vent_s`` is the ``fill_s`` of the place through which it vents, the same where that is
    the same.

    Notes
    -----
    Flow through pneumatic components by ISO 6358, isothermal, with ``b = 0.3`` (no equation number checked). Solved by
    ``p_2 / p_1 = 1 - (1 - b) (1 - cos x)``, where filling is ``dx/dt = -1 / tau``.
    """

    site: ClassVar[str] = "valve"
    title: ClassVar[str] = "flow through a narrow place, by the root of the pressure difference"
    kernel: ClassVar = orifice_kernel
    flows: ClassVar[bool] = True
    piped: ClassVar[bool] = True
    variant_of: ClassVar[str] = "rate_limit"

    fill_s: float = parameter("s", 0.0, 10.0, 0.0, typical=0.3)
    vent_s: float = parameter("s", 0.0, 10.0, 0.0, typical=0.3)
    chamber: int = -1

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return wider places: from one that is far too narrow no slope leads there."""
        return [{"fill_s": tau, "vent_s": tau} for tau in (0.1, 0.3, 1.0)]

    def pack(self, robot: Robot) -> np.ndarray:
        """Return the time constants of filling and venting, s, and the chamber."""
        fill_s, vent_s, chamber = super().pack(robot)
        way = robot.largest_pa / (robot.largest_pa + ATMOSPHERE_PA) / _WAY
        full = max(way - 1.0, 0.0) + math.acos(1.0 - min(way, 1.0))  # time constants until the largest pressure is filled
        return np.array([fill_s / full, vent_s / full, chamber])
