"""
Dots that a user chose in one picture, followed through a film.

Optical flow (Lucas and Kanade) leads from picture to picture, forward and back. Each dot is then
matched with the picture in which it was chosen, so that errors do not add up. A dot that matches
too little is lost. It is found again where one place alone matches, no farther than it can have
moved.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np

from kinpole_ros.film._corners import brightness_at
from kinpole_ros.film._decoder import FilmError

# Half and twice as much of each number were measured by four films: round dots, with and without
# blur, small and strongly compressed, and marks that show their turn.
_HALVES = (5.0, 7.0, 10.0, 14.0, 20.0, 28.0)  # pixels from a dot to the edge of its patch
_AROUND = 1.3  # of the smallest patch that has enough contrast; else dots are taken for others
_LEAST_CONTRAST = 4e3  # squared slopes of a patch, across their weakest direction; no effect
_SOFT = 1.0  # pixels, the blur by which slopes are those of the dot; else small dots are lost
_ROUNDS, _PASSES = 20, 3  # 10 rounds lose a small dot, 1 pass errs by 0.15 pixels and not 0.05
_LEAST_MATCH = 0.85  # correlation with the chosen picture; 0.7 takes others for small dots
_LEAST_UNIQUE = 0.1  # correlation that the best place of a lost dot has more than others; as above
_BACK = 0.25  # of the patch: forward and back again, flow farther off led to another dot
_TURNS = 24  # of a patch, in which a lost dot is searched; 12 find a mark 4 pictures later
_MOST_STRETCHED = 0.3  # logarithm of the scale; 0.15 loses a small dot
_LEAST_OF_CONTRAST = 0.4  # of the chosen dot; 0.2 takes the wall for blurred dots
_FARTHEST = 0.25  # of the picture's width, from where a dot was lost; 0.12 finds it later
_LARGE = 80.0  # pixels; farther away it is searched in every second pixel: time only
_SOME_TURNS, _ROUND_MATCH = (0.6, 1.2, 1.8), 0.95  # a round dot matches itself after them
_ROUND = 0.01  # of the slopes, by which a turn is none where little tells of it; no effect
_EXACT = 0.003  # pixels; no effect
_DISK_RADIUS = 10  # steps
_STEPS = np.arange(-_DISK_RADIUS, _DISK_RADIUS + 1) / _DISK_RADIUS
_DISK = np.stack(np.meshgrid(_STEPS, _STEPS), axis=-1).reshape(-1, 2)
_DISK = _DISK[(_DISK**2).sum(axis=-1) <= 1]
_WEIGHT = (1.2 - (_DISK**2).sum(axis=-1)) / (1.2 - (_DISK**2).sum(axis=-1)).sum()


class _Poses(NamedTuple):
    """Places (m, 2) of dots, pixels; their turns, rad, and logarithms of scale (m,)."""

    places: np.ndarray
    turns: np.ndarray
    scales: np.ndarray

    def of(self, rows: np.ndarray | list[int]) -> '_Poses':
        """Return those of some dots."""
        return _Poses(*(values[rows] for values in self))


class _Patches(NamedTuple):
    """
    What dots look like in the picture in which they were chosen.

    `halves` (m,) are pixels from a dot to the edge of its patch, `wanted` (m, P) the brightness of
    its points with mean 0 and deviation 1, and `gains` (m, 4, P) lead from differences to it to
    move (pixels), turn and logarithm of scale.
    """

    halves: np.ndarray
    wanted: np.ndarray
    gains: np.ndarray

    def of(self, rows: np.ndarray | list[int]) -> '_Patches':
        """Return those of some dots."""
        return _Patches(*(values[rows] for values in self))

    def matched(self, soft: np.ndarray, start: _Poses) -> tuple[_Poses, np.ndarray]:
        """Return the poses near `start` that match best, and their correlations (m,)."""
        places, turns, scales = (values.copy() for values in start)
        radius = self.halves[:, None] * (_DISK @ (1, 1j))
        match = np.zeros(len(places))
        for _ in range(_ROUNDS):
            turn = np.exp(scales + 1j * turns)[:, None]
            at = places[:, None] + _as_pixels(turn * radius)
            seen, _ = _standard(brightness_at(soft, at))
            match = (_WEIGHT * seen * self.wanted).sum(axis=-1)
            step = (self.gains @ (seen - self.wanted)[..., None])[..., 0]
            places -= _as_pixels(turn[:, 0] * (step[:, :2] @ (1, 1j)))
            turns -= step[:, 2]
            scales = np.clip(scales - step[:, 3], -_MOST_STRETCHED, _MOST_STRETCHED)
            if np.abs(step[:, :2]).max() < _EXACT:
                break
        match[~(np.linalg.norm(places - start.places, axis=-1) < self.halves)] = 0
        return _Poses(places, turns, scales), match


def _patches(soft: np.ndarray, names: list[str], places: np.ndarray) -> _Patches:
    """Return the patches of dots; raises FilmError for one without contrast."""
    halves = np.array([_half(soft, *one) for one in zip(names, places, strict=True)])
    wanted, spread = _standard(brightness_at(soft, places[:, None] + halves[:, None, None] * _DISK))
    slopes = _slopes(soft, places, halves)
    x, y = np.moveaxis(halves[:, None, None] * _DISK, -1, 0)
    turned, stretched = -y * slopes[..., 0] + x * slopes[..., 1], x * slopes[..., 0]
    columns = np.stack(
        (*np.moveaxis(slopes, -1, 0), turned, stretched + y * slopes[..., 1]), axis=1
    )
    columns = columns / spread[:, None]
    # A change of brightness or contrast is no motion.
    columns -= (_WEIGHT * columns).sum(axis=-1, keepdims=True)
    columns -= (_WEIGHT * columns * wanted[:, None]).sum(axis=-1, keepdims=True) * wanted[:, None]
    normal = (_WEIGHT * columns) @ np.swapaxes(columns, 1, 2)
    moves = np.trace(normal[:, :2, :2], axis1=1, axis2=2) / 2
    # A round dot has no turn that can be seen.
    ridge = np.zeros((len(halves), 4))
    ridge[:, 2:] = (_ROUND * moves * halves**2)[:, None]
    normal += ridge[:, :, None] * np.eye(4)
    return _Patches(halves, wanted, np.linalg.solve(normal, _WEIGHT * columns))


class Dots:
    """
    Follows dots from the picture in which they are chosen, near places (m, 2), pixels.

    `places` are their middles.
    """

    def __init__(self, gray: np.ndarray, names: list[str], places: np.ndarray) -> None:
        self._soft, self._gray = _soft(gray), gray
        self._patches, self.places, self._is_round = _chosen(self._soft, names, places)
        count = len(places)
        self._last = _Poses(self.places.copy(), np.zeros(count), np.zeros(count))
        self._moves, self._turning = np.zeros_like(places), np.zeros(count)
        self._lost = np.zeros(count, int)  # pictures since a dot was seen
        self._fastest = self._patches.halves / 4  # pixels a picture

    def follow(self, gray: np.ndarray) -> np.ndarray:
        """Return where the dots are in the next picture (m, 2), NaN where lost."""
        soft, last = _soft(gray), self._last
        places, is_good = self._flow(gray)
        start = last._replace(places=places, turns=last.turns + self._turning)
        found, match = self._patches.matched(soft, start)
        is_good &= (self._lost == 0) & (match > _LEAST_MATCH)
        for k in np.flatnonzero(~is_good).tolist():
            self._lost[k] += 1
            again = self._search(soft, k, found.places[is_good])
            if again is not None:
                for values, value in zip(found, again, strict=True):
                    values[k] = value[0]
                is_good[k] = True
        self._keep(gray, found, is_good)
        return np.where(is_good[:, None], found.places, np.nan)

    def _keep(self, gray: np.ndarray, found: _Poses, is_good: np.ndarray) -> None:
        """Keep the poses of the dots that are seen, and how they move."""
        moves = (found.places - self._last.places) / np.maximum(self._lost, 1)[:, None]
        fast = np.where(is_good, np.linalg.norm(moves, axis=-1), 0)
        self._fastest = np.maximum(self._fastest, fast)
        was_seen = is_good & (self._lost == 0)
        self._moves = np.where(was_seen[:, None], moves, 0)
        self._turning = np.where(was_seen, found.turns - self._last.turns, 0)
        for values, new in zip(self._last, found, strict=True):
            values[is_good] = new[is_good]
        self._lost[is_good] = 0
        self._gray = gray

    def _flow(self, gray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where flow leads the dots (m, 2), and whether it leads back."""
        halves, start = self._patches.halves, self._last.places.astype(np.float32)
        side = 2 * round(float(np.median(halves))) + 1
        given: dict[str, Any] = {'winSize': (side, side), 'flags': cv2.OPTFLOW_USE_INITIAL_FLOW}
        guess = (start + self._moves).astype(np.float32)
        there, is_found, _ = cv2.calcOpticalFlowPyrLK(self._gray, gray, start, guess, **given)
        back, _, _ = cv2.calcOpticalFlowPyrLK(gray, self._gray, there, start.copy(), **given)
        off = np.linalg.norm(back - start, axis=-1)
        return there.astype(float), (is_found.ravel() == 1) & (off < _BACK * halves)

    def _search(self, soft: np.ndarray, k: int, others: np.ndarray) -> _Poses | None:
        """Return the pose of a lost dot if one place alone matches; `others` are those seen."""
        half, last = self._patches.halves[k], self._last.of([k])
        reach = min(self._fastest[k] * (self._lost[k] + 1), _FARTHEST * soft.shape[1]) + half
        step = 1 if reach < _LARGE else 2
        low = np.maximum(np.floor(last.places[0] - reach - half), 0).astype(int)
        high = np.ceil(last.places[0] + reach + half).astype(int)
        part = soft[low[1] : high[1] : step, low[0] : high[0] : step]
        radius = int(half / step)
        if min(part.shape) <= 2 * radius:
            return None
        turns = last.turns + 2 * np.pi * np.arange(1 if self._is_round[k] else _TURNS) / _TURNS
        scores = np.stack(
            [_scores(part, self._turned(k, radius, step, turn)) for turn in turns.tolist()]
        )
        best = scores.max(axis=0)
        for other in (others - low) / step:
            cv2.circle(best, np.rint(other).astype(int).tolist(), 2 * radius, -1.0, -1)
        _, score, _, (x, y) = cv2.minMaxLoc(best)
        turn = turns[scores[:, y, x].argmax()]
        cv2.circle(best, (x, y), 2 * radius, -1.0, -1)
        if not max(best.max(), _LEAST_MATCH / 2) < score - _LEAST_UNIQUE:
            return None
        start = last._replace(places=low + step * np.array([[x, y]]) + 0.0, turns=np.array([turn]))
        found, match = self._patches.of([k]).matched(soft, start)
        return found if match[0] > _LEAST_MATCH else None

    def _turned(self, k: int, radius: int, step: int, turn: float) -> np.ndarray:
        """Return the chosen patch of a dot, turned, and 0 outside of its disk."""
        steps = step * np.arange(-radius, radius + 1)
        grid = steps + 1j * steps[:, None]
        patch = brightness_at(self._soft, self.places[k] + _as_pixels(grid * np.exp(-1j * turn)))
        is_inside = np.abs(grid) <= step * radius
        return np.where(is_inside, patch - patch[is_inside].mean(), 0).astype(np.float32)


def _scores(part: np.ndarray, patch: np.ndarray) -> np.ndarray:
    """Return the correlations of a patch with all places of a picture, -1 where contrast lacks."""
    disk = (patch != 0) / np.float32(np.count_nonzero(patch))
    energy = float((patch**2).sum())
    border = cv2.BORDER_REPLICATE
    likeness = cv2.filter2D(part, -1, patch / energy, borderType=border)
    mean = cv2.filter2D(part, -1, disk, borderType=border)
    square = cv2.filter2D(part**2, -1, disk, borderType=border) - mean**2
    contrast = np.sqrt(np.maximum(square, 1e-6) * np.count_nonzero(patch) / energy)
    return np.where(contrast > _LEAST_OF_CONTRAST, likeness / contrast, -1)


def _chosen(
    soft: np.ndarray, names: list[str], places: np.ndarray
) -> tuple[_Patches, np.ndarray, np.ndarray]:
    """
    Return the patches of dots, their places, and whether they are round.

    The place of a round dot is its middle: how it turns, and so how another point of it moves, is
    not seen.
    """
    zero = np.zeros(len(places))
    middles = places.astype(float)
    for _ in range(_PASSES):
        patches = _patches(soft, names, middles)
        # Half a turn about another point leads to twice the way to the middle.
        found, match = patches.matched(soft, _Poses(middles, zero + np.pi, zero))
        middles = np.where((match > _LEAST_MATCH)[:, None], (middles + found.places) / 2, middles)
    patches = _patches(soft, names, middles)
    matches = [patches.matched(soft, _Poses(middles, zero + turn, zero))[1] for turn in _SOME_TURNS]
    is_round = np.min(matches, axis=0) > _ROUND_MATCH
    places = np.where(is_round[:, None], middles, places)
    return _patches(soft, names, places), places, is_round


def _half(soft: np.ndarray, name: str, place: np.ndarray) -> float:
    """Return how far the patch of a dot reaches, pixels; raises FilmError if it shows nothing."""
    if not (place >= 0).all() or not (place < soft.shape[::-1]).all():
        size = f'{soft.shape[1]} x {soft.shape[0]}'
        raise FilmError(f'--points: {name} is at {_text(place)}, and the picture is {size}')
    for half in _HALVES:
        slopes = _slopes(soft, place[None], np.array([half]))[0] * half / _DISK_RADIUS
        if np.linalg.eigvalsh(slopes.T @ slopes)[0] > _LEAST_CONTRAST:
            return _AROUND * half
    raise FilmError(
        f'--points: {name} at {_text(place)} shows nothing that can be followed; fix: choose a dot '
        'or a corner that is darker or lighter than what is around it'
    )


def _text(place: np.ndarray) -> str:
    return f'{place[0]:g},{place[1]:g}'


def _slopes(soft: np.ndarray, places: np.ndarray, halves: np.ndarray) -> np.ndarray:
    """Return the slopes (m, P, 2) of the brightness in patches."""
    at = places[:, None] + halves[:, None, None] * _DISK
    return np.stack(
        [
            (brightness_at(soft, at + step) - brightness_at(soft, at - step))
            for step in np.eye(2) / 2
        ],
        axis=-1,
    )


def _standard(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return brightness (m, P) with mean 0 and deviation 1, and its deviation before (m, 1)."""
    values = values - (_WEIGHT * values).sum(axis=-1, keepdims=True)
    spread = np.sqrt((_WEIGHT * values**2).sum(axis=-1, keepdims=True)) + 1e-9
    return values / spread, spread


def _soft(gray: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.GaussianBlur(gray, (0, 0), _SOFT)).astype(np.float32)


def _as_pixels(numbers: np.ndarray) -> np.ndarray:
    return np.stack((numbers.real, numbers.imag), axis=-1)
