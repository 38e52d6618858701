"""The order of the words of a command: files before options that take several values."""

import os
from collections.abc import Mapping, Sequence


def files_first(
    words: Sequence[str], files: int, option: str, sizes: Mapping[str, int]
) -> list[str]:
    """
    Move the files of a command before its options, so that no option takes them for its values.

    argparse gives an option with several values every word up to the next option. Files that are
    missing elsewhere are therefore the last words of such an option.

    Parameters
    ----------
    words : sequence of str
        The words after the name of the command.
    files : int
        How many files the command takes.
    option : str
        The option that takes one value or more.
    sizes : mapping of str to int
        The options that take another number of values than one, and that number.

    Returns
    -------
    list of str
        The same words, the files first.
    """
    if '--' in words:  # then the words are told apart already
        return list(words)
    places, runs = _places_of(words, option, sizes)
    lacking = files - len(places)
    if lacking > 0:
        # The option keeps one value at least. Of several, it is the one that ends with a file.
        able = [run for run in reversed(runs) if len(run) > lacking]
        if able:
            run = max(able, key=lambda run: os.path.exists(words[run[-1]]))
            places = sorted([*places, *run[-lacking:]])
    rest = [word for k, word in enumerate(words) if k not in places]
    return [*(words[k] for k in places), *rest]


def _places_of(
    words: Sequence[str], option: str, sizes: Mapping[str, int]
) -> tuple[list[int], list[list[int]]]:
    """Return the indices of the words of no option, and of those after each `option`."""
    places: list[int] = []
    runs: list[list[int]] = []
    # How many of the next words belong to the option before them; -1 is all up to the next option.
    owned = 0
    for k, word in enumerate(words):
        # argparse takes the beginning of a name for the name.
        if word.startswith('--') and '=' not in word:
            owned = next((size for name, size in sizes.items() if name.startswith(word)), 1)
            if option.startswith(word):
                runs.append([])
                owned = -1
        elif word.startswith('-') and not word[1:2].isdigit() and word != '-':
            owned = 0
        elif owned < 0:
            runs[-1].append(k)
        elif owned:
            owned -= 1
        else:
            places.append(k)
    return places, runs
