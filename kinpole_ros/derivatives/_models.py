"""
What kinds of motion there may be within a window, and how each differentiates it.

A signal is a line, a process of zero mean on top of it, and white noise. A process is known by its
spectrum, exp(-(w l)^p): a longer `l` is a slower motion, and the power `p` says how fast harmonics
fall. Low polynomials are processes too. For covariances alone there is a rough spectrum, that of a
motion with four derivatives only (Matern 9/2: Rasmussen and Williams, Gaussian Processes for
Machine Learning, 2006, 4.2.1). On the samples of a window the singular vectors of a process, its
modes, make each of its amplitudes diagonal: evidence and derivatives of all amplitudes are sums
over modes (there, 2.7 for the line with a flat prior, 5.4 for the evidence).

Times are in samples from the middle of the window here, and signals in deviations of the noise. All
is made once for each kind of window, as arrays that _evidence.h reads.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Real

FEWEST_SAMPLES = 7
"""Samples of the shortest window there is."""
# Powers of the spectra, and the shortest length of each, samples.
SPECTRA = ((2.0, 1.0), (1.4, 1.0), (1.0, 4.0))
# Smoothness of the rough spectrum (7/2 gives snap no finite variance), and its shortest length.
_ROUGH = ((4.5, 4.0),)
# The longest length, windows. The next one is half as long, a quarter in the rough spectrum.
_LONGEST = 1.25
# A line is all there is of degree 1.
_DEGREES = (1, 2)
# Deviations of processes: the least, and how many, each 10 times the one before; more of them for
# samples that are all but exact.
_LEAST, _AMPLITUDES, _MORE = 10.0**0.5, 7, 13
FLAT = float(np.log(3 * _LEAST * 10.0 ** (_AMPLITUDES - 1)))
"""Logarithm of the deviation of mean and slope: three times the largest of the amplitudes."""
# A process may look like a parabola up to this one of the amplitudes.
_HIDDEN = 2
# What of a process is at most this part of the noise is not seen.
_SEEN = 1e-2
# The processes have this part of the prior; low polynomials, the line, and rest have the other.
_PROCESSES = 0.5
# Models that the compiled library treats at once, its LANES.
_LANES = 8
# A function smaller than this part of the largest is rounding.
_ROUNDING = 1e-13
# A step of which models leave a smaller part is not looked for.
_ROUNDING_OF_STEPS = 1e-9


class Process(NamedTuple):
    """A process by the number of its spectrum and its length, samples, or -1 and a degree."""

    spectrum: int
    length: float
    prior: float


class _Functions(NamedTuple):
    """
    The functions that make up a process on a window, even (0) or odd (1) about its middle.

    Without their mean and slope they are the first of `vectors` (n / 2, n / 2) times `sizes` (m,)
    times `right` (m, J) on its first half; `along` (J,) is what they have of these.
    """

    vectors: Real
    sizes: Real
    right: Real
    along: Real


def _processes(count: int, exact: bool) -> list[Process]:
    """
    All processes on a window of so many samples, those of a spectrum from the slowest on.

    The rough spectrum is the last. Exact samples have none, and lengths half as short: where their
    noise is larger than said, it is a motion too.
    """
    found = []
    for k, (_, shortest) in enumerate(SPECTRA if exact else SPECTRA + _ROUGH):
        longest, factor = _LONGEST * count, 2.0 if k < len(SPECTRA) else 4.0
        least = shortest / 2 if exact else shortest
        number = max(1, int(np.log(longest / least) / np.log(factor)) + 1)
        prior = _PROCESSES / len(SPECTRA) / number
        found += [Process(k, longest / factor**i, prior) for i in range(number)]
    return found + [Process(-1, degree, _simple()) for degree in _DEGREES]


def _simple() -> float:
    """The prior of a low polynomial, and of rest."""
    return (1 - _PROCESSES) / (len(_DEGREES) + 1)


def _amplitudes(exact: bool) -> Real:
    return np.asarray(_LEAST * 10.0 ** np.arange(_MORE if exact else _AMPLITUDES))


def _values(process: Process, count: int, time: Real, orders: range) -> list[tuple[Real, Real]]:
    """
    Derivatives at times (T,) of the functions, even and odd, (T, J), that make up a process.

    Of each of the orders.
    """
    if process.spectrum < 0:
        scale = 2 / count
        degrees = range(2, int(process.length) + 1)
        powers = [np.polynomial.Polynomial([0] * degree + [1.0]) for degree in degrees]
        found = []
        for order in orders:
            each = [power.deriv(order)(scale * time) * scale**order for power in powers]
            values = np.reshape(each, (len(powers), len(time))).T
            found.append((values[:, ::2], values[:, 1::2]))
        return found
    # Waves of a sum that repeats itself, but not within a window.
    step = 2 * np.pi / (count + 10 * process.length)
    frequency = step * np.arange(int(np.pi / step) + 1)
    if process.spectrum < len(SPECTRA):
        power, _ = SPECTRA[process.spectrum]
        weight = np.exp(-((frequency * process.length) ** power) / 2)
    else:
        smoothness, _ = _ROUGH[0]
        weight = (1 + (frequency * process.length) ** 2) ** -((smoothness + 0.5) / 2)
    weight[0] /= np.sqrt(2)
    weight /= np.sqrt((weight**2).sum())
    kept = weight > _ROUNDING
    frequency, weight = frequency[kept], weight[kept]
    phase = np.outer(time, frequency)
    waves = np.cos(phase), np.sin(phase)
    # Cosine and sine are each other's derivatives, the first with a sign.
    found = []
    for order in orders:
        sizes = weight * frequency**order
        even = -sizes if order % 4 in (1, 2) else sizes
        odd = -sizes if order % 4 in (2, 3) else sizes
        found.append((even * waves[order % 2], odd * waves[1 - order % 2]))
    return found


def _half_window(count: int) -> tuple[Real, Real, tuple[Real, Real]]:
    """
    The first half of a window's times, with the middle if there is one, and what these stand for.

    That is the root of 2 for two samples opposite to each other, and 1 for the middle; then mean
    and slope, of length 1, of all samples.
    """
    time = np.arange((count + 1) // 2) - (count - 1) / 2
    root = np.where(time < 0, np.sqrt(2.0), 1.0)
    return time, root, (root / np.linalg.norm(root), root * time / np.linalg.norm(root * time))


def _lines(count: int, time: Real, order: int) -> Real:
    """Derivatives (T, 2) of mean and slope."""
    zero, one = np.zeros(len(time)), np.ones(len(time))
    half, root, _ = _half_window(count)
    slope = (time, one, zero)[min(order, 2)] / np.linalg.norm(root * half)
    return np.stack((zero if order else one / np.sqrt(count), slope), axis=1)


@lru_cache(maxsize=512)
def _functions(process: Process, count: int, block: int) -> tuple[_Functions, _Functions]:
    """The functions of a process on a window, each sample the mean of a block."""
    time, root, lines = _half_window(count)
    offsets = (np.arange(block) - (block - 1) / 2) / block
    averaged = [_values(process, count, time + offset, range(1))[0] for offset in offsets]
    found = []
    for parity, line in enumerate(lines):
        seen = root[:, None] * sum(values[parity] for values in averaged) / block
        along = line @ seen
        seen -= np.outer(line, along)
        vectors, sizes, right = np.linalg.svd(seen, full_matrices=False)
        kept = sizes > _ROUNDING * sizes.max(initial=0.0)
        vectors, sizes, right = vectors[:, kept], sizes[kept], right[kept]
        # Small ones have rounding of the line, and of the large ones.
        every, signs = np.linalg.qr(np.column_stack((line, vectors, np.eye(len(line)))))
        every *= np.sign(np.diag(signs))
        # Of an odd number of samples the one in the middle is no part of what is odd.
        vectors = every[:, 1 : count // 2 if parity else None]
        found.append(_Functions(vectors, sizes, right, along))
    return found[0], found[1]


class _Member(NamedTuple):
    """A process on a window: its functions, even and odd, and sizes of their modes, 0 if unseen."""

    process: Process
    functions: tuple[_Functions, _Functions]
    sizes: tuple[Real, Real]

    def large(self, exact: bool) -> Real:
        """How much larger (A, m) its modes are than the noise, squared, by amplitudes."""
        return (_amplitudes(exact)[:, None] * np.concatenate(self.sizes)) ** 2


@lru_cache(maxsize=64)
def _members(count: int, block: int, exact: bool) -> list[_Member]:
    """All processes on a window, and what of them is seen; of exact samples there are all modes."""
    largest = _amplitudes(exact)[-1]
    found = []
    for process in _processes(count, exact):
        even, odd = _functions(process, count, block)
        sizes = [
            np.pad(one.sizes, (0, one.vectors.shape[1] - len(one.sizes)))
            if exact
            else one.sizes[: np.count_nonzero(one.sizes * largest > _SEEN)]
            for one in (even, odd)
        ]
        found.append(_Member(process, (even, odd), (sizes[0], sizes[1])))
    return found


def _fill(values: Real, nothing: float = 0.0) -> Real:
    """Fill the last axis up to whole lanes."""
    width = [(0, 0)] * (values.ndim - 1) + [(0, -values.shape[-1] % _LANES)]
    return np.pad(values, width, constant_values=nothing)


def _join(lines: list[Real], parts: list[tuple[Real, Real]], exact: bool) -> tuple[Real, Real]:
    """
    Join what is so for mean and slope (..., 1) and for the modes (..., m), even and odd, of all.

    Rest, the last process, has the mean only, and of exact samples the modes of a line. Returns
    (..., rows), and where processes begin and end among them (2, P + 1).
    """
    found: list[Real] = []
    first = []
    for parity, line in enumerate(lines):
        each = [np.concatenate((line, part[parity]), axis=-1) for part in parts]
        each.append(each[-len(_DEGREES)] if exact else line[..., : 1 - parity])
        begin = found[0].shape[-1] if parity else 0
        first.append(begin + np.cumsum([0, *(part.shape[-1] for part in each)]))
        found.append(_fill(np.concatenate(each, axis=-1)))
    return np.concatenate(found, axis=-1), np.array(first)


def models_of(count: int, block: int, exact: bool) -> tuple[np.ndarray, Real]:
    """
    Make the models of a window of `count` samples, each the mean of `block`.

    The largest motion is 1e7 deviations of the noise, and 1e13 if the samples are `exact`: then
    each process has as many modes as there are samples. Returns the integers and the numbers of
    `Models` of _evidence.h.
    """
    members, amplitudes = _members(count, block, exact), _amplitudes(exact)
    _, root, lines = _half_window(count)
    vectors = [
        tuple(one.vectors[:, : len(own)] for one, own in zip(*member[1:], strict=True))
        for member in members
    ]
    panels, first = _join([line[:, None] for line in lines], vectors, exact)
    # Of mean and slope nothing is known.
    sizes, _ = _join([np.full(1, np.inf)] * 2, [member.sizes for member in members], exact)
    if exact:
        sizes[first[1, -2]] = 0.0  # the slope of rest
    with np.errstate(divide='ignore'):
        large = (sizes[:, None] * amplitudes) ** 2
        share, left = 1 / (1 + 1 / large), 1 / (1 + large)
    tables = [_fill(share)] + [_fill(left, 1.0)] * exact
    occam = [-np.log1p(member.large(exact)).sum(axis=1) / 2 for member in members]
    prior = [member.process.prior / len(amplitudes) for member in members]
    # Rest has one amplitude, no slope, and is more probable by all that this might be.
    less = np.array([*occam, np.full(len(amplitudes), np.log(3 * amplitudes[-1]))])
    chances = np.log([*prior, _simple()])[:, None] + np.array((1, 2))[:, None, None] * less
    chances[:, -1, 1:] = -np.inf
    own = [
        np.r_[slice(*first[0, p : p + 2]), slice(*first[1, p : p + 2])] for p in range(len(less))
    ]
    freedom = np.array([share[rows].sum(axis=0) for rows in own])
    numbers = [
        (panels * root[:, None] / 2).reshape(len(root), -1, _LANES).swapaxes(0, 1),
        *(table.reshape(len(table), -1, _LANES).swapaxes(0, 1) for table in tables),
        *(_fill(part, -np.inf) for part in chances),
        _fill(freedom),
    ]
    if not exact:
        numbers.append(_unexplained_steps(count, members, amplitudes))
    # The spectra, the rough one, and the kind that belongs to all spectra.
    last = len(SPECTRA) + 1
    kind = np.array([*(one.process.spectrum % (last + 1) for one in members), last])
    kinds = _fill(np.tile(kind[:, None], len(amplitudes)), last)
    head = [len(less), kinds.shape[1] // _LANES, last, first[1, 0], len(sizes)]
    integers = np.concatenate((head, first.ravel(), kinds.ravel())).astype(np.int64)
    return integers, np.concatenate([part.ravel() for part in numbers])


def _unexplained_steps(count: int, members: list[_Member], amplitudes: Real) -> Real:
    """
    How much of steps the models leave: b' P b (P + 1, amplitudes, 3, n), inf where it is rounding.

    A step b of the motion, or of its first or second derivative, lies half a sample before a sample
    (n,), and P is the inverse of a model's covariance. Rest, the last process, leaves no steps to
    be seen.
    """
    time = np.arange(count)
    since = np.maximum(time - time[:, None] + 0.5, 0.0)
    steps = np.concatenate((since > 0, since, since**2 / 2)).T
    square = (steps**2).sum(axis=0)
    _, root, lines = _half_window(count)
    opposite = steps[::-1][: len(root)]
    halves = [root[:, None] / 2 * (steps[: len(root)] + sign * opposite) for sign in (1, -1)]
    left = square - sum((line @ half) ** 2 for line, half in zip(lines, halves, strict=True))
    lanes = len(amplitudes) + -len(amplitudes) % _LANES
    found = np.full((len(members) + 1, lanes, len(square)), np.inf)
    for p, member in enumerate(members):
        found[p, : len(amplitudes)] = left
        for one, sizes, half in zip(member.functions, member.sizes, halves, strict=True):
            large = (amplitudes[:, None] * sizes) ** 2
            seen = (one.vectors[:, : len(sizes)].T @ half) ** 2
            found[p, : len(amplitudes)] -= large / (1 + large) @ seen
    found[found < _ROUNDING_OF_STEPS * square] = np.inf
    return found


def _derivatives(
    count: int, block: int, exact: bool, time: Real, orders: range
) -> tuple[list[Real], list[tuple[Real, Real]], list[Real]]:
    """
    Derivatives (T, K, m) of mean and slope at times (T,), and of the modes of each process.

    And the covariances (T, K, K) of what no mode of each process has, of amplitude 1.
    """
    lines = np.stack([_lines(count, time, order) for order in orders], axis=1)  # (T, K, 2)
    found, unseen = [], []
    for member in _members(count, block, exact):
        values = _values(member.process, count, time, orders)
        more = np.zeros((len(time), len(orders), len(orders)))
        pair = []
        for parity, (one, sizes) in enumerate(zip(member.functions, member.sizes, strict=True)):
            left = np.stack([value[parity] for value in values], axis=1)
            left -= lines[..., parity, None] * one.along
            by = left @ one.right.T
            own = np.zeros((*left.shape[:2], len(sizes)))
            seen = np.count_nonzero(sizes)
            own[..., :seen] = by[..., :seen] / sizes[:seen]
            pair.append(own)
            left -= by[..., :seen] @ one.right[:seen]
            more += left @ left.swapaxes(1, 2)
        found.append((pair[0], pair[1]))
        unseen.append(more)
    return [lines[..., :1], lines[..., 1:]], found, unseen


def slopes_of(count: int, block: int, exact: bool) -> Real:
    """Derivatives (orders, panels, rows, _LANES), 1 to 4, of the modes at the first samples."""
    time, _, _ = _half_window(count)
    lines, found, _ = _derivatives(count, block, exact, time, range(1, 5))
    slopes = _fill(np.moveaxis(_join(lines, found, exact)[0], 0, 2))  # (K, rows, half)
    return slopes.reshape(*slopes.shape[:2], -1, _LANES).swapaxes(1, 2).ravel()


def stencils_of(count: int, block: int, exact: bool, orders: int, at: float) -> Real:
    """
    Make the numbers of `Stencils` of _evidence.h, of an instant so many samples from the middle.

    Of so many `orders`, from 0: what modes make of them, and the covariances of models over that of
    the noise. That a motion is a low polynomial, or rests, is known no better than that it is a
    process which looks like that: of a parabola the slowest of each spectrum, of the same amplitude
    up to the largest that may look like one, of a line and rest the slowest and least of the first.
    """
    members, amplitudes = _members(count, block, exact), _amplitudes(exact)
    lines, found, unseen = _derivatives(count, block, exact, np.array([at]), range(orders))
    spread = np.empty((orders, orders, len(members) + 1, len(amplitudes)))
    for p, member in enumerate(members):
        own = np.concatenate((*lines, *found[p]), axis=-1)[0]
        large = member.large(exact)
        share = np.pad(large / (1 + large), ((0, 0), (2, 0)), constant_values=1.0)
        spread[:, :, p] = (own[:, None] * own) @ share.T
        spread[:, :, p] += unseen[p][0][..., None] * amplitudes**2
    spectra = [member.process.spectrum for member in members]
    slowest = [spectra.index(k) for k in range(len(SPECTRA))]
    for p, member in enumerate(members):
        if member.process.spectrum < 0 and member.process.length > 1:
            hidden = np.minimum(np.arange(len(amplitudes)), _HIDDEN)
            spread[:, :, p] = spread[:, :, slowest].mean(axis=2)[..., hidden]
        elif member.process.spectrum < 0:
            spread[:, :, p] = spread[:, :, slowest[0], :1]
    spread[:, :, -1] = spread[:, :, slowest[0], :1]
    groups = np.moveaxis(_fill(spread).reshape(orders, orders, -1, _LANES), 2, 0)
    return np.concatenate((_join(lines, found, exact)[0].ravel(), groups.ravel()))
