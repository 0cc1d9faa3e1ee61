"""The torch twin: the same motion as the compiled equations, and exact gradients."""

import numpy as np
import torch

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.pod.rom import roll, static_coordinates
from softrl.pod.torch_twin import TorchRom
from softrl.robots.robot import Robot

Body = tuple[Robot, Snapshots, ReducedModel]
DT_S = 0.01


def scaled_loads(model: ReducedModel, snapshots: Snapshots, factor: float) -> torch.Tensor:
    return torch.tensor(factor * snapshots.trajectory_load[:, :25])


def at_rest(load: torch.Tensor) -> tuple[torch.Tensor, ...]:
    return *(torch.zeros_like(load),) * 2, torch.zeros(len(load), 2, 6, dtype=load.dtype)


def rolled(twin: TorchRom, loads: torch.Tensor) -> torch.Tensor:
    state, path = at_rest(loads[:, 0]), []
    for k in range(loads.shape[1]):
        state = twin.step(*state, loads[:, k], DT_S)
        path.append(state[0])
    return torch.stack(path, dim=1)


def test_it_moves_as_the_kernel_does_inside_and_outside_the_samples(body: Body) -> None:
    _, snapshots, model = body
    twin = TorchRom(model)
    for factor in (1.0, 2.5):
        loads = scaled_loads(model, snapshots, factor)
        expected = roll(model, DT_S, loads.numpy())
        found = rolled(twin, loads).numpy()
        error = np.abs(found - expected).max(axis=(0, 1)) / np.abs(expected).max(axis=(0, 1))
        assert error[np.abs(expected).max(axis=(0, 1)) > 1e-6].max() < 1e-6, error


def test_the_residual_vanishes_at_equilibrium_and_along_a_step(tripod: Body) -> None:
    _, snapshots, model = tripod
    loads = snapshots.loads[:5]
    z = torch.tensor(static_coordinates(model, loads, np.zeros(3)))
    still = torch.zeros_like(z)
    left = TorchRom(model, np.zeros(3)).residual(z, still, still, torch.tensor(loads)).numpy()
    np.testing.assert_allclose(left / np.abs(loads).max(axis=0), 0.0, atol=1e-6)
    # a short first step from rest obeys the continuous equations to first order
    twin, residuals = TorchRom(model, np.zeros(3)), []
    load = torch.tensor(snapshots.trajectory_load[:1, 0])
    for dt in (1e-3, 5e-4):
        z, velocity, _ = twin.step(*at_rest(load), load, dt)
        residuals.append(twin.residual(z, velocity, velocity / dt, load).abs().max().item())
    assert residuals[1] < 0.7 * residuals[0] < 0.1 * load.abs().max().item()


def test_gradients_agree_with_differences(tripod: Body) -> None:
    _, snapshots, model = tripod
    twin = TorchRom(model)
    for factor in (1.0, 2.5):
        loads = scaled_loads(model, snapshots, factor)[:, :8].clone().requires_grad_(True)

        def goal(at: torch.Tensor) -> torch.Tensor:
            return (1e3 * rolled(twin, at)[:, -1, 3:]).pow(2).sum()

        goal(loads).backward()
        for row, step in ((0, 2), (1, 5)):
            shift = torch.zeros_like(loads)
            shift[row, step, 1] = 1.0
            with torch.no_grad():
                numeric = (goal(loads + shift) - goal(loads - shift)).item() / 2.0
            np.testing.assert_allclose(loads.grad[row, step, 1].item(), numeric, rtol=1e-5)


def test_a_batch_is_its_rows(tripod: Body) -> None:
    _, snapshots, model = tripod
    loads, twin = scaled_loads(model, snapshots, 1.0), TorchRom(model)
    np.testing.assert_allclose(rolled(twin, loads)[1:].numpy(), rolled(twin, loads[1:]).numpy(), atol=1e-10)
