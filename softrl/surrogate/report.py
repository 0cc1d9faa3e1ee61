"""What the surrogate stage measures of its result: errors beside baselines, parity with PyBullet, figures."""

import time
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from softrl.artifacts.surrogate import Surrogate
from softrl.core.tracking import Tracker
from softrl.surrogate.fit import fit_joints, fit_joints_lbfgsb
from softrl.surrogate.kinematics import chain_of
from softrl.surrogate.maps import PressureToJoints
from softrl.surrogate.stiffness import chain_compliance
from softrl.surrogate.twin import Twin

RATE_BATCH = 4096


def report(
    surrogate: Surrogate,
    residual: np.ndarray,
    compliance: tuple[np.ndarray, np.ndarray],
    compared_fits: int,
    parity_samples: int,
    tracker: Tracker,
) -> Surrogate:
    """Return the surrogate with its metrics, after sending them and the figures to ``tracker``.

    Parameters
    ----------
    residual : (samples,) m left by the fit
    compliance : joints (S, 3) and d tip / d force (S, 3, 3) m/N of the body at pressures kept from the stiffness fit
    """
    metrics = {"train/fit_residual_mm": _rms(1e3 * residual)}
    metrics |= _map_errors(surrogate) | _stiffness_errors(surrogate, *compliance)
    metrics |= _fit_comparison(surrogate, compared_fits) | _parity(surrogate, parity_samples) | _rates(surrogate)
    for name, value in metrics.items():
        tracker.metric(name, value)
    tracker.figure("workspace", draw_workspace(surrogate))
    tracker.figure("pressure_to_joints", draw_maps(surrogate))
    tracker.text("surrogate.urdf", surrogate.urdf)
    return replace(surrogate, metrics=metrics)


def _rms(values: np.ndarray) -> float:
    """Return the root mean square of the lengths of rows, or of values."""
    return float(np.sqrt(np.mean(np.sum(np.atleast_2d(values.T).T ** 2, axis=-1))))


def _map_errors(s: Surrogate) -> dict[str, float]:
    """Return the errors of f_SP and its inverse on held-out rows beside an affine map and the mean."""
    twin, maps, held = Twin(s), PressureToJoints(s), s.heldout
    pressure, joints, tip = s.sample_pressure[held], s.sample_joints[held], s.sample_tip[held]
    design = np.column_stack([s.sample_pressure, np.ones(len(held))])
    affine = design[held] @ np.linalg.lstsq(design[~held], s.sample_joints[~held], rcond=None)[0]
    mean = np.broadcast_to(s.sample_joints[~held].mean(axis=0), joints.shape)
    errors = {}
    for label, guess in (("", maps.joints(pressure)), ("affine_", affine), ("mean_", mean)):
        errors[f"heldout/{label}joint_angle_deg"] = float(np.rad2deg(np.sqrt(np.mean((guess - joints)[:, :2] ** 2))))
        errors[f"heldout/{label}tip_error_mm"] = _rms(1e3 * (twin.tip(guess) - tip))
    errors["heldout/joint_slide_mm"] = 1e3 * float(np.sqrt(np.mean((maps.joints(pressure) - joints)[:, 2] ** 2)))
    errors["heldout/tip_error_max_mm"] = 1e3 * float(
        np.linalg.norm(twin.tip(maps.joints(pressure)) - tip, axis=1).max()
    )
    back = maps.pressure(joints) - pressure
    errors["heldout/roundtrip_pressure_kpa"] = float(np.sqrt(np.mean(back**2)) / 1e3)
    network_back = maps.pressure_by_network(joints) - pressure
    errors["heldout/roundtrip_network_pressure_kpa"] = float(np.sqrt(np.mean(network_back**2)) / 1e3)
    return errors


def _stiffness_errors(s: Surrogate, joints: np.ndarray, compliance: np.ndarray) -> dict[str, float]:
    """Return by how much the chain's tip stiffness differs from the body's, in percent of it, per axis."""
    body = 1.0 / np.einsum("sii->si", compliance)
    chain = 1.0 / np.einsum("sii->si", chain_compliance(joints, chain_of(s), s.joint_stiffness))
    error = 100.0 * np.sqrt(np.mean((chain / body - 1.0) ** 2, axis=0))
    found = {f"heldout/tip_stiffness_{a}_pct": float(e) for a, e in zip("xyz", error, strict=True)}
    return found | {
        f"train/tip_stiffness_{a}_n_per_mm": 1e-3 * float(k) for a, k in zip("xyz", body.mean(axis=0), strict=True)
    }


def _fit_comparison(s: Surrogate, count: int) -> dict[str, float]:
    """Return how L-BFGS-B (Algorithm 1) and Gauss-Newton compare on the same tips, and how fast each is."""
    tip, chain = s.sample_tip[:count], chain_of(s)
    started = time.perf_counter()
    searched = fit_joints_lbfgsb(chain, tip, s.joint_low, s.joint_high)
    lbfgsb_s = time.perf_counter() - started
    started = time.perf_counter()
    newton = fit_joints(chain, tip, s.joint_low, s.joint_high)
    newton_s = time.perf_counter() - started
    return {
        "train/fit_lbfgsb_residual_mm": _rms(1e3 * searched.residual),
        "train/fit_difference_deg": float(np.rad2deg(np.abs(searched.theta - newton.theta)[:, :2].max())),
        "train/fit_lbfgsb_rate_hz": count / lbfgsb_s,
        "train/fit_rate_hz": count / newton_s,
    }


def _parity(s: Surrogate, count: int) -> dict[str, float]:
    """Return the distance between the twin and PyBullet: without load, and settled under 1 N across."""
    from softrl.surrogate.parity import parity  # PyBullet starts slowly

    free, loaded = parity(s, s.sample_joints[-count:], np.array([1.0, 0.0, 0.0]))
    return {"heldout/bullet_parity_free_mm": 1e3 * free, "heldout/bullet_parity_loaded_mm": 1e3 * loaded}


def _rates(s: Surrogate) -> dict[str, float]:
    """Return equilibria per second of the twin, loaded, in one thread."""
    twin = Twin(s)
    theta = np.resize(s.sample_joints, (RATE_BATCH, 3))
    twin.solve(theta[:2], np.array([0.5, 0.0, 0.0]))
    started = time.perf_counter()
    twin.solve(theta, np.array([0.5, 0.0, 0.0]))
    return {"twin_loaded_rate_hz": RATE_BATCH / (time.perf_counter() - started)}


def draw_workspace(s: Surrogate) -> Figure:
    """Return the reachable tips of body and surrogate over each other, from the side and from above."""
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    axes = figure.subplots(1, 2)
    maps, twin = PressureToJoints(s), Twin(s)
    body, chain = 1e3 * s.sample_tip, 1e3 * twin.tip(maps.joints(s.sample_pressure))
    for axis, (i, j) in zip(axes, ((0, 2), (0, 1)), strict=True):
        axis.plot(body[:, i], body[:, j], ".", ms=3, color="0.65", label="body at equilibrium")
        axis.plot(
            chain[s.heldout, i],
            chain[s.heldout, j],
            "x",
            ms=3.5,
            mew=0.8,
            color="C0",
            label=r"$f_{SP}$ and chain, held out",
        )
        axis.set(xlabel=f"{'xyz'[i]} in mm", ylabel=f"{'xyz'[j]} in mm", aspect="equal")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    figure.suptitle(f"Workspace of {s.robot_name} and of its surrogate")
    return figure


def draw_maps(s: Surrogate) -> Figure:
    """Return the held-out error of f_SP per joint, and of pressures that went to joints and back."""
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    maps, held = PressureToJoints(s), s.heldout
    error = maps.joints(s.sample_pressure[held]) - s.sample_joints[held]
    tip = 1e3 * (Twin(s).tip(maps.joints(s.sample_pressure[held])) - s.sample_tip[held])
    left.hist(np.linalg.norm(tip, axis=1), bins=40, color="C0")
    left.set(xlabel="tip error in mm", ylabel="held-out pressures")
    left.set_title(f"$f_{{SP}}$: {np.rad2deg(np.sqrt(np.mean(error[:, :2] ** 2))):.3f} deg rms", fontsize=10)
    back = 1e-3 * (maps.pressure(s.sample_joints[held]) - s.sample_pressure[held])
    for i in range(s.chambers):
        right.plot(1e-3 * s.sample_pressure[held, i], back[:, i], ".", ms=3, label=f"chamber {i + 1}")
    right.set(xlabel="pressure in kPa", ylabel="back from the joints, error in kPa")
    right.legend(frameon=False, fontsize=8)
    return figure
