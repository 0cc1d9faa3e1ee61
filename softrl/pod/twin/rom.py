"""The energy ROM in torch: batched and differentiable, the same equations as ``pod.step.kernel`` to round-off."""

import numpy as np
import torch
from torch import Tensor

from softrl.artifacts.reduced_model import SHAPES, ReducedModel
from softrl.pod.step.kernel import LONGEST_STEP, NEAR, SCALINGS
from softrl.pod.step.reach import warn_beyond
from softrl.pod.step.tables import tables_of
from softrl.pod.step.viscosity import TINY
from softrl.pod.twin.algebra import beside, dot, inverse, ray, share_of, square, times, triangle
from softrl.pod.twin.energy import kinetic_energy, work_of_inertia

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
        self._model = model
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

    def residual(self, path: Tensor, load: Tensor, dt_s: float) -> Tensor:
        """Return what the last step of ``path`` leaves in the balance of forces (B, n + 3), Pa and N: zero along a motion.

        ``path`` (B, K, n + 3) are K >= 3 positions on the time step, ``load`` (B, n + 3) is held over the last step. The body's
        inside is not in them; it is followed along the path, from where it gave nothing, and forgets that within some steps.
        """
        path, outer = path @ self.inverse.T, load @ self.frame
        before, now, after = path[:, -3:].unbind(1)
        rate = (now - before) / dt_s
        amplitudes = self._amplitudes(before)[0], self._amplitudes(now)[0]
        held = self._inertia(after), self._resistance(now, after - now), self._give(now + 0.5 * dt_s * rate), amplitudes
        inner = self._followed(path[:, :-1], dt_s)
        inertia, right, *_ = self._sides(held, after, now, rate, inner, outer, dt_s)
        return (self._slope(after) + times(inertia, after) - right) @ self.inverse

    @torch.no_grad()
    def _followed(self, path: Tensor, dt_s: float) -> Tensor:
        """Return ``inner`` (B, 2, 6) at the end of a ``path`` (B, K, r) of the coordinates, along which it starts with zero."""
        inner = path.new_zeros(len(path), 2, SHAPES)
        if path.shape[1] < 3:
            return inner
        before, now, after = (path[:, i : path.shape[1] - 2 + i].flatten(0, 1) for i in range(3))
        values = self._monomials(self._ball(0.5 * (now + after))[0], self._few)
        drag = beside(self._root(values), values[:, : self.drag_root.shape[1]] @ self.drag_root.T)
        mass, give = self._inertia(after)[2:], self._give(1.5 * now - 0.5 * before)
        parts = [part.unflatten(0, (len(path), -1)) for part in (*mass, *drag, give)]
        for k in range(path.shape[1] - 2):
            rate = (path[:, k + 1] - path[:, k]) / dt_s
            apart, push, pull = self._ties(tuple(part[:, k] for part in parts), path[:, k + 1], rate, inner, dt_s)
            given = times(apart, push - times(pull.transpose(1, 2), path[:, k + 2]))
            inner = torch.stack([given, (given - inner[:, 0]) / dt_s], dim=1)
        return inner

    def step(
        self, z: Tensor, velocity: Tensor, inner: Tensor, load: Tensor, dt_s: float
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return z, its rate (B, n + 3) and ``inner`` (B, 2, 6) ``dt_s`` later, by implicit Euler.

        The load is held. The iteration runs outside the graph; a last Newton step from its end carries the exact first
        derivatives. ``inner`` is that of ``pod.step.inside``.
        """
        start, rate = z @ self.inverse.T, velocity @ self.inverse.T
        gives, giving = inner.unbind(1)
        ahead, outer = start + dt_s * rate, load @ self.frame
        before, now = self._amplitudes(start - dt_s * rate)[0], self._amplitudes(start)[0]
        give = self._give(start + 0.5 * dt_s * rate)
        kinetic = kinetic_energy(rate, giving, (now - before) / dt_s, *self._inertia(start)[2:])
        aim = self._foretold(give, (before, now), start, rate, inner, outer, dt_s)
        held = self._inertia(aim), self._resistance(start, aim - start), give, (before, now)
        sides = self._sides(held, aim, start, rate, inner, outer, dt_s)
        by = self._back(aim, *sides[:2])
        far = by.abs().amax(1, keepdim=True) >= NEAR
        if far.any():
            aim = torch.where(far, aim - by, aim)
            held = self._inertia(aim), self._resistance(start, aim - start), *held[2:]
            sides = self._sides(held, aim, start, rate, inner, outer, dt_s)
        inertia, right, apart, push, pull = sides
        with torch.no_grad():
            y = self._solve(ahead, inertia, right)
            warn_beyond(self._model, float(y.norm(dim=1).max()))
            jacobian = self._curvature(y) + inertia
        left = self._slope(y) + times(inertia, y) - right
        y = y - torch.linalg.solve(jacobian, left.unsqueeze(-1)).squeeze(-1)
        given = times(apart, push - times(pull.transpose(1, 2), y))
        moved, given_by = (y - start) / dt_s, (given - gives) / dt_s
        most = kinetic + work_of_inertia(y - aim, moved, rate, given_by, giving, held, dt_s)
        arrived, (_, _, couple, own) = self._amplitudes(y)[0], held[0]
        by = (arrived - now) / dt_s
        for _ in range(SCALINGS):
            energy = kinetic_energy(moved, given_by, by, couple, own)
            if not (energy > most.clamp(min=0.0)).any():
                break
            share = share_of(most, energy)
            moved, given_by = share * moved, share * given_by
            by = (arrived - self._amplitudes(y - dt_s * moved)[0]) / dt_s
        after = self._give(y + 0.5 * dt_s * moved)
        given = given * share_of(dot(given, times(give, given)), dot(given, times(after, given)))
        return y @ self.frame.T, moved @ self.frame.T, torch.stack([given, given_by], dim=1)

    def _foretold(
        self, give: Tensor, course: tuple[Tensor, Tensor], start: Tensor, rate: Tensor, inner: Tensor, outer: Tensor, dt_s: float
    ) -> Tensor:
        """Return where (B, r) a step from ``start`` leads by what one at ``rate`` before it tells, see ``pod.step.past``."""
        by = dt_s * rate
        stiff = square(self._root(self._monomials(self._ball(start + 0.5 * by)[0], self._few)))
        held = self._inertia(start), (stiff, *self._resistance(start - by, by)[1:]), give, course
        inertia, right, *_ = self._sides(held, start, start, rate, inner, outer, dt_s)
        curve, before, ahead = self._curvature(start), self._curvature(start - by), start + by
        left = self._slope(start) + times(1.5 * curve - 0.5 * before, by) + times(inertia, ahead) - right
        return ahead - self._direction(2.0 * curve - before + inertia, left)

    def _sides(
        self, held: tuple[tuple[Tensor, ...], tuple[Tensor, ...], Tensor, tuple[Tensor, Tensor]], aim: Tensor, start: Tensor,
        rate: Tensor, inner: Tensor, outer: Tensor, dt_s: float,
    ) -> tuple[Tensor, ...]:
        """Return what is constant in a step, ``inertia`` y - ``right``, and by what the inside follows from y.

        Amplitudes are taken at ``aim`` (B, r).
        """
        (amplitudes, lead, couple, own), (stiff, steep, drag, tough), give, course = held
        free, rub, viscous = self._weights(dt_s)
        flown = free * (inner[:, 0] + dt_s * inner[:, 1]) + rub * inner[:, 0]
        (before, now), mass = course, (free + rub) * square(lead)
        force = free * (amplitudes - 2.0 * now + before) + rub * (amplitudes - now)
        right = outer - times(lead.transpose(1, 2), force) + times(mass, aim) + viscous * (times(stiff, start) - steep)
        right = right + times(couple, flown) + viscous * times(drag, inner[:, 0])
        apart, push, pull = self._ties((couple, own, drag, tough, give), start, rate, inner, dt_s)
        share = pull @ apart
        return mass + viscous * stiff - share @ pull.transpose(1, 2), right - times(share, push), apart, push, pull

    def _ties(
        self, inside: tuple[Tensor, ...], start: Tensor, rate: Tensor, inner: Tensor, dt_s: float
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return apart (B, 6, 6), push (B, 6) and pull (B, r, 6): the inside ends a step at apart (push - pull' y).

        ``inside`` are its masses with y and its own, viscosities likewise, and stiffness.
        """
        (couple, own, drag, tough, give), (free, rub, viscous) = inside, self._weights(dt_s)
        flown = free * (inner[:, 0] + dt_s * inner[:, 1]) + rub * inner[:, 0]
        moved = free * (start + dt_s * rate) + rub * start
        pull = (free + rub) * couple + viscous * drag
        push = times(own, flown) + viscous * times(tough, inner[:, 0])
        push = push + times(couple.transpose(1, 2), moved) + viscous * times(drag.transpose(1, 2), start)
        return inverse((free + rub) * own + viscous * tough + give), push, pull

    def _weights(self, dt_s: float) -> tuple[float, float, float]:
        """Return by what a step multiplies mass for inertia and damping, and viscosity."""
        return self.mass_scale / dt_s**2, self.mass_damping / dt_s, self.stiffness_damping / dt_s

    def _back(self, y: Tensor, inertia: Tensor, right: Tensor) -> Tensor:
        """Return by how much (B, r) an iteration of Newton's goes back from ``y``."""
        return self._direction(self._curvature(y) + inertia, self._slope(y) + times(inertia, y) - right)

    def _direction(self, jacobian: Tensor, left: Tensor) -> Tensor:
        """Return by how much (B, r) an iteration of Newton's goes back from where the forces ``left`` (B, r) are."""
        _, bad = torch.linalg.cholesky_ex(jacobian)
        jacobian = jacobian + (bad > 0).to(left.dtype)[:, None, None] * self.quadratic
        step = torch.linalg.solve(jacobian, left.unsqueeze(-1)).squeeze(-1)
        return step / (step.abs().amax(1, keepdim=True) / LONGEST_STEP).clamp(min=1.0)

    def _inertia(self, aim: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return amplitudes (B, k) at ``aim``, their gradient (B, k, r), and the inside's mass with y and its own there."""
        u, _ = self._ball(aim)
        values = self._monomials(u, self._few)
        lead = self._lead(values)
        root = torch.linalg.cholesky(square(lead), upper=True)
        rows = values[:, : self.inner_root.shape[1]] @ self.inner_root.T
        return self._straight(aim, u, values, lead), lead, *beside(root, rows)

    def _amplitudes(self, y: Tensor) -> tuple[Tensor, Tensor]:
        """Return the amplitudes (B, k) at ``y`` and their gradient (B, k, r)."""
        u, _ = self._ball(y)
        values = self._monomials(u, self._few)
        lead = self._lead(values)
        return self._straight(y, u, values, lead), lead

    def _straight(self, y: Tensor, u: Tensor, values: Tensor, lead: Tensor) -> Tensor:
        """Return the amplitudes, which go on straight outside the ball, by the monomials and the gradient at ``u`` in it."""
        return values[:, : self.amplitudes.shape[1]] @ self.amplitudes.T + times(lead, y - u)

    def _lead(self, values: Tensor) -> Tensor:
        """Return the amplitudes' gradient (B, k, r) at monomials ``values``."""
        lead = values[:, : self.amplitude_slope.shape[1]] @ self.amplitude_slope.T
        return lead.reshape(len(values), -1, self.order)

    def _resistance(self, start: Tensor, by: Tensor) -> tuple[Tensor, ...]:
        """Return viscosity half way of a step ``by`` (B, r), the force (B, r) of its slope, and the inside's viscosities."""
        stiff, steep, root, values = self._chord(start + 0.5 * by, by)
        driven = -dot(steep, by) / dot(by, times(stiff, by)).clamp(min=TINY)
        drag = beside(root, values[:, : self.drag_root.shape[1]] @ self.drag_root.T)
        return stiff, steep / driven.clamp(min=1.0).unsqueeze(1), *drag

    def _chord(self, half: Tensor, by: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return viscosity ``half`` way of a step ``by``, what ``pod.step.chord`` adds, its root and the monomials there."""
        keep = torch.is_grad_enabled() and half.requires_grad
        with torch.enable_grad():
            middle = half if keep else half.detach().requires_grad_()
            values = self._monomials(self._ball(middle)[0], self._few)
            root = self._root(values)
            moved = times(root, by)
            spent = dot(moved, moved) + 0.0 * middle.sum(1)  # constant maps have a gradient, too
            (slope,) = torch.autograd.grad(spent.sum(), middle, create_graph=keep)
        root, values = (part if keep else part.detach() for part in (root, values))
        return square(root), 0.25 * slope, root, values

    def _root(self, values: Tensor) -> Tensor:
        """Return S L' (B, r, r) of viscosity at monomials ``values``."""
        entries = values[:, : self.stiffness_root.shape[1]] @ self.stiffness_root.T
        return entries.reshape(-1, self.order, self.order) @ self.stiffness_factor.T

    def _give(self, y: Tensor) -> Tensor:
        """Return the inside's stiffness (B, 6, 6)."""
        values = self._monomials(self._ball(y)[0], self.inner_give.shape[1])
        return square(triangle(values @ self.inner_give.T))

    def _solve(self, y: Tensor, inertia: Tensor, right: Tensor) -> Tensor:
        """Return the solution of the implicit step, by Newton with halved steps where the slope along them turns."""
        left = self._slope(y) + times(inertia, y) - right
        for _ in range(NEWTON):
            step = self._direction(self._curvature(y) + inertia, left)
            before = (left * step).sum(1)
            share = torch.ones_like(before).unsqueeze(1)
            for _ in range(6):
                trial = y - share * step
                left = self._slope(trial) + times(inertia, trial) - right
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
        weight, slope, _ = ray(degree, radius)
        along = ((slope - degree * weight / radius) / degree * values) @ self.gradient.T
        wall = 3.0 * self.wall * (radius - 1.0) ** 2
        return (weight / radius * values) @ self.gradient.T + u * ((u * along).sum(1, keepdim=True) + wall)

    def _curvature(self, y: Tensor) -> Tensor:
        """Return the potential's Hessian (B, r, r) J."""
        u, radius = self._ball(y)
        count, few = self.gradient.shape[1], self.hessian.shape[1]
        values, degree = self._monomials(u, count), self.degrees[:count] + 1.0
        weight, slope, bend = ray(degree, radius)
        first = slope - degree * weight / radius
        second = bend - 2.0 * degree * slope / radius + degree * (degree + 1.0) * weight / radius**2
        side = (first * values) @ self.gradient.T / radius
        along = (u * ((first / degree * values) @ self.gradient.T)).sum(1)[:, None, None] / radius.unsqueeze(-1)
        bending = (u * ((second / degree * values) @ self.gradient.T)).sum(1)[:, None, None]
        flat, _, _ = ray(self.degrees[:few] + 2.0, radius)
        inner = ((flat / radius**2 * values[:, :few]) @ self.hessian.T).reshape(-1, self.order, self.order)
        cross = side.unsqueeze(2) * u.unsqueeze(1)
        outer = u.unsqueeze(2) * u.unsqueeze(1)
        identity = torch.eye(self.order, dtype=y.dtype, device=y.device)
        beyond = (radius - 1.0).unsqueeze(-1)
        along = along + 3.0 * self.wall * beyond**2 / radius.unsqueeze(-1)
        bending = bending + 6.0 * self.wall * beyond
        return inner + cross + cross.transpose(1, 2) + (bending - along) * outer + along * identity
