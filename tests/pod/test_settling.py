"""Energies with a well beyond the samples are not trusted."""

from dataclasses import replace

import numpy as np

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import Snapshots
from softrl.core.polynomial import basis
from softrl.pod.fitting.fit import linear_model
from softrl.pod.fitting.settling import settles
from softrl.pod.step.tables import hessian_at_rest
from softrl.robots.robot import Robot

BARRIER = 0.8  # |y| beyond which the body no longer comes back


def test_a_well_behind_an_overshoot_is_found_by_throwing(tripod: tuple[Robot, Snapshots, ReducedModel]) -> None:
    """Under nine tenths of the largest force that it bears a body stands, but flies past it when that acts at once."""
    straight = replace(linear_model(tripod[2]), gravity_m_s2=np.zeros(3), rayleigh_stiffness_s=0.0, rayleigh_mass_per_s=0.1)
    size, axes = np.linalg.eigh(hessian_at_rest(straight.energy, straight.order))
    along, stiffness = axes[:, 0], float(size[0])
    cubic = stiffness / (3.0 * BARRIER)
    table, points = basis(straight.order, 3), np.random.default_rng(0).normal(size=(400, straight.order))
    falling = np.linalg.lstsq(table.values(points), (points @ along) ** 3, rcond=None)[0]
    wells = replace(straight, energy=np.r_[straight.energy, np.zeros(len(falling) - len(straight.energy))] - cubic * falling)
    force = 0.9 * stiffness**2 / (12.0 * cubic) * along
    loads = np.stack([np.zeros(straight.order), np.linalg.solve(straight.frame.T, force)])
    assert settles(straight, loads, thrown=False) and settles(straight, loads, thrown=True)
    assert settles(wells, loads, thrown=False)
    assert not settles(wells, loads, thrown=True)
