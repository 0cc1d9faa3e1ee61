"""The energy ROM in torch: batched and differentiable, the same equations as ``pod.kernel`` to round-off."""

import numpy as np
import torch
from torch import Tensor

from softrl.artifacts.reduced_model import ReducedModel
from softrl.pod.kernel import AGAIN, LONGEST_STEP
from softrl.pod.potential import PIVOT
from softrl.pod.tables import tables_of
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
    mass_root: Tensor
    stiffness_root: Tensor
    mass_slope: Tensor
    give: Tensor
    give_root: Tensor
    drag_root: Tensor
    elastic: Tensor
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
            "frame", "inverse", "gradient", "mass_root", "stiffness_root", "mass_slope", "degrees", "quadratic",
            "give", "give_root", "drag_root",
        ):  # fmt: skip
            self.register_buffer(name, torch.tensor(getattr(tables, name), dtype=dtype))
        pairs = np.zeros((r, r), dtype=int)
        pairs[np.triu_indices(r)] = np.arange(r * (r + 1) // 2)
        pairs = pairs + np.triu(pairs, 1).T
        for name in ("hessian", "elastic"):
            self.register_buffer(name, torch.tensor(getattr(tables, name)[pairs.ravel()], dtype=dtype))
        scales = [float(scale) for scale in tables.scales]
        self.mass_scale, self.mass_damping, self.stiffness_damping, self.wall = scales
        roots = tables.mass_root, tables.stiffness_root, tables.give, tables.give_root, tables.drag_root
        most = max(tables.gradient.shape[1], tables.elastic.shape[1], *(root.shape[1] for root in roots))
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
        mass, turning, *_ = self._inertia(y, rate)
        stiff, *_ = self._viscosity(y)
        viscous = _times(self.stiffness_damping * stiff + self.mass_damping * mass, rate)
        inside = _times(self.mass_scale * mass, change) - self.mass_scale * turning + viscous + self._slope(y)
        return inside @ self.inverse - load

    def step(
        self, z: Tensor, velocity: Tensor, inner: Tensor, load: Tensor, dt_s: float
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return z, its rate (B, n + 3) and ``inner`` (B, 2, 3) ``dt_s`` later, by implicit Euler.

        The load is held. The iteration runs outside the graph; a last Newton step from its end carries the exact first
        derivatives. ``inner`` is that of ``pod.inside``.
        """
        start, rate = z @ self.inverse.T, velocity @ self.inverse.T
        held = mass, turning, couple, own, give = self._inertia(start + dt_s * rate, rate)
        gives, ahead = inner[:, 0], start + dt_s * rate
        outer = load @ self.frame
        inertia, right, *_ = self._sides(held, self._resistance(start, dt_s * rate), start, rate, inner, outer, dt_s)
        first = self._direction(ahead, inertia, self._slope(ahead) + _times(inertia, ahead) - right)
        sides = self._sides(held, self._resistance(start, ahead - first - start), start, rate, inner, outer, dt_s)
        inertia, right, apart, push, pull = sides
        with torch.no_grad():
            y = self._solve(ahead, inertia, right)
            jacobian = self._curvature(y) + inertia
        left = self._slope(y) + _times(inertia, y) - right
        y = y - torch.linalg.solve(jacobian, left.unsqueeze(-1)).squeeze(-1)
        given = _times(apart, push - _times(pull.transpose(1, 2), y))
        moved, giving = (y - start) / dt_s, (given - gives) / dt_s
        spared = _dot(moved, _times(mass, moved)) + _shared(moved, giving, couple, own) - 2.0 * dt_s * _dot(turning, moved)
        bent = _dot(given, _times(give, given))
        for _ in range(AGAIN):
            later, _, couple, own, give = self._inertia(y + dt_s * moved, moved)
            now = _dot(moved, _times(later, moved)) + _shared(moved, giving, couple, own)
            ratio = _root_ratio(spared.clamp(min=0.0), now)
            moved, giving = moved * ratio, giving * ratio
        now = _dot(given, _times(give, given))
        given = given * _root_ratio(torch.minimum(bent, now), now)
        return y @ self.frame.T, moved @ self.frame.T, torch.stack([given, giving], dim=1)

    def _sides(
        self, held: tuple[Tensor, ...], resistance: tuple[Tensor, ...], start: Tensor, rate: Tensor, inner: Tensor,
        outer: Tensor, dt_s: float,
    ) -> tuple[Tensor, ...]:
        """Return what is constant in a step, ``inertia`` y - ``right``, and by what the inside follows from y."""
        (mass, turning, couple, own, give), (stiff, steep, drag, tough) = held, resistance
        free, rub, viscous = self.mass_scale / dt_s**2, self.mass_damping / dt_s, self.stiffness_damping / dt_s
        gives, giving = inner.unbind(1)
        flown = free * (gives + dt_s * giving) + rub * gives
        moved = free * (start + dt_s * rate) + rub * start
        inertia = (free + rub) * mass + viscous * stiff
        right = outer + self.mass_scale * turning + _times(mass, moved) + viscous * (_times(stiff, start) - steep)
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

    def _resistance(self, start: Tensor, by: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return viscosity half way of a step ``by`` (B, r), the force (B, r) of its slope, and the inside's viscosities."""
        half = start + 0.5 * by
        keep = torch.is_grad_enabled() and half.requires_grad
        with torch.enable_grad():
            middle = half if keep else half.detach().requires_grad_()
            parts = self._viscosity(middle)
            square = _dot(by, _times(parts[0], by)) + 0.0 * middle.sum(1)  # constant maps have a gradient, too
            (steep,) = torch.autograd.grad(square.sum(), middle, create_graph=keep)
        stiff, drag, tough, square = (part if keep else part.detach() for part in (*parts, square))
        driven = -0.25 * _dot(steep, by) / square.clamp(min=TINY)
        return stiff, 0.25 * steep / driven.clamp(min=1.0).unsqueeze(1), drag, tough

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

    def _inertia(self, y: Tensor, rate: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Return mass (B, r, r) in y, and the force (B, r) of inertia at constant ``rate``, both at scale 1.

        After them come the inside's mass with the coordinates (B, r, 3), its own (B, 3, 3) and its stiffness (B, 3, 3).
        """
        u, radius = self._ball(y)
        maps = self.mass_root, self.give_root, self.give
        values, r = self._monomials(u, max(part.shape[1] for part in maps)), self.order
        root, rows, give = (values[:, : part.shape[1]] @ part.T for part in maps)
        root, give = root.reshape(-1, r, r), give.reshape(-1, 3, 3)
        slope = (values[:, : self.mass_slope.shape[1]] @ self.mass_slope.T).reshape(-1, r, r, r)  # by, row, column

        def tangent(x: Tensor) -> Tensor:
            return torch.where(radius > 1.0, x - u * _dot(u, x).unsqueeze(1), x) / radius

        moved, turned = _times(root, rate), torch.einsum("bjai,bi->bja", slope, rate)
        along = tangent(rate)
        changed = torch.einsum("bja,bj->ba", turned, along)
        force = tangent(_times(turned, moved))
        force = force - torch.einsum("bjai,bj,ba->bi", slope, along, moved) - _times(root.transpose(1, 2), changed)
        couple, own = _beside(root, rows)
        return root.transpose(1, 2) @ root, force, couple, own, _square(give)

    def _viscosity(self, y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return viscosity (B, r, r) in y, the inside's with the coordinates (B, r, 3) and its own (B, 3, 3)."""
        u, _ = self._ball(y)
        roots = self.stiffness_root, self.drag_root
        values = self._monomials(u, max(self.elastic.shape[1], *(root.shape[1] for root in roots)))
        behind = self._elastic_factor(values).transpose(1, 2)
        stiff, rows = (values[:, : root.shape[1]] @ root.T for root in roots)
        stiff = stiff.reshape(-1, self.order, self.order) @ behind
        return _square(stiff), *_beside(stiff, rows)

    def _elastic_factor(self, values: Tensor) -> Tensor:
        """Return U (B, r, r) of ``pod.potential.fill_elastic_factor``."""
        r = self.order
        hessian = (values[:, : self.elastic.shape[1]] @ self.elastic.T).reshape(-1, r, r)
        columns: dict[int, Tensor] = {}
        rest = self.elastic[:: r + 1, 0]
        size = torch.maximum(hessian.diagonal(dim1=1, dim2=2), rest)
        for j in range(r - 1, -1, -1):
            column = hessian[:, : j + 1, j]
            for k in range(j + 1, r):
                column = column - columns[k][:, : j + 1] * columns[k][:, j : j + 1]
            least = torch.cat([column[:, :j] ** 2 / size[:, :j], PIVOT * rest[j].expand(len(column), 1)], dim=1)
            pivot = torch.maximum(column[:, j : j + 1], least.amax(1, keepdim=True)).sqrt()
            columns[j] = torch.cat([column[:, :j] / pivot, pivot, torch.zeros_like(hessian[:, j + 1 :, j])], dim=1)
        return torch.stack([columns[j] for j in range(r)], dim=2)


def _ray(degree: Tensor, radius: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return w_d and its two derivatives (B, k) at ``radius`` (B, 1); see ``pod.kernel``."""
    beyond, bend = radius - 1.0, degree * (degree - 1.0)
    return 1.0 + beyond * (degree + 0.5 * bend * beyond), degree + bend * beyond, bend.expand(len(radius), -1)


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)


def _dot(left: Tensor, right: Tensor) -> Tensor:
    return (left * right).sum(1)


def _root_ratio(goal: Tensor, now: Tensor) -> Tensor:
    """Return the factors (B, 1) whose squares bring ``now`` to ``goal``; 1 where there is nothing to scale."""
    still = now <= 0.0
    ratio = torch.where(still, torch.ones_like(now), goal) / torch.where(still, torch.ones_like(now), now)
    return ratio.clamp(min=1e-30).sqrt().unsqueeze(1)


def _beside(root: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
    """Return R'A (B, r, 3) and A'A + B'B (B, 3, 3) of ``root`` R (B, r, r) and ``rows``, A above B."""
    rows = rows.reshape(len(rows), -1, 3)
    return root.transpose(1, 2) @ rows[:, : root.shape[1]], rows.transpose(1, 2) @ rows


def _shared(moved: Tensor, giving: Tensor, couple: Tensor, own: Tensor) -> Tensor:
    """Return twice the kinetic energy (B,) of the inside and of what it shares with the coordinates."""
    return _dot(giving, _times(own, giving)) + 2.0 * _dot(moved, _times(couple, giving))


def _square(root: Tensor) -> Tensor:
    return root.transpose(1, 2) @ root
