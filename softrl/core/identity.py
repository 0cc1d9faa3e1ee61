"""Things as keys of what is kept of them."""

from typing import Generic, TypeVar

T = TypeVar("T")


class Same(Generic[T]):
    """A ``thing`` as a key, equal to itself alone: arrays within it need not be compared, and it lives as long as the key."""

    def __init__(self, thing: T) -> None:
        self.thing = thing

    def __hash__(self) -> int:
        return id(self.thing)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and other.thing is self.thing
