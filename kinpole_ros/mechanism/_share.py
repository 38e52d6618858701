"""Where the files that come with the package (scenes, parameters) are, however it was installed."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]


def share_folder() -> Path:
    """
    The folder that holds `config/`.

    Returns
    -------
    Path
        In a source tree (also through a link from a workspace) the folder of package.xml. Installed
        by pip or colcon, `share/kinpole_ros` under the prefix that the package lies in
        (sys.prefix, the user's or a workspace's own), or else what the ament index names.

    Raises
    ------
    FileNotFoundError
        Where none of them has it.

    """
    candidates = [_PACKAGE.parent] if (_PACKAGE.parent / 'package.xml').is_file() else []
    candidates += [prefix / 'share' / 'kinpole_ros' for prefix in _PACKAGE.parents]
    for folder in candidates:
        if (folder / 'config').is_dir():
            return folder
    try:
        from ament_index_python.packages import get_package_share_directory

        return Path(get_package_share_directory('kinpole_ros'))
    # No ament; a package that its index does not know; no ROS sourced.
    except (ImportError, LookupError, OSError):
        raise FileNotFoundError(
            f'{_PACKAGE}: no config/ folder goes with this copy of kinpole_ros: install it with '
            'pip or colcon, or give the path of the file'
        ) from None
