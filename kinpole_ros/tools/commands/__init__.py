"""
The subcommands of `kinpole`.

Each is a function; its docstring is its --help. It imports its tools when it runs, so that --help
comes at once.
"""

# The order of these imports is the order of the list in `kinpole --help`.
from kinpole_ros.tools.commands import (  # noqa: F401, I001
    replay,
    markers,
    films,
    mechanisms,
    results,
    live,
)
from kinpole_ros.tools.commands._command import COMMANDS

__all__ = ['COMMANDS']
