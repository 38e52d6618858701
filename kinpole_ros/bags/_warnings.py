"""What a replay warns of: each line says what is wrong and how to mend it."""

from collections.abc import Iterator

from kinpole_ros.bags._replay import Replayed
from kinpole_ros.messages import not_rigid, not_there
from kinpole_ros.parameters import Settings


def warnings_of(result: Replayed, settings: Settings) -> list[str]:
    """Lines on what makes the results of a replay with these settings fewer or worse."""
    lines = []
    if result.unreadable:
        lines.append(f'{result.unreadable} messages left out, the first: {result.problem}')
    if result.frames:
        absent = result.absent.items()
        lines += [not_there(body, names, result.identities) for body, names in absent]
    lines += [f'{body}: {not_rigid(off)}' for body, off in result.looseness.items() if off]
    lines += _untold(result, settings)
    return lines


def _untold(result: Replayed, settings: Settings) -> Iterator[str]:
    """A line on why there are no results, where there are none."""
    if result.estimates:
        return
    if not result.frames:
        yield 'no results, since the topic has no messages; record again, or name another --topic'
    elif result.repeated and result.repeated + 1 == result.frames:
        yield (
            'no results, since all stamps are the same; see that the driver sets header.stamp to '
            'the time of capture'
        )
    elif result.resets:
        yield (
            f'no results, since the stamps jump by more than the parameter window, '
            f'{settings.window:g} s; raise it, or see to the stamps'
        )
    else:
        yield (
            f'no results, since a frame has one when it is {settings.lag:g} s old (the parameter '
            f'lag), and there are {(result.last - result.first) / 1e9:.3g} s; record longer'
        )
