"""The torch twin: the same motion as the compiled equations, and exact gradients."""

import numpy as np
import pytest
import torch

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.pod.rom import roll, static_coordinates
from softrl.pod.step import reach
from softrl.pod.twin.rom import TorchRom
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


def test_the_residual_vanishes_at_equilibrium(tripod: Body) -> None:
    _, snapshots, model = tripod
    loads = snapshots.loads[:5]
    z = torch.tensor(static_coordinates(model, loads, np.zeros(3)))
    left = TorchRom(model, np.zeros(3)).residual(torch.stack([z, z, z], dim=1), torch.tensor(loads), DT_S).numpy()
    np.testing.assert_allclose(left / np.abs(loads).max(axis=0), 0.0, atol=1e-6)


def test_the_residual_vanishes_along_motions_and_on_nothing_else(tripod: Body) -> None:
    """Motions are the kernel's; what their inside gives is found from the path, if that is long enough."""
    _, snapshots, model = tripod
    twin, loads = TorchRom(model, np.zeros(3)), scaled_loads(model, snapshots, 0.5)
    z = torch.tensor(roll(model, DT_S, loads.numpy(), gravity_m_s2=np.zeros(3)))
    path = torch.cat([torch.zeros_like(z[:, :2]), z], dim=1)

    def left(positions: int, longer: float) -> np.ndarray:
        """Return the rms residual of all steps, each made ``longer``, by the last ``positions`` up to their ends."""
        residuals = []
        for k in range(2, path.shape[1]):
            part = path[:, max(k + 1 - positions, 0) : k + 1].clone()
            part[:, -1] += longer * (part[:, -1] - part[:, -2])
            residuals.append(twin.residual(part, loads[:, k - 2], DT_S))
        return torch.stack(residuals).pow(2).mean(dim=(0, 1)).sqrt().numpy()

    whole = left(path.shape[1], 0.0)
    assert (whole < 0.05 * left(path.shape[1], 0.01)).all(), whole
    assert (left(3, 0.0)[3:] > 20.0 * whole[3:]).all(), "forces at the tip without what the inside remembers"


def test_the_residuals_gradient_agrees_with_differences(tripod: Body) -> None:
    _, snapshots, model = tripod
    twin, loads = TorchRom(model), scaled_loads(model, snapshots, 0.5)
    path = torch.tensor(roll(model, DT_S, loads.numpy())[:, 10:19])
    end = path[:, -1].clone().requires_grad_(True)

    def goal(at: torch.Tensor) -> torch.Tensor:
        whole = torch.cat([path[:, :-1], at[:, None]], dim=1)
        return (twin.residual(whole, 0.9 * loads[:, 18], DT_S) @ twin.frame).pow(2).sum()

    (gradient,) = torch.autograd.grad(goal(end), end)
    for i in (0, 2, 3, 5):
        shift = torch.zeros_like(path[:, -1])
        shift[0, i] = 1e-6 * float(path[:, :, i].abs().max())
        with torch.no_grad():
            numeric = (goal(end + shift) - goal(end - shift)) / (2.0 * shift[0, i])
        np.testing.assert_allclose(gradient[0, i].item(), numeric.item(), rtol=1e-5)


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


def test_leaving_the_samples_is_reported_once(tripod: Body, caplog: pytest.LogCaptureFixture) -> None:
    _, snapshots, model = tripod
    reach._reported.clear()
    for _ in range(2):
        rolled(TorchRom(model), scaled_loads(model, snapshots, 20.0)[:, :4])
    assert 1 <= len(caplog.records) <= 4 and "times the reach of its snapshots" in caplog.text
