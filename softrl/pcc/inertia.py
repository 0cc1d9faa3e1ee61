"""How the lumped body resists being moved, in J: what its shape makes of its inertia, and what its turning makes of its rates."""

from typing import Any, NamedTuple

import numpy as np

from softrl.core.compiled import summing

AXIAL = 4.0 / np.pi**2  # of m L^2: the first mode of an evenly loaded rod along its axis


class Inertia(NamedTuple):
    """Inertia of a body in its coordinates, bends ``b``, elongation ``e`` (of a planar body none) and losses of curvature ``c``.

    Most that moves is moved by ``w = b + with_loss c``. By its square ``W`` the inertia of bending on falls by ``1 + inward W``,
    that of swinging across the plane of the bend by ``1 + across W + across_more W^2``, as those of an arc do: to fourth order
    in the kinetic energy, and up to a bend of 2 rad to 2 %. Both grow by ``(1 + e)^2``. The inertia of ``e``,
    ``S = beyond + reach / (1 + nearer W + nearer_more W^2)``, falls as a bent arc is nearer to its base, and ``e'`` moves with
    ``(1 + e) S' / 2``, as where a body is stretched evenly. The kinetic energy is positive in any shape.

    Attributes
    ----------
    bending, loss : J s^2, of ``w``, and of ``c`` beside it
    with_loss : share of ``c`` in ``w``
    inward, across, across_more : 1/rad^2, 1/rad^2, 1/rad^4
    reach, beyond : J s^2, of an even stretch, and what that of the first mode along the axis has beyond
    nearer, nearer_more : 1/rad^2, 1/rad^4
    """

    bending: float
    loss: float
    with_loss: float
    inward: float
    across: float
    across_more: float
    reach: float
    beyond: float
    nearer: float
    nearer_more: float


def inertia_of(length: float, mass: float, end: float) -> Inertia:
    """Return the inertia of a body of ``length``, m, with ``mass`` along it and ``end`` at its tip, kg.

    Across the axis a point at the share ``s`` of the length moves by ``b s^2 / 2 + c (s^2 / 2 - s^3 / 3)`` of it, less what the
    slopes, ``b s + c (s - s^2)``, shorten; the numbers are integrals of that over the body, and what it is at the tip.
    """
    bending, both, loss = mass / 20 + end / 4, mass / 45 + end / 12, mass * 13 / 1260 + end / 36
    reach = mass / 3 + end
    across, nearer = (mass / 168 + end / 24) / bending, (mass / 60 + end / 12) / reach
    return Inertia(
        bending=length**2 * bending,
        loss=length**2 * (loss - both**2 / bending),
        with_loss=both / bending,
        inward=(mass / 504 + end / 72) / bending,
        across=across,
        across_more=across**2 - (mass / 2880 + end / 320) / bending,
        reach=length**2 * reach,
        beyond=length**2 * mass * (AXIAL - 1 / 3),
        nearer=nearer,
        nearer_more=nearer**2 - (mass / 2520 + end / 360) / reach,
    )


@summing
def add_inertia(y: np.ndarray, rate: np.ndarray, gained: np.ndarray, out: np.ndarray, inertia: Any, order: Any) -> None:
    """Add to ``out`` (m,) the force, J, that coordinates ``y`` take at their ``rate``, 1/s, to be ``gained``, 1/s^2."""
    whole, share, bends = inertia.bending, inertia.with_loss, len(order) // 2
    first = len(order) - bends
    square = along = speed = pulled = 0.0
    for i in range(bends):
        w, dw, ddw = y[i] + share * y[first + i], rate[i] + share * rate[first + i], gained[i] + share * gained[first + i]
        square += w * w
        along += w * dw
        speed += dw * dw
        pulled += w * ddw
    in_plane, out_of_it = 1.0 + inertia.inward * square, 1.0 + (inertia.across + inertia.across_more * square) * square
    both = 1.0 / (in_plane * out_of_it)
    inward, across = out_of_it * both, in_plane * both
    # the energy is (of_across w'^2 + more (w.w')^2) / 2; how of_across falls and more changes is by the square
    of_across, more = whole * across, whole * both * (inertia.across - inertia.inward + inertia.across_more * square)
    grows = (inertia.across + 2.0 * inertia.across_more * square) * across
    falls, changes = of_across * grows, whole * both * inertia.across_more - more * (inertia.inward * inward + grows)
    outward = more * (speed + pulled) + changes * along * along + falls * speed
    by_rate, scale, down = -2.0 * falls * along, 1.0, 0.0
    if len(order) == 5:
        longer, near = 1.0 + y[2], 1.0 / (1.0 + (inertia.nearer + inertia.nearer_more * square) * square)
        sinks = (inertia.nearer + 2.0 * inertia.nearer_more * square) * near
        slope = -inertia.reach * sinks * near  # of S by the square, and how it changes
        curves = 2.0 * inertia.reach * near * (sinks * sinks - inertia.nearer_more * near)
        coming = slope * (speed + pulled) + 2.0 * curves * along * along
        out[2] += (inertia.beyond + inertia.reach * near) * gained[2] + 2.0 * slope * along * rate[2]
        out[2] += longer * (coming - of_across * speed - more * along * along)
        scale, faster = longer * longer, 2.0 * longer * rate[2]
        by_rate, down = scale * by_rate + faster * of_across, longer * slope * gained[2] + faster * more * along
    by_shape = scale * outward + down
    for i in range(bends):
        k = first + i
        w, dw, ddw = y[i] + share * y[k], rate[i] + share * rate[k], gained[i] + share * gained[k]
        force = scale * of_across * ddw + by_rate * dw + by_shape * w
        out[i] += force
        out[k] += share * force + inertia.loss * gained[k]
