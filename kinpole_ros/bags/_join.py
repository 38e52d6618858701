"""Results of the stretches of a bag concatenated, as if one replay had written them."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from kinpole_ros.bags._replayed import Replayed
from kinpole_ros.bags._table import join_parquet
from kinpole_ros.bags._writer import BagWriter


def concatenated(parts: Sequence[Replayed]) -> Replayed:
    """What the replays of all stretches, in order, came to: the last has learned from all."""
    count = sum(part.estimates for part in parts)
    determined = {
        body: {
            pole: sum(round(part.determined[body][pole] * part.estimates) for part in parts)
            / max(count, 1)
            for pole in poles
        }
        for body, poles in parts[-1].determined.items()
    }
    never = set.intersection(*(set(part.unknown) for part in parts))
    reasons: dict[str, str] = {}
    for part in parts:
        reasons |= {body: why for body, why in part.unknown.items() if part.estimates}
    unknown = {body: reasons.get(body, '') for body in parts[-1].unknown if body in never}
    return parts[-1]._replace(estimates=count, determined=determined, unknown=unknown)


def join(parts: Sequence[Path], target: Path, kind: str) -> None:
    """Put the results of stretches, in order, together in a file of this kind: as `replay` has."""
    if kind == 'mcap':
        with BagWriter(target) as writer:
            for part in parts:
                writer.append(part)
    elif kind == 'parquet':
        join_parquet(parts, target)
    else:
        with target.open('wb') as whole:
            for number, part in enumerate(parts):
                with part.open('rb') as file:
                    if number:
                        file.readline()
                    shutil.copyfileobj(file, whole, 1 << 20)
