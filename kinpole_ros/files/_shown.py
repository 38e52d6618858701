"""What comes out of files is shown in one short line that a terminal does not take for commands."""

_MOST_SHOWN = 80  # characters of a value or name
MOST_OF_A_LINE = 1000  # characters: some lines of a terminal


def cut(text: str, most: int = _MOST_SHOWN) -> str:
    """As much of it as there is room for in a line, as it is, or as Python writes it."""
    short = text[: most + 1]
    short = short if short.isprintable() else repr(short)
    return short if len(short) <= most else f'{short[:most]}...'


def printable(line: str) -> str:
    """The line with each character that is none to be seen as its number, as ascii() has it."""
    if line.isprintable():
        return line
    return ''.join(c if c.isprintable() else ascii(c)[1:-1] for c in line)


def cut_line(line: str, most: int = MOST_OF_A_LINE) -> str:
    """A line that may be long of names and values, without what is in its middle then."""
    return line if len(line) <= most else f'{line[: most // 2]} ... {line[-most // 2 :]}'
