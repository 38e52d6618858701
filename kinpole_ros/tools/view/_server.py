"""
The page and its stream of events over HTTP: to this machine alone, and to who has the address.

The address holds a token, for other users of the machine may connect too. The Host of a request is
looked at, since a page from elsewhere may have its name resolved to this machine (DNS rebinding).
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
from kinpole_ros.tools.view._feed import Feed

_HOST = '127.0.0.1'
_OURS = (_HOST, 'localhost')
_HEADERS = {
    'Cache-Control': 'no-store',
    'Referrer-Policy': 'no-referrer',
    'X-Content-Type-Options': 'nosniff',
    'X-Frame-Options': 'DENY',
}
# Bytes on their way to a page, beyond which it is slow; else the system holds seconds of them.
_UNREAD = 1 << 16
# s, for a request, and for a page to take what was sent.
_PATIENCE = 10.0
# The kind of event that tells of the rig, which a page needs first.
LASTING = 'rig'


@contextmanager
def serving(feed: Feed, page: str, port: int = 0, token: str = '') -> Iterator[str]:
    """
    Serve `page` and the events of `feed` meanwhile; its address.

    On a port that is free where `port` is 0, under a random token where none is given. Raises
    BagError where the port cannot be had.
    """
    token = token or secrets.token_urlsafe(16)
    try:
        server = ThreadingHTTPServer((_HOST, port), _handler(feed, page.encode(), token))
    except (OSError, OverflowError) as error:
        why = error.strerror if isinstance(error, OSError) else 'ports are numbers up to 65535'
        raise BagError(
            f'--port {port} of {_HOST} cannot be had ({why}); name another, or leave it out for '
            'one that is free'
        ) from None
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    try:
        yield f'http://{_HOST}:{server.server_address[1]}/{token}/'
    finally:
        feed.close()
        server.shutdown()
        server.server_close()
        thread.join()


def _handler(feed: Feed, page: bytes, token: str) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        timeout = _PATIENCE
        server_version, sys_version = 'kinpole', ''

        def do_GET(self) -> None:
            try:
                where = urlsplit(self.path)
            except ValueError:
                self._answer(400, 'text/plain', b'This is no address.\n')
                return
            given, _, name = where.path.lstrip('/').partition('/')
            host = re.sub(r':\d*$', '', self.headers.get('Host', ''))
            if host not in _OURS or not secrets.compare_digest(given.encode(), token.encode()):
                self._answer(403, 'text/plain', b'Open the address that kinpole view printed.\n')
            elif name == 'stream':
                self._stream()
            elif not name:
                self._answer(200, 'text/html', page)
            else:
                self._answer(404, 'text/plain', b'There is nothing here.\n')

        def _stream(self) -> None:
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _UNREAD)
            self._begin(200, 'text/event-stream')
            # ms until a page that lost its stream asks for it again.
            self.wfile.write(b'retry: 500\n\n')
            with suppress(OSError):  # the page is gone, or sleeps
                for data in feed.events(LASTING):
                    self.wfile.write(data)

        def _answer(self, status: int, kind: str, body: bytes) -> None:
            with suppress(OSError):
                self._begin(status, kind, len(body))
                self.wfile.write(body)

        def _begin(self, status: int, kind: str, size: int | None = None) -> None:
            self.send_response(status)
            self.send_header('Content-Type', f'{kind}; charset=utf-8')
            if size is not None:
                self.send_header('Content-Length', str(size))
            for name, value in _HEADERS.items():
                self.send_header(name, value)
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            """Say nothing: the address has the token."""

    return Handler
