"""The rows of a message that the names of markers stand for."""

from collections.abc import Iterable, Sequence


def find_rows(identities: Sequence[str], names: Iterable[str]) -> list[int]:
    """
    Find the markers of these names in a message.

    A name stands for the full identity, else for the one marker of that namespace, else for the
    one of that id: 'tip/3', 'tip' or '3'.

    Parameters
    ----------
    identities : sequence of str
        Identities of the rows of the message.
    names : iterable of str
        Names of markers, as in the parameters.

    Returns
    -------
    list of int
        The row of each marker; the number of rows for one that is not in the message.

    """
    none = len(identities)
    by_identity: dict[str, int] = {}
    by_namespace: dict[str, int] = {}
    by_id: dict[str, int] = {}
    for row, identity in enumerate(identities):
        by_identity.setdefault(identity, row)
        namespace, slash, number = identity.rpartition('/')
        if slash:
            for rows, name in ((by_namespace, namespace), (by_id, number)):
                # A name that two markers share stands for neither.
                rows[name] = none if name in rows else row

    def row_of(name: str) -> int:
        found = (rows.get(name, none) for rows in (by_identity, by_namespace, by_id))
        return next((row for row in found if row != none), none)

    return [row_of(name) for name in names]
