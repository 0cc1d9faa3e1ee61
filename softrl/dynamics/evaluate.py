"""Errors one step ahead and over rollouts, of the network and of the baselines it has to beat."""

from collections.abc import Callable

import numpy as np
import torch

from softrl.dynamics.dataset import TIP, Body, Windows, coordinates_of
from softrl.dynamics.transformer import ForwardNet, advance

# windows (B, window, features) -> rate (B, 8 + n) one step after the last row
Predictor = Callable[[torch.Tensor], torch.Tensor]
TURN = slice(5, 8)


def predictors(net: ForwardNet, body: Body, dt_s: float) -> dict[str, Predictor]:
    """Return the network and the baselines by name.

    ``rate_stays`` and ``state_stays`` know nothing of the load, ``arx`` is the linear part of the network by
    itself (least squares on the training windows), ``polynomial`` its whole closed form, ``rom`` the reduced model,
    which gives no rate of arc length, curvature, rotation.
    """
    states = net.states
    return {
        "f_s": net.last,
        "rate_stays": lambda rows: rows[:, -1, states : 2 * states],
        "state_stays": lambda rows: torch.zeros_like(rows[:, -1, :states]),
        "arx": lambda rows: net.linear_rate(rows[:, -net.linear_rows :])[:, -1],
        "polynomial": lambda rows: net.closed_rate(rows[:, -net.linear_rows :])[:, -1],
        "rom": lambda rows: _by_body(rows, body, states, dt_s),
    }


def onestep_errors(predict: Predictor, windows: Windows, dt_s: float) -> dict[str, float]:
    """Return rms errors one step ahead over all windows: position in mm, velocity in mm/s, orientation in deg."""
    errors = []
    for index in torch.arange(len(windows)).split(4096):
        rows, target = windows.take(index)
        with torch.no_grad():
            errors.append((predict(rows) - target).double().numpy())
    error = np.concatenate(errors)
    return {
        "position_onestep_mm": 1e3 * dt_s * _rms(error[:, TIP]),
        "velocity_onestep_mm_s": 1e3 * _rms(error[:, TIP]),
        "orientation_onestep_deg": np.rad2deg(dt_s * _rms(error[:, TURN])),
    }


def rollout(
    predict: Predictor, windows: Windows, index: torch.Tensor, steps: int, dt_s: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return predicted and true states, then rates, (B, steps, 8 + n) of rollouts from the windows ``index`` (B,)."""
    rows, load, target = windows.take_segments(index, steps)
    size = target.shape[2]
    start = rows[:, -1, :size]
    states, rates = [], []
    with torch.no_grad():
        for k in range(steps):
            rate = predict(rows)
            rows = advance(rows, rate, load[:, min(k + 1, steps - 1)], dt_s)
            states.append(rows[:, -1, :size])
            rates.append(rate)
    true = start.double()[:, None] + dt_s * torch.cumsum(target.double(), dim=1)
    state, rate = torch.stack(states, 1).double(), torch.stack(rates, 1).double()
    return state.numpy(), true.numpy(), rate.numpy(), target.double().numpy()


def rollout_errors(predict: Predictor, windows: Windows, steps: int, dt_s: float) -> dict[str, float]:
    """Return rms errors over rollouts of ``steps`` that begin every ``steps / 2`` rows of every run."""
    starts = torch.arange(0, windows.per_run - steps + 1, max(steps // 2, 1))
    index = (torch.arange(len(windows.rows))[:, None] * windows.per_run + starts).reshape(-1)
    state, true, rate, true_rate = rollout(predict, windows, index, steps, dt_s)
    return {
        "position_rollout_mm": 1e3 * _rms((state - true)[..., TIP]),
        "velocity_rollout_mm_s": 1e3 * _rms((rate - true_rate)[..., TIP]),
        "orientation_rollout_deg": np.rad2deg(_rms((state - true)[..., TURN])),
    }


def _by_body(rows: torch.Tensor, body: Body, states: int, dt_s: float) -> torch.Tensor:
    last, n = rows[:, -1].double(), body.chambers
    z = coordinates_of(last[:, :states], torch.tensor(body.rest_tip, dtype=torch.float64)).numpy()
    velocity = coordinates_of(last[:, states : 2 * states], torch.zeros(3, dtype=torch.float64)).numpy()
    after = body.roll(last[:, None, 2 * states :].numpy(), z, velocity, dt_s)[:, 0]
    change = torch.tensor((after - z) / dt_s, dtype=torch.float32)
    rate = torch.zeros(len(rows), states)
    rate[:, TIP], rate[:, states - n :] = change[:, n:], change[:, :n]
    return rate


def _rms(error: np.ndarray) -> float:
    """Return the rms length of vectors (..., 3)."""
    return float(np.sqrt(np.mean(np.sum(error**2, axis=-1))))
