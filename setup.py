"""The package as pip and colcon build it; its version is also in package.xml and __init__.py."""

import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
from glob import glob
from importlib.util import find_spec
from pathlib import Path

from setuptools import Extension, find_packages, setup
from setuptools.command.build_ext import build_ext

NAME = 'kinpole_ros'
SHARE = f'share/{NAME}'
# rclpy and its messages as wheels, for Linux on x86-64.
ROS = ['ros-jazzy-rclpy', 'ros-jazzy-common-interfaces', 'ros-jazzy-rmw-fastrtps-cpp']


# Products of complex numbers do not check for infinities: a third of the time in poles.c.
LIMITED_RANGE = '-fcx-limited-range'


def find_compiler() -> list[str]:
    """The command of a C compiler: CC, the one that built this Python, or a usual one."""
    for command in (os.environ.get('CC'), sysconfig.get_config_var('CC'), 'cc', 'gcc', 'clang'):
        if command and shutil.which(shlex.split(command)[0]):
            return shlex.split(command)
    return []


def takes(compiler: list[str], option: str, source: str) -> bool:
    """Whether a compiler knows an option; clang before 18 does not know all of them."""
    # zig finds fault with -fsyntax-only itself.
    command = [*compiler, '-Werror', option, '-E', source]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


class BuildExt(build_ext):
    """Builds a library that needs nothing of Python, so one command does on any platform."""

    def build_extension(self, ext: Extension) -> None:
        compiler = find_compiler()
        if not compiler and find_spec('ziglang'):
            # A wheel with a C compiler; for any processor, as other compilers do it, and without
            # symbols, which are a file beside the library on Windows.
            compiler = [sys.executable, '-m', 'ziglang', 'cc', '-mcpu=baseline', '-s']
        if not compiler:
            sys.exit(
                f'{NAME} has a part in C, and there is no C compiler (cc, gcc or clang) on the '
                f'PATH: install one with `{sys.executable} -m pip install ziglang`'
            )
        target = Path(self.get_ext_fullpath(ext.name))
        target.parent.mkdir(parents=True, exist_ok=True)
        options = ['-O3', '-fno-strict-aliasing', '-fvisibility=hidden', '-shared', '-fPIC']
        if takes(compiler, LIMITED_RANGE, ext.sources[0]):
            options.append(LIMITED_RANGE)
        # Those of CFLAGS go last, so they win: `make sanitize` builds with others.
        options += shlex.split(os.environ.get('CFLAGS', ''))
        command = [*compiler, *options, '-o', str(target), *ext.sources, '-lm']
        if subprocess.call(command):
            sys.exit(f'{NAME} is not built, since this failed: {shlex.join(command)}')


setup(
    name=NAME,
    version='0.1.0',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['py.typed'], f'{NAME}.tools.report': ['page/*']},
    ext_modules=[
        Extension(
            f'{NAME}._compiled',
            [
                f'{NAME}/core/src/{name}.c'
                for name in (
                    *('structs', 'memory', 'slots', 'fit', 'rejection', 'follow', 'poles'),
                    *('points', 'rows', 'joints', 'change_points'),
                    # All files of the estimator, twice.
                    *('dispatch', 'estimator', 'estimator_avx2'),
                )
            ],
            depends=glob(f'{NAME}/core/*/*.[ch]'),
        )
    ],
    cmdclass={'build_ext': BuildExt},
    # pip installs these to build with; `python setup.py`, as of colcon, would not find them.
    setup_requires=['ziglang']
    if 'setuptools.build_meta' in sys.modules and not find_compiler()
    else [],
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (SHARE, ['package.xml']),
        (f'{SHARE}/config', [*glob('config/*.yaml'), 'config/kinpole.rviz']),
        (f'{SHARE}/config/scenes', glob('config/scenes/*.yaml')),
        (f'{SHARE}/config/security', glob('config/security/*.xml')),
        (f'{SHARE}/launch', glob('launch/*.launch.py')),
        (f'{SHARE}/bags', glob('bags/*.mcap')),
    ],
    python_requires='>=3.10',
    # Message types are those of rosbags. Only the live node needs rclpy, which comes with ROS or
    # with the extra ros. `make oldest` tries these bounds.
    install_requires=[
        'lz4>=4.0.2',
        'mcap>=1.5',
        'numpy>=1.26',
        'PyYAML>=6.0.1',
        'rosbags>=0.10.8',
        'zstandard>=0.19',
    ],
    extras_require={
        'ros': ROS,
        'wheels': ROS,
        'batch': ['dask>=2023.5', 'fsspec>=2023.5'],
        'cluster': ['dask>=2023.5', 'distributed>=2023.5'],
        'bench': ['matplotlib>=3.7', 'pynumdiff>=0.3', 'scipy>=1.11'],
        'docs': ['furo>=2024.1.29', 'myst-parser>=3', 'numpydoc>=1.8', 'sphinx>=7.4'],
        'film': ['av>=17.1', 'opencv-python-headless>=4.10.0.84'],
        'formats': ['h5py>=3.8'],
        'pandas': ['pandas>=2.1'],
        'parquet': ['pyarrow>=12'],
        'plot': ['matplotlib>=3.7'],
        'test': [
            'c3d>=0.6',
            'colcon-ros>=0.4',
            'hypothesis>=6.90',
            'mcap-ros2-support>=0.5',
            'mpmath>=1.3',
            'mujoco>=3.2',
            # Fixed, since later ones find fault with what these let pass.
            'mypy==2.4.*',
            'packaging>=23',
            'playwright>=1.40',
            'pytest>=7.4',
            'pytest-xdist>=3.3',
            'ruff==0.17.*',
            'uv>=0.4',
            'yourdfpy>=0.0.56',
        ],
    },
    zip_safe=False,
    maintainer='kinpole_ros maintainers',
    maintainer_email='maintainers@users.noreply.github.com',
    description='Live planar kinematics of real mechanisms from tracked markers',
    long_description=(Path(__file__).parent / 'README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    url='https://index.ros.org/p/kinpole_ros/',
    license='Apache-2.0',
    keywords=['ROS 2', 'kinematics', 'mechanism', 'motion capture', 'centrode', 'instant center'],
    classifiers=[
        'Development Status :: 4 - Beta',
        'Intended Audience :: Science/Research',
        'Operating System :: OS Independent',
        'Programming Language :: C',
        'Programming Language :: Python :: 3 :: Only',
        *(f'Programming Language :: Python :: 3.{minor}' for minor in range(10, 15)),
        'Topic :: Scientific/Engineering :: Physics',
        'Typing :: Typed',
    ],
    entry_points={
        'console_scripts': [
            'kinpole = kinpole_ros.tools.cli:main',
            'kinpole_node = kinpole_ros.tools.cli:node',
        ],
    },
)
