"""
Between who makes the figures and the pages that show them: the newest of each kind of event.

A page that is slow misses what it was too late for, so nothing piles up.
"""

import threading
from collections.abc import Iterator

# s. What has nothing to say says so, which finds out whether the page is still there.
_SILENCE = 1.0


class Feed:
    """Events by kind, for the pages that are open."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        # By kind: its number, and its bytes as they are sent.
        self._events: dict[str, tuple[int, bytes]] = {}
        self._pages = 0
        self._count = 0
        self._closed = False

    def put(self, kind: str, data: str) -> None:
        """Have the pages told; `data` is one line."""
        with self._condition:
            self._count += 1
            self._events[kind] = self._count, f'event: {kind}\ndata: {data}\n\n'.encode()
            self._condition.notify_all()

    def wait_for_page(self, seconds: float) -> bool:
        """So long, until there is a page; whether there is one."""
        with self._condition:
            return self._condition.wait_for(lambda: self._pages > 0, seconds)

    def close(self) -> None:
        """Have all pages' events end."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()

    def events(self, lasting: str) -> Iterator[bytes]:
        """
        Events for a page, as they come, until the feed is closed.

        Of the kind `lasting` what was told before too: all else is of its moment.
        """
        with self._condition:
            seen = {kind: n for kind, (n, _) in self._events.items() if kind != lasting}
            self._pages += 1
            self._condition.notify_all()

        def news() -> list[str]:
            return [kind for kind, (n, _) in self._events.items() if n > seen.get(kind, 0)]

        try:
            while True:
                with self._condition:
                    self._condition.wait_for(lambda: self._closed or news(), _SILENCE)
                    if self._closed:
                        return
                    data = b''.join(self._events[kind][1] for kind in news())
                    seen = {kind: n for kind, (n, _) in self._events.items()}
                yield data or b':\n\n'
        finally:
            with self._condition:
                self._pages -= 1
