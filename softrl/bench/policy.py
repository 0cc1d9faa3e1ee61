"""bench=policy: how often a second the whole chain from a reading of the tip to pressures can be gone through."""

from dataclasses import dataclass

import numpy as np

from softrl.artifacts.calibration import Calibration
from softrl.artifacts.policy import Policy
from softrl.artifacts.surrogate import Surrogate
from softrl.bench.watch import Watch, timing
from softrl.core.errors import ConfigError
from softrl.core.tracking import Tracker
from softrl.rl.tasks.curves import CURVES
from softrl.rl.workspace import Workspace
from softrl.sim2real.controller import PolicyController
from softrl.sim2real.course import Course

RADIUS_SHARE = 0.8


@dataclass(frozen=True)
class PolicyBench:
    """One observation at a time, as on the robot.

    Attributes
    ----------
    decisions : in a timed run, along the 3-D figure-eight
    """

    policy: Policy
    surrogate: Surrogate
    calibration: Calibration
    decisions: int

    def __post_init__(self) -> None:
        if self.decisions < 1:
            raise ConfigError(f"bench.policy.decisions={self.decisions} must be at least 1")

    def measure(self, watch: Watch, seed: int, tracker: Tracker) -> dict[str, float]:
        """Return the metrics; the tip is read with a millimetre of noise."""
        rng, space = np.random.default_rng(seed), Workspace(self.surrogate)
        shape = CURVES["figure_eight"](self.decisions)
        target = space.fitted(shape, space.centre, RADIUS_SHARE, "figure_eight")
        tips = target + 1e-3 * rng.standard_normal(target.shape)
        controller = PolicyController(self.policy, self.surrogate, self.calibration, Course.free("circle", target))

        def run() -> list[float]:
            taken = []
            for step, tip in enumerate(tips):
                began = watch.now()
                controller.pressure(tip, step)
                taken.append(watch.now() - began)
            return taken

        run()  # what is compiled or loaded at the first call
        rounds = [run() for _ in range(watch.repeats)]
        longest = float(np.quantile(np.concatenate(rounds), 0.99))
        metrics = timing([sum(taken) for taken in rounds]).rate("policy", self.decisions, "hz")
        return metrics | {"policy_latency_p99_ms": 1e3 * longest}
