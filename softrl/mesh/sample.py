"""The coarse meshes of the tripod that the repository holds, so that a first run need not mesh."""

from dataclasses import asdict
from pathlib import Path

import numpy as np

from softrl.core.errors import ConfigError, MeshError
from softrl.mesh.cavity import degrees_apart
from softrl.mesh.geometry import TripodGeometry
from softrl.mesh.tetrahedra import Tetrahedra, TetrahedraSettings, tidy
from softrl.robots.robot import Robot

PACKAGE = Path(__file__).resolve().parents[1]
# beside the package in the repository, inside it when installed
SAMPLES = next((p / "assets" / "tripod" for p in (PACKAGE, PACKAGE.parent) if (p / "assets").is_dir()), PACKAGE)
PATTERN = "sample_mesh*.npz"
TURNED_DEG, OTHER_SHARE = 2.0, 0.01  # chambers turned, or measures changed, by more than this belong to another robot
MEASURES = ("chamber_radius_m", "length_m")


def read_sample(
    geometry: TripodGeometry, settings: TetrahedraSettings, robot: Robot, folder: Path = SAMPLES
) -> Tetrahedra:
    """Return the tetrahedra of the sample that was made of ``geometry`` with ``settings``.

    Raises
    ------
    ConfigError
        If no sample was made so, or it is of another robot: a changed measure must not stay without effect.
    """
    paths = sorted(folder.glob(PATTERN))
    if not paths:
        raise MeshError(f"{folder} holds no {PATTERN}; generate the mesh instead: stage.source=generate")
    wanted, changed = _recipe(geometry, settings), []
    for path in paths:
        with np.load(path, allow_pickle=False) as data:
            made_of = dict(zip(data["recipe_names"].tolist(), data["recipe_values"].tolist(), strict=True))
            differing = [key for key, value in wanted.items() if not np.isclose(value, made_of.get(key, np.nan))]
            if not differing:
                _check_robot(robot, data["chamber_angle_deg"], {name: float(data[name]) for name in MEASURES})
                return tidy(data["points"], data["tetrahedra"])
        changed.append((len(differing), differing[0], made_of.get(differing[0])))
    _, key, sampled = min(changed, key=lambda c: c[0])
    raise ConfigError(
        f"stage.{key}={wanted[key]:g}, but the nearest sample mesh was made with {sampled}; "
        "use stage.source=generate for other measures"
    )


def write_sample(
    solid: Tetrahedra, geometry: TripodGeometry, settings: TetrahedraSettings, robot: Robot, path: Path
) -> None:
    """Write ``solid`` as a sample together with its recipe; points are rounded to a tenth of a micrometre."""
    recipe = _recipe(geometry, settings)
    np.savez_compressed(
        path,
        points=np.round(solid.points, 7),
        tetrahedra=solid.corners.astype(np.int32),
        recipe_names=np.array(list(recipe)),
        recipe_values=np.array(list(recipe.values()), float),
        chamber_angle_deg=np.array(robot.chamber_angle_deg, float),
        **{name: np.array(getattr(robot, name), float) for name in MEASURES},
    )


def _recipe(geometry: TripodGeometry, settings: TetrahedraSettings) -> dict[str, float]:
    measures = {f"geometry.{key}": value for key, value in asdict(geometry).items() if key not in asdict(settings)}
    return measures | {f"tetrahedra.{key}": value for key, value in asdict(settings).items()}


def _check_robot(robot: Robot, angle_deg: np.ndarray, measures: dict[str, float]) -> None:
    """Raise ``ConfigError`` unless ``robot`` has the sample's chambers, in any order, and its ``measures`` in m."""
    apart = degrees_apart(np.array(robot.chamber_angle_deg), angle_deg)
    differs = []
    if robot.chambers != len(angle_deg) or max(apart.min(axis=0).max(), apart.min(axis=1).max()) > TURNED_DEG:
        differs.append(f"robot.chamber_angle_deg={list(robot.chamber_angle_deg)} where it has {angle_deg.tolist()}")
    for name, value in measures.items():
        if abs(getattr(robot, name) - value) > OTHER_SHARE * value:
            differs.append(f"robot.{name}={getattr(robot, name):g} where it has {value:g}")
    if differs:
        raise ConfigError(
            f"stage.source=sample is the mesh of another robot: {', '.join(differs)}; give the mesh or surface of robot "
            f"{robot.name}, stage.source=<mesh>, or stage.source=generate if it is a tripod with the measures of stage.geometry"
        )
