"""Kinetic energy and work of the torch twin's steps."""

from typing import Any

from torch import Tensor

from softrl.pod.twin.algebra import dot, times


def kinetic_energy(rate: Tensor, giving: Tensor, moved: Tensor, couple: Tensor, own: Tensor) -> Tensor:
    """Return twice the kinetic energies (B,), those of the inside in them; ``moved`` (B, k) are the amplitudes' rates."""
    return dot(moved, moved) + 2.0 * dot(rate, times(couple, giving)) + dot(giving, times(own, giving))


def work_of_inertia(
    off: Tensor, rate: Tensor, former: Tensor, giving: Tensor, formerly: Tensor, held: tuple[Any, ...], dt_s: float
) -> Tensor:
    """Return twice the works (B,) of ``pod.step.inertia.work_of_inertia``; ``off`` (B, r) is how far from its aim a step ends."""
    (amplitudes, lead, couple, own), _, _, (before, now) = held
    change = (amplitudes - 2.0 * now + before + times(lead, off)) / dt_s
    force = times(lead.transpose(1, 2), change) + times(couple, giving - formerly)
    inner = times(own, giving - formerly) + times(couple.transpose(1, 2), rate - former)
    return 2.0 * (dot(force, rate) + dot(inner, giving))
