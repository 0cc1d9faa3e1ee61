"""The contract of every body model: pressures and tip force in, motion out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from softrl.core.span import Span


@dataclass(frozen=True)
class Motion:
    """What a body did over a run, one row per sample; also what sensors report of it.

    Attributes
    ----------
    time : (steps,) s
    position : (steps, 3) m, tip in the base frame
    quaternion : (steps, 4) w x y z, tip orientation relative to the base frame
    pressure : (steps, chambers) Pa, what acted in the chambers
    """

    time: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    pressure: np.ndarray


class Hook(NamedTuple):
    """One effect as the body's kernel sees it; ``kernel`` has the signature ``effects.effect.PORT_KERNEL``.

    ``state`` is advanced in place, so a caller that needs the old state copies it first.
    """

    kernel: Any
    parameters: np.ndarray
    state: np.ndarray


class Simulator(Protocol):
    """A body: ROM, lumped, finite elements or PyBullet. Stateless; the state is a value."""

    @property
    def parameters(self) -> dict[str, float]:
        """Tunable physical parameters by name with unit suffix, e.g. ``youngs_modulus_scale``."""
        ...

    def with_parameters(self, **values: float) -> "Simulator":
        """Return a copy with some tunable parameters replaced (used by a refit)."""
        ...

    def reset(self, rng: np.random.Generator | None = None) -> Any:
        """Return the state at rest under zero pressure."""
        ...

    def step(
        self,
        state: Any,
        pressure: np.ndarray,
        dt_s: float,
        tip_force: np.ndarray | None = None,
        body: Sequence[Hook] = (),
        load: Sequence[Hook] = (),
    ) -> Any:
        """Return the state after ``dt_s`` under ``pressure`` (chambers,) Pa and ``tip_force`` (3,) N.

        ``state`` is left as it was; the hooks' own states are advanced in place, once, as in ``simulate``.
        """
        ...

    def observe(self, state: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return tip position (3,) m and quaternion (4,) w x y z."""
        ...

    def simulate(
        self,
        time: np.ndarray,
        pressure: np.ndarray,
        tip_force: np.ndarray | None = None,
        body: Sequence[Hook] = (),
        load: Sequence[Hook] = (),
    ) -> Motion:
        """Return the motion from rest under ``pressure`` (steps, chambers), each row held until its time.

        ``time`` is uniform, s. ``body`` and ``load`` effects act inside the equations of motion.
        """
        ...


@runtime_checkable
class Backward(Protocol):
    """A body whose steps are implicit Euler's, late by half a step: what changes acts on it as it is at a step's end."""

    backward: bool


def of_steps(body: Simulator, span: Span) -> np.ndarray:
    """Return what ``body`` is to be given of a ``span`` as held over each step."""
    return span.end if isinstance(body, Backward) else span.mean


@runtime_checkable
class Hanging(Protocol):
    """A body whose states know from which rest the effects in them see strains."""

    def at_rest(self, load: Sequence[Hook]) -> Any:
        """Return the state at rest under zero pressure, weight and ``load`` effects, where ``simulate`` begins.

        No time passes for the hooks' own states, which are brought there in place. Strains count from there in every step on.
        """
        ...


@runtime_checkable
class Layered(Protocol):
    """A body whose wall is told apart in layers, which may be stiffer or softer than its model's."""

    @property
    def layers(self) -> int:
        """Number of layers."""
        ...

    def with_layers(self, scales: tuple[float, ...]) -> Simulator:
        """Return a copy whose layers, from below, are ``scales`` (layers,) times as stiff as the model's."""
        ...
