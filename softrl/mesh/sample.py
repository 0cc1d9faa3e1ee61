"""The coarse sample of the tripod that the repository holds, and how it is written."""

from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

from softrl.core.errors import ConfigError, MeshError
from softrl.mesh.geometry import TripodGeometry
from softrl.mesh.tetrahedra import Tetrahedra, tidy

SAMPLE = Path(__file__).resolve().parents[2] / "assets" / "tripod" / "sample_mesh.npz"


def read_sample(geometry: TripodGeometry, path: Path = SAMPLE) -> Tetrahedra:
    """Return the sample's tetrahedra.

    Raises
    ------
    ConfigError
        If ``geometry`` is not what the sample was made of, so that a changed measure is never without effect.
    """
    if not path.is_file():
        raise MeshError(f"the sample {path} is missing; generate the mesh instead: stage.source=generate")
    with np.load(path, allow_pickle=False) as data:
        made_of = dict(zip(data["geometry_names"].tolist(), data["geometry_values"].tolist(), strict=True))
        solid = tidy(data["points"], data["tetrahedra"])
    for field in fields(geometry):
        value, sampled = getattr(geometry, field.name), made_of.get(field.name)
        if sampled is None or not np.isclose(value, sampled, rtol=1e-9):
            raise ConfigError(
                f"stage.geometry.{field.name}={value:g}, but the sample mesh was made with {sampled}; "
                "use stage.source=generate for other measures"
            )
    return solid


def write_sample(solid: Tetrahedra, geometry: TripodGeometry, path: Path = SAMPLE) -> None:
    """Write ``solid`` as the sample of ``geometry``; points rounded to a tenth of a micrometre."""
    measures = asdict(geometry)
    np.savez_compressed(
        path,
        points=np.round(solid.points, 7),
        tetrahedra=solid.corners.astype(np.int32),
        geometry_names=np.array(list(measures)),
        geometry_values=np.array(list(measures.values()), float),
    )
