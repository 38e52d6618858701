"""
The models of motion within a window, and how each differentiates it: tables for evidence.c.

A signal is a line, a process of zero mean on top of it, and white noise. A process has the spectrum
exp(-(w l)^p): the length l is the time scale of the motion, and the power p is how fast harmonics
decay. Low polynomials are processes too.

A process is a sum of waves of random size: x = F z, with waves F (n, J) of J frequencies and white
z (J,). The singular vectors of F, without its mean and slope, are the modes of the process, and the
singular values s the standard deviations of their coefficients. An amplitude a multiplies all of
these, so the modes diagonalize the covariances a^2 F F' of all amplitudes (Rasmussen and Williams,
Gaussian Processes for Machine Learning, 2006, 2.7 for the line with a flat prior, 5.4 for the
evidence). F itself is decomposed, since rounding destroys the small
eigenvalues of F F'. Waves and modes are even and odd about the middle of the window.

Times are in samples from the middle of the window, and signals in deviations of the noise. Windows
of one kind have one table.
"""

from functools import lru_cache
from math import factorial
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.core.bindings import SIZES
from kinpole_ros.derivatives._spectra import Lines, Spectrum
from kinpole_ros.planar._plane import Real

FEWEST_SAMPLES = SIZES['FEWEST_SAMPLES']
"""Samples of the shortest window, which still has every order."""
# Power of each spectrum and its shortest length, samples: a shorter one is like white noise.
SPECTRA = ((2.0, 1.0), (1.4, 1.0), (1.0, 4.0))
# Longest length, windows. The next one is half as long.
_MAX_LENGTH = 1.25
# Degrees of low polynomials; degree 1 is the line alone.
_DEGREES = (1, 2)
# Least amplitude, in deviations of the noise: a smaller process is not seen.
_MIN_AMPLITUDE = 10.0**0.5
# Number of amplitudes, each 10 times the one before, up to 3e6; and up to 3e12 for exact samples.
_AMPLITUDES, _EXACT_AMPLITUDES = 7, 13
# The largest of the amplitudes, by number, with which a process may look like a parabola.
_PARABOLA_AMPLITUDE = 2
# Modes with a smaller standard deviation at the largest amplitude, over the noise, are left out.
_MIN_MODE_SIGMA = 1e-2
# Prior probability of all processes; low polynomials, the line, and rest have the other half.
_PROCESS_PRIOR = 0.5
_SIMPLE_PRIOR = (1 - _PROCESS_PRIOR) / (len(_DEGREES) + 1)
# Models that the library evaluates side by side.
_LANES = SIZES['LANES']
# Singular values below this part of the largest are rounding.
_ROUNDING = 1e-13
# Squares of steps, of which a model leaves less than this part, are rounding.
_STEP_ROUNDING = 1e-9


class Process(NamedTuple):
    """
    A process: the number of its spectrum and its length in samples, or -1 and a degree.

    `prior` is the probability of all its amplitudes. One with the spectrum of the body has
    `spectral_lines`, per sample, and no length: those of a `signal`, the angle (0) or the position
    (1). It has no slope of its own if that signal has no trend.
    """

    spectrum: int
    length: float
    prior: float
    spectral_lines: Lines | None = None
    signal: int = -1

    @property
    def has_slope(self) -> bool:
        return self.spectral_lines is None or self.spectral_lines.has_trend


class _Functions(NamedTuple):
    """
    The waves F (n, J) of a process on a window, even or odd about its middle, decomposed.

    On the first half of the window, without the mean or slope, F is `vectors` (n / 2, n / 2), of
    which the first m count, times `sizes` (m,) times `right` (m, J). The mean or slope of F, as a
    multiple of the normalized line, is `on_line` (J,), 0 where that is no part of the process.
    """

    vectors: Real
    sizes: Real
    right: Real
    on_line: Real


def _processes(count: int, exact: bool) -> list[Process]:
    """
    Return the processes on a window of `count` samples, those of a spectrum from the longest on.

    Low polynomials are the last. Exact samples have lengths half as short: where their noise is
    larger than stated, it is a motion too.
    """
    processes = []
    for k, (_, shortest) in enumerate(SPECTRA):
        longest, least = _MAX_LENGTH * count, shortest / 2 if exact else shortest
        number = max(1, int(np.log2(longest / least)) + 1)
        prior = _PROCESS_PRIOR / len(SPECTRA) / number
        processes += [Process(k, longest / 2.0**i, prior) for i in range(number)]
    return processes + [Process(-1, degree, _SIMPLE_PRIOR) for degree in _DEGREES]


def _amplitudes(exact: bool) -> Real:
    number = _EXACT_AMPLITUDES if exact else _AMPLITUDES
    return np.asarray(_MIN_AMPLITUDE * 10.0 ** np.arange(number))


def _waves(process: Process, count: int, time: Real, orders: range) -> list[tuple[Real, Real]]:
    """Return derivatives (T, J) of the waves of a process at times (T,), even and odd, by order."""
    if process.spectrum < 0:
        return _powers(int(process.length), count, time, orders)
    frequency, weight = _sizes(process, count)
    phase = np.outer(time, frequency)
    waves = np.cos(phase), np.sin(phase)
    # The derivative of a cosine is a sine with the opposite sign, that of a sine a cosine.
    derivatives = []
    for order in orders:
        sizes = weight * frequency**order
        even = -sizes if order % 4 in (1, 2) else sizes
        odd = -sizes if order % 4 in (2, 3) else sizes
        derivatives.append((even * waves[order % 2], odd * waves[1 - order % 2]))
    return derivatives


def _sizes(process: Process, count: int) -> tuple[Real, Real]:
    """Return the frequencies (J,) of a process, rad per sample, and the sizes (J,) of its waves."""
    lines = process.spectral_lines
    if lines is not None:
        # The largest amplitude makes them as large as they are.
        return lines.frequency, np.sqrt(lines.variance) / _amplitudes(False)[-1]
    # The sum repeats itself after this period, which is longer than a window.
    step = 2 * np.pi / (count + 10 * process.length)
    frequency = step * np.arange(int(np.pi / step) + 1)
    power, _ = SPECTRA[process.spectrum]
    weight = np.exp(-((frequency * process.length) ** power) / 2)
    weight[0] /= np.sqrt(2)
    weight /= np.sqrt((weight**2).sum())
    is_used = weight > _ROUNDING
    return frequency[is_used], weight[is_used]


def _powers(degree: int, count: int, time: Real, orders: range) -> list[tuple[Real, Real]]:
    """Return the same of the powers from 2 to `degree` of the time over half a window."""
    scale = 2 / count
    powers = [np.polynomial.Polynomial([0] * k + [1.0]) for k in range(2, degree + 1)]
    derivatives = []
    for order in orders:
        by_power = [power.deriv(order)(scale * time) * scale**order for power in powers]
        values = np.reshape(by_power, (len(powers), len(time))).T
        derivatives.append((values[:, ::2], values[:, 1::2]))
    return derivatives


def _half_window(count: int) -> tuple[Real, Real, tuple[Real, Real]]:
    """
    Return the times (h,) of the first half of a window, with its middle, and their weights (h,).

    A weight is the root of 2 for two opposite samples, and 1 for the middle, so that the weighted
    half of an even or odd vector is as long as the whole vector. Then mean and slope (h,), of
    length 1.
    """
    time = np.arange((count + 1) // 2) - (count - 1) / 2
    root = np.where(time < 0, np.sqrt(2.0), 1.0)
    return time, root, (root / np.linalg.norm(root), root * time / np.linalg.norm(root * time))


def _line_derivatives(count: int, time: Real, order: int) -> Real:
    """Return derivatives (T, 2) of mean and slope at times (T,)."""
    zero, one = np.zeros(len(time)), np.ones(len(time))
    half, root, _ = _half_window(count)
    slope = (time, one, zero)[min(order, 2)] / np.linalg.norm(root * half)
    return np.stack((zero if order else one / np.sqrt(count), slope), axis=1)


def _decompose(process: Process, count: int, block: int) -> tuple[_Functions, _Functions]:
    """Return the functions of a process on a window, each sample the mean of a block."""
    time, root, lines = _half_window(count)
    offsets = (np.arange(block) - (block - 1) / 2) / block
    in_blocks = [_waves(process, count, time + offset, range(1))[0] for offset in offsets]
    functions = []
    for parity, line in enumerate(lines):
        own = root[:, None] * sum(values[parity] for values in in_blocks) / block
        # Odd functions are as they are, of a process without a slope.
        line = line[:, None] if not parity or process.has_slope else line[:, None][:, :0]
        on_line = (line.T @ own).sum(axis=0)
        own -= line.sum(axis=1)[:, None] * on_line
        vectors, sizes, right = np.linalg.svd(own, full_matrices=False)
        is_used = sizes > _ROUNDING * sizes.max(initial=0.0)
        vectors, sizes, right = vectors[:, is_used], sizes[is_used], right[is_used]
        # The vectors of small singular values are not orthogonal to the line, by rounding.
        basis, signs = np.linalg.qr(np.hstack((line, vectors, np.eye(len(line)))))
        basis *= np.sign(np.diag(signs))
        # The middle of an odd number of samples is zero in all odd vectors.
        vectors = basis[:, line.shape[1] : count // 2 if parity else None]
        functions.append(_Functions(vectors, sizes, right, on_line))
    return functions[0], functions[1]


# Those of the processes of all bodies: the spectra of bodies pass.
_functions = lru_cache(maxsize=512)(_decompose)


class _Member(NamedTuple):
    """A process on a window: its functions, even and odd, and the `sizes` of the modes in use."""

    process: Process
    functions: tuple[_Functions, _Functions]
    sizes: tuple[Real, Real]

    def variances(self, exact: bool) -> Real:
        """Return the variances (A, m) of the modes, over that of the noise, by amplitudes."""
        return (_amplitudes(exact)[:, None] * np.concatenate(self.sizes)) ** 2


def _member(process: Process, functions: tuple[_Functions, _Functions], exact: bool) -> _Member:
    """Return a process on a window; of exact samples all modes are in use, some of size 0."""
    largest = _amplitudes(exact)[-1]
    sizes = [
        np.pad(one.sizes, (0, one.vectors.shape[1] - len(one.sizes)))
        if exact
        else one.sizes[: np.count_nonzero(one.sizes * largest > _MIN_MODE_SIGMA)]
        for one in functions
    ]
    return _Member(process, functions, (sizes[0], sizes[1]))


@lru_cache(maxsize=64)
def _members(count: int, block: int, exact: bool) -> list[_Member]:
    """Return the processes of all bodies on a window."""
    processes = _processes(count, exact)
    return [_member(one, _functions(one, count, block), exact) for one in processes]


@lru_cache(maxsize=16)
def _members_of_body(spectrum: Spectrum, count: int, block: int) -> list[_Member]:
    """Return the processes with the spectrum of a body, as probable as all others."""
    members: list[_Member] = []
    for signal, lines in enumerate(spectrum.lines):
        if len(lines.frequency):
            # For samples that are means of a block.
            lines = Lines(lines.frequency * block, lines.variance * block, lines.has_trend)
            process = Process(len(SPECTRA), 0.0, _PROCESS_PRIOR, lines, signal)
            members.append(_member(process, _decompose(process, count, block), False))
    return members


def _with_body(of_all: list[Any], of_body: list[Any]) -> list[Any]:
    """Put what is of processes of a body before that of low polynomials, in a list of all."""
    last = len(of_all) - len(_DEGREES)
    return [*of_all[:last], *of_body, *of_all[last:]]


def _fill_lanes(values: Real, fill: float = 0.0) -> Real:
    """Extend the last axis to whole lanes."""
    width = [(0, 0)] * (values.ndim - 1) + [(0, -values.shape[-1] % _LANES)]
    return np.pad(values, width, constant_values=fill)


def _rows(
    lines: list[Real], members: list[_Member], modes: list[tuple[Real, Real]], exact: bool
) -> tuple[Real, Real]:
    """
    Stack values of mean and slope (..., 1) and of the `modes` (..., m) of all processes as rows.

    All even rows come first. Rest, the last process, has the mean only, or the modes of a line if
    samples are exact. Returns (..., rows), and the first rows (2, P + 1) of the processes.
    """
    rows: list[Real] = []
    first = []
    for parity, line in enumerate(lines):
        by_process = [
            np.concatenate(
                (line[..., : 1 - parity or one.process.has_slope], pair[parity]), axis=-1
            )
            for one, pair in zip(members, modes, strict=True)
        ]
        by_process.append(by_process[-len(_DEGREES)] if exact else line[..., : 1 - parity])
        begin = rows[0].shape[-1] if parity else 0
        first.append(begin + np.cumsum([0, *(one.shape[-1] for one in by_process)]))
        rows.append(_fill_lanes(np.concatenate(by_process, axis=-1)))
    return np.concatenate(rows, axis=-1), np.array(first)


def _cost_of_slope(process: Process, count: int) -> float:
    """Return what the slope of a process without one of its own costs, a log evidence above 0."""
    time, root, (_, slope) = _half_window(count)
    waves = _amplitudes(False)[-1] * _waves(process, count, time, range(1))[0][1]
    return float(np.log1p((((slope * root) @ waves) ** 2).sum()) / 2)


def models_of(
    count: int, block: int, exact: bool, spectrum: Spectrum | None = None
) -> tuple[np.ndarray, Real]:
    """
    Return the integers and the numbers of `Models` of models.h.

    For a window of `count` samples, each the mean of `block`, of a body with this `spectrum`. If
    samples are `exact`, amplitudes are larger, and each process has as many modes as samples.
    """
    of_body = _members_of_body(spectrum, count, block) if spectrum else []
    members, amplitudes = _with_body(_members(count, block, exact), of_body), _amplitudes(exact)
    _, root, lines = _half_window(count)
    vectors = [
        tuple(one.vectors[:, : len(own)] for one, own in zip(*member[1:], strict=True))
        for member in members
    ]
    basis, first = _rows([line[:, None] for line in lines], members, vectors, exact)
    # Mean and slope have a flat prior.
    mode_sizes = [member.sizes for member in members]
    sizes, _ = _rows([np.full(1, np.inf)] * 2, members, mode_sizes, exact)
    if exact:
        sizes[first[1, -2]] = 0.0  # the slope of rest
    with np.errstate(divide='ignore'):
        variance = (sizes[:, None] * amplitudes) ** 2
        shrinkage, residual_factor = 1 / (1 + 1 / variance), 1 / (1 + variance)
    tables = [_fill_lanes(shrinkage)] + [_fill_lanes(residual_factor, 1.0)] * exact
    own = [
        np.r_[slice(*first[0, p : p + 2]), slice(*first[1, p : p + 2])]
        for p in range(len(members) + 1)
    ]
    parameters = np.array([shrinkage[rows].sum(axis=0) for rows in own])
    log_prior, of_rest = _log_priors(members, count, exact)
    numbers = [
        (basis * root[:, None] / 2).reshape(len(root), -1, _LANES).swapaxes(0, 1),
        *(table.reshape(len(table), -1, _LANES).swapaxes(0, 1) for table in tables),
        *(_fill_lanes(one, -np.inf) for one in log_prior),
        _fill_lanes(parameters),
    ]
    if not exact:
        squares = _step_squares(count, block)
        none = np.full_like(squares[0], np.inf)
        # Steps are screened without the spectrum of the body.
        numbers.append(np.stack((*_with_body(squares, [none] * len(of_body)), none)))
        numbers.append(of_rest)
    # Polynomials and rest have the number after those of the spectra: common to all.
    last = len(SPECTRA) + (spectrum is not None)
    by_process = np.array([*(one.process.spectrum % (last + 1) for one in members), last])
    spectra = _fill_lanes(np.tile(by_process[:, None], len(amplitudes)), last)
    body_end = len(members) - len(_DEGREES)
    head = [len(members) + 1, spectra.shape[1] // _LANES, last, first[1, 0], len(sizes)]
    head += [body_end - len(of_body), body_end]
    integers = np.concatenate((head, first.ravel(), spectra.ravel())).astype(np.int64)
    return integers, np.concatenate([one.ravel() for one in numbers])


def _log_priors(members: list[_Member], count: int, exact: bool) -> tuple[Real, Real]:
    """
    Return the log priors of models (2, P + 1, A), with their determinants, of angle and position.

    Mean and slope have a flat prior, which is a factor of all models. Rest, the last process, has
    no slope, so its prior is larger by that of a slope. -infinity stands for no model. Return also
    by how much more this is (2) if the slope is one of the waves of the body, whose signal has no
    trend.
    """
    amplitudes = _amplitudes(exact)
    log_prior = np.full((2, len(members) + 1, len(amplitudes)), -np.inf)
    of_slope, of_rest = np.log(3 * amplitudes[-1]), np.zeros(2)
    signals = np.array((1, 2))  # of angle, and of position
    for p, (process, _, sizes) in enumerate(members):
        variance = (amplitudes[:, None] * np.concatenate(sizes)) ** 2
        evidence = -np.log1p(variance).sum(axis=1) / 2
        if process.spectral_lines is None:
            prior = np.log(process.prior / len(amplitudes))
            log_prior[:, p] = prior + signals[:, None] * evidence
            continue
        # One amplitude, of one signal.
        c = process.signal
        if not process.has_slope:
            of_waves = _cost_of_slope(process, count)
            evidence[-1] += of_waves
            of_rest[c] = signals[c] * (of_waves - of_slope)
        log_prior[c, p, -1] = np.log(process.prior) + signals[c] * evidence[-1]
    log_prior[:, -1, 0] = np.log(_SIMPLE_PRIOR) + signals * of_slope
    return log_prior, of_rest


@lru_cache(maxsize=16)
def _step_squares(count: int, block: int) -> list[Real]:
    """
    Return the squares b' P b (amplitudes, orders, n) of steps b by process, with P as in screens.h.

    A step of the motion, or of its first or second derivative, lies half a sample before each
    sample. Squares that are rounding are infinite.
    """
    time = np.arange(count)
    since = np.maximum(time - time[:, None] + 0.5, 0.0)
    powers = (since**k / factorial(k) for k in range(1, SIZES['STEP_ORDERS']))
    steps = np.concatenate((since > 0, *powers)).T
    square = (steps**2).sum(axis=0)
    _, root, lines = _half_window(count)
    opposite = steps[::-1][: len(root)]
    halves = [root[:, None] / 2 * (steps[: len(root)] + sign * opposite) for sign in (1, -1)]
    no_line = square - sum((line @ half) ** 2 for line, half in zip(lines, halves, strict=True))
    amplitudes = _amplitudes(False)
    found = []
    for member in _members(count, block, False):
        squares = np.full((len(amplitudes) + -len(amplitudes) % _LANES, len(square)), np.inf)
        squares[: len(amplitudes)] = no_line
        for one, sizes, half in zip(member.functions, member.sizes, halves, strict=True):
            variance = (amplitudes[:, None] * sizes) ** 2
            coefficients = one.vectors[:, : len(sizes)].T @ half
            squares[: len(amplitudes)] -= variance / (1 + variance) @ coefficients**2
        squares[squares < _STEP_ROUNDING * square] = np.inf
        found.append(squares)
    return found


# The derivatives of the modes of a process, even and odd, (T, K, m), and a covariance (T, K, K), of
# amplitude 1, of what the modes in use leave of its waves.
_Derived = tuple[tuple[Real, Real], Real]


def _derivatives(
    count: int, members: list[_Member], time: Real, orders: range
) -> tuple[list[Real], list[_Derived]]:
    """
    Return derivatives (T, K, 1) of mean and slope at times (T,), and those of processes.

    A mode between the samples is the combination F v / s of the waves F, of right vector v and
    size s.
    """
    lines = np.stack([_line_derivatives(count, time, order) for order in orders], axis=1)
    derived: list[_Derived] = []
    for member in members:
        values = _waves(member.process, count, time, orders)
        covariance = np.zeros((len(time), len(orders), len(orders)))
        pair = []
        for parity, (one, sizes) in enumerate(zip(member.functions, member.sizes, strict=True)):
            waves = np.stack([value[parity] for value in values], axis=1)
            waves -= lines[..., parity, None] * one.on_line
            by_mode = waves @ one.right.T
            own = np.zeros((*waves.shape[:2], len(sizes)))
            number = np.count_nonzero(sizes)
            own[..., :number] = by_mode[..., :number] / sizes[:number]
            pair.append(own)
            waves -= by_mode[..., :number] @ one.right[:number]
            covariance += waves @ waves.swapaxes(1, 2)
        derived.append(((pair[0], pair[1]), covariance))
    return [lines[..., :1], lines[..., 1:]], derived


@lru_cache(maxsize=32)
def _derivatives_of_all(
    count: int, block: int, exact: bool, orders: int, from_middle: float
) -> tuple[list[Real], list[_Derived]]:
    """Return those of the processes of all bodies, at one instant."""
    members, time = _members(count, block, exact), np.array([from_middle])
    return _derivatives(count, members, time, range(orders))


def slopes_of(count: int, block: int, exact: bool) -> Real:
    """
    Return derivatives (SLOPE_ORDERS, panels, rows, _LANES) of the modes at the first samples.

    They are of order 1 and above.
    """
    time, _, _ = _half_window(count)
    orders = range(1, SIZES['SLOPE_ORDERS'] + 1)
    members = _members(count, block, exact)
    lines, derived = _derivatives(count, members, time, orders)
    rows, _ = _rows(lines, members, [modes for modes, _ in derived], exact)
    slopes = _fill_lanes(np.moveaxis(rows, 0, 2))  # (K, rows, half)
    return slopes.reshape(*slopes.shape[:2], -1, _LANES).swapaxes(1, 2).ravel()


def stencils_of(
    count: int,
    block: int,
    exact: bool,
    orders: int,
    from_middle: float,
    spectrum: Spectrum | None = None,
) -> Real:
    """
    Return the numbers of `Stencils` of models.h, of an instant, samples from the middle.

    These are the derivatives of order 0 to `orders` - 1 of the modes, and the covariances of models
    for unit noise. Low polynomials and rest have those of the slowest processes, which look like
    them: a parabola that of the same amplitude, up to _PARABOLA_AMPLITUDE, in the mean of all
    spectra; a line and rest that of the least amplitude of the first spectrum.
    """
    of_body = _members_of_body(spectrum, count, block) if spectrum else []
    members, amplitudes = _with_body(_members(count, block, exact), of_body), _amplitudes(exact)
    lines, of_all = _derivatives_of_all(count, block, exact, orders, from_middle)
    _, added = _derivatives(count, of_body, np.array([from_middle]), range(orders))
    derived = _with_body(of_all, added)
    line = np.concatenate(lines, axis=-1)[0]
    covariance = np.empty((orders, orders, len(members) + 1, len(amplitudes)))
    for p, (member, (modes, remainder)) in enumerate(zip(members, derived, strict=True)):
        own, variance = np.concatenate(modes, axis=-1)[0], member.variances(exact)
        covariance[:, :, p] = (own[:, None] * own) @ (variance / (1 + variance)).T
        own_line = line[:, : 1 + member.process.has_slope]
        covariance[:, :, p] += (own_line @ own_line.T)[..., None]
        covariance[:, :, p] += remainder[0][..., None] * amplitudes**2
    spectra = [member.process.spectrum for member in members]
    slowest = [spectra.index(k) for k in range(len(SPECTRA))]
    for p, member in enumerate(members):
        if member.process.spectrum < 0 and member.process.length > 1:
            amplitude = np.minimum(np.arange(len(amplitudes)), _PARABOLA_AMPLITUDE)
            covariance[:, :, p] = covariance[:, :, slowest].mean(axis=2)[..., amplitude]
        elif member.process.spectrum < 0:
            covariance[:, :, p] = covariance[:, :, slowest[0], :1]
    covariance[:, :, -1] = covariance[:, :, slowest[0], :1]
    groups = np.moveaxis(_fill_lanes(covariance).reshape(orders, orders, -1, _LANES), 2, 0)
    rows, _ = _rows(lines, members, [modes for modes, _ in derived], exact)
    return np.concatenate((rows.ravel(), groups.ravel()))
