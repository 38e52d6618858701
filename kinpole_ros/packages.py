"""Optional Python packages: the commands that install them, and why an import of one failed."""

import sys
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType

# The packages of each extra in setup.py. Messages name them, and not the extra, since kinpole_ros
# is on no package index: pip finds its extras in a checkout only.
EXTRAS = MappingProxyType(
    {
        'batch': ('dask', 'fsspec'),
        'bench': ('matplotlib', 'pynumdiff', 'scipy'),
        'cluster': ('dask', 'distributed'),
        'film': ('av', 'opencv-python-headless'),
        'formats': ('h5py',),
        'pandas': ('pandas',),
        'parquet': ('pyarrow',),
        'plot': ('matplotlib',),
        'ros': ('ros-jazzy-rclpy', 'ros-jazzy-common-interfaces', 'ros-jazzy-rmw-fastrtps-cpp'),
    }
)


def install_command(extra: str) -> str:
    """
    Return the command that installs the packages of an extra, from anywhere.

    Parameters
    ----------
    extra : str
        A key of `EXTRAS`.

    Returns
    -------
    str
        The command, as 'pip install pyarrow'.
    """
    return f'pip install {" ".join(EXTRAS[extra])}'


def package_of(error: ImportError) -> str:
    """
    Return the top-level package that an import failed in.

    Parameters
    ----------
    error : ImportError
        What the import raised.

    Returns
    -------
    str
        Its name, '' if unknown. A compiled module that fails to load names only itself, as
        `_rclpy_pybind11`, so its package is found from the path of its file.
    """
    folder = Path(error.path).parent if error.path else None
    if folder is None or not (folder / '__init__.py').exists():
        return (error.name or '').partition('.')[0]
    while (folder.parent / '__init__.py').exists():
        folder = folder.parent
    return folder.name


def broken_import(error: ImportError) -> str:
    """
    Return why a package that is installed cannot be imported.

    Parameters
    ----------
    error : ImportError
        What the import raised.

    Returns
    -------
    str
        The reason in one line; '' if the package is not installed at all.
    """
    # rclpy appends lines with the address of a help page.
    reason = str(error).partition('\n')[0]
    package = package_of(error)
    if isinstance(error, ModuleNotFoundError):
        part = (error.name or '').partition('.')[2]
        if not part or find_spec(package) is None:
            return ''
        python = '.'.join(map(str, sys.version_info[:2]))
        return f'{package} is installed but has no {part} for Python {python}: {reason}'
    path = f' ({error.path})' if error.path and error.path not in reason else ''
    return f'{package or "a package"} is installed but fails to load: {reason}{path}'
