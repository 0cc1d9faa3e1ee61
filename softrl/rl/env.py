"""The tasks as gymnasium environments: ``gymnasium.make("softrl/Track-v0", surrogate=..., task=...)`` and its kin."""

from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from softrl.artifacts.surrogate import Surrogate
from softrl.core.errors import ConfigError
from softrl.rl.batch import OBSERVATION_LIMIT, Batch
from softrl.rl.tasks.task import Task
from softrl.rl.workspace import Workspace

ENVIRONMENTS = {"track": "softrl/Track-v0", "force": "softrl/Force-v0", "hybrid": "softrl/Hybrid-v0"}
CURVES, CURVE_SEED = 32, 0


class TwinEnv(gym.Env[np.ndarray, np.ndarray]):
    """One episode on the surrogate's twin.

    Parameters
    ----------
    surrogate, task : the body and what is asked of it
    curves : random curves that episodes draw from
    expects : name of the task that the environment's id stands for, or None for any
    render_mode : None, or rgb_array for a picture of tip and targets
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 2}

    def __init__(
        self,
        surrogate: Surrogate,
        task: Task,
        curves: int = CURVES,
        expects: str | None = None,
        render_mode: str | None = None,
    ) -> None:
        if expects not in (None, task.name):
            raise ConfigError(
                f"task={task.name} does not belong into {ENVIRONMENTS[str(expects)]}; use {ENVIRONMENTS[task.name]}"
            )
        space = Workspace(surrogate)
        self.batch = Batch(task, space, task.training_goals(curves, space, np.random.default_rng(CURVE_SEED)), 1)
        self.observation_space, self.action_space = spaces_of(self.batch)
        self.render_mode = render_mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start at a random command on a random curve; the same seed gives the same episode."""
        super().reset(seed=seed)
        self.batch.start_random(np.array([0]), self.np_random)
        return self.batch.observation()[0], {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Apply a scaled joint command; episodes end by time only."""
        step = self.batch.step(np.asarray(action)[None])
        info = {"position_error_m": float(step.position_error[0]), "force_error_n": float(step.force_error[0])}
        done = bool(self.batch.elapsed[0] >= self.batch.episode_steps)
        return step.observation[0], float(step.reward[0]), False, done, info

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """Return a picture (height, width, 3) of tip and targets from the side and from above, or None without a mode."""
        return draw_scene(self.batch) if self.render_mode == "rgb_array" else None


def spaces_of(batch: Batch) -> tuple[gym.spaces.Box, gym.spaces.Box]:
    """Return the spaces of observations and actions."""
    limit = OBSERVATION_LIMIT
    return (
        gym.spaces.Box(-limit, limit, (batch.observation_size,), np.float32),
        gym.spaces.Box(-1.0, 1.0, (3,), np.float32),
    )


def draw_scene(batch: Batch) -> np.ndarray:
    """Return a picture (height, width, 3) uint8 of the first episode of a batch."""
    figure = Figure(figsize=(6.0, 3.2), dpi=100, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    goal = 1e3 * batch.goals.position[batch.curve[0]]
    next_up = 1e3 * batch.targets()[0][0, 0]
    for axis, (i, j) in zip(figure.subplots(1, 2), ((0, 2), (0, 1)), strict=True):
        axis.plot(goal[:, i], goal[:, j], "-", color="0.7", lw=1)
        axis.plot(*next_up[[i, j]], "o", mfc="none", color="C1", label="next target")
        axis.plot(*(1e3 * batch.tip[0])[[i, j]], "x", color="C0", label="tip")
        axis.set(xlabel=f"{'xyz'[i]} in mm", ylabel=f"{'xyz'[j]} in mm", aspect="equal")
    canvas.draw()
    picture = np.asarray(canvas.buffer_rgba())[..., :3].copy()
    figure.clear()
    return picture


for _name, _id in ENVIRONMENTS.items():
    if _id not in gym.registry:
        gym.register(_id, entry_point="softrl.rl.env:TwinEnv", kwargs={"expects": _name})
