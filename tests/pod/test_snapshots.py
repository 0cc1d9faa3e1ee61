"""Snapshots: one row per load in all that is of a sample."""

from dataclasses import fields, replace

import numpy as np
import pytest

from softrl.artifacts.reduced_model import ReducedModel
from softrl.artifacts.snapshots import PER_SAMPLE, Snapshots
from softrl.core.errors import ArtifactError
from softrl.robots.robot import Robot

Body = tuple[Robot, Snapshots, ReducedModel]


@pytest.mark.parametrize("name", PER_SAMPLE)
def test_a_row_too_few_is_refused(tripod: Body, name: str) -> None:
    snapshots = tripod[1]
    with pytest.raises(ArtifactError, match=f"Snapshots.{name} has 39 rows for 40 loads"):
        replace(snapshots, **{name: getattr(snapshots, name)[1:]}).validate()


def test_slopes_have_a_row_per_load_and_no_array_of_samples_is_forgotten(tripod: Body) -> None:
    snapshots = tripod[1]
    few = snapshots.slopes | {"give": snapshots.slopes["give"][1:]}
    with pytest.raises(ArtifactError, match="slopes/give has 39 rows"):
        replace(snapshots, slopes=few).validate()
    arrays = {field.name: getattr(snapshots, field.name) for field in fields(snapshots)}
    shared = {"loads", "moment_gram", "nodal_mass", "rest_tip", "rest_volume"}  # forty nodes, too
    assert set(PER_SAMPLE) == {
        name for name, part in arrays.items()
        if isinstance(part, np.ndarray) and not name.startswith("trajectory") and name not in shared
    }  # fmt: skip
