"""All but the live node does without ROS, and gives the same to the last bit."""

import os
import subprocess
import sys
from pathlib import Path

from kinpole_ros.tools import cli

ROOT = Path(__file__).parents[1]
# What a machine without ROS has none of; a file that Python runs before all else sees to that.
HIDDEN = """
import sys

class Hidden:
    def find_spec(self, name, path=None, target=None):
        package = name.partition('.')[0]
        ros = package.startswith(('rclpy', 'ament_', 'launch', 'rosidl_', 'rpyutils'))
        if ros or package.endswith(('_msgs', '_interfaces')):
            raise ModuleNotFoundError(f'No module named {name!r}', name=name)

sys.meta_path.insert(0, Hidden())
"""

PROGRAM = """
import pkgutil, sys
from importlib import import_module
from importlib.util import find_spec

import kinpole_ros
from kinpole_ros.tools import cli
from kinpole_ros.tools.record.result_bag import read_record

for words in {words!r}:
    assert cli.main(words) == 0, words
# What plot draws is read from messages.
assert read_record({result!r}).bodies == ('crank', 'coupler', 'rocker')
# The compiled library is for ctypes, and no module.
# Films need an extra.
unneeded = ('kinpole_ros.ros', *(() if find_spec('cv2') else ('kinpole_ros.film',)))
others = 'kinpole_ros.tools.demo', 'kinpole_ros._compiled'
for module in pkgutil.walk_packages(kinpole_ros.__path__, 'kinpole_ros.'):
    if not module.name.startswith(unneeded) and module.name not in others:
        import_module(module.name)
assert 'rclpy' not in sys.modules
"""


def without_ros(folder: Path, words: list[list[str]], result: str) -> None:
    """Run commands, then read the bag `result`, in a process that finds no ROS."""
    (folder / 'sitecustomize.py').write_text(HIDDEN)
    program = PROGRAM.format(words=words, result=result)
    path = os.pathsep.join(filter(None, [str(folder), str(ROOT), os.environ.get('PYTHONPATH')]))
    done = subprocess.run(
        [sys.executable, '-c', program],
        cwd=folder,
        env={**os.environ, 'PYTHONPATH': path},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr


def test_every_command_but_the_live_ones_gives_the_same_without_ros(tmp_path: Path) -> None:
    (tmp_path / 'table.csv').write_text('t,a_x,a_y,b_x,b_y\n0,0,0,1,0\n0.1,0,0,1,0.1\n')
    config = str(ROOT / 'config' / 'four_bar.yaml')
    runs = {}
    for name in ('with', 'without'):
        folder = tmp_path / name
        run, clouds, result, table = (
            str(folder / file) for file in ('run.mcap', 'cloud.mcap', 'result.mcap', 'result.csv')
        )
        four_bar = ['simulate', 'four_bar', '--duration', '0.7', '--noise', '2e-4', '--output']
        spoiled = ['--tilt', '10', '--unlabeled', '--message', 'point_cloud2']
        runs[name] = [
            [*four_bar, run],
            [*four_bar, clouds, *spoiled],
            ['replay', run, '--config', config, '--output', result, '--csv', table],
            ['import', str(tmp_path / 'table.csv'), '--output', str(folder / 'imported.mcap')],
        ]
    more = [
        ['discover', run, '--output', str(folder / 'rig.yaml')],
        ['solve', 'four_bar', '--at', '45 deg', '--centers'],
    ]
    without_ros(tmp_path, [*runs['without'], *more], result)
    for words in runs['with']:
        assert cli.main(words) == 0, words
    for file in ('result.csv', 'result.mcap', 'run.mcap', 'cloud.mcap', 'imported.mcap'):
        ours, other = (tmp_path / name / file for name in ('without', 'with'))
        assert ours.read_bytes() == other.read_bytes(), file
    assert (folder / 'rig.yaml').is_file()
