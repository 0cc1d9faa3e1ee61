"""How the reduced model's error falls with equilibria and with coordinates."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.core.tracking import Tracker
from softrl.pod.fitting.basis import PodBasis
from softrl.pod.fitting.candidates import Choice
from softrl.pod.fitting.equilibria import Equilibria
from softrl.pod.fitting.fit import fit_model, folds_of, linear_model
from softrl.pod.fitting.settings import FitSettings
from softrl.pod.report import motions, rms, statics
from softrl.robots.robot import Robot


class Point(NamedTuple):
    """rms tip error m of a model fitted to ``equilibria``: on held-out ones, and on trajectories (nan without)."""

    equilibria: int
    static_m: float
    dynamic_m: float


def by_equilibria(
    shares: tuple[float, ...],
    settings: FitSettings,
    choice: Choice,
    robot: Robot,
    snapshots: Snapshots,
    samples: tuple[Equilibria, Equilibria],
    pod: PodBasis,
    whole: ReducedModel,
) -> list[Point]:
    """Return the errors of models fitted to the first ``shares`` of the seen samples, up to the chosen degree.

    ``whole`` is the one fitted to all of them.

    Sobol points fill the loads evenly however many are taken, so a share is what a smaller run would have seen.
    """
    seen, heldout = samples
    lean = replace(
        settings, energy_degree_max=max(choice.degree, 2), ridges=(max(choice.ridge, 1e-12),),
        image_weights=(choice.image_weight,), anchor_weights=(choice.anchor_weight,),
    )  # fmt: skip
    points = []
    for share in shares:
        count = max(settings.folds, round(share * len(seen.load)))
        few = seen.rows(slice(0, count))
        model = whole
        if count < len(seen.load):
            fold = folds_of(few, robot, settings.folds, np.random.default_rng(0))
            model, _ = fit_model(lean, robot, snapshots, few, pod, fold)
        points.append(Point(count, *errors_of(model, snapshots, heldout)))
    return points


def errors_of(model: ReducedModel, snapshots: Snapshots, heldout: Equilibria) -> tuple[float, float]:
    """Return the rms tip errors m on held-out equilibria and along the trajectories (nan without)."""
    static = rms(statics(model, heldout)[0].tip_errors())
    moving = rms(motions(model, snapshots).tip_errors()) if len(snapshots.trajectory_load) else np.nan
    return static, moving


def with_constant_viscosity(model: ReducedModel) -> ReducedModel:
    """Return ``model`` with the viscosity of its rest."""
    return replace(model, stiffness_root=model.stiffness_root[:, :1], drag_root=model.drag_root[:, :1])


def report_coordinates(
    model: ReducedModel, snapshots: Snapshots, heldout: Equilibria, tracker: Tracker
) -> None:
    """Log what a viscosity that changes and the non-linear maps are worth."""
    for name, other in (
        ("constant_viscosity", with_constant_viscosity(model)),
        ("linear", linear_model(model)),
        ("all", model),
    ):
        static, moving = errors_of(other, snapshots, heldout)
        tracker.metric(f"convergence/{name}_static_tip_rms_mm", 1e3 * static)
        if np.isfinite(moving):
            tracker.metric(f"convergence/{name}_dynamic_tip_rms_mm", 1e3 * moving)


def report_equilibria(points: list[Point], tracker: Tracker) -> None:
    """Log the errors against the number of equilibria."""
    for point in points:
        tracker.metric(f"convergence/equilibria_{point.equilibria}_static_tip_rms_mm", 1e3 * point.static_m)
        if np.isfinite(point.dynamic_m):
            tracker.metric(f"convergence/equilibria_{point.equilibria}_dynamic_tip_rms_mm", 1e3 * point.dynamic_m)
