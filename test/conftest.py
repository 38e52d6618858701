"""What several test files share: bags of scenes, made once, and the messages in a bag."""

import base64
import csv
import ctypes
import json
import os
import re
import shutil
import sys
import zlib
from argparse import Namespace
from array import array
from collections.abc import Callable, Iterator, Mapping
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import settings
from rclpy.serialization import deserialize_message

from kinpole_ros import messages
from kinpole_ros.bags import BagWriter, message_class, read_messages, simulate
from kinpole_ros.mechanism import load_scene
from kinpole_ros.messages import installed_class, serialize_message, type_name
from kinpole_ros.settings import Settings, load_settings
from kinpole_ros.tools.report import report
from kinpole_ros.tools.usage import parse_words

ROOT = Path(__file__).parents[1]
FOUR_BAR = ROOT / 'bags' / 'four_bar.mcap'
# Tests of films need the extra `film`.
collect_ignore_glob = [] if find_spec('av') and find_spec('cv2') else ['film/*']

# Whether rclpy can send frames.
WITH_TF = find_spec('tf2_msgs') is not None

# Nodes of the tests meet nobody else's, nor those of another run on this machine. From domain 102
# on, the ports are among those that the kernel gives to anybody, and nodes may miss each other.
os.environ['ROS_DOMAIN_ID'] = str(1 + os.getpid() % 90)
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'

# An example that takes long on a busy machine is no fault of what is tested. `make test` tries the
# same examples each time, so that what fails is the change's fault; `make fuzz` tries others.
settings.register_profile('same', deadline=None, derandomize=True, max_examples=15)
settings.register_profile('fuzz', deadline=None)
settings.load_profile(os.environ.get('HYPOTHESIS_PROFILE', 'same'))


# Tests that `make test` leaves out, the cases of them that it keeps, and what covers the others.
THOROUGH = Path(__file__).with_name('thorough.csv')


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption('--thorough', action='store_true', help='also the tests of thorough.csv')


def thorough_tests() -> dict[str, list[str]]:
    """Names of tests, and for each the cases that are kept, in which * is any text."""
    with THOROUGH.open(newline='') as file:
        return {row['test']: row['kept'].split(' | ') for row in csv.DictReader(file)}


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is thorough, unless it is asked for, or a test is named."""
    if config.getoption('--thorough') or any('::' in str(word) for word in config.args):
        return
    tests = thorough_tests()
    unknown = {(name, case) for name, cases in tests.items() for case in cases}
    left_out = []
    for item in items:
        name, bracket, case = item.nodeid.removeprefix('test/').partition('[')
        fitting = [
            one
            for one in tests.get(name, ['*'])
            if re.fullmatch(re.escape(one).replace(r'\*', '.*'), bracket + case)
            and (one or bracket)
        ]
        unknown -= {(name, one) for one in fitting or ['']}
        if not fitting:
            left_out.append(item)
    if unknown and config.args == config.getini('testpaths'):
        raise pytest.UsageError(f'{THOROUGH.name} names cases that are not there: {unknown}')
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if item not in {*left_out}]


@pytest.hookimpl(optionalhook=True)  # Without the plugin there are no workers.
def pytest_xdist_auto_num_workers() -> int:
    """One more than there are cores: live tests wait most of their time."""
    return (os.cpu_count() or 1) + 1


def shared_folder(factory: pytest.TempPathFactory, name: str) -> Path:
    """A folder that all workers of a run have in common."""
    base = factory.getbasetemp()
    folder = (base.parent if 'PYTEST_XDIST_WORKER' in os.environ else base) / name
    folder.mkdir(exist_ok=True)
    return folder


def made_once(path: Path, make: Callable[[Path], Any]) -> Path:
    """A file that the first worker that needs it makes; two that make it at once do no harm."""
    if not path.exists():
        part = path.parent / str(os.getpid()) / path.name
        part.parent.mkdir(exist_ok=True)
        make(part)
        part.rename(path)
    return path


@pytest.fixture(scope='module', autouse=True)
def memory_of_a_module() -> Iterator[None]:
    """
    What a module has used is given back: a worker grew to 1.2 GB, of which it used a third.

    Models of the reference alone take up to 300 MB.
    """
    yield
    for name in [name for name in sys.modules if name.startswith('derivatives_reference.')]:
        for function in vars(sys.modules[name]).values():
            if hasattr(function, 'cache_clear'):
                function.cache_clear()
    # glibc keeps what is free between what is not.
    if hasattr(libc := ctypes.CDLL(None), 'malloc_trim'):
        libc.malloc_trim(0)


@pytest.fixture(scope='session')
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """`simulated('four_bar', rate=100)` is the bag that `kinpole simulate` makes of that."""
    folder = shared_folder(tmp_path_factory, 'simulated')

    def make(scene: str | Path, **options: Any) -> Path:
        key = f'{scene} {sorted(options.items())}'
        bag = folder / f'{sha256(key.encode()).hexdigest()[:16]}.mcap'
        return made_once(bag, lambda part: simulate(load_scene(scene), part, **options))

    return make


def bodies_of(scene: str | Path) -> dict[str, tuple[str, ...]]:
    """The parameter `bodies` that fits a scene."""
    return dict(load_scene(scene).marker_names)


def options_of(command: str, *words: object, **values: Any) -> Namespace:
    """The options of `kinpole COMMAND WORDS`, with some set to values."""
    options = parse_words([command, *map(str, words)])
    assert values.keys() <= vars(options).keys()
    vars(options).update(values)
    return options


def write_config(path: Path, settings: Settings, **more: Any) -> Path:
    """A ROS 2 parameter file of these settings, and of others by name."""
    values = {
        'bodies': list(settings.bodies),
        'plane': settings.plane,
        'window': settings.window,
        'lag': settings.lag,
        **{name: {'markers': list(m)} for name, m in settings.bodies.items() if m},
        **more,
    }
    path.write_text(yaml.safe_dump({'/**': {'ros__parameters': values}}))
    return path


def decoded(bag: Path, *only: str) -> dict[str, list[Any]]:
    """The messages of a bag by topic, in order; of all topics if none is named."""
    found: dict[str, list[Any]] = {}
    for message in read_messages(bag, only or None):
        found.setdefault(message.topic, []).append(read_back(message.data, message.type_name))
    return found


def read_back(data: bytes, kind: str) -> Any:
    """The message of a type, as rclpy reads it; ours, of frames where tf2_msgs is not installed."""
    if kind == 'tf2_msgs/msg/TFMessage' and not WITH_TF:
        return messages.deserialize_message(data, message_class(kind))
    return deserialize_message(data, installed_class(kind))


def ros_class(cls: Any) -> Any:
    """The class of rclpy of a type of messages, of which `cls` is a class."""
    return installed_class(type_name(cls)) if hasattr(cls, '__msgtype__') else cls


def sent(message: Any) -> Any:
    """What rclpy publishes of a message: one of ours as bytes."""
    return serialize_message(message) if hasattr(message, '__msgtype__') else message


def stamp_of(message: Any) -> int:
    """Stamp in ns of a message, of its first marker if it is an array of them."""
    if not hasattr(message, 'header'):
        (message, *_) = message.markers if hasattr(message, 'markers') else message.transforms
    header = message.header
    return int(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec)


def numbers(value: Any) -> Iterator[float]:
    """Every floating-point number in a message, however deep."""
    if isinstance(value, float):
        yield value
    elif hasattr(value, 'point_step'):
        # Of clouds all fields of floating-point numbers: FLOAT32 and FLOAT64.
        data = np.frombuffer(bytes(value.data), np.uint8).reshape(value.width, -1)
        floats = {7: '<f4', 8: '<f8'}
        for field in value.fields:
            if kind := floats.get(field.datatype):
                own = data[:, field.offset : field.offset + np.dtype(kind).itemsize]
                yield from own.copy().view(kind).ravel().tolist()
    elif isinstance(value, list | tuple | array | np.ndarray):
        for item in value:
            yield from numbers(item)
    else:
        names = getattr(value, '__dataclass_fields__', None) or getattr(value, '__slots__', ())
        for name in names:
            if name != '_check_fields':
                yield from numbers(getattr(value, name))


def figures(messages: Mapping[str, list[Any]]) -> dict[str, dict[int, np.ndarray]]:
    """
    Numbers of the results under /kinpole/ by topic and stamp, less the exact ones.

    A recorder also hears what the node sends to pages and, if it is early, its transitions.
    """
    others = ('/truth/', '/transition_event', '/view', '/rig')
    return {
        topic: {stamp_of(message): np.array(list(numbers(message))) for message in listed}
        for topic, listed in messages.items()
        if topic.startswith('/kinpole/') and not any(other in topic for other in others)
    }


def assert_alike(
    found: Mapping[str, Mapping[int, np.ndarray]],
    expected: Mapping[str, Mapping[int, np.ndarray]],
    rtol: float = 1e-9,
    atol: float = 1e-12,
) -> None:
    """The same topics with the same stamps and, nearly, figures."""
    assert sorted(found) == sorted(expected)
    for topic, values in expected.items():
        assert list(found[topic]) == list(values), topic
        for stamp, value in values.items():
            np.testing.assert_allclose(
                found[topic][stamp], value, rtol, atol, err_msg=f'{topic} at {stamp} ns'
            )


def title_of(figure: Any) -> str:
    """The title over all of a matplotlib figure, which has `get_suptitle` from 3.8 on."""
    return str(figure._suptitle.get_text())


@pytest.fixture(scope='session')
def four_bar_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a four-bar."""
    # No name that HTML or a regular expression would take for something else.
    output = shared_folder(tmp_path_factory, 'report') / 'four <b>bar.html'
    configuration = load_settings(ROOT / 'config' / 'four_bar.yaml')
    return made_once(output, lambda part: report(FOUR_BAR, part, configuration))


@pytest.fixture(scope='session')
def gappy_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The markers of the four-bar without 170 frames, and without one more."""
    bag = tmp_path_factory.mktemp('gappy') / 'gappy.mcap'
    with BagWriter(bag) as writer:
        for k, message in enumerate(read_messages(FOUR_BAR, ['/markers'])):
            if not 100 <= k < 270 and k != 300:
                cls = message_class(message.type_name)
                writer.write_raw('/markers', cls, message.data, message.log_time)
    return bag


def data_of(page: Path) -> dict[str, Any]:
    """The data in a page."""
    (text,) = re.findall(r'<script id="data"[^>]*>([^<]*)</script>', page.read_text())
    data: dict[str, Any] = json.loads(zlib.decompress(base64.b64decode(text)))
    return data


def browser_path() -> str:
    names = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable')
    found = [path for name in names if (path := shutil.which(name))]
    if not found:
        pytest.skip(f'no browser: none of {", ".join(names)} is installed')
    return found[0]


@pytest.fixture(scope='module')
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')
    path = browser_path()
    with playwright.sync_playwright() as driver:
        # As root, as in containers, it runs without a sandbox only.
        browser = driver.chromium.launch(executable_path=path, args=['--no-sandbox'])
        yield browser
        browser.close()


def polylines(path: Path) -> list[tuple[str, bool, np.ndarray]]:
    """Layer, whether closed, and points (n,) of each polyline of a DXF file, R12."""
    rows = path.read_text(encoding='ascii').splitlines()
    pairs = list(zip(map(int, rows[::2]), rows[1::2], strict=True))
    assert pairs[-1] == (0, 'EOF')
    found: list[tuple[str, bool, list[complex]]] = []
    kind, last = '', {}
    for code, value in [*pairs, (0, '')]:
        if code == 0:
            if kind == 'POLYLINE':
                found.append((last[8], last[70] == '1', []))
            elif kind == 'VERTEX':
                found[-1][2].append(complex(float(last[10]), float(last[20])))
            kind, last = value, {}
        last[code] = value
    return [(layer, closed, np.array(points)) for layer, closed, points in found]
