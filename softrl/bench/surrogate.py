"""bench=surrogate: control steps in PyBullet beside the paper's way, and environment steps of the batched twin."""

from dataclasses import dataclass

import numpy as np

from softrl.bench.watch import Watch
from softrl.core.errors import ConfigError
from softrl.core.tracking import Tracker
from softrl.rl.batch import Batch
from softrl.rl.tasks.task import Task
from softrl.rl.vector_env import TwinVecEnv
from softrl.rl.workspace import Workspace
from softrl.surrogate.paper_style import PaperStyleWorld
from softrl.surrogate.simulator import SurrogateSimulator

CURVES = 16


@dataclass(frozen=True)
class SurrogateBench:
    """The rigid-link surrogate.

    Attributes
    ----------
    simulator : the surrogate in PyBullet
    task : of the twin's environments
    control_steps : in a timed run;  hold_steps : how many of them share a command
    sub_steps : of the simulation in a control step
    envs : episodes side by side in the twin;  env_steps : of all of them together in a timed run
    """

    simulator: SurrogateSimulator
    task: Task
    control_steps: int
    hold_steps: int
    sub_steps: int
    envs: int
    env_steps: int

    def __post_init__(self) -> None:
        for name in ("control_steps", "hold_steps", "sub_steps", "envs", "env_steps"):
            if getattr(self, name) < 1:
                raise ConfigError(f"bench.surrogate.{name}={getattr(self, name)} must be at least 1")

    def measure(self, watch: Watch, seed: int, tracker: Tracker) -> dict[str, float]:
        """Return the metrics."""
        rng = np.random.default_rng(seed)
        return self._control_steps(watch, rng) | self._env_steps(watch, rng)

    def _control_steps(self, watch: Watch, rng: np.random.Generator) -> dict[str, float]:
        """Time the same commands in this surrogate and in the paper's style, and compare where the tips come to rest."""
        simulator, samples = self.simulator, self.simulator.surrogate.sample_joints
        theirs_world = PaperStyleWorld(simulator.surrogate, simulator.robot)
        holds = samples[rng.integers(len(samples), size=-(-self.control_steps // self.hold_steps))]
        commands = np.repeat(holds, self.hold_steps, axis=0)[: self.control_steps]
        dt_s = self.sub_steps / simulator.world.rate_hz

        def ours() -> np.ndarray:
            state, tip = simulator.reset(), np.empty((len(commands), 3))
            for k, theta in enumerate(commands):
                state = simulator.world.advance(state, theta, dt_s, None)
                tip[k] = simulator.observe(state)[0]
            return tip

        def theirs() -> np.ndarray:
            return np.stack([theirs_world.control_step(theta, self.sub_steps) for theta in commands])

        reached = ours()  # starts the server and compiles
        own, other = watch.time(ours, theirs)
        settled = slice(self.hold_steps - 1, None, self.hold_steps)
        apart = np.linalg.norm(reached[settled] - theirs()[settled], axis=1)
        metrics = own.rate("pybullet_control_steps", self.control_steps)
        metrics |= other.rate("paper_style_control_steps", self.control_steps)
        return metrics | {
            "speedup_vs_paper_style": other.median / own.median,
            "paper_style_links": theirs_world.links,
            "pybullet_rate_hz": simulator.world.rate_hz,
            "paper_style_settled_tip_difference_mm": 1e3 * float(np.sqrt((apart**2).mean())),
        }

    def _env_steps(self, watch: Watch, rng: np.random.Generator) -> dict[str, float]:
        """Time whole environment steps: action to equilibrium, observation, reward, and new episodes."""
        space = Workspace(self.simulator.surrogate)
        goals = self.task.training_goals(CURVES, space, rng)

        env = TwinVecEnv(Batch(self.task, space, goals, self.envs), seed=0)
        env.reset()
        rounds = -(-self.env_steps // self.envs)
        actions = rng.uniform(-1.0, 1.0, (rounds, self.envs, 3)).astype(np.float32)

        def run() -> None:
            for action in actions:
                env.step(action)

        run()  # compiles
        return watch.time(run)[0].rate("twin_env_steps", rounds * self.envs)
