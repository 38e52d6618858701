"""
What comes of a recording of a rig as it was sent: errors over the ideal ones, coverage, and words.

The tracker is run as replay runs it, and figures are read from its messages, so that poles are
points of space and rates vectors, whatever the plane. Words are those of diagnostics.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterator
from textwrap import shorten
from typing import Any, NamedTuple

import numpy as np

from bench._cases import CASES, Case
from bench._record import NEAR, quantities, rms, squared_error
from bench._rigs import Recording, record
from bench._spoil import Sent, ideal
from kinpole_ros.findings import ERROR, WARN, finding_of
from kinpole_ros.messages import FINDING, DiagnosticsMaker, Output, result_outputs
from kinpole_ros.planar import to_complex
from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.tracker import Tracker
from kinpole_ros.tracking.values import RATE_NAMES

Rows = list[dict[str, Any]]
RATES = ('ω', 'α', 'jerk')
FIGURES = (*RATES, 'ICR')
# s. Clock, plane and shapes have to be known by then.
WARM_UP = 2.0
# Fewer figures of a body than this say nothing.
_FEWEST = 50
# An ideal error below this part of the rms of ω to that power, or of the body's size, is none to
# divide by: where a rate is found to be constant, its derivatives come out exactly zero.
_EXACT = {'ω': 1e-9, 'α': 1e-3, 'jerk': 1e-3, 'ICR': 1e-9}
# chi-square of 1 and of 2 degrees of freedom, 95%.
_LIMITS = dict.fromkeys(RATES, 3.841459) | {'ICR': 5.991465}
# Doubles of a pose with covariance.
_POSE = 43
# Warnings that are quoted of a case, and characters of each.
_QUOTED, _MOST = 3, 64
_NUMBER = re.compile(r'[-+]?\d[\d.]*(e[-+]?\d+)?')


class Outcome(NamedTuple):
    """
    What was found at the frames `frames` (M,) of a recording, by quantity and body.

    `error` (M, B), NaN where undetermined or too far off to count, `square` (M, B), the squared
    error over the covariance; `said` are the words of diagnostics, and `events` the body and the
    stamp of each event that was searched and found.
    """

    frames: np.ndarray
    error: dict[str, np.ndarray]
    square: dict[str, np.ndarray]
    said: set[str]
    events: list[tuple[int, int]]


def rig_rows(
    names: tuple[str, ...],
    seconds: float,
    cases: tuple[Case, ...] = CASES,
    rates: int = 2,
    progress: Callable[[float], None] = lambda share: None,
) -> Rows:
    """
    Rows by case and quantity, over the rigs of these names, each for so many s, at `rates` rates.

    `ratio` and `worst` are the median and the largest over all bodies of the RMS error over the
    ideal one, both of the frames at which both are determined; `covered`, `least_covered` and
    `ideal_covered` are shares of figures within the 95% region, median, least, and with ideal
    input; `beyond_5` and `beyond_10` those beyond so many stated deviations, means; `withheld` and
    `most_withheld` of what is determined with ideal input, that which is not. `said` is what the
    diagnostics say and have not with ideal input, and in how many of the runs.
    """
    made: dict[tuple[str, float, float, str], tuple[Recording, Outcome]] = {}
    rows: Rows = []
    for number, case in enumerate(cases):
        scores: list[dict[str, dict[str, np.ndarray]]] = []
        said: Counter[str] = Counter()
        for rate in case.rates[-rates:]:
            for rig in names:
                key = rig, rate, case.uneven, str(case.ideal)
                if key not in made:
                    recording = record(rig, rate, seconds, case.uneven)
                    made[key] = recording, run(recording, ideal(recording, settings=case.ideal))
                recording, base = made[key]
                # By name, so that a case is the same in whatever selection it is in.
                rng = np.random.default_rng((*case.what.encode(), *rig.encode(), round(rate)))
                sent = case.spoil(recording, rng)
                found = run(recording, sent)
                scores.append(_scores(recording, sent, found, base))
                said.update(found.said - base.said)
        often = sorted(said.items(), key=lambda item: (-item[1], item[0]))[:_QUOTED]
        words = '; '.join(f'{text} ({count}/{len(scores)})' for text, count in often)
        for name in FIGURES:
            parts = [score[name] for score in scores]
            rows.append(
                {
                    'part': case.part,
                    'what': case.what,
                    'trouble': case.trouble,
                    'level': case.level,
                    'quantity': name,
                }
                | _pooled({what: np.concatenate([p[what] for p in parts]) for what in parts[0]})
                | {'bar': case.bar if name in case.on else np.nan, 'said': words}
            )
        progress((number + 1) / len(cases))
    return rows


def run(r: Recording, sent: Sent, events: bool = False) -> Outcome:
    """Run the tracker over what was sent, a second at a time, as diagnostics are made."""
    settings = settings_from(sent.settings)
    tracker, maker = Tracker(settings), DiagnosticsMaker('rig')
    outputs = {row.topic: row for row in result_outputs(r.bodies, settings.plane)}
    said: set[str] = set()
    happened: list[tuple[int, int]] = []
    none = dict.fromkeys(FIGURES, np.zeros((0, len(r.bodies))))
    parts = [(np.zeros(0, int), none, none)]
    order = np.argsort(sent.stamps, kind='stable')
    seconds = np.floor(r.times[sent.frames]).astype(int)
    for second in np.unique(seconds):
        part = np.flatnonzero(seconds == second)
        found = tracker.add_parts(_messages(sent, part), 3, events)
        last = found[-1] if found else None
        array = maker.make(int(sent.stamps[part[-1]]), tracker, last, 1.0, {})
        if second >= 1:
            said |= _words(array.status)
        for estimate in found:
            happened += [(event.body, event.stamp) for event in estimate.events]
            place = order[np.searchsorted(sent.stamps[order], estimate.stamp)]
            index = sent.frames[place]
            late = r.times[index] >= WARM_UP
            error, square = _errors(r, index, estimate, outputs, sent.turn)
            parts.append(
                (
                    index[late],
                    {name: value[late] for name, value in error.items()},
                    {name: value[late] for name, value in square.items()},
                )
            )
    frames_of, errors, squares = zip(*parts, strict=True)
    return Outcome(
        np.concatenate(frames_of),
        {name: np.concatenate([error[name] for error in errors]) for name in FIGURES},
        {name: np.concatenate([square[name] for square in squares]) for name in FIGURES},
        said,
        happened,
    )


def _messages(sent: Sent, frames: np.ndarray) -> Iterator[MarkerFrames]:
    """Some of the frames that were sent, in runs of one layout, as they are read from messages."""
    points = sent.points[frames]
    there = np.isfinite(points[..., 0])
    counts = there.sum(axis=1) if sent.nameless else np.zeros(len(frames))
    for part in np.split(np.arange(len(frames)), np.flatnonzero(np.diff(counts)) + 1):
        # A marker that is in no message has no name in any.
        named = there[part].any(axis=0)
        names = tuple(name for name, seen in zip(sent.names, named, strict=True) if seen)
        yield MarkerFrames(sent.stamps[frames[part]], 'world', names, points[part][:, named])


def _errors(
    r: Recording,
    index: np.ndarray,
    estimate: Estimate,
    outputs: dict[str, Output],
    turn: np.ndarray,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Errors (T, B) and squared ones over their variance, by quantity, at the frames `index`."""
    position, angle = r.position[:, index], r.angle[:, index]
    with np.errstate(all='ignore'):
        truth = quantities(position, angle)
    error, square = {}, {}
    for k, name in enumerate(RATES):
        topics = (f'{body}/{RATE_NAMES[k]}' for body in r.bodies)
        vectors = np.stack([_doubles(outputs[t], estimate, 3) for t in topics], axis=1)
        error[name] = vectors @ turn[:, 2] - truth[name]
        with np.errstate(all='ignore'):
            square[name] = error[name] ** 2 / estimate.rate(k + 1).variance
    poses = np.stack(
        [_doubles(outputs[f'{b}/icr/with_covariance'], estimate, _POSE) for b in r.bodies], axis=1
    )
    spread = poses[..., 7:].reshape(*poses.shape[:2], 6, 6)[..., :3, :3]
    error['ICR'] = to_complex(poses[..., :3] @ turn[:, :2]) - truth['ICR']
    square['ICR'] = squared_error(error['ICR'], turn[:, :2].T @ spread @ turn[:, :2])
    with np.errstate(invalid='ignore'):
        far = ~(np.abs(truth['ICR'] - position[0]) <= NEAR * r.size)
    error['ICR'][far] = np.nan
    return error, square


def _doubles(output: Output, estimate: Estimate, count: int) -> np.ndarray:
    """The last `count` doubles of the messages (T, count) of a topic, NaN where there is none."""
    found = np.full((len(estimate), count), np.nan)
    instants, data = output.build(estimate)
    if data:
        rows = np.frombuffer(b''.join(data), np.uint8).reshape(len(data), -1)
        found[instants] = rows[:, -8 * count :].copy().view('<f8')
    return found


def _scores(
    r: Recording, sent: Sent, found: Outcome, base: Outcome
) -> dict[str, dict[str, np.ndarray]]:
    """By quantity, figures (B,) of each body, as `rig_rows` pools them."""
    expected = base.frames[np.isin(base.frames, sent.frames)]
    scores = {}
    for name in FIGURES:
        error, square, ideal_error = (
            _at(expected, frames, values)
            for frames, values in (
                (found.frames, found.error[name]),
                (found.frames, found.square[name]),
                (base.frames, base.error[name]),
            )
        )
        known, ideal_known = np.isfinite(error), np.isfinite(ideal_error)
        both = known & ideal_known
        least = rms(ideal_error, both)
        enough = (both.sum(axis=0) >= _FEWEST) & (least > _EXACT[name] * scale_of(r, name))
        ideal_square = base.square[name]
        with np.errstate(all='ignore'):
            scores[name] = {
                'ratio': np.where(enough, rms(error, both) / least, np.nan),
                'covered': _share(square <= _LIMITS[name], known),
                'ideal_covered': _share(
                    ideal_square <= _LIMITS[name], np.isfinite(base.error[name])
                ),
                'beyond_5': _share(square > 25, known),
                'beyond_10': _share(square > 100, known),
                'withheld': 1 - both.sum(axis=0) / ideal_known.sum(axis=0),
            }
    return scores


def _at(wanted: np.ndarray, frames: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The values (M, B) of `frames` (M,) at those that are wanted, NaN where there are none."""
    every = np.full((1 + max(*wanted, *frames, 0), values.shape[1]), np.nan, values.dtype)
    every[frames] = values
    return np.asarray(every[wanted])


def scale_of(r: Recording, name: str) -> np.ndarray:
    """What errors (B,) of a quantity are held against to tell them from rounding."""
    if name == 'ICR':
        return r.size
    return np.sqrt(np.mean(r.angle[1] ** 2, axis=0)) ** (RATES.index(name) + 1)


def _share(which: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Share (B,) of what is known, NaN where that is too little."""
    count = known.sum(axis=0)
    with np.errstate(all='ignore'):
        return np.where(count >= _FEWEST, (which & known).sum(axis=0) / count, np.nan)


def _pooled(scores: dict[str, np.ndarray]) -> dict[str, float]:
    """Medians over all bodies, the worst, and means of what is rare."""

    def over_all(pool: Callable[[np.ndarray], float], what: str) -> float:
        values = scores[what][np.isfinite(scores[what])]
        return float(pool(values)) if len(values) else np.nan

    return {
        'ratio': over_all(np.median, 'ratio'),
        'worst': over_all(np.max, 'ratio'),
        'covered': over_all(np.median, 'covered'),
        'least_covered': over_all(np.min, 'covered'),
        'ideal_covered': over_all(np.median, 'ideal_covered'),
        'beyond_5': over_all(np.mean, 'beyond_5'),
        'beyond_10': over_all(np.mean, 'beyond_10'),
        'withheld': over_all(np.mean, 'withheld'),
        'most_withheld': over_all(np.max, 'withheld'),
    }


def _words(statuses: list[Any]) -> set[str]:
    """What diagnostics warn of and, of the markers, have counted or named; # is a number."""
    pairs = [pair for status in statuses for pair in status.values]
    told = [finding_of(pair.value) for pair in pairs if pair.key.startswith(FINDING)]
    found = {finding.sentence() for finding in told if finding.level in (WARN, ERROR)}
    for pair in statuses[0].values:
        if pair.key.startswith(FINDING):
            continue
        number = _NUMBER.fullmatch(pair.value)
        if pair.value != '0' and (number is None or pair.value.isdigit()):
            found.add(pair.key if number else f'{pair.key}: {pair.value}')
    # The rest of a long one says what to do.
    return {_NUMBER.sub('#', shorten(text, _MOST, placeholder=' …')) for text in found}
