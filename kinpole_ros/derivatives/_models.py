"""
What kinds of motion there may be within a window, and how each differentiates it.

A signal is a line, a process of zero mean on top of it, and white noise. A process is known by its
spectrum, exp(-(w l)^p): a longer `l` is a slower motion, and the power `p` says how fast harmonics
fall. Low polynomials are processes too. On the samples of a window the singular vectors of a
process, its modes, make each of its amplitudes diagonal: evidence and derivatives of all amplitudes
are sums over modes (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006: 2.7 for
the line with a flat prior, 5.4 for the evidence).

Times are in samples from the middle of the window here, and signals in deviations of the noise.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Real

FEWEST_SAMPLES = 7
"""Samples of the shortest window there is."""
# Powers of the spectra, and the shortest length of each, samples.
SPECTRA = ((2.0, 1.0), (1.4, 1.0), (1.0, 4.0))
# The longest length, windows. Each of the others is half as long as the one before.
_LONGEST = 1.25
# A line is all there is of degree 1.
_DEGREES = (1, 2, 3, 4)
# Deviations of processes, the least and how many, each 10 times the one before; and how many there
# are for samples as good as exact, which go farther than is usual.
_LEAST_AMPLITUDE, _AMPLITUDES, _MORE = 10.0**0.5, 7, 11
# What of a process is at most this part of the noise is not seen.
_LEAST = 1e-2
# The processes have this part of the prior; low polynomials, the line, and rest have the other.
_PROCESSES = 0.5


class Process(NamedTuple):
    """A process by the number of its spectrum and its length, samples, or -1 and a degree."""

    spectrum: int
    length: float
    log_prior: float


class Modes(NamedTuple):
    """
    P processes on a window of n samples, as modes that are even or odd about its middle.

    `even` and `odd` (modes, (n + 1) // 2) make modes of the sums and differences of samples that
    lie opposite to each other, `vectors` (modes + 1, n) of all samples, the last being zero. The
    first of the even and of the odd are the mean and the slope. `place` (P, m) says which modes of
    all, even and then odd, a process has; where it has no more, that is one after the last. `size`
    (P, m) is how large a mode is by an amplitude of 1. By A amplitudes `share` (P, A, m) is how
    much of a mode is motion, `lost` (P, A, m) how much is not, `gain` (P, A, m) what the motion is
    in terms of the process, and `left` (P, A, m) the variance of these.

    Models are the processes, each with its amplitudes, and then rest, P A + 1 in all: `prior` is
    the logarithm of a model's prior, `chances` (models, 2, 1) are that less half of the logarithm
    of its determinant, for one and for two components, and `freedom` is how many parameters it has
    for the samples. Those of a spectrum begin at `groups`, the
    low polynomials, and rest, at the last of these.
    """

    even: Real
    odd: Real
    vectors: Real
    place: np.ndarray
    share: Real
    lost: Real
    gain: Real
    left: Real
    prior: Real
    chances: Real
    freedom: Real
    size: Real
    groups: np.ndarray
    processes: tuple[Process, ...]
    right: tuple[tuple[Real, Real], ...]
    amplitudes: Real
    exact: bool


class Stencils(NamedTuple):
    """
    What modes say of derivatives at an instant, K orders: `modes` (P, A K, m), of a process with
    each amplitude; `line` (2, K), of mean and slope; `covariance` (P A + 1, K K), of each model,
    rest being the last.
    """

    modes: Real
    line: Real
    covariance: Real


def _processes(count: int) -> tuple[Process, ...]:
    """All processes on a window of so many samples."""
    found = []
    for k, (_, least) in enumerate(SPECTRA):
        longest = _LONGEST * count
        lengths = longest / 2.0 ** np.arange(max(1, int(np.log2(longest / least)) + 1))
        prior = _PROCESSES / len(SPECTRA) / len(lengths)
        found += [Process(k, float(length), float(np.log(prior))) for length in lengths]
    prior = float(np.log(_simple()))
    return *found, *(Process(-1, degree, prior) for degree in _DEGREES)


def _simple() -> float:
    """The prior of a low polynomial, and of rest."""
    return (1 - _PROCESSES) / (len(_DEGREES) + 1)


def _values(process: Process, count: int, time: Real, order: int) -> tuple[Real, Real]:
    """Derivatives at times (T,) of the functions, even and odd, (T, J), that make up a process."""
    if process.spectrum < 0:
        powers = [np.polynomial.Polynomial([0] * d + [1.0]) for d in range(2, 1 + _degree(process))]
        scale = 2 / count
        found = [power.deriv(order)(scale * time) * scale**order for power in powers]
        values = np.reshape(found, (len(powers), len(time))).T
        return values[:, ::2], values[:, 1::2]
    # Waves of a sum that repeats itself, but not within a window.
    power, _ = SPECTRA[process.spectrum]
    step = 2 * np.pi / (count + 10 * process.length)
    frequency = step * np.arange(int(np.pi / step) + 1)
    weight = np.exp(-((frequency * process.length) ** power) / 2)
    weight[0] /= np.sqrt(2)
    weight /= np.sqrt((weight**2).sum())
    kept = weight > 1e-13
    phase = np.outer(time, frequency[kept]) + order * np.pi / 2
    weight = weight[kept] * frequency[kept] ** order
    return weight * np.cos(phase), weight * np.sin(phase)


def _degree(process: Process) -> int:
    return int(process.length)


@lru_cache(maxsize=64)
def modes_of(count: int, block: int = 1) -> Modes:
    """The modes of a window of `count` samples, a few or more, each the mean of `block`."""
    time, root, lines = _half_window(count)
    processes = _processes(count)
    rows: tuple[list[Real], list[Real]] = ([lines[0][None]], [lines[1][None]])
    sizes, right = [], []
    for process in processes:
        found = []
        for parity, part in enumerate(_averaged(process, count, time, block)):
            seen = root[:, None] * part
            seen = seen - np.outer(lines[parity], lines[parity] @ seen)
            vectors, size, turned = np.linalg.svd(seen, full_matrices=False)
            kept = size * _AMPLITUDES[-1] > _LEAST
            rows[parity].append(vectors[:, kept].T)
            found.append((size[kept], turned[kept]))
        sizes.append([size for size, _ in found])
        right.append((found[0][1], found[1][1]))
    even, odd = (np.concatenate(part) * root / 2 for part in rows)
    half, opposite = len(time), slice(count // 2 - 1, None, -1)
    vectors = np.zeros((len(even) + len(odd) + 1, count))
    vectors[: len(even), :half], vectors[len(even) : -1, :half] = even, odd
    vectors[: len(even), half:] = even[:, opposite]
    vectors[len(even) : -1, half:] = -odd[:, opposite]
    if count % 2:
        vectors[: len(even), half - 1] *= 2
    width = max(len(a) + len(b) for a, b in sizes)
    place = np.full((len(processes), width), len(even) + len(odd))
    size = np.zeros(place.shape)
    next_even, next_odd = 1, len(even) + 1
    for p, (a, b) in enumerate(sizes):
        numbers = (next_even + np.arange(len(a)), next_odd + np.arange(len(b)))
        place[p, : len(a) + len(b)] = np.concatenate(numbers)
        size[p, : len(a) + len(b)] = np.concatenate((a, b))
        next_even, next_odd = next_even + len(a), next_odd + len(b)
    amplitude = _AMPLITUDES[:, None]
    large = (amplitude * size[:, None]) ** 2
    share = large / (1 + large)
    gain = amplitude**2 * size[:, None] / (1 + large)
    left = amplitude**2 / (1 + large)
    # Rest has no slope, and is more probable by all that this might be.
    occam = np.append(-np.log1p(large).sum(axis=-1) / 2, np.log(_FLAT))
    prior = np.repeat([process.log_prior for process in processes], len(_AMPLITUDES))
    prior = np.append(prior - np.log(len(_AMPLITUDES)), np.log(_simple()))
    freedom = np.append(2 + share.sum(axis=-1), 1.0)
    spectra = [process.spectrum for process in processes]
    groups = np.array([spectra.index(k) for k in (*range(len(SPECTRA)), -1)]) * len(_AMPLITUDES)
    return Modes(
        even,
        odd,
        vectors,
        place,
        share,
        gain,
        left,
        prior,
        np.stack((prior + occam, prior + 2 * occam), axis=1)[..., None],
        freedom,
        size,
        groups,
        processes,
        tuple(right),
    )


def _half_window(count: int) -> tuple[Real, Real, tuple[Real, Real]]:
    """
    The first half of a window's times, with the middle if there is one, and what these stand for.

    That is the root of 2 for two samples opposite to each other, and 1 for the middle; then mean
    and slope, of length 1, of all samples.
    """
    time = np.arange((count + 1) // 2) - (count - 1) / 2
    root = np.where(time < 0, np.sqrt(2.0), 1.0)
    return time, root, (root / np.linalg.norm(root), root * time / np.linalg.norm(root * time))


def _averaged(process: Process, count: int, time: Real, block: int) -> tuple[Real, Real]:
    """The functions (T, J) that make up a process, as means over samples of the length of 1."""
    offsets = (np.arange(block) - (block - 1) / 2) / block
    parts = [_values(process, count, time + offset, 0) for offset in offsets]
    return sum(even for even, _ in parts) / block, sum(odd for _, odd in parts) / block


@lru_cache(maxsize=256)
def stencils_of(count: int, at: float, block: int, orders: int) -> Stencils:
    """
    Those of a window, as in `modes_of`, at an instant so many samples from its middle.

    Of so many `orders`, from 0.
    """
    modes = modes_of(count, block)
    time, root, lines = _half_window(count)
    width = np.linalg.norm(root * time)
    line = np.zeros((2, orders))
    line[0, 0] = count**-0.5
    line[1, :2] = at / width, 1 / width
    derived = np.zeros((len(modes.processes), orders, modes.place.shape[1]))
    unseen = np.zeros((len(modes.processes), orders, orders))
    for p, process in enumerate(modes.processes):
        seen = _averaged(process, count, time, block)
        here = [_values(process, count, np.array([at]), order) for order in range(orders)]
        begin = 0
        for parity, right in enumerate(modes.right[p]):
            rows = np.concatenate([pair[parity] for pair in here])
            rows = rows - np.outer(line[parity], lines[parity] @ (root[:, None] * seen[parity]))
            own = rows @ right.T
            derived[p, :, begin : begin + len(right)] = own
            begin += len(right)
            rows = rows - own @ right
            unseen[p] += rows @ rows.T
    weights = np.einsum('pkm,pam->pakm', derived, modes.gain)
    covariance = np.einsum('pkm,pjm,pam->pakj', derived, derived, modes.left)
    covariance += line.T @ line + (_AMPLITUDES**2)[:, None, None] * unseen[:, None]
    rest = np.zeros((1, orders, orders))
    rest[0, 0, 0] = 1 / count
    covariance = np.concatenate((covariance.reshape(-1, orders, orders), rest))
    weights = weights.reshape(len(weights), -1, weights.shape[-1])
    return Stencils(weights, line, covariance.reshape(len(covariance), -1))


@lru_cache(maxsize=16)
def slopes_of(count: int, block: int = 1) -> Real:
    """First and second derivatives (2, modes + 1, n) of the modes of a window at its samples."""
    modes = modes_of(count, block)
    half_time, root, lines = _half_window(count)
    time = np.arange(count) - (count - 1) / 2
    width = np.linalg.norm(time)
    slopes = np.zeros((2, *modes.vectors.shape))
    slopes[0, len(modes.even)] = 1 / width
    for p, process in enumerate(modes.processes):
        begin = 0
        seen = _averaged(process, count, half_time, block)
        for parity, right in enumerate(modes.right[p]):
            part = slice(begin, begin + len(right))
            size = modes.size[p, part, None]
            for order in (1, 2):
                rows = right @ _values(process, count, time, order)[parity].T
                if parity and order == 1:
                    rows -= (right @ (lines[1] * root @ seen[1]))[:, None] / width
                slopes[order - 1, modes.place[p, part]] = rows / size
            begin += len(right)
    return slopes
