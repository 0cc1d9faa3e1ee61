"""Batched algebra of the torch twin."""

import torch
from torch import Tensor

from softrl.artifacts.reduced_model import SHAPES, TRIANGLE
from softrl.pod.step.inside import LEAST


def ray(degree: Tensor, radius: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return w_d and its two derivatives (B, k) at ``radius`` (B, 1); see ``pod.step.potential``."""
    beyond, bend = radius - 1.0, degree * (degree - 1.0)
    return 1.0 + beyond * (degree + 0.5 * bend * beyond), degree + bend * beyond, bend.expand(len(radius), -1)


def times(matrix: Tensor, vector: Tensor) -> Tensor:
    """Return ``matrix`` (B, i, j) times ``vector`` (B, j)."""
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)


def dot(left: Tensor, right: Tensor) -> Tensor:
    """Return the scalar products (B,) of vectors (B, j)."""
    return (left * right).sum(1)


def share_of(goal: Tensor, now: Tensor) -> Tensor:
    """Return the factors (B, 1), at most 1, whose squares bring what has the energy ``now`` down to ``goal``."""
    more = now > goal.clamp(min=0.0)
    ratio = torch.where(more, goal.clamp(min=0.0), torch.ones_like(now)) / torch.where(more, now, torch.ones_like(now))
    return ratio.clamp(min=1e-30).sqrt().unsqueeze(1)


def beside(root: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
    """Return R'A (B, r, 6) and A'A + B'B (B, 6, 6) of ``root`` R (B, r, r) and ``rows``, A and the triangle B."""
    above, below = rows[:, :-TRIANGLE].reshape(len(rows), -1, SHAPES), triangle(rows[:, -TRIANGLE:])
    return root.transpose(1, 2) @ above, square(above) + square(below)


def triangle(rows: Tensor) -> Tensor:
    """Return upper triangles (B, 6, 6) of their ``rows`` (B, 21)."""
    i, j = torch.triu_indices(SHAPES, SHAPES, device=rows.device)
    whole = rows.new_zeros(len(rows), SHAPES, SHAPES)
    whole[:, i, j] = rows
    return whole


def square(root: Tensor) -> Tensor:
    """Return R'R (B, j, j) of ``root`` R (B, i, j)."""
    return root.transpose(1, 2) @ root


def inverse(matrix: Tensor) -> Tensor:
    """Return the inverses of symmetric matrices (B, 6, 6); what has no pivot, as shapes that the body has not, gives nothing."""
    trace = matrix.diagonal(dim1=1, dim2=2).sum(1)
    least = torch.where(trace > 0.0, LEAST * trace, torch.ones_like(trace))
    return torch.linalg.inv(matrix + least[:, None, None] * torch.eye(SHAPES, dtype=matrix.dtype, device=matrix.device))
