"""Checks of the files that a command is to write, before it reads or writes anything."""

import os
from collections.abc import Iterable, Sequence
from contextlib import suppress

from kinpole_ros.tools.commands._terminal import UsageError

# File name endings by kind of file.
_ENDINGS = {
    'an HTML page': ('.html', '.htm'),
    'an MCAP bag': ('.mcap',),
    'a CSV table': ('.csv', '.tsv', '.txt'),
    'a Parquet table': ('.parquet',),
    'a YAML file': ('.yaml', '.yml'),
    'a Foxglove layout': ('.json',),
    'a PlotJuggler layout': ('.xml',),
    'a picture': ('.png', '.pdf', '.svg', '.jpg', '.jpeg'),
    'a PNG picture': ('.png',),
    'a video': ('.mp4',),
    'a sheet of tags': ('.svg', '.pdf'),
    'a pair of pitch curves': ('.csv', '.svg', '.dxf'),
    'a linkage for other programs': ('.dxf', '.xml', '.urdf'),
}
# Kinds that need one of their endings: browsers go by the ending of a page, and the ending of the
# others is their format. Other kinds accept any ending that is not of another kind.
_STRICT = (
    'an HTML page',
    'a PNG picture',
    'a video',
    'a sheet of tags',
    'a pair of pitch curves',
    'a linkage for other programs',
)

# The option that names a file, the file (None if not given), and its kind: a key of _ENDINGS, or ''
# where the writer checks the ending.
Output = tuple[str, str | None, str]


def check_outputs(inputs: Iterable[str | None], outputs: Sequence[Output]) -> None:
    """
    Refuse outputs that would overwrite an input, another output or a recording.

    Inputs that are not given, or are no files, are ignored. A folder is a bag of several files.
    Raises FileExistsError for the first output that must not be written, and UsageError for one
    whose ending says that it is a file of another kind.
    """
    uses: dict[object, tuple[str, str]] = {}
    for path in filter(None, inputs):
        for file in _files_of(path):
            uses[_identity(file)] = file, 'is an input'
    for _, output, _ in outputs:
        if not output or (os.path.exists(output) and not os.path.isfile(output)):
            continue  # a folder is refused where it is opened; a device is no file to protect
        identity = _identity(output)
        if identity in uses:
            file, use = uses[identity]
            same = '' if file == output else f'is the same file as {file}, which '
            raise FileExistsError(f'{output} {same}{use}; name another file to write')
        uses[identity] = output, 'is another output'
        if os.path.isfile(output) and (recorder := _recorder_of(output)):
            raise FileExistsError(
                f'{output} is a recording, made by {recorder!r}; name another file to write, or '
                'remove that one first'
            )
    for name, output, kind in outputs:
        if output is not None and kind:
            check_ending(name, output, kind)


def check_ending(name: str, output: str, kind: str) -> None:
    """Refuse an output whose ending says that it is a file of another kind."""
    ending = os.path.splitext(output)[1].lower()
    allowed = _ENDINGS[kind]
    all_endings = {one for endings in _ENDINGS.values() for one in endings}
    if ending not in allowed and (kind in _STRICT or ending in all_endings):
        names = ' or '.join(allowed)
        raise UsageError(f'{name} {output}: the output is {kind}; end its name in {names}')


def _files_of(path: str) -> list[str]:
    """Return the files that are read for this path, a file or the folder of a bag."""
    if not os.path.isdir(path):
        return [path] if os.path.isfile(path) else []
    from kinpole_ros.bags import BagError, bag_files

    with suppress(BagError):  # refused where it is read
        return [os.path.join(path, 'metadata.yaml'), *map(str, bag_files(path))]
    return []


def _identity(path: str) -> object:
    """Return what all names of one file have in common, whether it exists or not."""
    with suppress(OSError):
        status = os.stat(path)
        return status.st_dev, status.st_ino
    return os.path.realpath(path)


def _recorder_of(path: str) -> str:
    with suppress(ImportError):  # commands without bags run without mcap
        from kinpole_ros.bags import recorder_of

        return recorder_of(path)
    return ''
