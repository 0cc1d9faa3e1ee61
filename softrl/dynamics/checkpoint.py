"""A training that can be broken off: all that the next update depends on, kept every so many updates."""

import logging
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import nn

from softrl.core.errors import SolverError
from softrl.core.resume import Kept

log = logging.getLogger(__name__)
DIVERGED = 1e6  # times what the closed form leaves


@dataclass
class Training:
    """A network on its way through its updates.

    Attributes
    ----------
    net, optimiser, schedule : changed by every update
    generator : draws the windows of the updates
    losses : name -> one value per update or judgement
    done : updates behind it
    """

    net: nn.Module
    optimiser: torch.optim.Optimizer
    schedule: torch.optim.lr_scheduler.LRScheduler
    generator: torch.Generator
    losses: dict[str, list[float]]
    done: int = 0


@dataclass
class Checkpoint:
    """Where a training is kept, under ``name``, every ``every`` updates; without ``kept`` it is not.

    Attributes
    ----------
    resumed : updates that an earlier run had done
    """

    kept: Kept | None
    name: str
    every: int
    resumed: int = field(default=0, init=False)

    def restore(self, training: Training) -> None:
        """Put ``training`` where an earlier run was broken off, if there was one."""
        if self.kept is None or self.name not in self.kept:
            return
        _unpack(training, self.kept.load(self.name))
        self.resumed = training.done
        log.info("training of %s goes on after %d updates of an earlier run", self.name, training.done)

    def keep(self, training: Training, last: int) -> None:
        """Keep ``training`` if it is time to, or if it has reached the update ``last``."""
        if self.kept is not None and (training.done % self.every == 0 or training.done == last):
            self.kept.save(self.name, _pack(training))


NO_CHECKPOINT = Checkpoint(None, "", 1)


def require_finite(loss: torch.Tensor, name: str, update: int) -> None:
    """Refuse to go on with a loss that is no number, or out of all proportion: the checkpoint before it stays."""
    if not float(loss.detach()) < DIVERGED:
        raise SolverError(
            f"training of {name} diverged in update {update}: its loss is {loss.item()}; "
            "lower stage.learning_rate (stage.inverse_learning_rate for the inverse)"
        )


def _pack(training: Training) -> dict[str, np.ndarray]:
    arrays = {f"net/{name}": value.numpy() for name, value in training.net.state_dict().items()}
    state = training.optimiser.state_dict()
    for number, moments in state["state"].items():
        arrays |= {f"moment/{number}/{name}": value.numpy() for name, value in moments.items()}
    group = state["param_groups"][0]
    arrays["rate"] = np.array([group["lr"], *group["betas"]])
    arrays["generator"] = training.generator.get_state().numpy()
    arrays["done"] = np.asarray(training.done)
    return arrays | {f"loss/{name}": np.array(values) for name, values in training.losses.items()}


def _unpack(training: Training, arrays: dict[str, np.ndarray]) -> None:
    training.done = int(arrays["done"])
    training.net.load_state_dict({name: torch.tensor(value) for name, value in _under("net", arrays).items()})
    state = training.optimiser.state_dict()
    state["state"] = {}
    for name, value in _under("moment", arrays).items():
        number, moment = name.split("/")
        state["state"].setdefault(int(number), {})[moment] = torch.tensor(value)
    lr, *betas = arrays["rate"].tolist()
    state["param_groups"][0] |= {"lr": lr, "betas": tuple(betas)}
    training.optimiser.load_state_dict(state)
    # the cycle of the learning rate follows from the number of updates alone
    at = {"last_epoch": training.done, "_step_count": training.done + 1, "_last_lr": [lr]}
    training.schedule.load_state_dict(training.schedule.state_dict() | at)
    training.generator.set_state(torch.tensor(arrays["generator"]))
    training.losses |= {name: values.tolist() for name, values in _under("loss", arrays).items()}


def _under(prefix: str, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name.removeprefix(f"{prefix}/"): a for name, a in arrays.items() if name.startswith(f"{prefix}/")}
