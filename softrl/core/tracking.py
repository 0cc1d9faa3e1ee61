"""What a stage may report while it runs."""

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Tracker(Protocol):
    """Receives metrics, figures and texts of one stage run."""

    def metric(self, name: str, value: float, step: int | None = None) -> None:
        """Record a number; ``name`` is ``quantity_unit``, with the split before it: ``heldout/tip_error_mm``."""
        ...

    def figure(self, name: str, figure: "Figure") -> None:
        """Record a figure as ``name``.png and close it."""
        ...

    def text(self, name: str, content: str) -> None:
        """Record a text file under ``name`` (with its ending)."""
        ...


class NullTracker:
    """Keeps the last value of every metric and drops the rest: for tests."""

    def __init__(self) -> None:
        self.metrics: dict[str, float] = {}

    def metric(self, name: str, value: float, step: int | None = None) -> None:
        """Keep the value."""
        self.metrics[name] = float(value)

    def figure(self, name: str, figure: "Figure") -> None:
        """Close the figure."""
        figure.clear()

    def text(self, name: str, content: str) -> None:
        """Drop the text."""
