"""The panel of figures that constants are measured by: errors, coverage, reports, and CPU time."""

import math
import time
from collections.abc import Iterator

import numpy as np

from bench._events import event_motions, smooth_motions
from bench._outcome import FIGURES, Outcome, run, scale_of
from bench._record import START, rms
from bench._rigs import NOISE, Recording, record
from bench._spoil import (
    Sent,
    Spoil,
    absent,
    combined,
    exponential,
    hidden,
    ideal,
    misplaced,
    noisier,
)

# Bodies of the records, each at its own noise of a marker, m.
_SMOOTH = ('four-bar coupler', 'two sines')
_EVENTS = ('bounce', 'stick-slip')
_NOISES = (NOISE / 5, NOISE)
# m, about the mean of the markers.
_MARKERS = np.array([0.09 + 0.02j, -0.03 + 0.1j, -0.08 - 0.05j, 0.05 - 0.06j])
_SPOILED = combined(exponential(5e-4, lost=0.04), hidden(0.06), misplaced(0.0, 0.02), noisier(8))
# Records by name: frames per s, s, and what is sent of them. The first 2 s do not count.
_RECORDS: dict[str, tuple[float, float, Spoil]] = {
    '60 Hz, spoiled': (60.0, 4.5, _SPOILED),
    '200 Hz': (200.0, 2.8, ideal),
}
# The same of the links of a four-bar.
_RIGS: dict[str, Spoil] = {'without names, some absent': absent(0.05)}
# ns. A report this near to an event is of it.
_SAME = 15_000_000
# An error below this part of the rms of ω to that power, or of the body's size, counts as this.
_LEAST = {'ω': 1e-5, 'α': 1e-3, 'jerk': 1e-3, 'ICR': 1e-5}


def _record(rate: float, seconds: float) -> Recording:
    """All bodies side by side; the odd ones have events."""
    known = smooth_motions() | event_motions()
    names = [name for pair in zip(_SMOOTH, _EVENTS, strict=True) for name in pair]
    times = np.arange(round(rate * seconds)) / rate
    made = [known[name](times + 0.3) for name in names]
    position = np.stack([one.position for one in made], axis=-1)
    angle = np.stack([one.angle for one in made], axis=-1)
    owner = np.repeat(np.arange(len(names)), len(_MARKERS))
    shape = np.tile(_MARKERS - _MARKERS.mean(), len(names))
    flat = position[0][:, owner] + shape * np.exp(1j * angle[0][:, owner])
    rng = np.random.default_rng(round(rate))
    noise = np.repeat(_NOISES, 2)[owner, None]
    points = np.stack((flat.real, flat.imag, 0 * flat.real), axis=-1)
    points += noise * rng.normal(size=points.shape)
    bodies = tuple(f'b{b}' for b in range(len(names)))
    markers = tuple(f'{bodies[b]}_{k}' for k, b in enumerate(owner))
    stamps = START + np.rint(1e9 * times).astype(np.int64)
    return Recording(bodies, times, stamps, points, markers, owner, shape, position, angle)


def inputs() -> list[tuple[str, Recording, Sent]]:
    """What the panel is measured on: records by name, and what is sent of them."""
    made = [(name, _record(rate, long), spoil) for name, (rate, long, spoil) in _RECORDS.items()]
    made += [(name, record('four-bar links', 200.0, 2.6), spoil) for name, spoil in _RIGS.items()]
    return [(name, r, spoil(r, np.random.default_rng(1))) for name, r, spoil in made]


def panel(given: list[tuple[str, Recording, Sent]]) -> dict[str, float]:
    """Figures by what they are of: errors, shares in % determined and covered, events, and s."""
    found: dict[str, float] = {}
    begin = time.process_time()
    for name, r, sent in given:
        is_own = name in _RECORDS
        outcome = run(r, sent, events=is_own)
        kinds = {', smooth': slice(0, None, 2), ', events': slice(1, None, 2)}
        for kind, bodies in kinds.items() if is_own else [('', slice(None))]:
            figures = _figures(r, outcome, bodies)
            found |= {f'{what}: {name}{kind}': value for what, value in figures.items()}
        if is_own:
            found |= {f'{what}: {name}': number for what, number in _reports(r, outcome)}
    found['CPU time'] = time.process_time() - begin
    return {what: value for what, value in found.items() if math.isfinite(value)}


def _figures(r: Recording, outcome: Outcome, bodies: slice) -> dict[str, float]:
    found = {}
    for name in FIGURES:
        error, square = outcome.error[name][:, bodies], outcome.square[name][:, bodies]
        known = np.isfinite(error)
        with np.errstate(all='ignore'):
            each = np.maximum(rms(error, known), _LEAST[name] * scale_of(r, name)[bodies])
            found[f'error of {name}'] = float(np.exp(np.nanmean(np.log(each))))
            found[f'{name} covered'] = 100.0 * float((square <= 9.0)[known].mean())
        found[f'{name} determined'] = 100.0 * float(known.mean())
    return found


def _reports(r: Recording, outcome: Outcome) -> Iterator[tuple[str, float]]:
    """The share, %, of the events that are reported, and of the reports that are of an event."""
    known = event_motions()
    due = [
        np.rint(1e9 * (known[_EVENTS[b // 2]](r.times + 0.3).events - 0.3))
        if b % 2
        else np.empty(0)
        for b in range(len(r.bodies))
    ]
    told = [
        np.array([at - START for body, at in outcome.events if body == b]) for b in range(len(due))
    ]
    last = max((at.max(initial=0) for at in told), default=0)
    far = [
        np.abs(one[:, None] - at[(at > 1e9) & (at < last)])
        for one, at in zip(told, due, strict=True)
    ]
    found = sum(int((off.min(axis=0, initial=np.inf) < _SAME).sum()) for off in far)
    true = sum(int((off.min(axis=1, initial=np.inf) < _SAME).sum()) for off in far)
    yield 'events reported', 100.0 * found / max(sum(off.shape[1] for off in far), 1)
    yield 'reports of events', 100.0 * true / max(sum(off.shape[0] for off in far), 1)
