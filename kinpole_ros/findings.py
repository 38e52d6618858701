"""
Findings: what is wrong with an input, as values; their sentences are in `finding_table`.

Programs compare codes and read values. Only `words` makes a sentence, and nothing is looked up by
it.
"""

import json
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from kinpole_ros.finding_table import TABLE

# Levels of diagnostic_msgs: with WARN results still come and may suffer, with ERROR they cannot be
# relied upon; STALE is when nothing comes.
OK, WARN, ERROR, STALE = range(4)


class Finding(NamedTuple):
    """
    Something that is wrong, or that results suffer from.

    Attributes
    ----------
    code : str
        A key of `finding_table.TABLE`.
    subject : str
        The body it is about, '' for the input.
    values : mapping
        Numbers and names of its sentence, as JSON holds them.
    level : int
        OK, WARN, ERROR or STALE.
    fix : str
        What helps where the table does not know it, as of a reason.

    """

    code: str
    subject: str = ''
    values: Mapping[str, Any] = {}
    level: int = WARN
    fix: str = ''

    def sentence(self) -> str:
        """Return what is wrong, without the subject."""
        return TABLE[self.code].sentence.format(**{'body': self.subject, **self.values})

    def words(self) -> str:
        """Return its sentence and its fix, without the subject."""
        values = {'body': self.subject, **self.values}
        fix = self.fix or TABLE[self.code].fix.format(**values)
        return self.sentence() + (f'; fix: {fix}' if fix else '')

    def line(self) -> str:
        """Return its words after its subject, for a list of several subjects."""
        return f'{self.subject}: {self.words()}' if self.subject else self.words()

    def as_json(self) -> str:
        """Return its subject, values, level and fix as JSON, for a program."""
        return json.dumps(self._asdict(), allow_nan=False, default=float)


def finding_of(text: str) -> Finding:
    """
    Return the finding of the JSON that `as_json` returned.

    Raises
    ------
    ValueError
        For other text, and for a code that this version does not know.

    """
    try:
        finding = Finding(**json.loads(text))
        finding.words()
    except (KeyError, TypeError, AttributeError, IndexError):
        raise ValueError(f'no finding of this version: {text[:80]}') from None
    return finding


def all_words(findings: Iterable[Finding]) -> str:
    """Return the words of findings of one subject, in one line."""
    return '; '.join(finding.words() for finding in findings)
