"""
The live page and its stream of events over HTTP, for browsers on this machine with the address.

The address has a token, since other users of the machine can connect too. The Host of a request is
checked, since a foreign page may have its name resolved to this machine (DNS rebinding).
"""

import re
import secrets
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

from kinpole_ros.bags import BagError

_ADDRESS = '127.0.0.1'
_HEADERS = {
    'Cache-Control': 'no-store',
    'Referrer-Policy': 'no-referrer',
    'X-Content-Type-Options': 'nosniff',
    'X-Frame-Options': 'DENY',
}
# Bytes in flight to a page before it counts as slow; the default buffers hold seconds of events.
_SEND_BUFFER = 1 << 16
_TIMEOUT = 10.0  # s, for a request, and for a page to receive what was sent
# A stream without events sends a comment after this time, s, to notice that the page is closed.
_KEEP_ALIVE = 1.0
_RETRY = 500  # ms until a page that lost its stream reconnects
# The kind of event that describes the rig. A page needs the last one first.
RIG_EVENT = 'rig'


class Feed:
    """
    The newest event of each kind, for the pages that are open.

    A slow page skips events, so that nothing accumulates.
    """

    def __init__(self) -> None:
        self._condition = threading.Condition()
        # Number and bytes of the newest event, by kind.
        self._events: dict[str, tuple[int, bytes]] = {}
        self._pages = 0
        self._count = 0
        self._closed = False

    def put(self, kind: str, data: str) -> None:
        """Send an event to the pages; `data` is one line."""
        with self._condition:
            self._count += 1
            self._events[kind] = self._count, f'event: {kind}\ndata: {data}\n\n'.encode()
            self._condition.notify_all()

    def wait_for_page(self, seconds: float) -> bool:
        """Wait until a page is open, or for some seconds; return whether one is open."""
        with self._condition:
            return self._condition.wait_for(lambda: self._pages > 0, seconds)

    def close(self) -> None:
        """End the events of all pages."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()

    def events(self, first_kind: str) -> Iterator[bytes]:
        """Yield events for a page until the feed is closed; first the last one of `first_kind`."""
        with self._condition:
            sent = {kind: n for kind, (n, _) in self._events.items() if kind != first_kind}
            self._pages += 1
            self._condition.notify_all()

        def new_kinds() -> list[str]:
            return [kind for kind, (n, _) in self._events.items() if n > sent.get(kind, 0)]

        try:
            while True:
                with self._condition:
                    self._condition.wait_for(lambda: self._closed or new_kinds(), _KEEP_ALIVE)
                    if self._closed:
                        return
                    data = b''.join(self._events[kind][1] for kind in new_kinds())
                    sent = {kind: n for kind, (n, _) in self._events.items()}
                yield data or b':\n\n'
        finally:
            with self._condition:
                self._pages -= 1


@contextmanager
def serving(feed: Feed, page: str, port: int = 0, token: str = '') -> Iterator[str]:
    """
    Serve `page` and the events of `feed`; yield the address.

    Port 0 is any free port, and an empty token a random one. Raises BagError if the port cannot be
    used.
    """
    token = token or secrets.token_urlsafe(16)
    try:
        server = ThreadingHTTPServer((_ADDRESS, port), _handler(feed, page.encode(), token))
    except (OSError, OverflowError) as error:
        why = error.strerror if isinstance(error, OSError) else 'ports are numbers up to 65535'
        raise BagError(
            f'--port {port} of {_ADDRESS} cannot be used ({why}); name another, or leave it out '
            'for a free one'
        ) from None
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    try:
        yield f'http://{_ADDRESS}:{server.server_address[1]}/{token}/'
    finally:
        feed.close()
        server.shutdown()
        server.server_close()
        thread.join()


def _handler(feed: Feed, page: bytes, token: str) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        timeout = _TIMEOUT
        server_version, sys_version = 'kinpole', ''

        def do_GET(self) -> None:
            try:
                path = urlsplit(self.path).path
            except ValueError:
                self._answer(400, 'text/plain', b'This is no address.\n')
                return
            given, _, name = path.lstrip('/').partition('/')
            host = re.sub(r':\d*$', '', self.headers.get('Host', ''))
            is_local = host in (_ADDRESS, 'localhost')
            if not is_local or not secrets.compare_digest(given.encode(), token.encode()):
                self._answer(403, 'text/plain', b'Open the address that kinpole view printed.\n')
            elif name == 'stream':
                self._stream()
            elif not name:
                self._answer(200, 'text/html', page)
            else:
                self._answer(404, 'text/plain', b'There is nothing here.\n')

        def _stream(self) -> None:
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
            self._send_headers(200, 'text/event-stream')
            self.wfile.write(f'retry: {_RETRY}\n\n'.encode())
            with suppress(OSError):  # the page is closed, or suspended
                for data in feed.events(RIG_EVENT):
                    self.wfile.write(data)

        def _answer(self, status: int, kind: str, body: bytes) -> None:
            with suppress(OSError):
                self._send_headers(status, kind, len(body))
                self.wfile.write(body)

        def _send_headers(self, status: int, kind: str, size: int | None = None) -> None:
            self.send_response(status)
            self.send_header('Content-Type', f'{kind}; charset=utf-8')
            if size is not None:
                self.send_header('Content-Length', str(size))
            for name, value in _HEADERS.items():
                self.send_header(name, value)
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            """Log nothing: the address contains the token."""

    return Handler
