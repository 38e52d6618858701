"""Results as a spreadsheet: one row an instant, empty cells for what is undetermined."""

import csv
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from types import TracebackType

import numpy as np

from kinpole_ros.bags._reader import BagError
from kinpole_ros.estimate import POLE_NAMES, RATE_NAMES, Estimate, Numbers, Vectors
from kinpole_ros.parameters import Settings


class Table:
    """
    Writes estimates to a CSV file; use it in a `with` block. Raises BagError when it cannot.

    Columns: t in s; of every body x, y, angle, the rates and curvature each with the column
    NAME_sigma behind it, and the poles and the ICR's velocity as NAME_x, NAME_y and their sigmas;
    of every pair the relative rate and center. SI units, sigma is one standard deviation.
    """

    def __init__(self, path: str | Path, settings: Settings) -> None:
        self._path = Path(path)
        self._order = settings.derivative_order or 4
        self._pairs = [f'{j}_wrt_{i}' for i, j in combinations(settings.bodies, 2)]
        self._bodies = tuple(settings.bodies)
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._file = open(self._path, 'w', newline='', encoding='utf-8')  # noqa: SIM115
        except OSError as error:
            raise self._failed(error) from None
        self._rows = csv.writer(self._file)
        self._write(['t', *self._header()])

    def __enter__(self) -> 'Table':
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self._file.close()
        except OSError as failed:
            if kind is None:
                raise self._failed(failed) from None

    def add(self, estimate: Estimate) -> None:
        """Write the row of one instant."""
        seconds, rest = divmod(estimate.stamp, 1_000_000_000)
        cells = [f'{seconds}.{rest:09d}']
        for b in range(len(self._bodies)):
            cells += _pose(estimate, b)
            for numbers in self._numbers(estimate):
                cells += _number(numbers, b)
            for vectors in self._vectors(estimate):
                cells += _vector(vectors, b)
        for k in range(len(self._pairs)):
            cells += _number(estimate.relative_rate, k)
            cells += _vector(estimate.relative_icr, k)
        self._write(cells)

    def _numbers(self, estimate: Estimate) -> Iterator[Numbers]:
        for order in range(1, self._order + 1):
            yield estimate.rate(order)
        if self._order >= 3:
            yield estimate.centrode_curvature

    def _vectors(self, estimate: Estimate) -> Iterator[Vectors]:
        for order in range(1, self._order + 1):
            yield estimate.pole(order)
        if self._order >= 2:
            yield estimate.icr_velocity

    def _header(self) -> Iterator[str]:
        numbers = [*RATE_NAMES[: self._order]]
        if self._order >= 3:
            numbers.append('centrode_curvature')
        vectors = [*POLE_NAMES[: self._order]]
        if self._order >= 2:
            vectors.append('icr_velocity')
        for body in self._bodies:
            yield from (f'{body}_{name}' for name in ('x', 'y', 'angle'))
            yield from _columns(body, numbers, vectors)
        for pair in self._pairs:
            yield from _columns(pair, ['angular_velocity'], ['icr'])

    def _write(self, cells: list[str]) -> None:
        try:
            self._rows.writerow(cells)
        except OSError as error:
            raise self._failed(error) from None

    def _failed(self, error: OSError) -> BagError:
        return BagError(
            f'{self._path} cannot be written: {error.strerror}; '
            'check the path, its rights and the space on the disk'
        )


def _columns(prefix: str, numbers: list[str], vectors: list[str]) -> Iterator[str]:
    for name in numbers:
        yield from (f'{prefix}_{name}', f'{prefix}_{name}_sigma')
    for name in vectors:
        yield from (f'{prefix}_{name}_{end}' for end in ('x', 'y', 'x_sigma', 'y_sigma'))


def _pose(estimate: Estimate, b: int) -> list[str]:
    if estimate.missing[b]:
        return ['', '', '']
    place = estimate.position[0, b]
    return [repr(float(v)) for v in (place.real, place.imag, estimate.angle[0, b])]


def _number(numbers: Numbers, k: int) -> list[str]:
    if not numbers.determined[k]:
        return ['', '']
    return [repr(float(numbers.value[k])), repr(float(np.sqrt(numbers.variance[k])))]


def _vector(vectors: Vectors, k: int) -> list[str]:
    if not vectors.determined[k]:
        return ['', '', '', '']
    value = vectors.value[k]
    sigmas = np.sqrt(np.diagonal(vectors.covariance[k]))
    return [repr(float(v)) for v in (value.real, value.imag, *sigmas)]
