"""A prediction depends on its own window only, on all of it, and on nothing later."""

import pytest
import torch

from softrl.dynamics.transformer import ForwardNet, GruNet, advance

STATES, LOADS, WINDOW = 11, 6, 6


@pytest.fixture
def net() -> ForwardNet:
    torch.manual_seed(0)
    made = ForwardNet(STATES, LOADS, WINDOW, 16, 4, 2, 32, 2)
    torch.nn.init.normal_(made.head.weight)  # as if trained: the head begins at zero
    return made.eval()


@pytest.fixture
def rows() -> torch.Tensor:
    return torch.randn(5, WINDOW, 2 * STATES + LOADS, generator=torch.Generator().manual_seed(1))


def test_batch_mates_do_not_matter(net: ForwardNet, rows: torch.Tensor) -> None:
    others = rows.clone()
    others[1:] = torch.randn(others[1:].shape, generator=torch.Generator().manual_seed(2))
    with torch.no_grad():
        torch.testing.assert_close(net(rows)[0], net(others)[0], rtol=1e-6, atol=1e-6)
        torch.testing.assert_close(net(rows)[0], net(rows[:1])[0], rtol=1e-6, atol=1e-6)


def test_every_past_row_matters(net: ForwardNet, rows: torch.Tensor) -> None:
    with torch.no_grad():
        for k in range(WINDOW):
            changed = rows.clone()
            changed[:, k] += 0.5
            assert (net(changed) - net(rows))[:, -1].abs().max() > 1e-3, f"row {k} has no influence"


def test_no_later_row_matters(net: ForwardNet, rows: torch.Tensor) -> None:
    with torch.no_grad():
        for k in range(1, WINDOW):
            changed = rows.clone()
            changed[:, k:] += 1.0
            torch.testing.assert_close(net(changed)[:, :k], net(rows)[:, :k], rtol=1e-6, atol=1e-6)
            assert (net(changed) - net(rows))[:, k:].abs().min() > 0.0


def test_untrained_network_predicts_that_the_rate_of_tip_and_volumes_stays(rows: torch.Tensor) -> None:
    fresh = ForwardNet(STATES, LOADS, WINDOW, 16, 4, 2, 32, 2)
    with torch.no_grad():
        rate = fresh(rows)
    own = [0, 1, 2, 8, 9, 10]
    torch.testing.assert_close(rate[..., own], rows[..., [STATES + i for i in own]])
    assert not rate[..., 3:8].any()


def test_advance_moves_the_state_by_the_rate() -> None:
    rows = torch.randn(3, WINDOW, 2 * STATES + LOADS)
    rate, load = torch.randn(3, STATES), torch.randn(3, LOADS)
    after = advance(rows, rate, load, 0.01)
    torch.testing.assert_close(after[:, :-1], rows[:, 1:])
    torch.testing.assert_close(after[:, -1, :STATES], rows[:, -1, :STATES] + 0.01 * rate)
    torch.testing.assert_close(after[:, -1, STATES:], torch.cat([rate, load], dim=1))


def test_the_recurrent_baseline_is_as_large_and_sees_the_past_of_its_own_window_only() -> None:
    size = (STATES, LOADS, WINDOW, 32, 4, 2, 64, 2)
    torch.manual_seed(0)
    net, other = ForwardNet(*size), GruNet(*size)
    count, twin_count = (sum(w.numel() for w in one.parameters() if w.requires_grad) for one in (net, other))
    assert abs(twin_count / count - 1.0) < 0.1, f"{twin_count} against {count} weights"
    torch.nn.init.normal_(other.head.weight)
    rows = torch.randn(3, WINDOW, 2 * STATES + LOADS)
    later, mate = rows.clone(), rows.clone()
    later[:, -1] += 1.0
    mate[1] += 1.0
    with torch.no_grad():
        answer = other(rows)
        torch.testing.assert_close(other(later)[:, :-1], answer[:, :-1])
        torch.testing.assert_close(other(mate)[0], answer[0])
        assert not torch.allclose(other(later)[:, -1], answer[:, -1])
