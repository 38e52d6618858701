"""
The commands, one a module: `add` says what words it takes, `run` does it and tells the outcome.

What a command needs is imported when it runs, so that --help comes at once.
"""

from types import ModuleType

from kinpole_ros.tools.commands import (
    batch,
    bench,
    demo,
    discover,
    fit,
    import_,
    layout,
    play,
    plot,
    record,
    replay,
    report,
    simulate,
    solve,
    tolerance,
    view,
)

__all__ = ['COMMANDS']

# In the order in which --help lists them.
COMMANDS: dict[str, ModuleType] = {
    'replay': replay,
    'batch': batch,
    'simulate': simulate,
    'solve': solve,
    'tolerance': tolerance,
    'discover': discover,
    'fit': fit,
    'plot': plot,
    'report': report,
    'view': view,
    'layout': layout,
    'import': import_,
    'play': play,
    'record': record,
    'demo': demo,
    'bench': bench,
}
