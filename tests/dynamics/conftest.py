"""A body with a known quadratic energy and a quartic term: the interface of the reduced model without its fit."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch

from softrl.robots.robot import Robot


@dataclass(frozen=True)
class QuadraticBody:
    """Volumes follow tip and pressure, the tip hangs on springs that stiffen; M a + D v + dW/dz = load.

    W = |V - A u|^2 / (2 c) + u.K u / 2 + s |u|^4 / 4 with the tip's displacement u.
    """

    area: np.ndarray
    compliance: float
    stiffness: np.ndarray
    stiffening: float
    mass: np.ndarray
    damping: np.ndarray
    rest_tip: np.ndarray
    chambers: int = 3

    def force(self, z: torch.Tensor) -> torch.Tensor:
        area = torch.tensor(self.area)
        u = z[:, self.chambers :]
        pressure = (z[:, : self.chambers] - u @ area.T) / self.compliance
        spring = u @ torch.tensor(self.stiffness) + self.stiffening * u * u.pow(2).sum(dim=1, keepdim=True)
        return torch.cat([pressure, spring - pressure @ area], dim=1)

    def residual(self, path: torch.Tensor, load: torch.Tensor, dt_s: float) -> torch.Tensor:
        before, last = ((path[:, i] - path[:, i - 1]) / dt_s for i in (-2, -1))
        return self.balance(path[:, -1], last, (last - before) / dt_s, load)

    def balance(
        self, z: torch.Tensor, velocity: torch.Tensor, acceleration: torch.Tensor, load: torch.Tensor
    ) -> torch.Tensor:
        return acceleration @ torch.tensor(self.mass) + velocity @ torch.tensor(self.damping) + self.force(z) - load

    def step(
        self, z: torch.Tensor, velocity: torch.Tensor, load: torch.Tensor, dt: float
    ) -> tuple[torch.Tensor, torch.Tensor]:
        new = z + dt * velocity
        for _ in range(4):
            v = (new - z) / dt
            r = self.balance(new, v, (v - velocity) / dt, load)
            u = new[:, self.chambers :]
            hessian = torch.tensor(self.linear() + self.mass / dt**2 + self.damping / dt).expand(len(z), -1, -1).clone()
            square = u.pow(2).sum(dim=1)[:, None, None] * torch.eye(3, dtype=torch.float64)
            hessian[:, self.chambers :, self.chambers :] += self.stiffening * (square + 2 * u[:, :, None] * u[:, None])
            new = new - torch.linalg.solve(hessian, r[..., None])[..., 0]
        return new, (new - z) / dt

    @property
    def rest(self) -> np.ndarray:
        return np.zeros(6)

    def roll(self, load: np.ndarray, start: np.ndarray, velocity: np.ndarray, dt_s: float) -> np.ndarray:
        z, v, path = torch.tensor(start), torch.tensor(velocity), []
        for k in range(load.shape[1]):
            z, v = self.step(z, v, torch.tensor(load[:, k]), dt_s)
            path.append(z)
        return torch.stack(path, dim=1).numpy()

    def linear(self) -> np.ndarray:
        a, c = self.area, self.compliance
        return np.block([[np.eye(3) / c, -a / c], [-a.T / c, self.stiffness + a.T @ a / c]])

    def quaternion(self, z: np.ndarray) -> np.ndarray:
        turn = 4.0 * np.stack([-z[..., 4], z[..., 3], 0 * z[..., 3]], axis=-1)
        w = np.sqrt(1.0 - (0.5 * turn) ** 2 @ np.ones(3))
        return np.concatenate([w[..., None], 0.5 * turn], axis=-1)


def quadratic_body() -> QuadraticBody:
    angle = np.deg2rad([-90.0, -210.0, -330.0])
    area = np.stack([-4e-4 * np.cos(angle), -4e-4 * np.sin(angle), 1e-3 + 0 * angle], axis=1)
    stiffness = np.diag([350.0, 350.0, 4000.0])
    mass = np.diag([1e3, 1e3, 1e3, 0.3, 0.3, 0.5])
    body = QuadraticBody(area, 2e-10, stiffness, 3e5, mass, np.zeros((6, 6)), np.array([0.0, 0.0, 0.174]))
    # damping in proportion to stiffness
    return QuadraticBody(area, 2e-10, stiffness, 3e5, mass, 0.03 * body.linear(), body.rest_tip)


@pytest.fixture(scope="session")
def body() -> QuadraticBody:
    return quadratic_body()


@pytest.fixture(scope="session")
def robot() -> Robot:
    return Robot(
        name="triple", chamber_angle_deg=(-90.0, -210.0, -330.0), chamber_radius_m=0.05, chamber_area_m2=1e-3,
        length_m=0.174, mass_kg=0.6, pressure_min_pa=-20e3, pressure_max_pa=35e3, slew_pa_per_s=2e5,
        tip_force_max_n=2.0, axis="+z", output="tip_pose", command="pressure", command_to_pa=1.0,
        gravity_m_s2=(0.0, 0.0, -9.81),
    )  # fmt: skip
