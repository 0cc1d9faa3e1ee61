"""Springs of the chain's joints from the body's own compliance: how tip and orientation yield to forces."""

import logging
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from scipy.optimize import minimize

from softrl.core.errors import SolverError
from softrl.surrogate.kinematics import Chain, joint_axes, joint_jacobians
from softrl.surrogate.springs import QUADRATIC, TERMS, Springs, monomials, softness_at

log = logging.getLogger(__name__)
POSES_PER_TERM = 4  # fewer do not tell the terms of a cubic apart
WIDEST, STEEPEST = 5.0, 3.0  # a factor of 150 about the mean softness; of 20 from a gap to the middle one
BENDING = 3.0  # weight of bending, of which there is one number where the tip's compliance has nine


class Poses(NamedTuple):
    """Tips (S, 3) m and orientations (S, 4) w x y z, or None where a body tells no orientation.

    ``sampled`` (S,) bool: poses among those that the body was built from, where its compliance can be trusted; None for all.
    """

    tip: np.ndarray
    quaternion: np.ndarray | None
    sampled: np.ndarray | None = None


class Compliance(NamedTuple):
    """What a body yields at its tip: ``tip`` (S, 3, 3) m/N and ``turn`` (S, 3, 3) rad/N per force, or None."""

    tip: np.ndarray
    turn: np.ndarray | None

    def where(self, keep: np.ndarray | slice) -> "Compliance":
        """Return that of the poses ``keep`` (S,) bool, or of a slice of them."""
        return Compliance(self.tip[keep], None if self.turn is None else self.turn[keep])


class Couple(NamedTuple):
    """What a body's tip turns under moments, which a body that is known by loads alone does not tell, in one pose.

    ``theta`` (3,) is the chain's command there, ``turn`` (3, 3) rad per N m.
    """

    theta: np.ndarray
    turn: np.ndarray


Statics = Callable[[np.ndarray], Poses]  # loads (S, n + 3) Pa and N -> poses at equilibrium


def body_compliance(pose_of: Statics, pressure: np.ndarray, force: float) -> Compliance:
    """Return how the body yields at ``pressure`` (S, n) Pa, by central differences of ``force`` N."""
    moved, turned = [], []
    for axis in range(3):
        push = np.zeros((len(pressure), 3))
        push[:, axis] = force
        ahead, behind = pose_of(np.hstack([pressure, push])), pose_of(np.hstack([pressure, -push]))
        moved.append((ahead.tip - behind.tip) / (2.0 * force))
        if ahead.quaternion is not None and behind.quaternion is not None:
            turned.append(turn_between(behind.quaternion, ahead.quaternion) / (2.0 * force))
    tip = np.stack(moved, axis=2)
    # a conservative body yields symmetrically; what differs is the differences' own error
    return Compliance(0.5 * (tip + np.swapaxes(tip, 1, 2)), np.stack(turned, axis=2) if turned else None)


def told_compliance(pose_of: Statics, pressure: np.ndarray, force: float) -> tuple[np.ndarray, Compliance]:
    """Return in which of the poses at ``pressure`` (S, n) Pa the body tells its compliance (S,) bool, and that of these.

    It does where every force moves the tip along. Near where a body falls over a small push takes it to another rest, and what
    the ends of the push differ by is no compliance.

    Raises
    ------
    SolverError
        If fewer than two poses tell it.
    """
    compliance = body_compliance(pose_of, pressure, force)
    told = np.isfinite(compliance.tip).all(axis=(1, 2))
    told[told] = np.linalg.eigvalsh(compliance.tip[told])[:, 0] > 0.0
    lost = int((~told).sum())
    if len(told) - lost < 2:
        raise SolverError(
            f"under {force:g} N the body goes over to another rest, or to none, in {lost} of {len(told)} poses; expected 2 or "
            "more in which it stands fast: lower stage.compliance_force_n, or check the reduced model's statics under tip forces"
        )
    if lost:
        log.warning(
            "in %d of %d poses the body goes over to another rest under %g N; springs are neither fitted nor judged there",
            lost, len(told), force,
        )  # fmt: skip
    return told, compliance.where(told)


def turn_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the small rotation vectors (S, 3) rad that turn one orientation (S, 4) w x y z into the other."""
    w, v = first[:, :1], -first[:, 1:]
    scalar = second[:, :1] * w - np.sum(second[:, 1:] * v, axis=1, keepdims=True)
    vector = second[:, :1] * v + w * second[:, 1:] + np.cross(second[:, 1:], v)
    return 2.0 * vector * np.sign(scalar)


def bending_of(turn: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return the part of ``turn`` (S, 3, ...) across the tip's own ``axis`` (S, 3): bending, without twist."""
    return turn - axis.reshape(*axis.shape, *(1,) * (turn.ndim - 2)) * np.einsum("si,si...->s...", axis, turn)[:, None]


def chain_turn(theta: np.ndarray, chain: Chain, springs: Springs) -> np.ndarray:
    """Return d orientation / d force (S, 3, 3) rad/N of the unloaded chain at commands (S, 3)."""
    moved, turned, _ = _gap_slopes(theta, chain)
    softness = np.stack([softness_at(row, springs) for row in np.ascontiguousarray(theta, dtype=float)])
    return np.einsum("saki,sij,sbkj,k->sab", turned, softness, moved, springs.share)


def _gap_slopes(theta: np.ndarray, chain: Chain) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return d tip and d orientation / d joints (S, 3, gaps, 3), and the tip's own axis (S, 3), at commands (S, 3)."""
    rows = np.ascontiguousarray(theta, dtype=float)
    axes, direction = joint_axes(rows, chain)
    shape = (len(rows), 3, len(chain.below), 3)
    return joint_jacobians(rows, chain).reshape(shape), axes.reshape(shape), direction


def fit_springs(theta: np.ndarray, chain: Chain, compliance: Compliance, low: np.ndarray, high: np.ndarray,
                iterations: int, ridge: float, alike: bool = False, couple: Couple | None = None) -> Springs:  # fmt: skip
    """Return the springs, for commands in ``low`` .. ``high`` (3,), that explain ``compliance`` at ``theta`` (S, 3).

    They explain ``couple`` besides, which tells how the chain's give is spread over its height. With ``alike`` they are the
    same in every pose and gap, and the joints of a gap do not act on each other.

    Notes
    -----
    Least squares by L-BFGS-B over the coefficients and a taper along the chain, of slope and bow, from springs of one value;
    poses that are too few for a cubic get a quadratic, which is surer at poses that were not seen. ``ridge`` keeps the
    coefficients small, as one pose of that weight would: few poses leave more to it. The bounds are far from any body's:
    without them a search that steps too far once ends where softness underflows.
    The tip's compliance counts relative to the body's in every direction (both sides multiplied by the inverse of its
    Cholesky factor), so that the stiff axis counts as the soft ones; bending counts relative to its size. Twist of the tip
    about its own axis is left out: hinges alone cannot follow it.
    """
    torch.set_num_threads(1)
    moved, turned, axis = _gap_slopes(theta, chain)
    gaps = len(chain.below)
    count = TERMS if len(theta) >= POSES_PER_TERM * TERMS else QUADRATIC
    terms = torch.tensor(np.stack([monomials(row, low, high)[:count] for row in theta]))
    size = torch.tensor(_uniform_softness(moved, compliance.tip) ** 0.5)
    whiten = torch.linalg.inv(torch.linalg.cholesky(torch.tensor(compliance.tip)))
    slopes, body = torch.tensor(moved), torch.tensor(compliance.tip)
    bend = None if compliance.turn is None else torch.tensor(bending_of(compliance.turn, axis))
    turns = torch.tensor(bending_of(turned, axis))
    height = torch.linspace(-1.0, 1.0, gaps, dtype=torch.float64)
    tapered = bend is not None and not alike
    by_couple = None if couple is None or not tapered else _couple_terms(couple, chain, low, high, count)
    kept = torch.ones(count, 6, dtype=torch.float64)
    if alike:
        kept[:], kept[0, :3] = 0.0, 1.0  # one value a kind of joint

    def loss_of(shape: torch.Tensor, taper: torch.Tensor) -> torch.Tensor:
        softness, share = _softness(terms @ (kept * shape), size), _share(taper, height)
        miss = whiten @ (torch.einsum("saki,sij,sbkj,k->sab", slopes, softness, slopes, share) - body)
        loss = (miss @ whiten.transpose(1, 2)).pow(2).sum(dim=(1, 2)).mean() + ridge / len(theta) * shape.pow(2).sum()
        if bend is not None:
            error = torch.einsum("saki,sij,sbkj,k->sab", turns, softness, slopes, share) - bend
            loss = loss + BENDING * error.pow(2).sum() / bend.pow(2).sum()
        if by_couple is not None:
            row, axes, wanted = by_couple
            soft = _softness((row @ (kept * shape))[None], size)[0]
            error = torch.einsum("aki,ij,bkj,k->ab", axes, soft, axes, share) - wanted
            loss = loss + BENDING * error.pow(2).sum() / wanted.pow(2).sum()
        return loss

    shape, taper = _least(loss_of, count, tapered, iterations)
    coefficients = (kept * shape).numpy().copy()
    coefficients[0, :3] += np.log(size.numpy())
    coefficients[:, 3:] *= size.numpy()[[1, 2, 2]]
    return Springs(coefficients, _share(taper, height).numpy().copy(), low, high)


def _least(
    loss_of: Callable[[torch.Tensor, torch.Tensor], torch.Tensor], count: int, tapered: bool, iterations: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the shape (count, 6) and taper (2,) of the least loss, from zeros; taper stays zero if not ``tapered``."""

    def value(x: np.ndarray) -> tuple[float, np.ndarray]:
        at = torch.tensor(x, requires_grad=True)
        loss = loss_of(at[:-2].reshape(count, 6), at[-2:])
        (slope,) = torch.autograd.grad(loss, at)
        return float(loss.detach()), slope.numpy()

    bound = np.append(np.full(6 * count, WIDEST), np.full(2, STEEPEST if tapered else 0.0))
    settings = {"maxiter": iterations, "maxfun": 2 * iterations, "maxcor": 30, "ftol": 1e-14, "gtol": 1e-10}
    found = minimize(
        value, np.zeros(len(bound)), jac=True, method="L-BFGS-B", bounds=list(zip(-bound, bound, strict=True)), options=settings
    )  # fmt: skip
    if not np.isfinite(found.fun):
        raise SolverError("the fit of the joints' springs diverged; check the reduced model's statics under tip forces")
    return torch.tensor(found.x[:-2].reshape(count, 6)), torch.tensor(found.x[-2:])


def _couple_terms(
    couple: Couple, chain: Chain, low: np.ndarray, high: np.ndarray, count: int
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the monomials (count,), d orientation / d joints across the tip (3, gaps, 3) and the body's turn there (3, 3)."""
    _, turned, axis = _gap_slopes(couple.theta[None], chain)
    across = np.eye(3) - np.outer(axis[0], axis[0])
    row = monomials(np.ascontiguousarray(couple.theta, dtype=float), low, high)[:count]
    return (
        torch.tensor(row), torch.tensor(np.einsum("ab,bki->aki", across, turned[0])),
        torch.tensor(across @ couple.turn @ across),
    )  # fmt: skip


def _uniform_softness(moved: np.ndarray, compliance: np.ndarray) -> np.ndarray:
    """Return a softness (3,) of each kind of joint from the mean compliance: hinges across the chain, slides along it."""
    across = 0.5 * (compliance[:, 0, 0] + compliance[:, 1, 1]).mean() / (moved[:, 0, :, 1] ** 2).sum(axis=1).mean()
    along = compliance[:, 2, 2].min() / (moved[:, 2, :, 2] ** 2).sum(axis=1).mean()
    if not min(across, along) > 0.0:
        raise SolverError(
            f"the body's tip yields by {np.einsum('sii->si', compliance).mean(axis=0)} m/N; expected positive values: "
            "check the reduced model's statics under tip forces"
        )
    return np.array([across, across, along])


def _softness(values: torch.Tensor, size: torch.Tensor) -> torch.Tensor:
    """Return S (S, 3, 3) = L L' of factors with log diagonal ``values`` [:, :3] and the rest below, in units of ``size``."""
    zero = torch.zeros_like(values[:, 0])
    diagonal = torch.exp(values[:, :3])
    factor = torch.stack(
        [
            torch.stack([diagonal[:, 0], zero, zero], dim=1),
            torch.stack([values[:, 3], diagonal[:, 1], zero], dim=1),
            torch.stack([values[:, 4], values[:, 5], diagonal[:, 2]], dim=1),
        ],
        dim=1,
    )
    factor = size[:, None] * factor
    return factor @ factor.transpose(1, 2)


def _share(taper: torch.Tensor, height: torch.Tensor) -> torch.Tensor:
    return torch.softmax(taper[0] * height + taper[1] * height**2, dim=0) * len(height)
