"""Quantities that other packages compute from estimates."""

from collections.abc import Callable
from typing import NamedTuple

from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.values import Numbers, Vectors


class RegisteredQuantity(NamedTuple):
    """
    A quantity that another package computes from estimates, for topics, tables and `state`.

    `kind` is point, vector, number, force or torque; numbers (T,) are along the normal of the
    plane. It needs derivatives up to `order`. One of a `body` has its topic below the name of that,
    and a field in `state`.
    """

    topic: str
    kind: str
    order: int
    unit: str
    values: Callable[[Estimate], Numbers | Vectors]
    body: int | None = None

    @property
    def is_vector(self) -> bool:
        """Whether it has two components in the plane."""
        return self.kind not in ('number', 'torque')
