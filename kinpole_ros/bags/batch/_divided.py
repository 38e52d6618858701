"""One long bag done by several processes: each has a stretch of it, which are concatenated here."""

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path

from kinpole_ros.bags import bag_files
from kinpole_ros.bags._join import concatenated, join
from kinpole_ros.bags._replay import replay
from kinpole_ros.bags._replayed import Replayed
from kinpole_ros.bags._stretch import Stretch, stretches
from kinpole_ros.bags.batch import _store
from kinpole_ros.bags.batch._results import EXPECTED, Row, made_of, name_of, name_results
from kinpole_ros.tracking.parameters import Settings

# Bytes of a bag, at some 200 a frame: five seconds of work or more.
_LONG = 4 << 20


def ways(bags: Sequence[str], folder: Path | str, settings: Settings, workers: int) -> list[int]:
    """
    Among how many of the workers each bag is divided, where there are fewer bags than workers.

    A comparison with a scene runs on from frame to frame, and is not divided.
    """
    most = workers // len(bags)
    if most < 2 or settings.scene or isinstance(folder, str):
        return [1] * len(bags)
    return [most if _is_long(bag) else 1 for bag in bags]


def _is_long(bag: str) -> bool:
    try:
        return not _store.is_url(bag) and sum(f.stat().st_size for f in bag_files(bag)) > _LONG
    except EXPECTED:
        return False


def replay_stretch(
    bag: str,
    folder: Path,
    settings: Settings,
    topic: str | None,
    kinds: list[str],
    number: int,
    count: int,
    progress: Callable[[float], None] | None = None,
) -> Replayed:
    """Replay the stretch of this number, of so many, into files of its own beside the results."""
    parts = {kind: _part(bag, folder, number, kind) for kind in kinds}
    return replay(
        bag,
        settings,
        output=parts.get('mcap'),
        csv=parts.get('csv'),
        topic=topic,
        progress=progress,
        parquet=parts.get('parquet'),
        place=nullcontext,
        stretch=Stretch(*stretches(count)[number]),
    )


def assemble(
    bag: str,
    folder: Path,
    settings: Settings,
    topic: str | None,
    kinds: list[str],
    results: list[Replayed],
) -> Row:
    """The row of a bag whose stretches are done, and its results under their names."""
    whole = {kind: folder / f'{name_of(bag)}.{kind}.part' for kind in kinds}
    for kind, target in whole.items():
        join([_part(bag, folder, k, kind) for k in range(len(results))], target, kind)
    of_what = made_of(bag, settings, topic)
    return name_results(bag, folder, settings, of_what, whole, concatenated(results))


def _part(bag: str, folder: Path, number: int, kind: str) -> Path:
    return folder / f'{name_of(bag)}.{number}.{kind}.part'
