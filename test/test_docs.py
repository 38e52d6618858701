"""
The code blocks of README, quickstart, tutorials, how-to pages and others work as shown.

The blocks of a page run in order, in a new folder. A block of text is output of the commands
between it and the block of text before, to the last digit that it shows. Live commands run for the
live tutorial only. On other pages, and for commands of ROS installations, the names in the command
are checked. Requests of `ros2` to an inactive node go to a node in this process.
"""

import glob
import os
import re
import runpy
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy
import yaml
from rcl_interfaces.srv import SetParameters
from rclpy.lifecycle import TransitionCallbackReturn
from test_node import ask_to_set

from kinpole_ros.mechanism import load_scene
from kinpole_ros.messages import result_outputs
from kinpole_ros.ros.node import KinpoleNode
from kinpole_ros.settings import (
    NODE_PARAMETERS,
    OWN_PARAMETERS,
    PARAMETERS,
    RUNNING,
    load_settings,
    settings_from,
)
from kinpole_ros.tools.cli import main
from kinpole_ros.tools.usage import make_parser

ROOT = Path(__file__).parents[1]
DOCS = ROOT / 'docs'
LIVE = DOCS / 'tutorial_live.md'
PAGES = [
    ROOT / 'README.md',
    *sorted(DOCS.glob('tutorial_*.md')),
    *(DOCS / f'{name}.md' for name in ('quickstart', 'real_rigs', 'live', 'bags', 'scenes')),
    *sorted(DOCS.glob('howto/*.md')),
]
BLOCK = re.compile(r'^( *)```(\w*)\n(.*?)^\1```$', re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r'(-?\d+(\.\d+)?)(e[-+]?\d+)?')
ENDLESS = ('node', 'play', 'record', 'view')
# s, of a process that has to come up, or to end.
PATIENCE = 40


def blocks(page: Path) -> list[tuple[str, str]]:
    """Kind and text of each block, without the indent of a list."""
    found = BLOCK.findall(page.read_text('utf-8'))
    return [(kind, re.sub(f'^{indent}', '', text, flags=re.M)) for indent, kind, text in found]


def is_printed(shown: str, line: str) -> bool:
    """
    Whether a line of a page is this line of the output.

    A number may differ by one in its last digit, because machines round differently, and columns
    may have other widths.
    """
    ours, printed = ([*NUMBER.finditer(text)] for text in (shown, line))
    if NUMBER.sub('#', shown).split() != NUMBER.sub('#', line).split():
        return False
    return all(
        abs(float(a[0]) - float(b[0])) <= 1.01 * max(last_digit(a), last_digit(b))
        for a, b in zip(ours, printed, strict=True)
    )


def last_digit(number: re.Match[str]) -> float:
    """What one in the last digit of a printed number is worth."""
    _, digits, exponent = number.groups(default='')
    return float(f'1e{int(exponent[1:] or 0) - max(len(digits) - 1, 0)}')


class Reader:
    """Runs or checks the commands of a page."""

    def __init__(self, live: bool) -> None:
        self.live = live
        self.running: list[subprocess.Popen[bytes]] = []
        self.node: KinpoleNode | None = None

    def bash(self, line: str) -> None:
        words = shlex.split(line, comments=True)
        if not words:
            return
        if words[0] == 'kinpole':
            self.kinpole([w for word in words[1:] for w in (sorted(glob.glob(word)) or [word])])
        elif words[0] == 'make':
            assert re.search(rf'^{words[1]}:', (ROOT / 'Makefile').read_text(), re.M), line
        elif words[:2] == ['ros2', 'launch']:
            launch(words[2:])
        elif words[0] == 'pip':
            extras = re.findall(r'\[(.*)\]', words[2])[0].split(',')
            assert all(f"'{extra}': " in (ROOT / 'setup.py').read_text() for extra in extras)
        elif words[0] == 'sed':
            subprocess.run(line, shell=True, check=True)
        elif words[:3] == ['ros2', 'lifecycle', 'set']:
            self.change_state(words[4])
        elif words[:3] == ['ros2', 'param', 'set'] and self.node is not None:
            values = [(words[4], yaml.safe_load(words[5]))]
            assert ask_to_set(self.node, SetParameters, values).results[0].successful
        elif words[:3] == ['ros2', 'param', 'set']:
            assert PARAMETERS[words[4]].settable == RUNNING
            settings_from({words[4]: yaml.safe_load(words[5])})
        elif words[:3] == ['ros2', 'topic', 'echo']:
            outputs = result_outputs(tuple(load_settings('rig.yaml').bodies), 'xy')
            names = {output.under('/kinpole') for output in outputs}
            assert words[3] in {*names, '/diagnostics'}
        else:
            accepted = 'source .venv/bin/activate', 'python3 -m venv .venv'
            assert line in accepted, f'{line}: teach the test to check this'

    def kinpole(self, words: list[str]) -> None:
        make_parser().parse_known_args(words)
        if '--scheduler' in words:
            return  # a cluster that is elsewhere
        if words[0] not in ENDLESS:
            assert main(words) == 0, words
        elif self.live:
            # A second node takes the place of the first, which may still be starting.
            for process in [p for p in self.running if words[0] == 'node' and 'node' in p.args]:
                process.kill()
                process.wait()
                self.running.remove(process)
            command = [sys.executable, '-m', 'kinpole_ros.tools.cli', *words]
            self.running.append(subprocess.Popen(command))
            if words[0] == 'record':
                recorded(Path(words[words.index('--output') + 1]))
                self.stop(self.running.pop())
        elif '--params-file' in words:
            load_settings(words[words.index('--params-file') + 1])

    def change_state(self, transition: str) -> None:
        if self.node is None:
            rig = ('--params-file', str(ROOT / 'config' / 'four_bar.yaml'))
            rclpy.init(args=['kinpole', '--ros-args', *rig])
            self.node = KinpoleNode()
        assert getattr(self.node, f'trigger_{transition}')() == TransitionCallbackReturn.SUCCESS
        assert self.node.active == (transition == 'activate')

    @staticmethod
    def stop(process: 'subprocess.Popen[bytes]') -> None:
        """Ctrl-C."""
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0

    def close(self) -> None:
        for process in self.running:
            process.kill()
            process.wait()
        if self.node is not None:
            self.node.destroy_node()
            rclpy.try_shutdown()


def launch(words: list[str]) -> None:
    """A launch file of this package, with arguments that it declares."""
    package, file, *arguments = words
    assert package == 'kinpole_ros'
    text = (ROOT / 'launch' / file).read_text('utf-8')
    declared = set(re.findall(r"DeclareLaunchArgument\(\s*'(\w+)'", text))
    assert {argument.partition(':=')[0] for argument in arguments} <= declared


def recorded(bag: Path) -> None:
    """Wait until results are in the file."""
    deadline = time.monotonic() + PATIENCE
    while not bag.exists() or bag.stat().st_size < 100_000:
        assert time.monotonic() < deadline, 'nothing was recorded'
        time.sleep(0.05)


@pytest.fixture
def reader(
    request: pytest.FixtureRequest,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[Reader]:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('PYTHONPATH', f'{ROOT}{os.pathsep}{os.environ.get("PYTHONPATH", "")}')
    (tmp_path / 'config').symlink_to(ROOT / 'config')
    one = Reader(request.node.callspec.params['page'] == LIVE)
    yield one
    one.close()


def given(folder: Path, simulated) -> None:
    """What pages take for granted: recordings with their parameters, and a file of DeepLabCut."""
    (folder / 'runs').mkdir()
    for name in ('recording.mcap', 'runs/1.mcap'):
        bag = simulated('four_bar', rate=100.0, duration=2.0, noise=2e-4)
        (folder / name).symlink_to(bag)
    (folder / 'my_rig.yaml').symlink_to(ROOT / 'config' / 'four_bar.yaml')
    code = next(text for kind, text in blocks(DOCS / 'tutorial_spreadsheet.md') if kind == 'python')
    exec(code, {})
    (folder / 'filmDLC.csv').rename('videoDLC.csv')


def test_references_contain_every_command_topic_and_parameter() -> None:
    references = runpy.run_path(str(DOCS / '_reference.py'))['REFERENCES']
    everything = ''.join(reference() for reference in references.values())
    commands = re.findall(r'^## kinpole (\w+)', everything, re.M)
    assert {'node', 'replay', 'report', 'discover', 'fit', 'bench'} <= {*commands}
    outputs = {output.topic for output in result_outputs(('<body>',), 'xy')}
    plain = {topic for topic in outputs if not topic.endswith(('/deviation', '/with_covariance'))}
    for name in (*PARAMETERS, *plain):
        assert f'`{name}`' in everything, name
    for comment in references:
        assert any(comment in page.read_text('utf-8') for page in DOCS.glob('*.md')), comment


def test_every_option_has_a_user() -> None:
    text = (DOCS / 'interfaces.md').read_text('utf-8')
    parameters, topics, flags = re.split('^## (?:Topics|Flags).*$', text, flags=re.M)
    for name in (*PARAMETERS, *NODE_PARAMETERS, *OWN_PARAMETERS):
        assert re.search(rf'^\| `{re.escape(name)}` \| .* \|$', parameters, re.M), name
    launch = (ROOT / 'launch' / 'kinpole.launch.py').read_text('utf-8')
    for name in re.findall(r"DeclareLaunchArgument\(\s*'(\w+)'", launch):
        assert f'`{name}`' in parameters, name
    references = runpy.run_path(str(DOCS / '_reference.py'))['REFERENCES']
    for name in re.findall(r'^\| `(\S+)` ', references['<!-- every topic -->'](), re.M):
        assert f'`{name}`' in topics or f'`{name.rpartition("/")[2]}`' in topics, name
    for name in re.findall(r'^`(--[\w-]+)', references['<!-- every command -->'](), re.M):
        assert f'`{name}`' in flags, name


def slugs(page: Path) -> set[str]:
    """Return the anchors of the headings of a page, as GitHub and the site name them."""
    text = re.sub(r'^ *```.*?^ *```$', '', page.read_text('utf-8'), flags=re.M | re.S)
    headings = re.findall(r'^#+ (.*)', text, re.M)
    return {re.sub(r'[^\w -]', '', one.lower()).replace(' ', '-') for one in headings}


def test_links_lead_to_files_and_headings() -> None:
    pages = [*ROOT.glob('*.md'), *DOCS.rglob('*.md'), *(ROOT / 'examples').rglob('*.md')]
    for page in pages:
        for link in re.findall(r'\]\(([^)\s]+)\)', page.read_text('utf-8')):
            path, _, anchor = link.partition('#')
            if not path.startswith('https://'):
                target = page.parent / path if path else page
                assert target.exists(), f'{page.name}: {link}'
                assert not anchor or anchor in slugs(target), f'{page.name}: {link}'


def test_readme_and_architecture_stay_short() -> None:
    assert len((ROOT / 'README.md').read_text('utf-8').splitlines()) < 120
    assert len((DOCS / 'architecture.md').read_text('utf-8').split()) < 2500


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.stem)
def test_blocks_run(page: Path, reader: Reader, tmp_path: Path, simulated, capfd) -> None:
    if page.name in ('README.md', 'bags.md'):
        given(tmp_path, simulated)
    names: dict[str, object] = {}
    for kind, text in blocks(page):
        if kind == 'bash':
            for line in text.replace('\\\n', ' ').splitlines():
                reader.bash(line)
        elif kind == 'python':
            exec(text, names)
        elif kind == 'yaml' and (named := re.match(r'# (\S+\.yaml)', text)):
            Path(named[1]).write_text(text, 'utf-8')
        elif kind == 'yaml' and 'ros__parameters' not in text:
            load_scene(text)
        elif kind == 'yaml':
            Path('shown.yaml').write_text(text, 'utf-8')
            load_settings('shown.yaml')
        else:
            assert kind == 'text', f'{page}: say what kind of block this is: {text}'
            out = capfd.readouterr()
            printed = (out.out + out.err).splitlines()
            stale = [s for s in text.splitlines() if not any(is_printed(s, one) for one in printed)]
            assert not stale, f'{page}: not printed: {stale} but\n{out.out}{out.err}'
