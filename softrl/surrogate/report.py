"""What the surrogate stage measures of its result: errors beside baselines, parity with PyBullet, figures."""

import logging
import time
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from softrl.artifacts.snapshots import Snapshots
from softrl.artifacts.surrogate import Surrogate
from softrl.core.tracking import Tracker
from softrl.surrogate.fit import Fit, fit_joints, fit_joints_lbfgsb
from softrl.surrogate.kinematics import chain_of, joint_axes
from softrl.surrogate.maps import PressureToJoints
from softrl.surrogate.springs import Springs, springs_of
from softrl.surrogate.stiffness import Compliance, Statics, bending_of, chain_turn
from softrl.surrogate.twin import Twin, chain_compliance

log = logging.getLogger(__name__)
RATE_BATCH, REACHED_M = 4096, 1e-3
JOINTS = 3  # of the grouped command
# of the largest force that the tip is made for: in the comparison with PyBullet, where the twin is timed, and of the
# differences at the full model's loads
PARITY_SHARE, RATE_SHARE, STEP_SHARE = 0.5, 0.25, 0.01


class Judged(NamedTuple):
    """What the stage kept to judge by.

    Attributes
    ----------
    residual : (samples,) m left by the fit of joints
    quaternion : (samples, 4) w x y z of the body there, or None
    joints : (S, 3) commands at pressures that the springs were not fitted to
    compliance : of the body there
    alike : springs of one value a kind of joint, fitted to the same poses as those of the surrogate
    """

    residual: np.ndarray
    quaternion: np.ndarray | None
    joints: np.ndarray
    compliance: Compliance
    alike: Springs


def report(
    surrogate: Surrogate,
    judged: Judged,
    compared_fits: int,
    parity_samples: int,
    tip_force_max_n: float,
    tracker: Tracker,
) -> Surrogate:
    """Return the surrogate with its metrics, after sending them and the figures to ``tracker``.

    Its tip is made for ``tip_force_max_n``, which says what a load is: one of another size does not move it, or breaks it.
    """
    metrics = {"train/fit_residual_mm": _rms(1e3 * judged.residual)}
    metrics |= _map_errors(surrogate) | _orientation_error(surrogate, judged.quaternion) | _reach(surrogate)
    metrics |= _stiffness_errors(surrogate, judged)
    metrics |= _fit_comparison(surrogate, compared_fits) | _parity(surrogate, parity_samples, PARITY_SHARE * tip_force_max_n)
    metrics |= _rates(surrogate, RATE_SHARE * tip_force_max_n)
    for name, value in metrics.items():
        tracker.metric(name, value)
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
    if s.chambers <= JOINTS:  # many pressures of more chambers make the same joints: another one is no error
        for label, back in (("", maps.pressure(joints)), ("network_", maps.pressure_by_network(joints))):
            errors[f"heldout/roundtrip_{label}pressure_kpa"] = float(np.sqrt(np.mean((back - pressure) ** 2)) / 1e3)
    again = maps.joints(maps.pressure(joints)) - joints
    errors["heldout/roundtrip_joint_angle_deg"] = float(np.rad2deg(np.sqrt(np.mean(again[:, :2] ** 2))))
    return errors


def _orientation_error(s: Surrogate, quaternion: np.ndarray | None) -> dict[str, float]:
    """Return the angle between body and chain, whose commands were fitted to tips alone, beside a tip that never turns."""
    if quaternion is None:
        return {}
    held = s.heldout
    overlap = np.abs(np.sum(Twin(s).quaternion(s.sample_joints[held]) * quaternion[held], axis=1))
    still = np.abs(quaternion[held, 0])
    return {
        f"heldout/{name}orientation_deg": _rms(np.rad2deg(2.0 * np.arccos(np.minimum(cosine, 1.0))))
        for name, cosine in (("", overlap), ("upright_", still))
    }


def _reach(s: Surrogate) -> dict[str, float]:
    """Return how much of the body's workspace the surrogate reaches with pressures in range, in percent of held-out tips."""
    return {"heldout/workspace_reached_pct": reached_pct(s, s.sample_tip[s.heldout])}


def reached_pct(s: Surrogate, tip: np.ndarray) -> float:
    """Return how many of tips (S, 3) m the surrogate comes within a millimetre of with pressures in range, in percent."""
    twin, maps = Twin(s), PressureToJoints(s)
    reached = twin.tip(maps.joints(maps.pressure(twin.joints_for_tip(tip))))
    return 100.0 * float((np.linalg.norm(reached - tip, axis=1) < REACHED_M).mean())


def report_workspace(s: Surrogate, full_tip: np.ndarray, robot_tip: np.ndarray, tracker: Tracker) -> None:
    """Log how much of the workspaces of full model and robot the surrogate covers, and draw all of them (Fig. 7a).

    ``full_tip`` (S, 3) m are tips of the full model on which no force acts, ``robot_tip`` (S, 3) m those at which the robot
    settled, if it was recorded; of either there may be none.
    """
    for name, tip in (("full_model", full_tip), ("robot", robot_tip)):
        if len(tip):
            tracker.metric(f"workspace_{name}_reached_pct", reached_pct(s, tip))
            tracker.metric(f"workspace_{name}_tips_count", len(tip))
    tracker.figure("workspace", draw_workspace(s, full_tip, robot_tip))


def _stiffness_errors(s: Surrogate, judged: Judged) -> dict[str, float]:
    """Return by how much tip and bending stiffness differ from the body's, in percent, beside springs of one value."""
    joints, compliance = np.ascontiguousarray(judged.joints), judged.compliance
    body = 1.0 / np.einsum("sii->si", compliance.tip)
    found: dict[str, float] = {}
    for label, springs in (("", springs_of(s)), ("alike_", judged.alike)):
        chain = chain_compliance(joints, chain_of(s), springs)
        error = 100.0 * np.sqrt(np.mean((1.0 / np.einsum("sii->si", chain) / body - 1.0) ** 2, axis=0))
        found |= {f"heldout/{label}tip_stiffness_{a}_pct": float(e) for a, e in zip("xyz", error, strict=True)}
        if compliance.turn is not None:
            found[f"heldout/{label}bending_stiffness_pct"] = _bending_error(s, joints, springs, compliance.turn)
    return found | {
        f"train/tip_stiffness_{a}_n_per_mm": 1e-3 * float(k) for a, k in zip("xyz", body.mean(axis=0), strict=True)
    }


def _bending_error(s: Surrogate, joints: np.ndarray, springs: Springs, turn: np.ndarray) -> float:
    """Return the rms relative error, in percent, of the turn under the push across that turns the body most."""
    axis = joint_axes(joints, chain_of(s))[1]
    body, chain = bending_of(turn, axis), bending_of(chain_turn(joints, chain_of(s), springs), axis)
    left, _, right = np.linalg.svd(body)
    along = np.einsum("sij,si,sj->s", chain, left[:, :, 0], right[:, 0])
    size = np.einsum("sij,si,sj->s", body, left[:, :, 0], right[:, 0])
    return 100.0 * float(np.sqrt(np.mean((size / along - 1.0) ** 2)))


def report_full_model(
    s: Surrogate, snapshots: Snapshots, pose_of: Statics, pushed_n: float, tracker: Tracker
) -> None:
    """Log how the loaded surrogate compares with the full model's equilibria under pressures and forces together.

    ``pose_of`` tells the body's tips under the same pressures alone. Stiffness is that of the loaded tips; a force stiffens the
    body, while the chain's springs know the pressures only: they part the more the larger it is, and forces of up to
    ``pushed_n`` stand apart. Loads under which the chain buckles, where no equilibrium is found, are counted and left out.
    """
    twin, n = Twin(s), s.chambers
    force = snapshots.loads[:, n:]
    free_tip = pose_of(np.hstack([snapshots.loads[:, :n], np.zeros_like(force)])).tip
    theta = twin.joints_for_tip(free_tip)
    tip = snapshots.coordinate[:, n:] + snapshots.rest_tip
    loaded = twin.solve(theta, force, refuse=False)
    moved, found = loaded.tip, loaded.found
    if not found.all():
        told = "the chain buckles under %d of %d loads of the full model, and is compared under the others"
        log.warning(told, (~found).sum(), len(found))
    size = np.linalg.norm(force, axis=1)
    stiff = 1.0 / np.einsum("sii->si", snapshots.compliance[:, n:, n:])
    for label, rows in (("loaded_", found), ("pushed_", found & (size <= pushed_n))):
        tracker.metric(f"full_model/{label}count", rows.sum())
        if not rows.any():
            continue
        tracker.metric(f"full_model/{label}tip_mm", _rms(1e3 * (moved - tip)[rows]))
        tracker.metric(f"full_model/{label}force_n", _rms(size[rows]))
        error = _loaded_stiffness(twin, theta[rows], force[rows], STEP_SHARE * pushed_n) / stiff[rows] - 1.0
        for axis, name in enumerate("xyz"):
            known = np.isfinite(error[:, axis])
            tracker.metric(f"full_model/{label}tip_stiffness_{name}_pct", 100.0 * _rms(error[known, axis]))
    tracker.metric("full_model/unloaded_tip_mm", _rms(1e3 * (free_tip - tip)))
    tracker.figure("workspace_loaded", draw_loaded(tip[found], moved[found], s.robot_name))


def _loaded_stiffness(twin: Twin, theta: np.ndarray, force: np.ndarray, step_n: float) -> np.ndarray:
    """Return the tips' stiffness (S, 3) N/m along x, y and z under commands (S, 3) and forces (S, 3) N, by ``step_n`` more.

    It is nan where the chain buckles under that.
    """
    stiff = np.empty((len(theta), 3))
    for axis, push in enumerate(step_n * np.eye(3)):
        ahead, behind = (twin.solve(theta, force + sign * push, refuse=False) for sign in (1.0, -1.0))
        apart = ahead.tip[:, axis] - behind.tip[:, axis]
        stiff[:, axis] = np.where(ahead.found & behind.found, 2.0 * step_n / apart, np.nan)
    return stiff


def _fit_comparison(s: Surrogate, count: int) -> dict[str, float]:
    """Return how the searches for joints compare on the same tips, and how many a second of the processor each finds.

    L-BFGS-B with the closed form's gradient, the paper's way (the simulator in the loop, differences for a gradient) on
    fewer tips, and Gauss-Newton, which the stage uses.
    """
    from softrl.surrogate.parity import fit_joints_by_simulation  # PyBullet starts slowly

    tip, chain, few = s.sample_tip[:count], chain_of(s), max(1, count // 8)
    started = time.process_time()
    searched = fit_joints_lbfgsb(chain, tip, s.joint_low, s.joint_high)
    lbfgsb_s = time.process_time() - started
    started = time.process_time()
    simulated = fit_joints_by_simulation(s, tip[:few])
    simulated_s = time.process_time() - started
    started = time.process_time()
    newton = fit_joints(chain, np.tile(tip, (64, 1)), s.joint_low, s.joint_high)
    newton_s = (time.process_time() - started) / 64
    newton = Fit(newton.theta[:count], newton.residual[:count])
    return {
        "train/fit_simulated_residual_mm": _rms(1e3 * simulated.residual),
        "train/fit_simulated_rate_hz": few / simulated_s,
        "train/fit_lbfgsb_residual_mm": _rms(1e3 * searched.residual),
        "train/fit_difference_deg": float(np.rad2deg(np.abs(searched.theta - newton.theta)[:, :2].max())),
        "train/fit_lbfgsb_rate_hz": count / lbfgsb_s,
        "train/fit_rate_hz": count / newton_s,
    }


def _parity(s: Surrogate, count: int, push_n: float) -> dict[str, float]:
    """Return the distance between the twin and PyBullet: without load, and settled under ``push_n`` across."""
    from softrl.surrogate.parity import parity  # PyBullet starts slowly

    free, loaded = parity(s, s.sample_joints[-count:], np.array([push_n, 0.0, 0.0]))
    return {"heldout/bullet_parity_free_mm": 1e3 * free, "heldout/bullet_parity_loaded_mm": 1e3 * loaded}


def _rates(s: Surrogate, push_n: float) -> dict[str, float]:
    """Return equilibria per second of the processor of the twin under ``push_n`` across, in one thread."""
    twin = Twin(s)
    theta = np.resize(s.sample_joints, (RATE_BATCH, 3))
    push = partial(twin.solve, force=np.array([push_n, 0.0, 0.0]), refuse=False)  # a body too soft for it is slow, no fault
    push(theta[:2])
    started = time.process_time()
    push(theta)
    return {"twin_loaded_rate_hz": RATE_BATCH / (time.process_time() - started)}


def draw_workspace(s: Surrogate, full_tip: np.ndarray, robot_tip: np.ndarray) -> Figure:
    """Return tips (S, 3) m of reduced body, surrogate, full model and robot over each other, from the side and from above."""
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    axes = figure.subplots(1, 2)
    maps, twin = PressureToJoints(s), Twin(s)
    body, chain = 1e3 * s.sample_tip, 1e3 * twin.tip(maps.joints(s.sample_pressure))
    for axis, (i, j) in zip(axes, ((0, 2), (0, 1)), strict=True):
        axis.plot(body[:, i], body[:, j], ".", ms=3, color="0.75", label="reduced body")
        axis.plot(
            chain[s.heldout, i],
            chain[s.heldout, j],
            "x",
            ms=3.5,
            mew=0.8,
            color="C0",
            label=r"$f_{SP}$ and chain, held out",
        )
        seen = (full_tip, "^", "k", "full model"), (robot_tip, "o", "C1", "robot, settled")
        for tip, style, colour, label in seen:
            if len(tip):
                axis.plot(1e3 * tip[:, i], 1e3 * tip[:, j], style, ms=4, mfc="none", mew=0.9, color=colour, label=label)
        axis.set(xlabel=f"{'xyz'[i]} in mm", ylabel=f"{'xyz'[j]} in mm", aspect="equal")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    figure.suptitle(f"Workspace of {s.robot_name} and of its surrogate")
    return figure


def draw_maps(s: Surrogate) -> Figure:
    """Return the held-out error of f_SP per joint, and of pressures that went to joints and back, where these tell them."""
    figure, told = Figure(figsize=(9.0, 3.4), layout="constrained"), s.chambers <= JOINTS
    left, *others = figure.subplots(1, 2 if told else 1, squeeze=False)[0]
    maps, held = PressureToJoints(s), s.heldout
    error = maps.joints(s.sample_pressure[held]) - s.sample_joints[held]
    tip = 1e3 * (Twin(s).tip(maps.joints(s.sample_pressure[held])) - s.sample_tip[held])
    left.hist(np.linalg.norm(tip, axis=1), bins=40, color="C0")
    left.set(xlabel="tip error in mm", ylabel="held-out pressures")
    left.set_title(f"$f_{{SP}}$: {np.rad2deg(np.sqrt(np.mean(error[:, :2] ** 2))):.3f} deg rms", fontsize=10)
    back = 1e-3 * (maps.pressure(s.sample_joints[held]) - s.sample_pressure[held])
    for right in others:
        for i in range(s.chambers):
            right.plot(1e-3 * s.sample_pressure[held, i], back[:, i], ".", ms=3, label=f"chamber {i + 1}")
        right.set(xlabel="pressure in kPa", ylabel="back from the joints, error in kPa")
        right.legend(frameon=False, fontsize=8)
    return figure


def draw_loaded(full: np.ndarray, chain: np.ndarray, robot_name: str) -> Figure:
    """Return tips (samples, 3) m of the full model and of the loaded chain over each other, joined by their difference."""
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    for axis, (i, j) in zip(figure.subplots(1, 2), ((0, 2), (0, 1)), strict=True):
        for one, other in zip(1e3 * full, 1e3 * chain, strict=True):
            axis.plot([one[i], other[i]], [one[j], other[j]], "-", color="0.5", lw=0.8)
        axis.plot(*(1e3 * full[:, [i, j]].T), "o", ms=3.5, mfc="none", color="k", label="full model")
        axis.plot(*(1e3 * chain[:, [i, j]].T), "x", ms=3.5, color="C0", label="surrogate")
        axis.set(xlabel=f"{'xyz'[i]} in mm", ylabel=f"{'xyz'[j]} in mm", aspect="equal")
    figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    figure.suptitle(f"{robot_name} under the same pressures and tip forces")
    return figure
