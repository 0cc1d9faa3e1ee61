"""The energy ROM in torch: batched and differentiable, the same equations as ``pod.kernel`` to round-off."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from softrl.artifacts.reduced_model import SHAPES, TRIANGLE, ReducedModel
from softrl.pod.kernel import LONGEST_STEP, SCALINGS
from softrl.pod.tables import gradient_of, tables_of
from softrl.pod.viscosity import TINY

NEWTON = 30
TOLERANCE = 1e-10


class TorchRom(torch.nn.Module):
    """Equations of motion of a reduced model, without effects.

    Parameters
    ----------
    model : the reduced model
    gravity_m_s2 : (3,) in the base frame; the model's own if None. The snapshots' equilibria are without weight.
    youngs_modulus_scale, damping_scale, mass_scale : as in ``RomSimulator``
    dtype : of all tensors; single precision resolves about 1e-5 of the motion

    Notes
    -----
    Coordinates z are (B, n + 3) m^3 and m, loads Pa and N, in the order of ``ReducedModel``.
    """

    frame: Tensor
    inverse: Tensor
    gradient: Tensor
    hessian: Tensor
    amplitudes: Tensor
    amplitude_slope: Tensor
    amplitude_bend: Tensor
    stiffness_root: Tensor
    stiffness_factor: Tensor
    inner_give: Tensor
    inner_root: Tensor
    drag_root: Tensor
    degrees: Tensor
    quadratic: Tensor

    def __init__(
        self,
        model: ReducedModel,
        gravity_m_s2: np.ndarray | None = None,
        youngs_modulus_scale: float = 1.0,
        damping_scale: float = 1.0,
        mass_scale: float = 1.0,
        dtype: torch.dtype = torch.float64,
    ) -> None:
        super().__init__()
        tables = tables_of(model, gravity_m_s2, youngs_modulus_scale, damping_scale, mass_scale)
        self.order = r = model.order
        for name in (
            "frame", "inverse", "gradient", "amplitudes", "amplitude_slope", "stiffness_factor", "degrees", "quadratic",
            "inner_give", "inner_root", "drag_root",
        ):  # fmt: skip
            self.register_buffer(name, torch.tensor(getattr(tables, name), dtype=dtype))
        pairs = np.zeros((r, r), dtype=int)
        pairs[np.triu_indices(r)] = np.arange(r * (r + 1) // 2)
        pairs = pairs + np.triu(pairs, 1).T
        for name in ("hessian", "stiffness_root"):
            self.register_buffer(name, torch.tensor(getattr(tables, name)[pairs.ravel()], dtype=dtype))
        bend = gradient_of(tables.amplitude_slope, r)
        self.register_buffer("amplitude_bend", torch.tensor(bend.reshape(-1, bend.shape[-1]), dtype=dtype))
        scales = [float(scale) for scale in tables.scales]
        self.mass_scale, self.mass_damping, self.stiffness_damping, self.wall = scales
        roots = tables.amplitudes, tables.stiffness_root, tables.inner_give, tables.inner_root, tables.drag_root
        self._few = max(root.shape[1] for root in roots)
        most = max(tables.gradient.shape[1], self._few)
        self._levels: list[tuple[Tensor, Tensor]] = []
        for degree in range(1, int(tables.degrees[most - 1]) + 1):
            level = np.flatnonzero(tables.degrees == degree)
            first = int(np.flatnonzero(tables.degrees == degree - 1)[0])
            self._levels.append((torch.tensor(tables.parent[level] - first), torch.tensor(tables.variable[level])))

    def residual(self, z: Tensor, velocity: Tensor, acceleration: Tensor, load: Tensor) -> Tensor:
        """Return M a + M' v - grad(v'M v) / 2 + D v + dW/dz - weight - load, (B, n + 3) Pa and N; zero along a motion.

        That the body's inside gives to acceleration, a few per cent of inertia in a fast motion, is left out.
        """
        y, rate, change = z @ self.inverse.T, velocity @ self.inverse.T, acceleration @ self.inverse.T
        u, radius = self._ball(y)
        values = self._monomials(u, self._few)
        lead, bent = self._lead(values), self._bent(values, u, radius, rate)
        along = self.mass_scale * (_times(lead, change) + bent) + self.mass_damping * _times(lead, rate)
        viscous = self.stiffness_damping * _times(_square(self._root(values)), rate)
        inside = _times(lead.transpose(1, 2), along) + viscous + self._slope(y)
        return inside @ self.inverse - load

    def step(
        self, z: Tensor, velocity: Tensor, inner: Tensor, load: Tensor, dt_s: float
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return z, its rate (B, n + 3) and ``inner`` (B, 2, 6) ``dt_s`` later, by implicit Euler.

        The load is held. The iteration runs outside the graph; a last Newton step from its end carries the exact first
        derivatives. ``inner`` is that of ``pod.inside``.
        """
        start, rate = z @ self.inverse.T, velocity @ self.inverse.T
        gives, giving = inner.unbind(1)
        ahead, outer = start + dt_s * rate, load @ self.frame
        before, now = self._amplitudes(start - dt_s * rate), self._amplitudes(start)
        give = self._give(start + 0.5 * dt_s * rate)
        kinetic = _kinetic(rate, giving, (now - before) / dt_s, *self._inertia(start)[2:])
        held = self._inertia(ahead), self._resistance(start, dt_s * rate), give, (before, now)
        inertia, right, *_ = self._sides(held, ahead, start, rate, inner, outer, dt_s)
        first = ahead - self._direction(ahead, inertia, self._slope(ahead) + _times(inertia, ahead) - right)
        held = self._inertia(first), self._resistance(start, first - start), give, (before, now)
        inertia, right, apart, push, pull = self._sides(held, first, start, rate, inner, outer, dt_s)
        with torch.no_grad():
            y = self._solve(ahead, inertia, right)
            jacobian = self._curvature(y) + inertia
        left = self._slope(y) + _times(inertia, y) - right
        y = y - torch.linalg.solve(jacobian, left.unsqueeze(-1)).squeeze(-1)
        given = _times(apart, push - _times(pull.transpose(1, 2), y))
        moved, given_by = (y - start) / dt_s, (given - gives) / dt_s
        most = kinetic + _work(y - first, moved, rate, given_by, giving, held, dt_s)
        arrived, (_, _, couple, own) = self._amplitudes(y), held[0]
        by = (arrived - now) / dt_s
        for _ in range(SCALINGS):
            energy = _kinetic(moved, given_by, by, couple, own)
            if not (energy > most.clamp(min=0.0)).any():
                break
            share = _share_of(most, energy)
            moved, given_by = share * moved, share * given_by
            by = (arrived - self._amplitudes(y - dt_s * moved)) / dt_s
        after = self._give(y + 0.5 * dt_s * moved)
        given = given * _share_of(_dot(given, _times(give, given)), _dot(given, _times(after, given)))
        return y @ self.frame.T, moved @ self.frame.T, torch.stack([given, given_by], dim=1)

    def _sides(
        self, held: tuple[tuple[Tensor, ...], tuple[Tensor, ...], Tensor, tuple[Tensor, Tensor]], aim: Tensor, start: Tensor,
        rate: Tensor, inner: Tensor, outer: Tensor, dt_s: float,
    ) -> tuple[Tensor, ...]:
        """Return what is constant in a step, ``inertia`` y - ``right``, and by what the inside follows from y.

        Amplitudes are taken at ``aim`` (B, r).
        """
        (amplitudes, lead, couple, own), (stiff, steep, drag, tough), give, (before, now) = held
        free, rub, viscous = self.mass_scale / dt_s**2, self.mass_damping / dt_s, self.stiffness_damping / dt_s
        gives, giving = inner.unbind(1)
        flown = free * (gives + dt_s * giving) + rub * gives
        moved = free * (start + dt_s * rate) + rub * start
        mass = (free + rub) * _square(lead)
        force = free * (amplitudes - 2.0 * now + before) + rub * (amplitudes - now)
        inertia = mass + viscous * stiff
        right = outer - _times(lead.transpose(1, 2), force) - viscous * steep
        right = right + _times(mass, aim) + viscous * _times(stiff, start)
        right = right + _times(couple, flown) + viscous * _times(drag, gives)
        pull = (free + rub) * couple + viscous * drag
        push = _times(own, flown) + viscous * _times(tough, gives)
        push = push + _times(couple.transpose(1, 2), moved) + viscous * _times(drag.transpose(1, 2), start)
        apart = torch.linalg.pinv((free + rub) * own + viscous * tough + give, rtol=1e-12, hermitian=True)
        share = pull @ apart
        return inertia - share @ pull.transpose(1, 2), right - _times(share, push), apart, push, pull

    def _direction(self, y: Tensor, inertia: Tensor, left: Tensor) -> Tensor:
        """Return by how much (B, r) an iteration of Newton's takes ``y`` back."""
        jacobian = self._curvature(y) + inertia
        _, bad = torch.linalg.cholesky_ex(jacobian)
        jacobian = jacobian + (bad > 0).to(y.dtype)[:, None, None] * self.quadratic
        step = torch.linalg.solve(jacobian, left.unsqueeze(-1)).squeeze(-1)
        return step / (step.abs().amax(1, keepdim=True) / LONGEST_STEP).clamp(min=1.0)

    def _inertia(self, aim: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return amplitudes (B, k) at ``aim``, their gradient (B, k, r), and the inside's mass with y and its own there."""
        u, _ = self._ball(aim)
        values = self._monomials(u, self._few)
        lead = self._lead(values)
        root = torch.linalg.cholesky(_square(lead), upper=True)
        rows = values[:, : self.inner_root.shape[1]] @ self.inner_root.T
        return self._straight(aim, u, values, lead), lead, *_beside(root, rows)

    def _amplitudes(self, y: Tensor) -> Tensor:
        """Return the amplitudes (B, k) at ``y``."""
        u, _ = self._ball(y)
        values = self._monomials(u, self._few)
        return self._straight(y, u, values, self._lead(values))

    def _straight(self, y: Tensor, u: Tensor, values: Tensor, lead: Tensor) -> Tensor:
        """Return the amplitudes, which go on straight outside the ball, by the monomials and the gradient at ``u`` in it."""
        return values[:, : self.amplitudes.shape[1]] @ self.amplitudes.T + _times(lead, y - u)

    def _lead(self, values: Tensor) -> Tensor:
        """Return the amplitudes' gradient (B, k, r) at monomials ``values``."""
        lead = values[:, : self.amplitude_slope.shape[1]] @ self.amplitude_slope.T
        return lead.reshape(len(values), -1, self.order)

    def _bent(self, values: Tensor, u: Tensor, radius: Tensor, rate: Tensor) -> Tensor:
        """Return by how much the amplitudes' rates (B, k) change at constant ``rate``; ``values`` are the monomials at ``u``."""
        inward = torch.where(radius > 1.0, rate - u * _dot(u, rate).unsqueeze(1), rate) / radius
        bend = (values[:, : self.amplitude_bend.shape[1]] @ self.amplitude_bend.T).reshape(len(u), self.order, -1, self.order)
        return torch.einsum("bjai,bi,bj->ba", bend, rate, inward)

    def _resistance(self, start: Tensor, by: Tensor) -> tuple[Tensor, ...]:
        """Return viscosity half way of a step ``by`` (B, r), the force (B, r) of its slope, and the inside's viscosities."""
        stiff, steep, root, values = self._chord(start + 0.5 * by, by)
        driven = -_dot(steep, by) / _dot(by, _times(stiff, by)).clamp(min=TINY)
        drag = _beside(root, values[:, : self.drag_root.shape[1]] @ self.drag_root.T)
        return stiff, steep / driven.clamp(min=1.0).unsqueeze(1), *drag

    def _chord(self, half: Tensor, by: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return viscosity ``half`` way of a step ``by``, what ``pod.chord`` adds, its root and the monomials there."""
        keep = torch.is_grad_enabled() and half.requires_grad
        with torch.enable_grad():
            middle = half if keep else half.detach().requires_grad_()
            values = self._monomials(self._ball(middle)[0], self._few)
            root = self._root(values)
            moved = _times(root, by)
            square = _dot(moved, moved) + 0.0 * middle.sum(1)  # constant maps have a gradient, too
            (slope,) = torch.autograd.grad(square.sum(), middle, create_graph=keep)
        root, values = (part if keep else part.detach() for part in (root, values))
        return _square(root), 0.25 * slope, root, values

    def _root(self, values: Tensor) -> Tensor:
        """Return S L' (B, r, r) of viscosity at monomials ``values``."""
        entries = values[:, : self.stiffness_root.shape[1]] @ self.stiffness_root.T
        return entries.reshape(-1, self.order, self.order) @ self.stiffness_factor.T

    def _give(self, y: Tensor) -> Tensor:
        """Return the inside's stiffness (B, 6, 6)."""
        values = self._monomials(self._ball(y)[0], self.inner_give.shape[1])
        return _square(_triangle(values @ self.inner_give.T))

    def _solve(self, y: Tensor, inertia: Tensor, right: Tensor) -> Tensor:
        """Return the solution of the implicit step, by Newton with halved steps where the slope along them turns."""
        left = self._slope(y) + _times(inertia, y) - right
        for _ in range(NEWTON):
            step = self._direction(y, inertia, left)
            before = (left * step).sum(1)
            share = torch.ones_like(before).unsqueeze(1)
            for _ in range(6):
                trial = y - share * step
                left = self._slope(trial) + _times(inertia, trial) - right
                past = (left * step).sum(1) < -0.9 * before.abs()
                if not past.any() or step.abs().max() < TOLERANCE:
                    break
                share = torch.where(past.unsqueeze(1), 0.5 * share, share)
            y = trial
            if step.abs().max() < (TOLERANCE if y.dtype == torch.float64 else 1e-5):
                break
        return y

    def _ball(self, y: Tensor) -> tuple[Tensor, Tensor]:
        """Return the point (B, r) in the unit ball on the ray to ``y``, and max(|y|, 1) (B, 1)."""
        radius = (y * y).sum(1, keepdim=True).clamp(min=1.0).sqrt()
        return y / radius, radius

    def _monomials(self, point: Tensor, count: int) -> Tensor:
        """Return the first ``count`` monomials (B, count)."""
        levels, total = [torch.ones_like(point[:, :1])], 1
        for parent, variable in self._levels:
            if total >= count:
                break
            levels.append(levels[-1][:, parent] * point[:, variable])
            total += len(parent)
        return torch.cat(levels, dim=1)

    def _slope(self, y: Tensor) -> Tensor:
        """Return the potential's gradient (B, r) J."""
        u, radius = self._ball(y)
        count = self.gradient.shape[1]
        values, degree = self._monomials(u, count), self.degrees[:count] + 1.0
        weight, slope, _ = _ray(degree, radius)
        along = ((slope - degree * weight / radius) / degree * values) @ self.gradient.T
        wall = 3.0 * self.wall * (radius - 1.0) ** 2
        return (weight / radius * values) @ self.gradient.T + u * ((u * along).sum(1, keepdim=True) + wall)

    def _curvature(self, y: Tensor) -> Tensor:
        """Return the potential's Hessian (B, r, r) J."""
        u, radius = self._ball(y)
        count, few = self.gradient.shape[1], self.hessian.shape[1]
        values, degree = self._monomials(u, count), self.degrees[:count] + 1.0
        weight, slope, bend = _ray(degree, radius)
        first = slope - degree * weight / radius
        second = bend - 2.0 * degree * slope / radius + degree * (degree + 1.0) * weight / radius**2
        side = (first * values) @ self.gradient.T / radius
        along = (u * ((first / degree * values) @ self.gradient.T)).sum(1)[:, None, None] / radius.unsqueeze(-1)
        bending = (u * ((second / degree * values) @ self.gradient.T)).sum(1)[:, None, None]
        flat, _, _ = _ray(self.degrees[:few] + 2.0, radius)
        inner = ((flat / radius**2 * values[:, :few]) @ self.hessian.T).reshape(-1, self.order, self.order)
        cross = side.unsqueeze(2) * u.unsqueeze(1)
        outer = u.unsqueeze(2) * u.unsqueeze(1)
        identity = torch.eye(self.order, dtype=y.dtype, device=y.device)
        beyond = (radius - 1.0).unsqueeze(-1)
        along = along + 3.0 * self.wall * beyond**2 / radius.unsqueeze(-1)
        bending = bending + 6.0 * self.wall * beyond
        return inner + cross + cross.transpose(1, 2) + (bending - along) * outer + along * identity


def _ray(degree: Tensor, radius: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return w_d and its two derivatives (B, k) at ``radius`` (B, 1); see ``pod.kernel``."""
    beyond, bend = radius - 1.0, degree * (degree - 1.0)
    return 1.0 + beyond * (degree + 0.5 * bend * beyond), degree + bend * beyond, bend.expand(len(radius), -1)


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)


def _dot(left: Tensor, right: Tensor) -> Tensor:
    return (left * right).sum(1)


def _share_of(goal: Tensor, now: Tensor) -> Tensor:
    """Return the factors (B, 1), at most 1, whose squares bring what has the energy ``now`` down to ``goal``."""
    more = now > goal.clamp(min=0.0)
    ratio = torch.where(more, goal.clamp(min=0.0), torch.ones_like(now)) / torch.where(more, now, torch.ones_like(now))
    return ratio.clamp(min=1e-30).sqrt().unsqueeze(1)


def _kinetic(rate: Tensor, giving: Tensor, moved: Tensor, couple: Tensor, own: Tensor) -> Tensor:
    """Return twice the kinetic energies (B,), those of the inside in them; ``moved`` (B, k) are the amplitudes' rates."""
    return _dot(moved, moved) + 2.0 * _dot(rate, _times(couple, giving)) + _dot(giving, _times(own, giving))


def _work(
    off: Tensor, rate: Tensor, former: Tensor, giving: Tensor, formerly: Tensor, held: tuple[Any, ...], dt_s: float
) -> Tensor:
    """Return twice the works (B,) of ``pod.inertia.work_of_inertia``; ``off`` (B, r) is how far from its aim a step ends."""
    (amplitudes, lead, couple, own), _, _, (before, now) = held
    change = (amplitudes - 2.0 * now + before + _times(lead, off)) / dt_s
    force = _times(lead.transpose(1, 2), change) + _times(couple, giving - formerly)
    inner = _times(own, giving - formerly) + _times(couple.transpose(1, 2), rate - former)
    return 2.0 * (_dot(force, rate) + _dot(inner, giving))


def _beside(root: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
    """Return R'A (B, r, 6) and A'A + B'B (B, 6, 6) of ``root`` R (B, r, r) and ``rows``, A and the triangle B."""
    above, below = rows[:, :-TRIANGLE].reshape(len(rows), -1, SHAPES), _triangle(rows[:, -TRIANGLE:])
    return root.transpose(1, 2) @ above, _square(above) + _square(below)


def _triangle(rows: Tensor) -> Tensor:
    """Return upper triangles (B, 6, 6) of their ``rows`` (B, 21)."""
    i, j = torch.triu_indices(SHAPES, SHAPES, device=rows.device)
    whole = rows.new_zeros(len(rows), SHAPES, SHAPES)
    whole[:, i, j] = rows
    return whole


def _square(root: Tensor) -> Tensor:
    return root.transpose(1, 2) @ root
