"""
The page of a report, live: what a node publishes, 30 times a second, in a browser on this machine.

One topic of the node is for pages, and it is subscribed to only while one is open: what nobody
reads costs the node nothing.
"""

import os

from kinpole_ros import __version__
from kinpole_ros.tools.report import page
from kinpole_ros.tools.view._feed import Feed
from kinpole_ros.tools.view._live import Live
from kinpole_ros.tools.view._server import serving

__all__ = ['view']
_NICE = 10  # pages wait for whatever else runs


def view(chosen: str = '', port: int = 0) -> None:
    """
    Serve the page until SIGINT or SIGTERM, and print its address.

    `chosen` is a node by its full name, its namespace, or one of its topics; '' is any. Raises
    BagError where the port cannot be had, or ROS cannot start.
    """
    from kinpole_ros.ros.listener import watching

    # Where cores are scarce the node, and whoever waits for it, comes first.
    os.nice(_NICE)
    feed = Feed()
    words = {'live': True, 'title': 'kinpole view', 'made': f'kinpole {__version__}'}
    with serving(feed, page(words), port) as address, watching() as (watcher, stop_requested):
        print(f'open {address} in a browser on this machine; Ctrl-C ends it', flush=True)
        live = Live(watcher, feed, chosen)
        while not stop_requested():
            live.step()
