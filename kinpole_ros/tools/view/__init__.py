"""
The page of a report, live: what a node publishes, 30 times a second, in a browser on this machine.

The node has one topic for pages, which is subscribed to only while a page is open: without readers
it costs the node nothing.
"""

import os

from kinpole_ros import __version__
from kinpole_ros.tools.report import page
from kinpole_ros.tools.view._live import Live
from kinpole_ros.tools.view._server import Feed, serving

__all__ = ['view']
_NICENESS = 10


def view(chosen: str = '', port: int = 0) -> None:
    """
    Serve the page until SIGINT or SIGTERM, and print its address.

    `chosen` is a node by its full name, its namespace, or one of its topics; '' is the first node
    found. Port 0 is any free port. Raises BagError if the port cannot be used, or ROS cannot start.
    """
    from kinpole_ros.ros.listener import watching

    # On busy cores the node and its subscribers come first.
    os.nice(_NICENESS)
    feed = Feed()
    words = {'live': True, 'title': 'kinpole view', 'made': f'kinpole {__version__}'}
    with serving(feed, page(words), port) as address, watching() as (watcher, stop_requested):
        print(f'open {address} in a browser on this machine; Ctrl-C ends it', flush=True)
        live = Live(watcher, feed, chosen)
        while not stop_requested():
            live.step()
