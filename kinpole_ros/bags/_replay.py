"""A bag of markers through the same tracker as the live node, to a bag or a table of results."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack
from itertools import chain, groupby
from pathlib import Path

import numpy as np

from kinpole_ros.bags._periodic import Column, PeriodicDiagnostics
from kinpole_ros.bags._reader import BagError, Truncated, bag_files, read_blocks, topics
from kinpole_ros.bags._replayed import Replayed
from kinpole_ros.bags._stretch import Stretch
from kinpole_ros.bags._table import CsvTable, ParquetTable
from kinpole_ros.bags._writer import BagWriter, in_place_of
from kinpole_ros.messages import (
    INPUT_TYPE_NAMES,
    DiagnosticArray,
    DiagnosticsMaker,
    MarkerReader,
    MessageError,
    Output,
    PoseReader,
    identity_lines,
    kind_of,
    outputs_of,
    reader_of,
    theory_of,
)
from kinpole_ros.tracking.assignment import MarkerPlaces
from kinpole_ros.tracking.estimate import MOST_PAIRED_BODIES, POLE_NAMES, Estimate
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.parameters import Settings
from kinpole_ros.tracking.space import updated
from kinpole_ros.tracking.tracker import Tracker

NODE_NAME = 'kinpole'
_SECOND = 1_000_000_000  # ns
_MOST_KEPT = 31 << 20  # bytes; from 32 MiB on nothing is kept


def replay(
    bag: str | Path,
    settings: Settings,
    output: str | Path | None = None,
    csv: str | Path | None = None,
    topic: str | None = None,
    progress: Callable[[float], None] | None = None,
    parquet: str | Path | None = None,
    take: Callable[[Estimate], None] | None = None,
    *,
    place: Callable[[str | Path], AbstractContextManager[str | Path]] = in_place_of,
    stretch: Stretch | None = None,
) -> Replayed:
    """
    Run the markers of a bag through the tracker, as fast as the machine goes.

    `bag` is an .mcap file or a rosbag2 folder; `topic` overrides the settings' marker topic.
    Results go to `output`, an .mcap under /kinpole/..., and to the tables `csv` and `parquet`;
    `take` is called with them, some instants at a time.
    Deterministic: the bag's stamps drive everything. A bag that is cut off gives the results of
    all that is before the cut. Results take the place of what was there when all of them are whole;
    until then they are beside it, as NAME.….part, or where `place` says, which ends when all is
    whole. Of a `stretch` of the bag results are what they are of all of it.
    Raises BagError when the bag, its topic or an output cannot be used.
    """
    name, kind = _marker_topic(bag, settings, topic)
    files = bag_files(bag)
    taken = {_identity(file): 'the bag to be replayed' for file in files}
    # Without metadata all that lies in a folder is the bag.
    folder = None if (Path(bag) / 'metadata.yaml').exists() else Path(bag).resolve()
    concatenated = [file.name for file in files] if folder is not None and len(files) > 1 else []
    for target in (output, csv, parquet):
        if target is None:
            continue
        identity = _identity(Path(target))
        if identity in taken:
            raise BagError(f'{target} is {taken[identity]}; name another file for the results')
        path = Path(target).resolve()
        if path.parent == folder and path.suffix == '.mcap':
            raise BagError(
                f'{target} would be a part of the bag to be replayed, which is all .mcap files of '
                'its folder; name a file in another folder for the results'
            )
        taken[identity] = 'the bag of results' if target is output else 'the CSV table'
    # glibc keeps what is freed once it has seen so much come and go, and no longer asks the system
    # for the arrays of each block anew: a tenth of all the time.
    np.empty(_MOST_KEPT, np.uint8)
    stretch, done = stretch or Stretch(0, 1), 0.0

    def report(share: float) -> None:
        nonlocal done
        done = share
        if progress is not None:
            progress(share)

    theory = theory_of(settings)
    tracker = Tracker(settings)
    reader = reader_of(kind, settings)
    order = settings.derivative_order or 4
    outputs = outputs_of(settings, theory)
    periodic = PeriodicDiagnostics(DiagnosticsMaker(NODE_NAME, theory, name))
    comparison = None
    if theory is not None:
        from kinpole_ros.linkage.theory import Comparison

        comparison = Comparison(theory)
    found = {body: dict.fromkeys(POLE_NAMES[:order], 0) for body in tracker.bodies}
    unknown = dict.fromkeys(tracker.bodies, '')
    space, looked = tracker.space(), 0
    estimates = 0
    problem = ''
    first, last = None, 0
    truncated: Truncated | None = None
    identities: tuple[str, ...] = ()
    absent = {body: list(markers) for body, markers in settings.bodies.items() if markers}
    if settings.marker_identity == 'shape':
        absent = {body: names for body, names in absent.items() if body not in settings.shapes}
    with ExitStack() as results, ExitStack() as stack:
        places = {
            target: results.enter_context(place(target))
            for target in (output, csv, parquet)
            if target is not None
        }
        writer = None
        if output is not None:
            writer = stack.enter_context(BagWriter(places[output], name=output))
        tables = [
            stack.enter_context(table(places[target], settings, target))
            for table, target in ((CsvTable, csv), (ParquetTable, parquet))
            if target is not None
        ]
        if writer is not None:
            # A topic that never has anything to say is there to be asked for, too.
            for row in outputs:
                writer.add_topic(row.under(f'/{NODE_NAME}'), row.message_type)
            writer.add_topic('/diagnostics', DiagnosticArray)
        for parts, log_times, error in _frames(bag, name, kind, reader, report):
            if isinstance(error, Truncated):
                truncated = error
            elif error is not None:
                tracker.counts['unreadable'] += 1
                problem = problem or str(error)
                periodic.trouble['message'] = str(error)
            if not parts:
                continue
            stretch.look(done, parts[0].stamps)
            if stretch.is_over:
                break
            periodic.silent = not stretch.is_known
            for frames in parts:
                earliest = int(frames.stamps.min())
                first = earliest if first is None else min(first, earliest)
                last = max(last, int(frames.stamps.max()))
                if frames.identities != identities:
                    identities = frames.identities
                    absent = _still_absent(absent, identities)
            handed = parts if writer is None else periodic.parts(parts, tracker)
            known = tracker.add_parts(handed, order if stretch.is_known else None)
            if last - looked >= _SECOND:
                looked, space = last, updated(space, tracker.space())
            if writer is not None:
                # Known as soon as the frames came that they fell due with.
                columns = [
                    result_columns(outputs, estimate, f'/{NODE_NAME}', log_times[estimate.due])
                    for estimate in known
                ]
                # Also of those that are not wanted: they remember what later ones need.
                made = list(chain(*columns, periodic.columns(known, log_times)))
                writer.write_many(made if stretch.is_wanted else ())
            for estimate in known if stretch.is_wanted else ():
                estimates += len(estimate)
                _count(found, estimate)
                unknown = _still_unknown(unknown, estimate)
                if comparison is not None:
                    comparison.add(estimate)
                for table in tables:
                    table.add(estimate)
                if take is not None:
                    take(estimate)
        counts = tracker.counts
        if counts['unreadable'] and not counts['frames']:
            raise BagError(f'{bag}: no message on {name} can be read: {problem}')
        lacking = reader.unseen_names() if isinstance(reader, PoseReader) else ''
        if lacking and not counts['frames']:
            raise BagError(f'{bag}: on {name} {lacking}')
    space = updated(space, tracker.space())
    share = {
        body: {pole: count / max(estimates, 1) for pole, count in poles.items()}
        for body, poles in found.items()
    }
    return Replayed(
        counts['frames'],
        estimates,
        share,
        counts['unreadable'],
        problem,
        counts['repeated'],
        counts['late'],
        counts['resets'],
        counts['frame_changes'],
        truncated,
        dict(zip(tracker.bodies, tracker.noise().tolist(), strict=True)),
        dict(zip(tracker.bodies, tracker.rigidity_residual().tolist(), strict=True)),
        dict(zip(tracker.bodies, tracker.causes(), strict=True)),
        [
            body
            for body, more in zip(tracker.bodies, tracker.noise_underestimated(), strict=True)
            if more
        ],
        first or 0,
        last,
        absent,
        identities,
        unknown,
        concatenated,
        comparison.found() if comparison is not None else [],
        comparison.positions() if comparison is not None else None,
        space,
        counts['lost'],
        tracker.stamp_state(),
        [*identity_lines(tracker, tracker.counts), *filter(None, (lacking, pairs_line(settings)))],
        tracker.erring(),
        dict(zip(tracker.bodies, tracker.wrong().tolist(), strict=True)),
        tracker.outages(),
    )


def pairs_line(settings: Settings) -> str:
    """Say that relative motions of pairs are not measured, if there are too many bodies."""
    count = len(settings.bodies)
    if count <= MOST_PAIRED_BODIES:
        return ''
    return (
        f'relative rates and centers of pairs are left out: there are {count} bodies, and pairs '
        f'are measured of up to {MOST_PAIRED_BODIES}; fix: for these, name fewer bodies'
    )


def _identity(path: Path) -> tuple[int, int] | Path:
    """What all names of one file have in common, those of hard links too."""
    try:
        about = path.stat()
    except OSError:
        return path.resolve()
    return about.st_dev, about.st_ino


def _still_absent(
    absent: dict[str, list[str]], identities: tuple[str, ...]
) -> dict[str, list[str]]:
    """Those of the markers of each body that are not in a message either."""
    none, places = len(identities), MarkerPlaces(identities)
    left = {
        body: [name for name in names if places.find(name) == none]
        for body, names in absent.items()
    }
    return {body: names for body, names in left.items() if names}


def _frames(
    bag: str | Path,
    topic: str,
    kind: str,
    reader: MarkerReader | PoseReader,
    progress: Callable[[float], None] | None,
) -> Iterator[tuple[list[MarkerFrames], np.ndarray, BagError | MessageError | None]]:
    """
    The frames of a bag with the log times of their messages, or what is wrong, in order.

    Those of messages of several layouts, as where markers come and go, are in parts.
    """
    blocks = read_blocks(bag, [topic], progress)
    nothing, wanted = np.zeros(0, np.int64), INPUT_TYPE_NAMES[kind]
    while True:
        try:
            block = next(blocks, None)
        except Truncated as error:
            yield [], nothing, error
            return
        if block is None:
            return
        # Bytes of another type may well be read, as markers that are none.
        for message in block:
            if message.type_name != wanted:
                problem = (
                    f'{topic} has messages of {message.type_name} among those of {wanted}; see '
                    'that each type has a topic of its own'
                )
                yield [], nothing, MessageError(problem)
        block = [message for message in block if message.type_name == wanted]
        log_times = np.array([message.log_time for message in block], np.int64)
        found = reader.read_numbered([message.data for message in block])
        for unreadable, group in groupby(found, lambda pair: isinstance(pair[0], MessageError)):
            parts, numbers = zip(*group, strict=True)
            if unreadable:
                yield from (([], nothing, error) for error in parts)
            else:
                yield list(parts), log_times[np.concatenate(numbers)], None


def result_columns(
    outputs: list[Output], estimate: Estimate, prefix: str, log_times: np.ndarray
) -> Iterator[Column]:
    """
    All there is to say of T instants, as `BagWriter.write_many` takes it.

    On topics under `prefix`, logged at `log_times` (T,), ns.
    """
    for row in outputs:
        instants, data = row.build(estimate)
        if data:
            topic = row.under(prefix)
            yield topic, row.message_type, log_times[instants].tolist(), data


def _count(found: dict[str, dict[str, int]], estimate: Estimate) -> None:
    for b, poles in enumerate(found.values()):
        for order, pole in enumerate(poles, 1):
            poles[pole] += int(estimate.pole(order).determined[:, b].sum())


def _still_unknown(unknown: dict[str, str], estimate: Estimate) -> dict[str, str]:
    """Those of the bodies that are known at none of these instants either, and why not."""
    rows = zip(estimate.bodies, estimate.missing.T, strict=True)
    reasons = {body: missing for body, missing in rows if body in unknown}
    return {body: str(said[-1]) for body, said in reasons.items() if (said != '').all()}


def _marker_topic(bag: str | Path, settings: Settings, topic: str | None) -> tuple[str, str]:
    """The topic's full name and the short name of its type."""
    name = topic or settings.marker_topic
    if name.startswith('~/'):
        name = f'/{NODE_NAME}/{name[2:]}'
    elif not name.startswith('/'):
        name = f'/{name}'
    there = topics(bag)
    known = set(INPUT_TYPE_NAMES.values())
    if name not in there:
        # What cannot be meant is not listed, unless there is nothing else.
        fit = {t: kind for t, kind in there.items() if kind in known} or there
        listed = ', '.join(f'{t} ({kind})' for t, kind in sorted(fit.items())) or 'no topics'
        raise BagError(f'{bag}: no topic {name}; it holds {listed}; name one with --topic')
    wanted, there_is = settings.marker_type, there[name]
    kind = kind_of(there_is, wanted)
    if kind is not None:
        return name, kind
    if there_is not in known:
        raise BagError(
            f'{bag}: topic {name} is {there_is}; markers must be one of '
            f'{", ".join(sorted(known))}; fix: name another with --topic, or have '
            f'`kinpole import {bag} --output NEW.mcap` read messages of trackers'
        )
    kinds = [one for one, ros in INPUT_TYPE_NAMES.items() if ros == there_is]
    if kind_of(there_is):
        kinds.append('auto')
    raise BagError(
        f'{bag}: topic {name} is {there_is}, but the parameter marker_type is {wanted}; set it to '
        f'{" or ".join(kinds)}{"" if kind_of(there_is) else ", and name the frame of each body"}'
    )
