"""
Dyads: loops of two unknowns, which most linkages are made of, closed without trigonometry.

Such a loop is a triangle of one known vector and two with an unknown each, so one square root gives
the directions e^{iα} themselves. Its sign, and the whole turns of the angles, are those of a guess.
"""

import numpy as np

from kinpole_ros.mechanism._loops import Block, Linkage, weigh
from kinpole_ros.planar._plane import Complex, Real

# Next to a dead point (sine of the angle between the two sides) the square root loses digits, and
# far from the guess (rad) its sign is no help: both are left to Newton's method.
_FLAT, _FAR = 1e-2, 0.5
_Arm = complex | Complex


def close_dyad(
    linkage: Linkage, block: Block, known: Real, turn: Complex, slide: Real
) -> np.ndarray:
    """
    Move the two unknowns in `known` from a guess to where the loop closes, and fill in the block's
    e^{iα} and lengths; return where that is done (T,). Elsewhere `known` is left as it was.
    """
    first, before = block.turns.start, block.slides.start
    rest = weigh(block.constant[:1, :first], turn[:first])[0]
    arms: list[_Arm] = list(block.constant[0, block.turns])
    for v in range(before):
        sliding = block.sliding[v, 0]
        if sliding[: block.turns.stop].any():
            rest += slide[v] * weigh(sliding[None, :first], turn[:first])[0]
            arms = [arm + slide[v] * sliding[first + k] for k, arm in enumerate(arms)]
    rows, turned = linkage.turns[block.turns], turn[block.turns]
    guess = weigh(rows, known)
    moves: list[tuple[Real, Real]] = []
    if block.dyad == 'RRR':
        done = _two_turns(rest, arms[0], arms[1], guess, turned)
    else:
        row, sliding = linkage.slides[before], block.sliding[before, 0]
        length = weigh(row[None], known)[0]
        if block.dyad == 'RRP':
            along = weigh(sliding[None, :first], turn[:first])[0]
            slide[before], done = _turn_and_slide(rest, arms[0], along, length, turned[0])
        else:
            slide[before], done = _slide_that_turns(
                rest, arms[0], sliding[first], length, turned[0]
            )
        moves.append((row, slide[before] - length))
    change = np.arctan2(turned.imag.copy(), turned.real.copy()) - guess
    change -= (2 * np.pi) * np.rint(change * (0.5 / np.pi))
    done &= (np.abs(change) < _FAR).all(axis=0)
    whole = bool(done.all())
    for row, move in (*zip(rows, change, strict=True), *moves):
        (unknown,) = (k for k in block.unknown if row[k])
        if not whole:
            move[~done] = 0.0
        known[unknown] += move if row[unknown] == 1 else move / row[unknown]
    return done


def _two_turns(rest: Complex, a: _Arm, b: _Arm, guess: Real, turned: Complex) -> np.ndarray:
    """Solve rest + a u + b v = 0 for u and v of length 1: RRR, by the law of cosines."""
    aa, bb, square = _square(a), _square(b), _square(rest)
    # a u = rest (along + i across) / rest². Its sine is that from b v to a u, seen in the guess.
    along = (bb - aa - square) / 2
    across = aa * square - along * along
    done = across > _FLAT**2 * aa * bb
    sides = (guess[0] - guess[1] + (np.angle(a) - np.angle(b))) * (0.5 / np.pi)
    sides -= np.rint(sides)
    u, v = turned
    u.real, u.imag = along, np.copysign(np.sqrt(across), -sides)
    u *= rest
    u *= 1.0 / square
    np.add(rest, u, out=v)
    v *= -1.0 / b
    u *= 1.0 / a
    return np.asarray(done)


def _turn_and_slide(
    rest: Complex, a: _Arm, along: Complex, length: Real, turned: Complex
) -> tuple[Real, np.ndarray]:
    """Solve rest + a u + l along = 0 for u of length 1 and l: RRP, by the theorem of Pythagoras."""
    back = np.conj(along) / _square(along)
    rest, a = rest * back, a * back
    square = _square(a)
    base = square - rest.imag**2
    # Im a u = -Im rest; the guess tells on which side of the end of `rest` the arm lies.
    reach = np.copysign(np.sqrt(base), -rest.real - length)
    turned.real, turned.imag = reach, -rest.imag
    turned *= np.conj(a) / square
    return -rest.real - reach, np.asarray(base > _FLAT**2 * square)


def _slide_that_turns(
    rest: Complex, a: _Arm, along: complex, length: Real, turned: Complex
) -> tuple[Real, np.ndarray]:
    """Solve rest + (a + l along) u = 0 for u of length 1 and l: RPR, Pythagoras again."""
    a, square = a / along, _square(rest) / _square(along)
    foot = np.real(a)
    base = square - np.imag(a) ** 2
    found = np.copysign(np.sqrt(base), length + foot) - foot
    np.divide(-rest, along * (a + found), out=turned)
    return found, np.asarray(base > _FLAT**2 * square)


def _square(z: _Arm) -> Real:
    """|z|²."""
    return np.asarray(np.real(z) ** 2 + np.imag(z) ** 2)
