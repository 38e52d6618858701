"""
Serve the live page and its stream of server-sent events over HTTP, to browsers on this machine.

Other users of the machine can connect too, so the address has a token, and requests without it are
refused. So are requests with another Host than this machine: a page from elsewhere may have its
name resolved to this machine (DNS rebinding).
"""

import re
import secrets
import socket
import sys
import threading
from collections.abc import Generator, Iterator, Mapping
from contextlib import closing, contextmanager
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
# Bytes that wait for a page. The stream of a slow page then blocks and skips events; in the default
# buffers, seconds of old events would wait.
_SEND_BUFFER = 1 << 16
_TIMEOUT = 10.0  # s, for a request, and for a page to receive what was sent
# A stream without events sends a comment after this time, s, to notice that the page is closed.
_KEEP_ALIVE = 1.0
_COMMENT = b':\n\n'
_RETRY = 500  # ms until a page that lost its stream reconnects
_POLL_INTERVAL = 0.05  # s until the server notices that it shall end
RIG_EVENT = 'rig'  # the kind of event that describes the bodies; pages need it before all others


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

    def events(self, first_kind: str) -> Generator[bytes, None, None]:
        """
        Yield events for a page until the feed is closed, and comments while there are none.

        The page gets the newest event of `first_kind`, also one from before it was opened, and of
        other kinds only events that came after that one and after the page was opened.
        """
        with self._condition:
            first_sent, others_sent = 0, self._count
            self._pages += 1
            self._condition.notify_all()

        def unsent() -> list[bytes]:
            first, data = self._events.get(first_kind, (0, b''))
            if not first:
                return []
            is_unsent = first > first_sent
            oldest = max(first, others_sent) if is_unsent else others_sent
            others = (event for kind, event in self._events.items() if kind != first_kind)
            return [data] * is_unsent + [data for number, data in others if number > oldest]

        try:
            while True:
                with self._condition:
                    self._condition.wait_for(lambda: self._closed or unsent(), _KEEP_ALIVE)
                    if self._closed:
                        return
                    batch = b''.join(unsent())
                    first_sent = others_sent = self._count
                yield batch or _COMMENT
        finally:
            with self._condition:
                self._pages -= 1


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore connections that pages close, or suspend, before they have their answer."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)


@contextmanager
def serving(feed: Feed, page: str, port: int = 0, token: str = '') -> Iterator[str]:
    """
    Serve `page` and the events of `feed`; yield the address.

    Port 0 is any free port, and an empty token a random one; tokens have only characters that URLs
    need not quote. At the end the feed is closed, which ends the streams of all pages. Raises
    BagError if the port cannot be used.
    """
    token = token or secrets.token_urlsafe(16)
    try:
        server = _Server((_ADDRESS, port), _handler(feed, page.encode(), token))
    except (OSError, OverflowError) as error:
        why = error.strerror if isinstance(error, OSError) else 'ports are numbers up to 65535'
        raise BagError(
            f'--port {port} of {_ADDRESS} cannot be used ({why}); name another, or leave it out '
            'for a free one'
        ) from None
    thread = threading.Thread(target=server.serve_forever, args=(_POLL_INTERVAL,), daemon=True)
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
            given, slash, name = path.lstrip('/').partition('/')
            host = re.sub(r':\d*$', '', self.headers.get('Host', ''))
            is_local = host in (_ADDRESS, 'localhost')
            if not is_local or not secrets.compare_digest(given.encode(), token.encode()):
                self._answer(403, 'text/plain', b'Open the address that kinpole view printed.\n')
            elif not slash:  # the page finds its stream relative to its folder
                self._answer(302, 'text/plain', b'', f'/{token}/')
            elif name == 'stream':
                self._stream()
            elif not name:
                self._answer(200, 'text/html', page)
            else:
                self._answer(404, 'text/plain', b'There is nothing here.\n')

        def _stream(self) -> None:
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
            self._send_headers(200, 'text/event-stream', {})
            self.wfile.write(f'retry: {_RETRY}\n\n'.encode())
            with closing(feed.events(RIG_EVENT)) as events:
                for data in events:
                    self.wfile.write(data)

        def _answer(self, status: int, kind: str, body: bytes, location: str = '') -> None:
            headers = {'Content-Length': str(len(body))}
            self._send_headers(status, kind, headers | ({'Location': location} if location else {}))
            self.wfile.write(body)

        def _send_headers(self, status: int, kind: str, headers: Mapping[str, str]) -> None:
            self.send_response(status)
            self.send_header('Content-Type', f'{kind}; charset=utf-8')
            for name, value in {**_HEADERS, **headers}.items():
                self.send_header(name, value)
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            """Log nothing: the address contains the token."""

    return Handler
