"""The package as ROS, pip and colcon see it: what it declares is what it holds."""

import ast
import os
import re
import runpy
import shutil
import subprocess
import sys
import tarfile
import xml.etree.ElementTree as ET
from graphlib import TopologicalSorter
from importlib.util import find_spec
from pathlib import Path, PurePath
from types import ModuleType
from typing import Any

import pytest
import yaml

import kinpole_ros
from kinpole_ros.bags import read_messages
from kinpole_ros.mechanism import load_scene
from kinpole_ros.messages import DRAWING, _types, type_name
from kinpole_ros.settings import load_settings

ROOT = Path(__file__).parents[1]
PACKAGE_XML = ET.parse(ROOT / 'package.xml').getroot()
# Imports that are no ROS packages, and what package.xml calls them; None: no rosdep key, as
# package.xml says, or an extra.
PYTHON_PACKAGES = {
    # Ours, beside the package.
    'bench': None,
    'derivatives_reference': None,
    'c3d': None,
    'av': None,
    'cv2': None,
    'dask': None,
    'distributed': None,
    'fsspec': None,
    'h5py': None,
    'lz4': None,
    'matplotlib': None,
    'hypothesis': 'python3-hypothesis',
    'mcap': None,
    'mpmath': 'python3-mpmath',
    'numpy': 'python3-numpy',
    'packaging': 'python3-packaging',
    'pandas': None,
    'pyarrow': None,
    'pytest': 'python3-pytest',
    'rosbags': None,
    'yaml': 'python3-yaml',
    'zstandard': None,
}
NOT_OURS = {
    '.venv',
    '.venv-oldest',
    '.venv-newest',
    '.git',
    'build',
    'install',
    'log',
    'out',
    '__pycache__',
}


def python_files() -> list[Path]:
    folders = [path for path in ROOT.iterdir() if path.is_dir() and path.name not in NOT_OURS]
    files = [*ROOT.glob('*.py'), *(path for folder in folders for path in folder.rglob('*.py'))]
    assert len(files) > 30
    return files


def setup_words() -> dict[str, Any]:
    """What setup.py passes to setup(), where it is written out."""
    words: dict[str, Any] = {}
    for node in ast.walk(ast.parse((ROOT / 'setup.py').read_text())):
        if isinstance(node, ast.keyword) and node.arg in ('version', 'entry_points'):
            words[node.arg] = ast.literal_eval(node.value)
    return words


def test_package_xml_is_a_manifest_of_format_3_for_ament_python():
    packages = pytest.importorskip('catkin_pkg.package')
    package = packages.parse_package(str(ROOT / 'package.xml'))
    package.validate()
    assert package.package_format == 3
    assert package.get_build_type() == 'ament_python'
    assert package.licenses == ['Apache-2.0']


# catkin_pkg uses what its docutils has grown out of.
@pytest.mark.filterwarnings('ignore::DeprecationWarning')
def test_version_is_one_in_package_xml_setup_code_and_changelog():
    versions = {PACKAGE_XML.findtext('version'), setup_words()['version'], kinpole_ros.__version__}
    versions.add(yaml.safe_load((ROOT / 'CITATION.cff').read_text())['version'])
    assert len(versions) == 1
    changelogs = pytest.importorskip('catkin_pkg.changelog')
    changelog = changelogs.get_changelog_from_path(str(ROOT / 'CHANGELOG.rst'), 'kinpole_ros')
    latest, _date, entries = next(iter(changelog.foreach_version()))
    assert {latest} == versions
    assert entries


def needed(*paths: Path) -> set[str]:
    """What package.xml must name for the imports of these files."""
    imported = set()
    for path in paths:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name.split('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                imported.add(node.module.split('.')[0])
    ours = {'kinpole_ros', *(path.stem for path in paths)}
    named = {PYTHON_PACKAGES.get(name, name) for name in imported - sys.stdlib_module_names - ours}
    return {name for name in named if name}


def declared(kind: str) -> set[str]:
    return {str(element.text) for element in PACKAGE_XML.iter(kind)}


def test_every_import_is_declared_in_package_xml():
    package = needed(*(ROOT / 'kinpole_ros').rglob('*.py'), *(ROOT / 'launch').glob('*.py'))
    assert {'rclpy', 'launch_ros', 'python3-numpy'} <= package
    # Those of rclpy are found by the names of their types.
    classes = [cls for cls in vars(_types).values() if hasattr(cls, '__msgtype__')]
    package |= {type_name(cls).partition('/')[0] for cls in classes}
    assert package == declared('exec_depend')
    tests = needed(*(ROOT / 'test').rglob('*.py'))
    assert {'rosgraph_msgs', 'python3-pytest'} <= tests
    # The pictures are drawn by an extra.
    drawn = {'python3-matplotlib'}
    assert tests - declared('exec_depend') == declared('test_depend') - drawn


def test_no_module_imports_itself_through_others():
    package = ROOT / 'kinpole_ros'
    paths = {
        '.'.join(path.relative_to(ROOT).with_suffix('').parts).removesuffix('.__init__'): path
        for path in package.rglob('*.py')
    }
    imported = {}
    for module, path in paths.items():
        nodes = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.ImportFrom)]
        names = {(n.module, f'{n.module}.{alias.name}') for n in nodes for alias in n.names}
        imported[module] = {full if full in paths else name for name, full in names}
        # All know the version of the package.
        imported[module] -= {'kinpole_ros', module}
    list(TopologicalSorter(imported).static_order())


# What the modules of each room may import of the others.
BELOW = {
    'files': set(),
    'planar': set(),
    'core': set(),
    'settings': {'files'},
    'tracking': {'settings', 'planar', 'core', 'derivatives'},
    'derivatives': {'planar', 'core'},
    'mechanism': {'files', 'planar'},
    'linkage': {'planar', 'settings', 'tracking', 'mechanism'},
    'messages': {'core', 'settings', 'tracking', 'derivatives', 'linkage'},
    'bags': {
        'files',
        'planar',
        'settings',
        'tracking',
        'derivatives',
        'mechanism',
        'linkage',
        'messages',
    },
    'film': {'files', 'bags', 'messages'},
    'ros': {'settings', 'tracking', 'linkage', 'messages', 'bags'},
    'tools': {
        'files',
        'planar',
        'settings',
        'tracking',
        'mechanism',
        'linkage',
        'messages',
        'bags',
        'film',
        'ros',
    },
}


def test_arrows_between_rooms_point_one_way():
    package = ROOT / 'kinpole_ros'
    rooms = {path.name for path in package.iterdir() if path.is_dir() and path.name[0] != '_'}
    assert rooms == set(BELOW)
    for room, below in BELOW.items():
        used = set()
        for path in (package / room).rglob('*.py'):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.ImportFrom) and (node.module or '').startswith(
                    'kinpole_ros'
                ):
                    names = [alias.name for alias in node.names]
                    used |= {*(node.module or '').split('.')[1:2]} or set(names)
        # These import nothing of the packages.
        assert used - {room, '__version__', 'findings', 'packages'} <= below, room


# Of a replay without output; each takes 3 to 60 ms to import.
UNUSED = (
    'rosbags',
    'kinpole_ros.bags.formats',
    'kinpole_ros.bags._simulate',
    'mcap.writer',
    'importlib.metadata',
    'numpy.ma',
    'numpy.random',
    'sqlite3',
)


@pytest.mark.parametrize(
    ('module', 'others'),
    [
        ('kinpole_ros.ros.node', ['kinpole_ros.bags', 'mcap', 'lz4', 'zstandard', 'rosbags']),
        ('kinpole_ros.bags', ['rclpy', 'matplotlib', *UNUSED]),
        ('kinpole_ros.api', ['kinpole_ros.bags', 'kinpole_ros.messages', 'mcap', 'rclpy']),
    ],
)
def test_linkage_and_mechanism_are_imported_with_a_scene_only(
    module: str, others: list[str]
) -> None:
    """They took half of the start of a node; neither does the start need the `others`."""
    program = f'import kinpole_ros, {module}, sys; print(*sys.modules)'
    done = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, timeout=60, check=True
    )
    loaded = set(done.stdout.split())
    assert module in loaded
    assert not loaded & {'kinpole_ros.linkage', 'kinpole_ros.mechanism', *others}


def test_the_source_distribution_holds_all_that_is_tracked(tmp_path):
    tree = tmp_path / 'kinpole_ros'
    for path in tracked():
        (tree / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / path, tree / path)
    code = f'from setuptools.build_meta import build_sdist; build_sdist({str(tmp_path)!r})'
    run([sys.executable, '-c', code], tree)
    with tarfile.open(next(tmp_path.glob('*.tar.gz'))) as archive:
        held = {str(PurePath(*PurePath(name).parts[1:])) for name in archive.getnames()}
    assert {*map(str, tracked())} - held == {'.gitignore'}


def test_every_python_file_says_first_why_it_exists():
    silent = [path for path in python_files() if not ast.get_docstring(ast.parse(path.read_text()))]
    assert silent == []


def tracked() -> list[Path]:
    """The files of the project, from its folder."""
    if not (ROOT / '.git').exists() or not shutil.which('git'):
        pytest.skip('not a git tree')
    command = ['git', '-c', f'safe.directory={ROOT}', 'ls-files', '-z']
    listing = subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout
    paths = [Path(os.fsdecode(name)) for name in listing.split(b'\0') if name]
    assert len(paths) > 30
    return [path for path in paths if (ROOT / path).is_file()]


def build_library(folder: Path, path: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run setup.py as colcon does, with the programs of one folder only."""
    for name in ('setup.py', 'README.md', *(ROOT / 'kinpole_ros').rglob('*.[ch]')):
        target = folder / (ROOT / name).relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, target)
    build = [sys.executable, 'setup.py', '-q', 'build_ext', '--build-lib', str(folder / 'lib')]
    environment = {'PATH': path, 'PYTHONPATH': str(folder), **variables}
    return subprocess.run(build, cwd=folder, env=environment, capture_output=True, text=True)


def test_a_compiler_that_fails_is_reported(tmp_path):
    assert build_library(tmp_path, os.environ['PATH'], CC='false').returncode != 0


def test_without_a_compiler_the_message_names_the_wheel_that_is_one(tmp_path):
    if find_spec('ziglang'):
        pytest.skip('ziglang is installed, so there is a compiler')
    done = build_library(tmp_path, str(tmp_path))
    assert done.returncode != 0
    assert done.stderr.endswith(f'install one with `{sys.executable} -m pip install ziglang`\n')


def test_without_a_compiler_the_wheel_ziglang_compiles(tmp_path):
    """A package in place of the wheel passes its words on to the compiler of this machine."""
    compiler = shutil.which('cc')
    if not compiler:
        pytest.skip('there is no cc')
    (tmp_path / 'ziglang').mkdir()
    (tmp_path / 'ziglang' / '__main__.py').write_text(
        'import subprocess, sys\n'
        'assert sys.argv[1:3] == ["cc", "-mcpu=baseline"]\n'
        f'sys.exit(subprocess.call(["{compiler}", "-B/usr/bin", *sys.argv[3:], "-O0"]))\n'
    )
    done = build_library(tmp_path, str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert list((tmp_path / 'lib' / 'kinpole_ros').glob('_compiled*'))


def test_pip_is_asked_for_the_wheel_where_there_is_no_compiler(tmp_path):
    code = 'from setuptools.build_meta import get_requires_for_build_wheel as r; print(r())'
    for path, asked in ((os.environ['PATH'], False), (str(tmp_path), True)):
        folder = tmp_path / str(asked)
        folder.mkdir()
        shutil.copy(ROOT / 'setup.py', folder)
        shutil.copy(ROOT / 'README.md', folder)
        (folder / 'kinpole_ros').mkdir()
        environment = {'PATH': path, 'CC': 'cc'}
        done = subprocess.run(
            [sys.executable, '-c', code],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        assert ('ziglang' in done.stdout.splitlines()[-1]) == asked


def test_the_images_are_made_of_files_that_are_there():
    copied = re.findall(r'(?m)^COPY (?!--from)(\S+) ', (ROOT / 'Dockerfile').read_text())
    assert 'requirements/demo.txt' in copied
    assert [name for name in copied if not (ROOT / name).exists()] == []


def test_set_up_shows_what_is_installed_and_fails_with_its_reason(tmp_path):
    for name in 'Makefile', 'setup.py':
        shutil.copy(ROOT / name, tmp_path)
    version = f'{sys.version_info.major}.{sys.version_info.minor}'
    install = 'INSTALL=echo Collecting numpy; until test -e go; do sleep 0.05; done; false'
    words = [
        'make',
        '--no-print-directory',
        f'PYTHON={sys.executable}',
        'LOCK=',
        'PROGRESS=0.1',
        install,
    ]
    # One that is there already is used again.
    (tmp_path / '.venv' / 'bin').mkdir(parents=True)
    (tmp_path / '.venv' / 'bin' / 'python').symlink_to(sys.executable)
    (tmp_path / '.venv' / 'pyvenv.cfg').write_text('include-system-site-packages = false\n')
    with subprocess.Popen(
        [*words, f'.venv/demo-{version}-wheels'],
        cwd=tmp_path,
        env={k: v for k, v in os.environ.items() if k != 'AMENT_PREFIX_PATH'},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith('Setting up .venv')
        # Before the installation ends, which waits for this.
        assert process.stdout.readline() == 'Collecting numpy\n'
        (tmp_path / 'go').touch()
        _, complaints = process.communicate(timeout=60)
    assert process.returncode == 2
    assert 'The installation failed' in complaints


def test_no_tracked_file_is_over_a_megabyte():
    assert [path for path in tracked() if (ROOT / path).stat().st_size > 1_000_000] == []


@pytest.mark.parametrize('scene', ['cardan', 'four_bar', 'rolling_wheel'])
def test_bags_hold_markers_and_the_exact_answer(scene):
    topics = [message.topic for message in read_messages(ROOT / 'bags' / f'{scene}.mcap')]
    assert topics.count('/markers') == 400
    answered = {topic.split('/')[3] for topic in topics if topic.startswith('/kinpole/truth/')}
    assert answered == set(load_scene(scene).markers)


class Call:
    """Stands for a class of launch: keeps what it was made with."""

    def __init__(self, *args: Any, **words: Any) -> None:
        self.args, self.words = args, words


def of_launch(monkeypatch: pytest.MonkeyPatch, module: str, *names: str) -> dict[str, type[Call]]:
    classes = {name: type(name, (Call,), {}) for name in names}
    fake = ModuleType(module)
    fake.__dict__.update(classes)
    monkeypatch.setitem(sys.modules, module, fake)
    return classes


def test_launch_file_starts_the_node_with_every_argument_it_declares(monkeypatch):
    of_launch(monkeypatch, 'launch', 'LaunchDescription')
    declare = of_launch(monkeypatch, 'launch.actions', 'DeclareLaunchArgument')
    values = of_launch(
        monkeypatch, 'launch.substitutions', 'LaunchConfiguration', 'PathJoinSubstitution'
    )
    conditions = of_launch(monkeypatch, 'launch.conditions', 'IfCondition')
    of_launch(monkeypatch, 'launch_ros', 'actions')
    nodes = of_launch(monkeypatch, 'launch_ros.actions', 'LifecycleNode', 'Node')
    of_launch(monkeypatch, 'launch_ros.substitutions', 'FindPackageShare')
    launch = runpy.run_path(str(ROOT / 'launch' / 'kinpole.launch.py'))
    entities = launch['generate_launch_description']().args[0]

    arguments = {
        e.args[0]: e.words for e in entities if isinstance(e, declare['DeclareLaunchArgument'])
    }
    (node,), (viewer,) = (
        [e.words for e in entities if isinstance(e, nodes[kind])]
        for kind in ('LifecycleNode', 'Node')
    )
    assert all(words['description'] for words in arguments.values())
    for file in (arguments['params_file']['default_value'], viewer['arguments'][1]):
        folder, name = file.args[0]
        share, config = folder.args[0]
        assert share.args == ('kinpole_ros',)
        assert (ROOT / config / name).is_file()
    load_settings(ROOT / 'config' / arguments['params_file']['default_value'].args[0][1])

    # In a namespace RViz shows what is drawn there: its file names the topic without one.
    rviz = yaml.safe_load((ROOT / 'config' / 'kinpole.rviz').read_text())
    displays = rviz['Visualization Manager']['Displays']
    (drawn,) = (each['Topic']['Value'] for each in displays if 'Topic' in each)
    assert drawn == f'/{node["name"]}/{DRAWING}'
    assert viewer['remappings'] == [(drawn, drawn[1:])]
    assert viewer['namespace'].args == node['namespace'].args

    assert node['package'] == 'kinpole_ros'
    scripts = setup_words()['entry_points']['console_scripts']
    assert node['executable'] in [script.split()[0] for script in scripts]
    params_file, parameters = node['parameters']
    ((topic, markers),) = node['remappings']
    assert topic == load_settings(ROOT / 'config' / 'kinpole.yaml').marker_topic
    used = {
        'params_file': params_file,
        'namespace': node['namespace'],
        'use_sim_time': parameters['use_sim_time'],
        'markers': markers,
        'rviz': viewer['condition'].args[0],
        'frame': viewer['arguments'][3],
    }
    assert isinstance(viewer['condition'], conditions['IfCondition'])
    assert {name: value.args for name, value in used.items()} == {n: (n,) for n in arguments}
    assert all(isinstance(value, values['LaunchConfiguration']) for value in used.values())


def run(words: list[str | Path], folder: Path) -> str:
    """Run a command as in a fresh shell; returns what it printed."""
    ours = ('COLCON', 'PYTEST')
    env = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    env['COLCON_HOME'] = str(folder / 'colcon_home')
    done = subprocess.run(words, cwd=folder, env=env, capture_output=True, text=True, timeout=400)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope='module')
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A colcon workspace with a copy of the package, built."""
    pytest.importorskip('colcon_ros')
    folder = tmp_path_factory.mktemp('workspace')
    leave = shutil.ignore_patterns(*NOT_OURS, '*.egg-info', '.*_cache', '.hypothesis')
    shutil.copytree(ROOT, folder / 'src' / 'kinpole_ros', ignore=leave)
    colcon(folder, 'build')
    return folder


def colcon(workspace: Path, *words: str) -> str:
    # Not by the name colcon, which may belong to another Python.
    code = 'import sys; from colcon_core.command import main; sys.exit(main())'
    return run([sys.executable, '-c', code, *words], workspace)


def test_colcon_installs_what_ros2_run_and_launch_look_for(workspace):
    prefix = workspace / 'install' / 'kinpole_ros'
    for script in ('kinpole', 'kinpole_node'):
        assert os.access(prefix / 'lib' / 'kinpole_ros' / script, os.X_OK)
    marker = prefix / 'share' / 'ament_index' / 'resource_index' / 'packages' / 'kinpole_ros'
    assert marker.is_file()
    share = prefix / 'share' / 'kinpole_ros'
    for folder, suffix in (('config', '.yaml'), ('launch', '.launch.py'), ('bags', '.mcap')):
        files = [path.relative_to(ROOT) for path in (ROOT / folder).rglob(f'*{suffix}')]
        assert files
        assert [path for path in files if not (share / path).is_file()] == []
    assert (share / 'package.xml').is_file()


def test_installed_command_runs_on_installed_files_alone(workspace):
    prefix = workspace / 'install' / 'kinpole_ros'
    kinpole = prefix / 'lib' / 'kinpole_ros' / 'kinpole'
    script = (
        '. install/local_setup.sh && "$0" simulate four_bar --duration 0.1 --output a.mcap && '
        '"$1" -c "from kinpole_ros.mechanism import share_folder; print(share_folder())"'
    )
    printed = run(['sh', '-c', script, kinpole, sys.executable], workspace)
    assert printed.splitlines()[-1] == str(prefix / 'share' / 'kinpole_ros')
    assert any(message.topic == '/markers' for message in read_messages(workspace / 'a.mcap'))


def test_colcon_test_finds_and_runs_the_tests(workspace):
    colcon(workspace, 'test', '--pytest-args', 'test/test_package.py', '-k', 'version')
    assert 'Summary: 1 test, 0 errors, 0 failures' in colcon(workspace, 'test-result')
