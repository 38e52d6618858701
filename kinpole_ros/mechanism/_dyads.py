"""
Dyads: loops of two unknowns, of which most linkages consist, closed without trigonometry.

Such a loop is a triangle of one known vector and two with an unknown each, so one square root gives
the directions e^{iα} themselves. Its sign, and the whole turns of the angles, are those of a guess.
"""

import numpy as np

from kinpole_ros.mechanism._loops import Block, Linkage, weigh
from kinpole_ros.planar._plane import Complex, Real

# Next to a dead point (sine of the angle between the two sides) the square root loses digits, and
# far from the guess (rad) its sign is uncertain: both cases are left to Newton's method.
_MIN_SINE, _MAX_CHANGE = 1e-2, 0.5
_Arm = complex | Complex


def close_dyad(
    linkage: Linkage, block: Block, state: Real, turn: Complex, slide: Real
) -> np.ndarray:
    """
    Move the two unknowns in `state` from a guess to where the loop closes, and fill in the block's
    e^{iα} and lengths; return where that is done (T,). Elsewhere `state` does not change.
    """
    first, before = block.turns.start, block.slides.start
    base = weigh(block.constant[:1, :first], turn[:first])[0]
    arms: list[_Arm] = list(block.constant[0, block.turns])
    for v in range(before):
        sliding = block.sliding[v, 0]
        if sliding[: block.turns.stop].any():
            base += slide[v] * weigh(sliding[None, :first], turn[:first])[0]
            arms = [arm + slide[v] * sliding[first + k] for k, arm in enumerate(arms)]
    rows, directions = linkage.turns[block.turns], turn[block.turns]
    guess = weigh(rows, state)
    moves: list[tuple[Real, Real]] = []
    if block.dyad == 'RRR':
        done = _two_turns(base, arms[0], arms[1], guess, directions)
    else:
        row, sliding = linkage.slides[before], block.sliding[before, 0]
        length = weigh(row[None], state)[0]
        if block.dyad == 'RRP':
            along = weigh(sliding[None, :first], turn[:first])[0]
            slide[before], done = _turn_and_slide(base, arms[0], along, length, directions[0])
        else:
            slide[before], done = _slide_that_turns(
                base, arms[0], sliding[first], length, directions[0]
            )
        moves.append((row, slide[before] - length))
    change = np.arctan2(directions.imag.copy(), directions.real.copy()) - guess
    change -= (2 * np.pi) * np.rint(change * (0.5 / np.pi))
    done &= (np.abs(change) < _MAX_CHANGE).all(axis=0)
    all_done = bool(done.all())
    for row, move in (*zip(rows, change, strict=True), *moves):
        (unknown,) = (k for k in block.unknown if row[k])
        if not all_done:
            move[~done] = 0.0
        state[unknown] += move if row[unknown] == 1 else move / row[unknown]
    return done


def _two_turns(base: Complex, a: _Arm, b: _Arm, guess: Real, directions: Complex) -> np.ndarray:
    """Solve base + a u + b v = 0 for u and v of length 1: RRR, by the law of cosines."""
    aa, bb, square = _square(a), _square(b), _square(base)
    # a u = base (along + i across) / base². Its sine is that from b v to a u, seen in the guess.
    along = (bb - aa - square) / 2
    across = aa * square - along * along
    done = across > _MIN_SINE**2 * aa * bb
    sides = (guess[0] - guess[1] + (np.angle(a) - np.angle(b))) * (0.5 / np.pi)
    sides -= np.rint(sides)
    u, v = directions
    u.real, u.imag = along, np.copysign(np.sqrt(across), -sides)
    u *= base
    u *= 1.0 / square
    np.add(base, u, out=v)
    v *= -1.0 / b
    u *= 1.0 / a
    return np.asarray(done)


def _turn_and_slide(
    base: Complex, a: _Arm, along: Complex, length: Real, direction: Complex
) -> tuple[Real, np.ndarray]:
    """Solve base + a u + l along = 0 for u of length 1 and l: RRP, by the theorem of Pythagoras."""
    back = np.conj(along) / _square(along)
    base, a = base * back, a * back
    square = _square(a)
    leg = square - base.imag**2
    # Im a u = -Im base; the guess tells on which side of the end of `base` the arm lies.
    foot = np.copysign(np.sqrt(leg), -base.real - length)
    direction.real, direction.imag = foot, -base.imag
    direction *= np.conj(a) / square
    return -base.real - foot, np.asarray(leg > _MIN_SINE**2 * square)


def _slide_that_turns(
    base: Complex, a: _Arm, along: complex, length: Real, direction: Complex
) -> tuple[Real, np.ndarray]:
    """Solve base + (a + l along) u = 0 for u of length 1 and l: RPR, Pythagoras again."""
    a, square = a / along, _square(base) / _square(along)
    foot = np.real(a)
    leg = square - np.imag(a) ** 2
    slide = np.copysign(np.sqrt(leg), length + foot) - foot
    np.divide(-base, along * (a + slide), out=direction)
    return slide, np.asarray(leg > _MIN_SINE**2 * square)


def _square(z: _Arm) -> Real:
    """|z|²."""
    return np.asarray(np.real(z) ** 2 + np.imag(z) ** 2)
