"""The refit from the command may not unlearn what the measured pressure has shown of the body."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from softrl.diagnosis.judging.join import _spoilt


class Bowl:
    """Errs by ``noise``, and by its distance from the point at which it lies, m."""

    def __init__(self, noise: float) -> None:
        self.noise = noise

    def residual(self, _: Any, point: np.ndarray) -> Any:
        return SimpleNamespace(squares=np.full(4, self.noise**2 + float(point @ point)))


@pytest.mark.parametrize(
    ("noise", "moved", "helped", "spoilt"),
    [(1.0, 0.5, 1.0, False), (1.0, 2.0, 1.5, True), (1.0, 2.0, 3.0, False), (0.01, 0.1, 1.5, False)],
)
def test_a_point_is_spoilt_where_the_body_errs_more_than_it_helps(
    noise: float, moved: float, helped: float, spoilt: bool
) -> None:
    judge = SimpleNamespace(rms=lambda squares: float(np.sqrt(np.mean(squares))), material=0.2)
    final = SimpleNamespace(hypothesis=None, fit=SimpleNamespace(point=np.zeros(1)))
    motion: Any = SimpleNamespace(final=final, part=SimpleNamespace(problem=Bowl(noise)), judge=judge)
    assert _spoilt(motion, np.array([moved]), helped) is spoilt
