"""The coarse meshes of the tripod that the repository holds, so that a first run need not mesh."""

from dataclasses import asdict
from pathlib import Path

import numpy as np

from softrl.core.errors import ConfigError, MeshError
from softrl.mesh.geometry import TripodGeometry
from softrl.mesh.tetrahedra import Tetrahedra, TetrahedraSettings, tidy

PACKAGE = Path(__file__).resolve().parents[1]
# beside the package in the repository, inside it when installed
SAMPLES = next((p / "assets" / "tripod" for p in (PACKAGE, PACKAGE.parent) if (p / "assets").is_dir()), PACKAGE)
PATTERN = "sample_mesh*.npz"


def read_sample(geometry: TripodGeometry, settings: TetrahedraSettings, folder: Path = SAMPLES) -> Tetrahedra:
    """Return the tetrahedra of the sample that was made of ``geometry`` with ``settings``.

    Raises
    ------
    ConfigError
        If no sample was made so: a changed measure must not stay without effect.
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
                return tidy(data["points"], data["tetrahedra"])
        changed.append((len(differing), differing[0], made_of.get(differing[0])))
    _, key, sampled = min(changed, key=lambda c: c[0])
    raise ConfigError(
        f"stage.{key}={wanted[key]:g}, but the nearest sample mesh was made with {sampled}; "
        "use stage.source=generate for other measures"
    )


def write_sample(solid: Tetrahedra, geometry: TripodGeometry, settings: TetrahedraSettings, path: Path) -> None:
    """Write ``solid`` as a sample together with its recipe; points are rounded to a tenth of a micrometre."""
    recipe = _recipe(geometry, settings)
    np.savez_compressed(
        path,
        points=np.round(solid.points, 7),
        tetrahedra=solid.corners.astype(np.int32),
        recipe_names=np.array(list(recipe)),
        recipe_values=np.array(list(recipe.values()), float),
    )


def _recipe(geometry: TripodGeometry, settings: TetrahedraSettings) -> dict[str, float]:
    measures = {f"geometry.{key}": value for key, value in asdict(geometry).items()}
    return measures | {f"tetrahedra.{key}": value for key, value in asdict(settings).items()}
