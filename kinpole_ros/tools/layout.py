"""
Layouts of other viewers for the topics of a rig: Foxglove or Lichtblick, and PlotJuggler.

Made of the parameters or of a bag of results, so every curve has its topic.
"""

import json
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.bags import NODE_NAME, BagError, in_place_of, read_messages, topics
from kinpole_ros.messages import COLORS, DRAWING, outputs_of, theory_of, type_name
from kinpole_ros.tools.plot import bodies_of, decode, plane_of_motion, row_of
from kinpole_ros.tracking.estimate import POLE_NAMES, RATE_NAMES, measured_pairs
from kinpole_ros.tracking.parameters import Settings, load_settings
from kinpole_ros.tracking.plane import XY, plane_of

Json = dict[str, Any]
_JOINTS = '/joint_states'
_UNITS = ('rad/s', 'rad/s²', 'rad/s³', 'rad/s⁴')
# Of the camera, degrees from the z axis and about it, to look along the normal.
_VIEWS = {'x': (90.0, 90.0), 'y': (90.0, 180.0), 'z': (0.0, 0.0)}


class Shown(NamedTuple):
    """
    What there is to show: topics of a `node` by full name, with types, and its bodies and joints.

    `axis` is that of the frame which the normal of the plane is nearest to, `frame` that of the
    markers, '' where it is not known.
    """

    node: str
    kinds: Mapping[str, str]
    bodies: Sequence[str]
    joints: Sequence[str]
    axis: str
    frame: str

    def curves(self) -> dict[str, list[tuple[str, str, str]]]:
        """By title, (label, topic, color) of vectors whose part along the normal is drawn."""
        found: dict[str, list[tuple[str, str, str]]] = {}
        own = [(body, body) for body in self.bodies]
        pairs = [
            (f'{self.bodies[j]} wrt {self.bodies[i]}', f'{self.bodies[j]}/wrt/{self.bodies[i]}')
            for i, j in measured_pairs(len(self.bodies))
        ]
        colors = {label: self.color(n) for n, (label, _) in enumerate(own + pairs)}
        parts = [(name, unit, own) for name, unit in zip(RATE_NAMES, _UNITS, strict=True)]
        parts.insert(2, ('angular_velocity', f'{_UNITS[0]}, relative', pairs))
        for name, unit, subjects in parts:
            rows = [
                (f'{label}{suffix}', topic, colors[label])
                for label, subject in subjects
                for suffix, end in (('', ''), (' 1σ', '/deviation'))
                if (topic := f'{self.node}/{subject}/{name}{end}') in self.kinds
            ]
            if rows:
                found[f'{name.replace("_", " ")} ({unit})'] = rows
        return found

    @staticmethod
    def color(number: int) -> str:
        """That in which the body of this number is drawn."""
        red, green, blue = (round(255 * part) for part in COLORS[number % len(COLORS)])
        return f'#{red:02x}{green:02x}{blue:02x}'


def shown_of(config: str | None) -> Shown:
    """
    What a parameter file has published, or a bag of results holds; without either, the defaults.

    Raises ParameterError as reading one does, and BagError as reading the other.
    """
    if config and (Path(config).is_dir() or config.endswith('.mcap')):
        return _of_bag(config)
    settings = load_settings(config) if config else Settings()
    node = f'/{NODE_NAME}'
    kinds = {
        output.under(node): type_name(output.message_type)
        for output in outputs_of(settings, theory_of(settings))
    }
    normal = (plane_of(settings.plane) or XY).normal
    bodies, joints = tuple(settings.bodies), tuple(settings.joints)
    return Shown(node, kinds, bodies, joints, _axis(normal), '')


def _of_bag(bag: str) -> Shown:
    kinds = topics(bag)
    splits = (topic.rsplit('/', 2) for topic in kinds)
    nodes = [parts[0] for parts in splits if parts[0] and parts[-1] == 'odom']
    nodes = sorted({node for node in nodes if not node.endswith('/truth')})
    if not nodes:
        raise BagError(f'{bag} holds no results; make them first: kinpole replay {bag} --output R')
    node = nodes[0]
    bodies = bodies_of(node, kinds)
    poses = [f'{node}/{body}/odom' for body in bodies]
    axis, frame, joints = 'z', '', []
    for message in read_messages(bag, poses):
        pose = decode(message.type_name, message.data)
        frame = pose.header.frame_id
        axis = _axis(plane_of_motion(np.array([row_of(message.type_name, message.data)])).normal)
        break
    for message in read_messages(bag, [node + _JOINTS]):
        joints = list(decode(message.type_name, message.data).name)
        break
    return Shown(node, kinds, bodies, joints, axis, frame)


def _axis(normal: np.ndarray) -> str:
    return 'xyz'[int(np.abs(normal).argmax())]


def foxglove(shown: Shown) -> str:
    """A layout for Foxglove and Lichtblick: JSON, as they save it."""
    phi, theta = _VIEWS[shown.axis]
    drawing = f'{shown.node}/{DRAWING}'
    panels: dict[str, Json] = {
        '3D!kinpole': {
            'cameraState': {
                'perspective': False,
                'distance': 1.5,
                'phi': phi,
                'thetaOffset': theta,
                'target': [0, 0, 0],
                'targetOffset': [0, 0, 0],
                'targetOrientation': [0, 0, 0, 1],
                'fovy': 45,
                'near': 0.01,
                'far': 1000,
            },
            'followMode': 'follow-none',
            **({'followTf': shown.frame} if shown.frame else {}),
            'scene': {'transforms': {'axisScale': 0.1, 'showLabel': False}},
            'transforms': {},
            'topics': {drawing: {'visible': True}},
            'layers': {},
        },
        'DiagnosticSummary!kinpole': {
            'topicToRender': '/diagnostics',
            'minLevel': 0,
            'pinnedIds': [],
            'hardwareIdFilter': '',
            'sortByLevel': True,
        },
    }
    plots = []
    for number, (title, rows) in enumerate(shown.curves().items()):
        panel = f'Plot!kinpole{number}'
        plots.append(panel)
        panels[panel] = {
            # The one is Foxglove's, the other Lichtblick's.
            'foxglovePanelTitle': title,
            'lichtblickPanelTitle': title,
            'paths': [
                {
                    'value': f'{topic}.vector.{shown.axis}',
                    'label': label,
                    'enabled': True,
                    'timestampMethod': 'headerStamp',
                    'color': color,
                    'lineSize': 1 if label.endswith('σ') else 2,
                }
                for label, topic, color in rows
            ],
            'xAxisVal': 'timestamp',
            'isSynced': True,
            'showLegend': True,
            'legendDisplay': 'floating',
            'showPlotValuesInLegend': True,
            'showXAxisLabels': True,
            'showYAxisLabels': True,
            'sidebarDimension': 240,
            'followingViewWidth': 10,
        }
    left: Any = _split('column', ['3D!kinpole', 'DiagnosticSummary!kinpole'], 70)
    layout = {
        'configById': panels,
        'globalVariables': {},
        'userNodes': {},
        'playbackConfig': {'speed': 1},
        'layout': _split('row', [left, _column(plots)], 50) if plots else left,
    }
    return json.dumps(layout, indent=2, ensure_ascii=False) + '\n'


def _split(direction: str, parts: Sequence[Any], percentage: float) -> Json:
    first, second = parts
    return {'direction': direction, 'first': first, 'second': second, 'splitPercentage': percentage}


def _column(panels: Sequence[str]) -> Any:
    """Panels one under the other, equally high."""
    first, *rest = panels
    return _split('column', [first, _column(rest)], 100 / len(panels)) if rest else first


def plotjuggler(shown: Shown) -> str:
    """A layout for PlotJuggler: XML, as version 3 saves it."""
    root = ET.Element('root')
    tabs = ET.SubElement(root, 'tabbed_widget', {'name': 'Main Window', 'parent': 'main_window'})
    rates = {
        title: [(color, {'name': f'{topic}/vector/{shown.axis}'}) for _, topic, color in rows]
        for title, rows in shown.curves().items()
    }
    _add_tab(tabs, 'rates', rates, 'TimeSeries')
    across = [axis for axis in 'xyz' if axis != shown.axis]
    poles = {
        pole.upper(): [
            (
                shown.color(number),
                {
                    'name': f'{topic}/point [{body}]',
                    'curve_x': f'{topic}/point/{across[0]}',
                    'curve_y': f'{topic}/point/{across[1]}',
                },
            )
            for number, body in enumerate(shown.bodies)
            if (topic := f'{shown.node}/{body}/{pole}') in shown.kinds
        ]
        for pole in POLE_NAMES
    }
    _add_tab(tabs, 'poles', poles, 'XYPlot')
    states = shown.node + _JOINTS
    joints = {
        f'joint {what}': [('#444444', {'name': f'{states}/{joint}/{what}'})]
        for joint in shown.joints
        for what in ('position', 'velocity')
        if states in shown.kinds
    }
    _add_tab(tabs, 'joints', joints, 'TimeSeries')
    ET.SubElement(tabs, 'currentTabIndex', index='0')
    ET.SubElement(root, 'use_relative_time_offset', enabled='1')
    ET.indent(root, ' ')
    return ET.tostring(root, 'utf-8').decode() + '\n'


def _add_tab(
    tabs: ET.Element,
    title: str,
    plots: Mapping[str, Sequence[tuple[str, Mapping[str, str]]]],
    mode: str,
) -> None:
    """One more tab, of plots one under the other, if any has a curve."""
    plots = {name: curves for name, curves in plots.items() if curves}
    if not plots:
        return
    tab = ET.SubElement(tabs, 'Tab', tab_name=title, containers='1')
    container = ET.SubElement(tab, 'Container')
    sizes = ';'.join([f'{1 / len(plots):.6f}'] * len(plots))
    count = str(len(plots))
    split = ET.SubElement(container, 'DockSplitter', orientation='-', count=count, sizes=sizes)
    for name, curves in plots.items():
        area = ET.SubElement(split, 'DockArea', name=name)
        words = {'mode': mode, 'style': 'Lines', 'flip_x': 'false', 'flip_y': 'false'}
        plot = ET.SubElement(area, 'plot', words)
        ET.SubElement(plot, 'limitY')
        for color, curve in curves:
            ET.SubElement(plot, 'curve', {**curve, 'color': color})


LAYOUTS: dict[str, Callable[[Shown], str]] = {'foxglove': foxglove, 'plotjuggler': plotjuggler}


def write_layout(viewer: str, config: str | None, output: str) -> Shown:
    """Write the layout of a viewer, one of LAYOUTS; returns what it shows."""
    shown = shown_of(config)
    with in_place_of(output) as part:
        part.write_text(LAYOUTS[viewer](shown), encoding='utf-8')
    return shown
