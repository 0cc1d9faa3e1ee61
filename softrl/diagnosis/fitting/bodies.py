"""Bodies with other parameters, kept: what a simulator works out of them is worked out once."""

from functools import lru_cache

from softrl.core.identity import Same
from softrl.core.simulator import Simulator

KEPT = 16  # bodies with other parameters: the columns of a Jacobian by effects' parameters share one
STIFFNESS = "stiffness_scale", "modulus_scale"  # how names of a simulator's parameters end that make its wall stiffer


def tuned_body(simulator: Simulator, tuned: dict[str, float], stiffer: float) -> Simulator:
    """Return the ``simulator`` with parameters as they are ``tuned``, its wall ``stiffer`` by a share beyond that."""
    return _tuned(Same(simulator), *((k, v * (1.0 + stiffer) if k.endswith(STIFFNESS) else v) for k, v in tuned.items()))


@lru_cache(maxsize=KEPT)
def _tuned(same: Same[Simulator], *values: tuple[str, float]) -> Simulator:
    return same.thing.with_parameters(**dict(values)) if values else same.thing
