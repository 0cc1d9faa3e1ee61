"""The maps of a reduced model besides its energy, fitted to equilibria: amplitudes, viscosity, centre of mass, rotation."""

import logging
from typing import Any, NamedTuple

import numpy as np

from softrl.pod.fitting.equilibria import Answers, Equilibria, slopes_of
from softrl.pod.fitting.maps import Seen, best_forms, equations, symmetric_roots, trust
from softrl.pod.fitting.settings import FitSettings
from softrl.pod.fitting.symmetry import lopsided, reflected, weight_to_trust
from softrl.robots.robot import Robot
from softrl.robots.symmetry import Symmetry, images_of, symmetries

log = logging.getLogger(__name__)
ROUND_OFF = 1e-9  # of what is largest
RIDGES = (1e-10, 1e-8, 1e-7, 1e-6, 1e-5)  # tried for every map
LOPSIDED = 0.1  # of the mass at rest: a mesh that is merely unstructured has some per cent


ALIKE = (  # maps that are fitted together: in turn those that vanish at rest and the others, with slopes and without
    ("amplitudes", "centre_of_mass", "rotation", "layer_energy"),
    ("stiffness_root", "inner_root", "drag_root", "give", "give_rotation", "inner_give", "inner_rotation"),
    ("layer_give", "layer_drop", "layer_spin"),
    ("stiffness_root_by_gravity",),
)
AT_REST = ALIKE[0], ALIKE[2]  # those that vanish at rest


def fit_maps(
    settings: FitSettings, robot: Robot, samples: Equilibria, frame: np.ndarray, fold: np.ndarray
) -> dict[str, Any]:
    """Return the coefficients of all maps besides the energy; each weighs the samples' images as they deserve.

    A map is fitted to its values at the equilibria and, where that is known, to how it changes under the largest load of
    each kind. Equilibria that no polynomial follows count for little, see ``trust``. Images by a symmetry that the body
    plainly lacks are those of another body: they are left out.
    """
    images = _images_of(robot, samples, frame)
    weights = settings.image_weights if images else (0.0,)
    everything = reflected(samples, [*symmetries(robot.chamber_direction)[:1], *images])
    largest = np.abs(everything.load).max(axis=0)
    modes = modes_of(everything, largest, settings.amplitudes_max)
    terms = Terms(frame, _mean_factor(everything, frame, "stiffness"), modes, float(samples.moment_gram[0, 0]))
    goals = _goals(everything, terms, largest)
    goals["stiffness_root_by_gravity"] = _stiffness_root_by_gravity(everything.answers, terms)
    goals |= {name: _flat(everything.answers[name]) for name in ("layer_drop", "layer_spin")}
    goals["layer_give"] = _flat(_pairs(everything.answers["layer_give"]))
    seen = Seen(
        np.linalg.solve(frame, everything.coordinate.T).T, np.linalg.solve(frame, everything.compliance) * largest
    )
    folds, own = np.tile(fold, 1 + len(images)), slice(0, len(fold))
    maps: dict[str, Any] = {"stiffness_factor": terms.stiffness_factor}
    for names in ALIKE:
        degrees, at_origin = {name: _degree_max(name, settings) for name in names}, names in AT_REST
        parts = {
            weight: _part(weight, seen, {name: goals[name] for name in names}, len(fold))
            for weight in weights
        }
        trusted = trust(*parts[max(parts)], degrees, at_origin)
        parts = {weight: (here, values, each * trusted[: len(each)]) for weight, (here, values, each) in parts.items()}
        forms = {
            weight: best_forms(here, values, each, folds[: len(each)], own, degrees, at_origin, RIDGES)
            for weight, (here, values, each) in parts.items()
        }
        for name in names:
            image = weight_to_trust({weight: np.sqrt(form[name].error) for weight, form in forms.items()})
            form, (here, values, each) = forms[image][name], parts[image]
            maps[name] = equations(here, values[name], each, form.degree, at_origin).solve(form.ridge)
            log.debug("%s of degree %d, ridge %g, images of weight %g", name, form.degree, form.ridge, image)
    mass = frame.T @ samples.answers["mass"] @ frame
    maps["amplitudes"] = _with_rest(maps["amplitudes"], goals["amplitudes"][own], seen.rows(own), mass)
    return maps


def tell_symmetry(robot: Robot, samples: Equilibria, frame: np.ndarray) -> None:
    """Warn where the body plainly lacks a symmetry of the robot's, once for all fits: workers' logs are nobody's."""
    if len(_images_of(robot, samples, frame)) < len(images_of(robot)):
        log.warning(
            "robot %s: a symmetry of its chambers' layout changes the body's mass at rest by more than %.0f %%: its maps are "
            "fitted without images of the samples by such symmetries; if the body is meant to have them, put the centre of its "
            "base at x = y = 0 and check robot.chamber_angle_deg, else run stage=fem with more equilibria",
            robot.name, 100.0 * LOPSIDED,
        )  # fmt: skip


def _images_of(robot: Robot, samples: Equilibria, frame: np.ndarray) -> list[Symmetry]:
    """Return the robot's symmetries besides the identity, but for those that the body plainly lacks."""
    return [image for image in images_of(robot) if lopsided(samples, image, frame) <= LOPSIDED]


def modes_of(samples: Equilibria, largest: np.ndarray, most: int) -> np.ndarray:
    """Return (k, a, 3) kg^-0.5, by which moments become amplitudes: of modes that are orthonormal in the mass.

    They are those in which ``samples`` move most: where they are, and how they change under the ``largest`` load of each kind.
    """
    values, vectors = np.linalg.eigh(samples.moment_gram)
    whole = values > ROUND_OFF * values[-1]
    whitened = vectors[:, whole] / np.sqrt(values[whole])
    moved = [samples.answers["moments"], *np.moveaxis(samples.slopes["moments"] * largest[:, None, None], 1, 0)]
    fields = (whitened.T @ np.concatenate(moved)).reshape(len(largest) * len(samples.load) + len(samples.load), -1)
    _, sizes, shapes = np.linalg.svd(fields, full_matrices=False)
    kept = shapes[:most][sizes[:most] > ROUND_OFF * sizes[0]]
    return np.asarray(whitened @ kept.reshape(len(kept), -1, 3))


def _with_rest(coefficients: np.ndarray, goal: np.ndarray, seen: Seen, mass: np.ndarray) -> np.ndarray:
    """Return the amplitudes (k + r, monomials) with r more, linear ones: what k of them leave of ``mass`` (S, r, r) near rest.

    ``goal`` (S, 1 + n + 3, k) are the amplitudes and their changes along the moves that are ``seen``, of the body's own samples:
    so the mass is exact at rest, on this mesh.
    """
    near = [int(np.linalg.norm(seen.points, axis=1).argmin())]
    lead = np.linalg.solve(seen.moves[near].transpose(0, 2, 1), goal[near, 1:])  # (1, r, k)
    rest = symmetric_roots(mass[near] - lead @ lead.transpose(0, 2, 1))[0]
    linear = np.zeros((len(rest), coefficients.shape[1]))
    linear[:, 1 : 1 + len(rest)] = rest
    return np.concatenate([coefficients, linear])


def _part(
    image_weight: float, seen: Seen, goals: dict[str, np.ndarray], own: int
) -> tuple[Seen, dict[str, np.ndarray], np.ndarray]:
    """Return where, what and with which weight (S,) maps are seen: ``own`` samples, and unless they weigh nothing images."""
    goal = next(iter(goals.values()))
    rows = slice(0, len(goal) if image_weight else own)
    weight = np.where(np.arange(len(goal)) < own, 1.0, image_weight)[rows]
    values = {name: value[rows] for name, value in goals.items()}
    return Seen(seen.points[rows], seen.moves[rows, :, : goal.shape[1] - 1]), values, weight


def _degree_max(name: str, settings: FitSettings) -> int:
    """Return the highest degree that is tried for a map."""
    own = {
        "centre_of_mass": max(settings.energy_degree_max - 1, 2),  # weight is less than elasticity, and costs as much
        "layer_energy": max(settings.energy_degree_max - 1, 2),
        "layer_drop": settings.map_degree_max,
        "layer_spin": settings.map_degree_max,
        "layer_give": settings.map_degree_max,
        "rotation": settings.map_degree_max,
        "amplitudes": settings.amplitude_degree_max,
        "stiffness_root": settings.viscosity_degree_max,
    }
    return own.get(name, settings.root_degree_max)


class Terms(NamedTuple):
    """In what terms maps are seen: the frame, a factor L with L L' the mean viscosity, modes (k, a, 3), and the mass."""

    frame: np.ndarray
    stiffness_factor: np.ndarray
    modes: np.ndarray
    mass: float


def _goals(images: Equilibria, terms: Terms, largest: np.ndarray) -> dict[str, np.ndarray]:
    """Return by name what the maps are fitted to (S, 1 + n + 3, columns): values, then changes under each load."""

    def values(answers: Answers) -> Answers:
        return _values(answers, terms)

    slopes = slopes_of(values, {name: images.answers[name] for name in images.slopes}, images.slopes, largest)
    return {
        name: np.concatenate([value[:, None], slopes[name] * largest[:, None]], axis=1)
        for name, value in values(images.answers).items()
    }


def _root(answers: Answers, terms: Terms) -> np.ndarray:
    """Return symmetric S (S, r, r) with ``L S S L'`` the viscosity."""
    return symmetric_roots(_apart(terms.stiffness_factor, terms.frame.T @ answers["stiffness"] @ terms.frame))


def _apart(factor: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Return L^-1 ``matrices`` L^-T of ``factor`` L."""
    inverse = np.linalg.inv(factor)
    return inverse @ matrices @ inverse.T


def _stiffness_root_by_gravity(answers: Answers, terms: Terms) -> np.ndarray:
    """Return the changes (S, 1, 3 pairs) of the root of viscosity by unit gravity along each axis."""
    values, vectors = np.linalg.eigh(_root(answers, terms))
    vectors = vectors[:, None]
    change = _apart(terms.stiffness_factor, terms.frame.T @ answers["viscosity_by_gravity"] @ terms.frame)
    turned = vectors.transpose(0, 1, 3, 2) @ change @ vectors / (values[:, :, None] + values[:, None])[:, None]
    return _flat(_pairs(vectors @ turned @ vectors.transpose(0, 1, 3, 2)))


def _flat(values: np.ndarray) -> np.ndarray:
    """Return ``values`` (S, ...), whose slopes are not known, as what a map is fitted to (S, 1, columns)."""
    return values.reshape(len(values), 1, -1)


def _pairs(matrices: np.ndarray) -> np.ndarray:
    """Return the upper triangles (..., pairs) of ``matrices`` (..., r, r)."""
    rows, columns = np.triu_indices(matrices.shape[-1])
    return matrices[..., rows, columns]


def _values(answers: Answers, terms: Terms) -> Answers:
    """Return the values (S, columns) of every map whose slopes are known."""
    frame, viscous = terms.frame, _root(answers, terms)
    mass = np.linalg.cholesky(frame.T @ answers["mass"] @ frame).transpose(0, 2, 1)
    moments = answers["moments"]
    drag_across, give_across = answers["inner_drag"] @ frame, answers["inner_coupling"] @ frame
    values = {
        "amplitudes": np.einsum("sai,kai->sk", moments, terms.modes),
        "stiffness_root": _pairs(viscous),
        "inner_root": _rows_beside(mass, give_across, answers["inner_mass"]),
        "drag_root": _rows_beside(viscous @ terms.stiffness_factor.T, drag_across, answers["inner_viscosity"]),
        "give": symmetric_roots(answers["give"]),
        "centre_of_mass": moments[:, 0] / terms.mass,
        "rotation": answers["rotation"],
        "give_rotation": answers["give_spin"],
        "inner_give": _triangles(answers["inner_give"]),
        "inner_rotation": answers["inner_spin"],
        "layer_energy": answers["layer_energy"],
    }
    return {name: value.reshape(len(value), -1) for name, value in values.items()}


def _rows_beside(root: np.ndarray, across: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return A and B (S, 6 r + 21) with R'A = ``across``' (S, r, 6) and A'A + B'B = ``own`` (S, 6, 6), R the ``root``.

    Of B its upper triangle.
    """
    above = np.linalg.solve(root.transpose(0, 2, 1), across.transpose(0, 2, 1))
    return np.hstack([above.reshape(len(above), -1), _triangles(own - above.transpose(0, 2, 1) @ above)])


def _triangles(squares: np.ndarray) -> np.ndarray:
    """Return the upper triangles R (S, pairs) with R'R = ``squares`` (S, k, k), which may be singular."""
    upper = np.linalg.qr(symmetric_roots(squares))[1]
    sign = np.where(np.einsum("sii->si", upper) < 0.0, -1.0, 1.0)
    return _pairs(upper * sign[:, :, None])


def _mean_factor(samples: Equilibria, frame: np.ndarray, name: str) -> np.ndarray:
    """Return the lower triangular factor of the mean of the answer ``name`` per ``frame``."""
    return np.linalg.cholesky((frame.T @ samples.answers[name] @ frame).mean(axis=0))
