"""Many bags: each gets its result, one that fails costs only itself, and a stopped run goes on."""

import csv
import errno
import gc
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from conftest import bodies_of, decoded, write_config

import kinpole_ros.bags.batch as module
from kinpole_ros.bags import BagError
from kinpole_ros.bags import replay as replay_one
from kinpole_ros.bags._replay import replay_into
from kinpole_ros.bags.batch import Cluster, _folder, _jobs, _workers, batch
from kinpole_ros.bags.batch._jobs import Job, finished, replay_bag
from kinpole_ros.files import _writing, as_cell
from kinpole_ros.settings import Settings
from kinpole_ros.tools.cli import main

Simulated = Callable[..., Path]
SETTINGS = Settings(window=0.2, lag=0.05, derivative_order=2)
ROOT = Path(__file__).parents[2]


# Python runs this before the command: a worker that opens the sixth bag says so and waits, so that
# no signal comes to a batch that has ended.
PAUSE = """
import multiprocessing, pathlib, sys, time

def hear(event, words):
    if event == 'open' and str(words[0]).endswith('run_5.mcap'):
        if multiprocessing.parent_process() is not None:
            pathlib.Path(__file__).with_name('paused').touch()
            time.sleep(60)

sys.addaudithook(hear)
"""


@contextmanager
def process(*words: str, path: Path = ROOT) -> Iterator['subprocess.Popen[str]']:
    """A Python program in a session of its own, ended with all it started."""
    started = subprocess.Popen(
        [sys.executable, *words],
        cwd=ROOT,
        env={**os.environ, 'PYTHONPATH': os.pathsep.join((str(path), str(ROOT)))},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        yield started
    finally:
        # Also where it has ended: what it started may have its pipes, and keep them open.
        with suppress(ProcessLookupError):
            os.killpg(started.pid, signal.SIGKILL)
        started.communicate()


def until(condition: Callable[[], bool], seconds: float = 90.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def summary(folder: Path) -> list[dict[str, str]]:
    with open(folder / 'summary.csv', newline='', encoding='utf-8') as file:
        return list(csv.DictReader(file))


def files(folder: Path) -> dict[str, int]:
    """When each file but the summary was written."""
    return {p.name: p.stat().st_mtime_ns for p in folder.iterdir() if p.name != 'summary.csv'}


def in_turn(jobs: list[Job], workers: int, take: Any, share: Any) -> None:
    """In place of processes: each job at once, in this thread."""
    _workers.replay_here(jobs, take, share)


def link(bag: Path, *places: Path) -> list[Path]:
    for place in places:
        place.parent.mkdir(parents=True, exist_ok=True)
        os.link(bag, place)
    return list(places)


@pytest.mark.parametrize('first', '=+-@')
def test_no_cell_of_a_table_is_a_formula(simulated: Simulated, tmp_path: Path, first: str) -> None:
    (bag,) = link(simulated('cardan', rate=100, duration=0.6), tmp_path / f'{first}cmd.mcap')
    body = f'{first}cmd|calc'
    settings = Settings(bodies={body: bodies_of('cardan')['rod']})
    batch([bag], tmp_path / 'out', settings, kinds=('csv',), workers=1)
    (row,) = summary(tmp_path / 'out')
    assert row['results'].startswith(f"'{first}cmd-")
    spans = [float(row[name]) for name in ('start', 'end', 'seconds')]
    assert spans == [1.0, 1.59, 0.59]
    with open(tmp_path / 'out' / row['results'][1:], newline='', encoding='utf-8') as file:
        for cells in csv.reader(file):
            for cell in cells:
                assert cell[:1] not in '=+-@' or not cell or float(cell)


def test_numbers_in_a_table_stay_numbers() -> None:
    cells = '-1.5', '+2', '-1e-05', '', -1.5, None, 'a=b', '-', '-x', '=1', '@', '+a', '\t=1'
    quoted = [as_cell(cell) for cell in cells]
    assert quoted == [*cells[:7], "'-", "'-x", "'=1", "'@", "'+a", "'\t=1"]


def test_bags_without_parameters_are_said_to_be_of_one_body(
    simulated: Simulated, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = simulated('cardan', rate=100, duration=0.6)
    bags = link(bag, tmp_path / 'monday.mcap', tmp_path / 'tuesday.mcap')
    words = ['batch', *map(str, bags), '--output', str(tmp_path / 'out'), '--workers', '1']
    for _ in range(2):  # made, and found again
        main(words)
        said = capsys.readouterr().out
        assert 'markers are taken as one rigid body, "body"' in said
        assert f'kinpole discover {bags[0]} --output rig.yaml' in said
        assert '; so it is for 1 other bag\n' in said
    config = write_config(tmp_path / 'rig.yaml', replace(SETTINGS, bodies=bodies_of('cardan')))
    main([*words, '--config', str(config)])
    assert 'one rigid body' not in capsys.readouterr().out


def test_a_missing_package_for_tables_is_told_before_any_replay(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('kinpole_ros.tools.commands.replay.find_spec', lambda name: None)
    out = tmp_path / 'out'
    assert main(['batch', 'a.mcap', 'b.mcap', '--parquet', '--output', str(out)]) == 2
    line = 'kinpole batch: --parquet needs pyarrow; fix: pip install pyarrow, or use --csv\n'
    assert capsys.readouterr().err == line
    assert not out.exists()


def test_each_bag_has_its_result_and_a_failed_one_costs_only_itself(
    simulated: Simulated, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = simulated('cardan', rate=100, duration=0.6)
    good = link(bag, tmp_path / 'monday' / 'run.mcap', tmp_path / 'tuesday' / 'run.mcap')
    broken, cut = tmp_path / 'broken.mcap', tmp_path / 'cut.mcap'
    broken.write_text('no bag')
    cut.write_bytes(bag.read_bytes()[:-3000])
    config = write_config(tmp_path / 'rig.yaml', SETTINGS, derivative_order=2)
    out = tmp_path / 'out'
    words = ['batch', *map(str, (broken, *good, cut, good[0], '--config', config, '--output', out))]
    words += ['--csv', '--mcap']
    assert main([*words, '--workers', '2']) == 2
    said, complaints = capsys.readouterr()
    assert said.startswith('4 bags, 1 failed, 1 cut off; ')
    assert f'kinpole batch: {broken} is not an MCAP file' in complaints
    assert f'kinpole batch: {cut} is cut off at byte' in complaints
    assert len(complaints.splitlines()) == 2

    rows = summary(out)
    assert [row['bag'] for row in rows] == [str(path) for path in (broken, *good, cut)]
    assert [bool(row['error']) for row in rows] == [True, False, False, False]
    assert [bool(row['truncated']) for row in rows] == [False, False, False, True]
    replay_one(bag, SETTINGS, tmp_path / 'one.mcap', tmp_path / 'one.csv', whole=True)
    expected = decoded(tmp_path / 'one.mcap')
    assert len({row['results'] for row in rows}) == 4
    for row in rows[1:3]:
        result, table = row['results'].split()
        assert result.startswith('run-')
        assert decoded(out / result) == expected
        assert (out / table).read_bytes() == (tmp_path / 'one.csv').read_bytes()
        assert (row['frames'], row['start'], row['end']) == ('60', '1.0', '1.59')
        assert (row['resets'], row['unreadable']) == ('0', '0')
        assert float(row['body_noise']) < 1e-9
        assert float(row['body_icr_determined']) > 0.5
    assert not list(out.glob('*.part'))

    # Again: nothing that is finished is done again, what failed is tried again.
    before = files(out)
    broken.unlink()
    os.link(bag, broken)
    assert main(words) == 2
    after = files(out)
    assert {name: after[name] for name in before} == before
    assert sum(name.startswith('broken-') for name in after) == 3
    assert [bool(row['error']) for row in summary(out)] == [False] * 4


@pytest.mark.parametrize('sent', [signal.SIGINT, signal.SIGKILL])
def test_a_run_that_was_stopped_keeps_what_is_finished_and_goes_on(
    simulated: Simulated,
    tmp_path: Path,
    sent: signal.Signals,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    bag = simulated('cardan', rate=200, duration=1)
    bags = link(bag, *(tmp_path / f'run_{k}.mcap' for k in range(10)))
    out = tmp_path / 'out'
    words = [*bags, '--output', out, '--csv']
    command = ['-m', 'kinpole_ros.tools.cli', 'batch', *map(str, words), '--workers', '1']
    (tmp_path / 'sitecustomize.py').write_text(PAUSE)
    with process(*command, path=tmp_path) as started:
        until((tmp_path / 'paused').exists)
        if sent == signal.SIGINT:  # as a terminal does it, to all of them
            os.killpg(started.pid, sent)
        else:
            started.send_signal(sent)
        said, complaints = started.communicate(timeout=60)
        if sent == signal.SIGINT:
            assert started.returncode == 130
            assert said == complaints == ''
            assert len(summary(out)) >= 1
            assert not list(out.glob('*.part'))
    done = files(out)
    finished = [name for name in done if name.endswith('.csv')]
    assert 1 <= len(finished) < 10
    assert all((out / name).read_bytes() for name in finished)

    monkeypatch.setattr(module, 'replay_in_processes', in_turn)
    assert main(['batch', *map(str, words)]) == 0
    said, complaints = capsys.readouterr()
    assert complaints == ''
    assert said.startswith('10 bags, 0 failed, 0 cut off; 2000 frames in')
    assert not list(out.glob('*.part'))
    assert {name: when for name, when in files(out).items() if name in finished} == {
        name: done[name] for name in finished
    }
    tables = {path.read_bytes() for path in out.glob('run_*.csv')}
    assert len(tables) == 1
    assert len(summary(out)) == 10


def test_a_dask_cluster_is_used_by_its_address(
    simulated: Simulated,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip('distributed')
    bag = simulated('four_bar', rate=100, duration=0.6)
    bags = link(bag, *(tmp_path / f'run_{k}.mcap' for k in range(3)))
    (tmp_path / 'broken.mcap').write_text('no bag')
    where = tmp_path / 'scheduler.json'
    words = ['batch', *map(str, bags), str(tmp_path / 'broken.mcap')]
    words += ['--output', str(tmp_path / 'out'), '--parquet', '--scheduler']
    pytest.importorskip('pyarrow')
    scheduling = ['-m', 'dask', 'scheduler', '--host', '127.0.0.1', '--port', '0']
    with process(*scheduling, '--no-dashboard', '--scheduler-file', str(where)) as scheduler:
        until(where.exists)
        until(lambda: where.read_text().endswith('}'))
        address = json.loads(where.read_text())['address']
        with monkeypatch.context() as patience:
            patience.setattr(_workers, '_CONNECT_TIMEOUT', 0.5)
            assert main([*words, address]) == 2
        assert f'the Dask scheduler at {address} has no workers; fix' in capsys.readouterr().err
        worker = ['-m', 'dask', 'worker', '--scheduler-file', str(where), '--nthreads', '1']
        with process(*worker, '--no-dashboard', '--no-nanny'):
            # A worker has a folder of its own to work in, and finds the scene all the same.
            monkeypatch.chdir(tmp_path)
            scene = (ROOT / 'config' / 'scenes' / 'four_bar.yaml').read_text()
            Path('mine.yaml').write_text(scene)
            config = write_config(
                Path('rig.yaml'), replace(SETTINGS, bodies=bodies_of('four_bar')), scene='mine.yaml'
            )
            words[-1:-1] = ['--config', str(config)]
            assert main([*words, address]) == 2
        assert scheduler.poll() is None
    said = capsys.readouterr()
    assert said.out.startswith('4 bags, 1 failed, 0 cut off; 180 frames in')
    warning, failure = said.err.splitlines()
    assert f'anyone who reaches {address} can run code on its workers; fix: ' in warning
    assert 'broken.mcap is not an MCAP file' in failure
    assert len(list((tmp_path / 'out').glob('run_*.parquet'))) == 3
    monkeypatch.setattr(_workers, '_CONNECT_TIMEOUT', 0.5)
    assert main([*words, 'tcp://127.0.0.1:9']) == 2
    assert 'no Dask scheduler answers at tcp://127.0.0.1:9' in capsys.readouterr().err


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[Any, Any, str]]:
    """A scheduler of Dask and its worker, as processes, and its address."""
    pytest.importorskip('distributed')
    where = tmp_path / 'scheduler.json'
    scheduling = ['-m', 'dask', 'scheduler', '--host', '127.0.0.1', '--port', '0']
    with process(*scheduling, '--no-dashboard', '--scheduler-file', str(where)) as scheduler:
        until(lambda: where.exists() and where.read_text().endswith('}'))
        worker = ['-m', 'dask', 'worker', '--scheduler-file', str(where), '--nthreads', '1']
        with process(*worker, '--no-dashboard', '--no-nanny') as crew:
            yield scheduler, crew, json.loads(where.read_text())['address']


@pytest.mark.parametrize('lost', ['scheduler', 'worker'])
def test_a_cluster_that_ends_costs_one_line_and_leaves_a_summary(
    simulated: Simulated, tmp_path: Path, cluster: tuple[Any, Any, str], lost: str
) -> None:
    scheduler, worker, address = cluster
    bag, out = simulated('cardan', rate=100, duration=3.0), tmp_path / 'out'
    bags = link(bag, *(tmp_path / f'run_{k}.mcap' for k in range(60)))
    words = ['-m', 'kinpole_ros.tools.cli', 'batch', *map(str, bags), '--output', str(out)]
    with process(*words, '--scheduler', address) as started:
        assert started.stderr is not None
        assert 'anyone who reaches' in started.stderr.readline()
        until(lambda: len(list(out.glob('*.json'))) > 1)
        if lost == 'worker':
            worker.kill()
            said = started.stderr.readline()
            assert (
                said
                == f'the Dask cluster has no worker; waiting for one: `dask worker {address}`\n'
            )
        scheduler.kill()
        _, complaints = started.communicate(timeout=90)
    assert started.returncode == 2
    (line,) = complaints.splitlines()
    assert f'the Dask scheduler at {address} ended; what is done is in the summary; fix: ' in line
    assert 1 < len(summary(out)) < 60


def test_a_worker_ends_with_a_batch_that_is_killed_in_the_middle_of_its_job() -> None:
    code = (
        f'import sys; sys.path[:0] = {[str(path) for path in Path(__file__).parents[:2]]!r}\n'
        'from test_batch import in_a_process, report_and_sleep\n'
        "if __name__ == '__main__':\n"
        '    in_a_process([report_and_sleep], lambda _, pid: print(int(pid), flush=True))\n'
    )
    with process('-c', code) as started:
        assert started.stdout is not None
        pid = 0
        while not pid:  # what comes first is that it has begun
            pid = int(started.stdout.readline())
        assert is_running(pid)
        started.kill()
        started.wait()
        until(lambda: not is_running(pid), 20)


def in_a_process(
    replays: list[Callable[..., Any]], share: Callable[[int, float], None]
) -> dict[int, dict[str, Any]]:
    """Rows of jobs, whose settings are the functions to call in place of a replay."""
    rows: dict[int, dict[str, Any]] = {}
    jobs = [Job(f'{k}.mcap', 'memory://', SETTINGS, []) for k in range(len(replays))]
    numbered = [replace(job, kinds=[replay]) for job, replay in zip(jobs, replays, strict=True)]
    with mock.patch.object(_workers, '_replay', call_kind):
        _workers.replay_in_processes(numbered, 1, rows.__setitem__, share)
    return rows


def call_kind(numbered: tuple[int, Job], share: Any) -> _workers.Done:
    number, job = numbered
    share(number, 0.0)
    return _workers.Done(number, job.kinds[0](lambda done: share(number, done)))  # type: ignore[operator]


def report_and_sleep(progress: Callable[[float], None]) -> None:
    """A job that has nothing to say after its begin."""
    progress(os.getpid())
    time.sleep(600)


def is_running(pid: int) -> bool:
    """Whether a process has not ended, even if nobody has asked for its exit status."""
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except OSError:
        return False


@pytest.mark.parametrize(
    'name',
    [
        *('filecache::file:///etc/passwd', 'simplecache::s3://lab/run.mcap', 'local:///etc/passwd'),
        *('LOCAL://x', 'zip://run.mcap::/home/me/a.zip', 'git://.', 'reference://run.mcap'),
    ],
)
def test_a_list_names_no_address_that_leads_to_files_here(tmp_path: Path, name: str) -> None:
    path = tmp_path / 'bags.txt'
    path.write_text(f's3://lab/run.mcap\n{name}\n')
    with pytest.raises(BagError, match=re.escape(f'bags.txt: {name} is a file of this machine')):
        module.listed_bags(path)
    path.write_text('s3://lab/run.mcap\n/data/run.mcap\nfile:///data/a.mcap\na::b.mcap\n')
    assert len(module.listed_bags(path)) == 4


def certificates(folder: Path) -> dict[str, Path]:
    """Files of TLS: an authority, and a certificate and key that it signed."""
    openssl = shutil.which('openssl')
    if openssl is None:
        pytest.skip('openssl makes the certificates')
    ca, ca_key, cert, key = (folder / name for name in ('ca.pem', 'ca.key', 'me.pem', 'me.key'))
    request = [openssl, 'req', '-x509', '-newkey', 'rsa:2048', '-nodes', '-days', '2']
    for words in (
        ['-subj', '/CN=lab', '-keyout', ca_key, '-out', ca],
        ['-subj', '/CN=me', '-keyout', key, '-out', cert, '-CA', ca, '-CAkey', ca_key],
    ):
        subprocess.run([*request, *words], check=True, capture_output=True)
    return {'ca': ca, 'cert': cert, 'key': key}


def test_a_dask_cluster_with_tls_takes_only_jobs_of_those_with_a_certificate(
    simulated: Simulated, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip('distributed')
    bag = simulated('cardan', rate=100, duration=0.3)
    made = certificates(tmp_path)
    where = tmp_path / 'scheduler.json'
    tls = ['--tls-ca-file', made['ca'], '--tls-cert', made['cert'], '--tls-key', made['key']]
    tls = [str(word) for word in (*tls, '--no-dashboard')]
    started = ['-m', 'dask', 'scheduler', '--protocol', 'tls', '--host', '127.0.0.1', '--port', '0']
    with process(*started, *tls, '--scheduler-file', str(where)):
        until(where.exists)
        until(lambda: where.read_text().endswith('}'))
        address = json.loads(where.read_text())['address']
        worker = ['-m', 'dask', 'worker', address, '--nthreads', '1', '--no-nanny']
        with process(*worker, *tls):
            words = ['batch', str(bag), '--output', str(tmp_path / 'out'), '--scheduler', address]
            assert main(words) == 2
            line = capsys.readouterr().err
            assert f'no Dask scheduler answers at {address}' in line
            assert '--tls-cert' in line
            assert line.count('\n') == 1
            assert main([*words, '--tls-ca', str(tmp_path / 'none.pem')]) == 2
            assert capsys.readouterr().err.count('\n') == 1
            # Dask closes a client that found no scheduler when it is collected, and that waits for
            # ever in the thread of the next one.
            gc.collect()
            for name, path in made.items():
                words += [f'--tls-{name}', str(path)]
            assert main(words) == 0
            said = capsys.readouterr()
            assert said.err == ''
            assert said.out.startswith('1 bags, 0 failed, 0 cut off; 30 frames in')


def listening(parent: int) -> tuple[set[int], set[str]]:
    """The processes below one and itself, and the sockets on which any of them listens."""
    processes, sockets = [parent], set()
    for pid in processes:
        with suppress(OSError):
            for task in Path(f'/proc/{pid}/task').iterdir():
                processes += map(int, (task / 'children').read_text().split())
            for file in Path(f'/proc/{pid}/fd').iterdir():
                sockets.add(os.readlink(file))
    found = set()
    for table, state, inode, listens in (
        ('tcp', 3, 9, '0A'),
        ('tcp6', 3, 9, '0A'),
        ('unix', 3, 6, '00010000'),
    ):
        for line in Path(f'/proc/net/{table}').read_text().splitlines()[1:]:
            words = line.split()
            if words[state] == listens and f'socket:[{words[inode]}]' in sockets:
                found.add(f'{table}: {line}')
    return set(processes), found


def test_no_process_of_a_batch_listens_on_a_socket(simulated: Simulated, tmp_path: Path) -> None:
    """Whoever connected to one could run code as the user."""
    bag = simulated('cardan', rate=200, duration=1)
    bags = link(bag, *(tmp_path / f'run_{k}.mcap' for k in range(4)))
    words = [*map(str, bags), '--output', str(tmp_path / 'out'), '--workers', '2']
    seen: set[int] = set()
    sockets: set[str] = set()

    def ended() -> bool:
        processes, found = listening(started.pid)
        seen.update(processes)
        sockets.update(found)
        return started.poll() is not None

    with process('-m', 'kinpole_ros.tools.cli', 'batch', *words) as started:
        until(ended)
        assert started.returncode == 0
    assert len(seen) >= 3  # two workers
    assert not sockets


def die_of_a_signal(progress: Callable[[float], None]) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def half_a_job(progress: Callable[[float], None]) -> dict[str, Any]:
    progress(0.5)
    return {'error': ''}


def test_a_worker_process_that_dies_costs_the_job_it_was_at() -> None:
    shares: list[tuple[int, float]] = []
    rows = in_a_process(
        [half_a_job, die_of_a_signal, half_a_job], lambda *share: shares.append(share)
    )
    assert 'its worker process ended; fix: run the same command again' in rows.pop(1)['error']
    assert rows == {0: {'error': ''}, 2: {'error': ''}}
    assert {(0, 0.5), (2, 0.5)} < set(shares)


def test_a_fault_of_ours_costs_only_its_bag(
    simulated: Simulated, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag, out = bag_and_folder(simulated, tmp_path)
    monkeypatch.setattr(_jobs, 'replay_into', lambda *_: 1 / 0)
    row = replay_bag(Job(bag, out, SETTINGS, ['csv']))
    assert row == {'bag': bag, 'error': 'ZeroDivisionError: division by zero'}


def test_results_are_made_anew_when_bag_settings_or_scene_change(
    simulated: Simulated, tmp_path: Path
) -> None:
    bag = str(link(simulated('four_bar', rate=100, duration=0.3), tmp_path / 'run.mcap')[0])
    out = tmp_path / 'out'
    out.mkdir()
    scene = tmp_path / 'mine.yaml'
    scene.write_text((ROOT / 'config' / 'scenes' / 'four_bar.yaml').read_text())
    settings = replace(SETTINGS, bodies=bodies_of('four_bar'), scene=str(scene))
    row = replay_bag(Job(bag, out, settings, ['csv']))
    assert row['error'] == ''

    def there(*given: Any) -> bool:
        return finished(Job(bag, out, *given)) == row

    assert there(settings, ['csv'])
    assert not there(settings, ['csv', 'mcap'])
    assert not there(replace(settings, marker_topic='/other'), ['csv'])
    assert not there(replace(settings, window=0.3), ['csv'])
    with scene.open('a') as file:
        file.write('# changed\n')
    assert not there(settings, ['csv'])
    replay_bag(Job(bag, out, settings, ['csv']))
    assert there(settings, ['csv'])
    os.utime(bag, ns=(0, 0))
    assert not there(settings, ['csv'])
    replay_bag(Job(bag, out, settings, ['csv']))
    for text in ('', '[]', '{"made_of": 1}', '{"made_of": [], "row": 5}'):
        next(out.glob('*.json')).write_text(text)
        assert not there(settings, ['csv'])


def bag_and_folder(simulated: Simulated, tmp_path: Path) -> tuple[str, Path]:
    """A short bag, and an empty folder for its results."""
    out = tmp_path / 'out'
    out.mkdir()
    bag = link(simulated('cardan', rate=100, duration=0.6), tmp_path / 'run.mcap')[0]
    return str(bag), out


def test_results_of_other_settings_are_none_of_these(simulated: Simulated, tmp_path: Path) -> None:
    bag, out = bag_and_folder(simulated, tmp_path)
    other = replace(SETTINGS, window=0.3)
    replay_bag(Job(bag, out, SETTINGS, ['csv']))
    row = replay_bag(Job(bag, out, other, ['mcap']))
    # The table is there, but of settings that are no longer.
    assert row['results'].endswith('.mcap')
    assert finished(Job(bag, out, other, ['csv'])) is None
    assert finished(Job(bag, out, other, ['mcap'])) == row
    row = replay_bag(Job(bag, out, other, ['csv']))
    assert [name[-4:] for name in row['results'].split()] == ['mcap', '.csv']
    assert finished(Job(bag, out, other, ['csv', 'mcap'])) == row
    replay_one(bag, other, csv=tmp_path / 'one.csv', whole=True)
    assert next(out.glob('*.csv')).read_bytes() == (tmp_path / 'one.csv').read_bytes()


def test_results_that_are_exchanged_in_part_are_not_finished(
    simulated: Simulated, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag, out = bag_and_folder(simulated, tmp_path)
    row = replay_bag(Job(bag, out, SETTINGS, ['csv', 'mcap']))
    assert finished(Job(bag, out, SETTINGS, ['csv', 'mcap'])) == row
    with monkeypatch.context() as broken:
        # A stop between the names, as a kill would have it, has no error of ours.
        broken.setattr(_jobs, 'whole_file', lambda *_: 1 / 0)
        replay_bag(Job(bag, out, replace(SETTINGS, window=0.3), ['csv', 'mcap']))
    assert finished(Job(bag, out, SETTINGS, ['csv', 'mcap'])) is None


def test_runs_into_one_folder_take_turns_at_a_bag(
    simulated: Simulated, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag, out = bag_and_folder(simulated, tmp_path)
    begun, go = threading.Event(), threading.Event()
    rows: list[dict[str, Any]] = []

    def replay_when_told(*args: Any, **options: Any) -> Any:
        assert not begun.is_set(), 'replayed twice, or by two at once'
        begun.set()
        assert go.wait(60)
        return replay_into(*args, **options)

    def one_run() -> None:
        rows.append(replay_bag(Job(bag, out, SETTINGS, ['csv'])))

    monkeypatch.setattr(_jobs, 'replay_into', replay_when_told)
    runs = [threading.Thread(target=one_run) for _ in range(2)]
    for run_ in runs:
        run_.start()
    assert begun.wait(60)
    # One that is stopped now does not clean up after the one at work.
    with (
        pytest.raises(BlockingIOError),
        _jobs.alone(Job(bag, out, SETTINGS, []), wait=False),
    ):
        pass
    go.set()
    for run_ in runs:
        run_.join(60)
    assert rows[0] == rows[1]
    assert rows[0]['error'] == ''
    assert not list(out.glob('*.part'))


def test_a_bag_of_a_long_name_has_results(simulated: Simulated, tmp_path: Path) -> None:
    bag = link(simulated('cardan', rate=100, duration=0.6), tmp_path / f'{"x" * 250}.mcap')[0]
    (tmp_path / 'out').mkdir()
    assert replay_bag(Job(str(bag), tmp_path / 'out', SETTINGS, ['parquet']))['error'] == ''


def test_what_cannot_be_used_is_one_line(
    simulated: Simulated,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    bag = str(simulated('cardan', rate=100, duration=0.3))
    (tmp_path / 'file').write_text('')
    monkeypatch.chdir(tmp_path)
    for words, complaint in (
        (['--output', 'file'], 'file cannot be written: '),
        (['--workers', '0'], '--workers is 0; it must be 1 or more'),
        (['--workers', '1', '--scheduler', 'tcp://x:1'], 'leave it out with --scheduler'),
        (['--config', 'none.yaml'], 'none.yaml'),
        (['--tls-ca', 'ca.pem'], 'are for a cluster; give --scheduler too'),
    ):
        assert main(['batch', bag, *words]) == 2
        line = capsys.readouterr().err
        assert line.count('\n') == 1
        assert complaint in line
    with monkeypatch.context() as read_only:
        refused = OSError(errno.EROFS, 'Read-only file system')
        read_only.setattr(_folder, 'TemporaryFile', mock.Mock(side_effect=refused))
        assert main(['batch', bag, '--output', 'out']) == 2
    line = capsys.readouterr().err
    assert f'{tmp_path}/out cannot be written: Read-only file system; fix: ' in line
    assert line.count('\n') == 1
    (tmp_path / 'summary.csv').mkdir()
    with pytest.raises(BagError, match=r'summary\.csv cannot be written: Is a directory'):
        _folder.write_summary(tmp_path / 'summary.csv', [])
    assert not list(tmp_path.glob('*.part'))
    with monkeypatch.context() as crowded:
        failed = OSError(errno.EAGAIN, 'Resource temporarily unavailable')
        crowded.setattr(_workers._CONTEXT, 'Process', mock.Mock(side_effect=failed))
        assert main(['batch', bag]) == 2
        line = capsys.readouterr().err
        assert 'no worker processes can be started ([Errno 11] Resource temporarily' in line
        assert line.count('\n') == 1


def test_without_dask_bags_are_replayed_one_after_another(
    simulated: Simulated,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    bag = simulated('cardan', rate=100, duration=0.3)
    monkeypatch.setitem(sys.modules, 'distributed', None)
    monkeypatch.setitem(sys.modules, 'dask', None)
    (row,) = batch([bag], tmp_path / 'here', SETTINGS)
    assert row['error'] == ''
    assert not caplog.messages
    bags = link(bag, tmp_path / 'a.mcap', tmp_path / 'b.mcap')
    assert [row['error'] for row in batch(bags, tmp_path / 'here', SETTINGS, workers=2)] == ['', '']
    (said,) = caplog.messages
    assert said.endswith('uses all cores, is not installed; fix: pip install dask fsspec')
    with pytest.raises(
        BagError, match=r'^--scheduler needs Dask; fix: pip install dask distributed'
    ):
        batch([bag], tmp_path / 'there', SETTINGS, cluster=Cluster('tls://x:1'))


def test_what_makes_results_worse_is_reported_and_kept_in_the_summary(
    simulated: Simulated, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = simulated('four_bar', rate=100, duration=1.5)
    assert main(['batch', str(bag), '--output', str(tmp_path / 'links')]) == 0
    assert f'{bag}: body: its markers are' in capsys.readouterr().err
    (row,) = summary(tmp_path / 'links')
    assert 'off one rigid body' in row['warnings']


def test_a_body_known_at_no_instant_is_status_2_and_in_the_summary(
    simulated: Simulated, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = simulated('four_bar', rate=100, duration=0.6)
    bodies = {'crank': bodies_of('four_bar')['crank'], 'rocker': ('rokcer_1', 'rokcer_2')}
    config = write_config(tmp_path / 'rig.yaml', Settings(bodies=bodies))
    out = tmp_path / 'out'
    for _ in range(2):  # made, and found there
        assert main(['batch', str(bag), '--config', str(config), '--output', str(out)]) == 2
        said, complaints = capsys.readouterr()
        assert said.startswith('1 bags, 0 failed, 0 cut off, 1 never estimated a body; 60 frames')
        assert "messages lack 'rokcer_1', 'rokcer_2' of rocker" in complaints
        (row,) = summary(out)
        assert (row['error'], row['unknown']) == ('', 'rocker')


def test_results_among_the_bags_are_no_bags(simulated: Simulated, tmp_path: Path) -> None:
    bag = simulated('cardan', rate=100, duration=0.6)
    # A name that is no text costs nothing either.
    odd = os.fsdecode(b'no text \xff.mcap')
    link(bag, tmp_path / 'run.mcap', tmp_path / odd)

    def every_bag() -> list[Path]:
        return sorted(tmp_path.glob('*.mcap'))

    rows = batch(every_bag(), tmp_path, SETTINGS, workers=1)
    assert {Path(row['bag']).name: row['error'] for row in rows} == {'run.mcap': '', odd: ''}
    assert len(every_bag()) == 4
    before = files(tmp_path)
    assert batch(every_bag(), tmp_path, SETTINGS) == rows
    assert files(tmp_path) == before
    assert [row['bag'].replace('\udcff', '\\udcff') for row in rows] == [
        row['bag'] for row in summary(tmp_path)
    ]
    with pytest.raises(BagError, match='all bags named are results of earlier runs in'):
        batch([path for path in every_bag() if '-' in path.name], tmp_path, SETTINGS)
    # A bag is not what merely lies beside a file of notes.
    (tmp_path / 'run.json').write_text('{"row": "by hand"}')
    assert batch(every_bag(), tmp_path, SETTINGS) == rows


def test_results_do_not_become_a_part_of_the_folder_they_are_of(
    simulated: Simulated, tmp_path: Path
) -> None:
    link(simulated('cardan', rate=100, duration=0.6), tmp_path / 'runs' / 'run.mcap')
    with pytest.raises(BagError, match=r'runs is a bag to be replayed, .* another folder'):
        batch([tmp_path / 'runs'], tmp_path / 'runs', Settings())
    assert [path.name for path in (tmp_path / 'runs').iterdir()] == ['run.mcap']


def test_progress_goes_by_bytes_within_bags_and_over_what_is_left(
    simulated: Simulated, tmp_path: Path
) -> None:
    bag = simulated('cardan', rate=500, duration=2)
    short = simulated('cardan', rate=100, duration=0.6)
    told: list[float] = []
    batch([bag], tmp_path, SETTINGS, workers=1, progress=told.append)
    assert told == sorted(told)
    assert (told[0], told[-1]) == (0.0, 1.0)
    assert len(told) > 3

    told.clear()
    batch([bag, short], tmp_path, SETTINGS, workers=1, progress=told.append)
    assert (told[0], told[-1]) == (0.0, 1.0)  # what was finished before is none of it


def test_progress_is_of_all_bags_by_their_bytes_and_never_goes_back() -> None:
    told: list[float] = []
    share = module._share_of_all([300, 100], told.append, threading.Lock())
    share(0, 0.5)
    share(0, 1.0)
    share(0, 0.9)  # told before the end, arrived after it
    share(1, 1.0)
    assert told == [0.0, 0.375, 0.75, 1.0]


def test_a_summary_that_does_not_fit_the_disk_leaves_the_one_before(tmp_path: Path) -> None:
    path = tmp_path / 'summary.csv'
    _folder.write_summary(path, [{'bag': 'a', 'error': ''}])
    before = path.read_bytes()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, hard))
    try:
        with pytest.raises(BagError, match='cannot be written: File too large; fix'):
            _folder.write_summary(path, [{'bag': 'b', 'error': ''}])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)
    assert [(file.name, file.read_bytes()) for file in tmp_path.iterdir()] == [
        ('summary.csv', before)
    ]


def test_on_windows_a_lock_is_asked_for_until_it_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tried with what Windows has taken for it: it raises PermissionError where another has it."""
    asked: list[int] = []

    class Windows:
        LK_NBLCK = 2

        @staticmethod
        def locking(number: int, mode: int, size: int) -> None:
            asked.append(number)
            if len(asked) % 3:
                raise PermissionError(13, 'Permission denied')

    monkeypatch.setattr(_writing, '_fcntl', None)
    monkeypatch.setattr(_writing, '_msvcrt', Windows)
    monkeypatch.setattr(_writing, '_RETRY_INTERVAL', 0.0)
    with open(tmp_path / 'held', 'ab') as held:
        _writing.lock(held, wait=True)
        assert asked == [held.fileno()] * 3
        with pytest.raises(BlockingIOError):
            _writing.lock(held, wait=False)


def test_bags_are_named_by_a_file_too(
    simulated: Simulated, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, 'replay_in_processes', in_turn)
    bag = simulated('cardan', rate=100, duration=0.3)
    named = link(bag, tmp_path / 'a.mcap', tmp_path / 'b c.mcap')
    names = tmp_path / 'names.txt'
    names.write_text(f'# of monday\n{named[0]}\n\n  {named[1]}  \r\n{named[0]}\n')
    assert main(['batch', '--list', str(names), '--output', str(tmp_path / 'out')]) == 0
    assert [row['bag'] for row in summary(tmp_path / 'out')] == [str(path) for path in named]


def test_a_list_without_bags_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'names.txt').write_text('# none\n\n')
    os.mkfifo(tmp_path / 'fifo')
    for words, complaint in (
        ([], 'no bags are named; give some, or a file that names them by --list'),
        (['--list', str(tmp_path / 'names.txt')], 'names no bags; fix: '),
        (['--list', str(tmp_path / 'none.txt')], 'cannot be read: No such file'),
        (['--list', str(tmp_path / 'fifo')], 'cannot be read: it is not a regular file'),
    ):
        assert main(['batch', *words]) == 2
        line = capsys.readouterr().err
        assert complaint in line
        assert line.count('\n') == 1


def test_results_of_very_many_bags_lie_in_folders_and_are_found_where_they_were(
    simulated: Simulated, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = simulated('cardan', rate=100, duration=0.3)
    bags = link(bag, *(tmp_path / f'{name}.mcap' for name in 'abc'))
    out = tmp_path / 'out'
    monkeypatch.setattr(module, 'replay_in_processes', in_turn)
    (flat,) = batch(bags[:1], out, SETTINGS)
    monkeypatch.setattr(_folder, '_MOST_IN_FOLDER', 2)
    rows = batch(bags, out, SETTINGS)
    assert rows[0] == flat
    for row in rows[1:]:
        shard, _, name = row['results'].partition('/')
        assert shard == name.removesuffix('.mcap')[-10:-8]
        assert (out / row['results']).is_file()
    written = {path: path.stat().st_mtime_ns for path in out.rglob('*.mcap')}
    assert len(written) == 3
    # Fewer again, and results among the bags: nothing is made anew.
    assert batch(bags[1:], out, SETTINGS) == rows[1:]
    assert batch([*bags, *written], out, SETTINGS) == rows
    assert {path: path.stat().st_mtime_ns for path in out.rglob('*.mcap')} == written
    assert not list(out.rglob('*.part'))


def test_bags_and_results_may_be_in_a_store(
    simulated: Simulated, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fsspec = pytest.importorskip('fsspec')
    store = fsspec.filesystem('memory')
    bag = simulated('cardan', rate=100, duration=0.3)
    store.pipe('/lab/runs/one.mcap', bag.read_bytes())
    store.pipe('/lab/runs/two/part_0.mcap', bag.read_bytes())
    store.pipe('/lab/runs/three.mcap', b'no bag')
    local = tmp_path / 'run.mcap'
    os.link(bag, local)
    names = ['memory://lab/runs/one.mcap', 'memory://lab/runs/two', local.as_uri()]
    rows = batch([*names, 'memory://lab/runs/three.mcap'], 'memory://lab/out', SETTINGS)
    assert [row['bag'] for row in rows[:3]] == [*names[:2], str(local)]
    replay_one(bag, SETTINGS, tmp_path / 'one.mcap', whole=True)
    expected = decoded(tmp_path / 'one.mcap')
    for row in rows[:3]:
        (tmp_path / 'got.mcap').write_bytes(store.cat(f'/lab/out/{row["results"]}'))
        assert decoded(tmp_path / 'got.mcap') == expected
    assert 'is not an MCAP file' in rows[3]['error']
    assert store.cat('/lab/out/summary.csv').decode().count('\n') == 5

    # Again: what is there is not made anew, but of a bag that changed.
    monkeypatch.setattr(module, 'replay_in_processes', in_turn)
    before = {name: about['created'] for name, about in store.find('/lab/out', detail=True).items()}
    store.pipe('/lab/runs/one.mcap', bag.read_bytes())
    again = batch(names, 'memory://lab/out', SETTINGS)
    assert [row['results'] for row in again] == [row['results'] for row in rows[:3]]
    after = {name: about['created'] for name, about in store.find('/lab/out', detail=True).items()}
    made = {name for name in before if after[name] != before[name]}
    assert made == {f'/lab/out/{rows[0]["results"]}', '/lab/out/summary.csv'} | {
        f'/lab/out/{Path(rows[0]["results"]).stem}.json'
    }
    # Into a folder of this machine.
    (row,) = batch(names[:1], (tmp_path / 'out').as_uri(), SETTINGS)
    assert decoded(tmp_path / 'out' / row['results']) == expected
    (row,) = batch(['memory://lab/none.mcap'], tmp_path / 'out', SETTINGS)
    assert 'memory://lab/none.mcap cannot be read: No such file or folder; fix: ' in row['error']


def test_a_store_that_is_unknown_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(BagError, match='nowhere://x cannot be read: Protocol not known') as error:
        batch(['a.mcap'], 'nowhere://x', SETTINGS)
    assert str(error.value).count('\n') == 0
