"""A wall that is stiffer, or softer, at one height than the model's."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from softrl.effects.effect import Effect, parameter


@dataclass(frozen=True)
class LayerStiffness(Effect):
    """Stiffness of the wall at one height, as a multiple of the model's: one bellows of each chamber, or two neighbours.

    Notes
    -----
    Layer ``i`` of ``L``, from below, is ``1 + (scale - 1) max(0, 1 - |i - (L - 1) height_share|)`` times as stiff (no equation
    number checked): a layer at ``height_share = i / (L - 1)``, between two layers both. The body itself changes, see
    ``pod.step.layers``, with what it costs in rotation and weight; a body without layers, as the lumped one, cannot show it. What
    tells one layer from another is how far the tip turns for how far it moves.
    """

    site: ClassVar[str] = "body"
    title: ClassVar[str] = "stiffness of the wall"
    layered: ClassVar[bool] = True

    scale: float = parameter("1", 0.4, 2.5, 1.0, typical=0.7)
    height_share: float = parameter("1", 0.0, 1.0, 0.5, typical=0.5, scale=0.25)

    @classmethod
    def shapes(cls) -> list[dict[str, float]]:
        """Return layers near either end of the body: from the middle no slope leads past its neighbours."""
        return [{"height_share": 0.15}, {"height_share": 0.85}]

    def layers(self, count: int) -> np.ndarray:
        """Return the factors (count,) on the stiffness of the layers, from below."""
        near = 1.0 - np.abs(np.arange(count) - (count - 1) * self.height_share)
        return 1.0 + (self.scale - 1.0) * near.clip(min=0.0)
