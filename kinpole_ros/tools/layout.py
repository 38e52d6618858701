"""
Layouts of other viewers for the topics of a rig: Foxglove or Lichtblick, and PlotJuggler.

They are made from the parameters or from a bag of results, so every curve has its topic.
"""

import json
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.bags import NODE_NAME, BagError, in_place_of, read_messages
from kinpole_ros.linkage.theory import load_theory
from kinpole_ros.messages import COLORS, DRAWING, RIG, outputs_of, read_rig, type_name
from kinpole_ros.settings import Settings, load_settings
from kinpole_ros.tools.record import result_bag
from kinpole_ros.tracking.plane import XY, plane_of
from kinpole_ros.tracking.values import POLE_NAMES, RATE_NAMES, measured_pairs

Json = dict[str, Any]
_JOINTS = '/joint_states'
_UNITS = ('rad/s', 'rad/s²', 'rad/s³', 'rad/s⁴')
# Angles of the camera from the z axis and about it, degrees, to look along each axis.
_CAMERA_ANGLES = {'x': (90.0, 90.0), 'y': (90.0, 180.0), 'z': (0.0, 0.0)}


class RigTopics(NamedTuple):
    """
    The topics of a `node` by full name, with their types, and its bodies and joints.

    `axis` is the axis nearest to the normal of the plane, in the `frame` of the markers ('' if
    unknown).
    """

    node: str
    kinds: Mapping[str, str]
    bodies: Sequence[str]
    joints: Sequence[str]
    axis: str
    frame: str

    def curves(self) -> dict[str, list[tuple[str, str, str]]]:
        """Return (label, topic, color) by title, of vectors along the normal."""
        bodies = [(body, body) for body in self.bodies]
        pairs = [
            (f'{self.bodies[j]} wrt {self.bodies[i]}', f'{self.bodies[j]}/wrt/{self.bodies[i]}')
            for i, j in measured_pairs(len(self.bodies))
        ]
        colors = {label: color_of(n) for n, (label, _) in enumerate(bodies + pairs)}
        plots = [(name, unit, bodies) for name, unit in zip(RATE_NAMES, _UNITS, strict=True)]
        plots.insert(2, ('angular_velocity', f'{_UNITS[0]}, relative', pairs))
        curves: dict[str, list[tuple[str, str, str]]] = {}
        for name, unit, subjects in plots:
            rows = [
                (f'{label}{suffix}', topic, colors[label])
                for label, subject in subjects
                for suffix, end in (('', ''), (' 1σ', '/deviation'))
                if (topic := f'{self.node}/{subject}/{name}{end}') in self.kinds
            ]
            if rows:
                curves[f'{name.replace("_", " ")} ({unit})'] = rows
        return curves


def color_of(number: int) -> str:
    """Return the color in which the node draws the body of this number."""
    red, green, blue = (round(255 * value) for value in COLORS[number % len(COLORS)])
    return f'#{red:02x}{green:02x}{blue:02x}'


def topics_of(config: str | None) -> RigTopics:
    """
    Return the topics of a parameter file or of a bag of results; without either, the default ones.

    Raises ParameterError or BagError if the file cannot be used.
    """
    if config and Path(config).exists() and result_bag.is_bag(config):
        return _topics_of_bag(config)
    settings = load_settings(config) if config else Settings()
    node = f'/{NODE_NAME}'
    theory = load_theory(settings) if settings.scene else None
    kinds = {
        output.under(node): type_name(output.message_type)
        for output in outputs_of(settings, theory)
    }
    axis = _nearest_axis((plane_of(settings.plane) or XY).normal)
    return RigTopics(node, kinds, tuple(settings.bodies), tuple(settings.joints), axis, '')


def _topics_of_bag(bag: str) -> RigTopics:
    kinds, (node, *_) = result_bag.require_results(bag)
    rig: dict[str, Any] | None = None
    for message in read_messages(bag, [f'{node}/{RIG}']):
        rig = read_rig(message.data)
        if rig['plane'] is not None and rig['frame_id']:
            break
    if rig is None:
        raise BagError(f'{bag}: no message on {node}/{RIG}; fix: record it with the results')
    axis = 'z' if rig['plane'] is None else _nearest_axis(np.array(rig['plane']['normal']))
    bodies = [body['name'] for body in rig['bodies']]
    return RigTopics(node, kinds, bodies, list(rig['joints']), axis, rig['frame_id'])


def _nearest_axis(normal: np.ndarray) -> str:
    return 'xyz'[int(np.abs(normal).argmax())]


def foxglove(rig: RigTopics) -> str:
    """Return a layout for Foxglove and Lichtblick: JSON, without what is a default there."""
    phi, theta = _CAMERA_ANGLES[rig.axis]
    panels: dict[str, Json] = {
        '3D!kinpole': {
            'cameraState': {
                'perspective': False,
                'distance': 1.5,
                'phi': phi,
                'thetaOffset': theta,
                'near': 0.01,
                'far': 1000,
            },
            'followMode': 'follow-none',
            **({'followTf': rig.frame} if rig.frame else {}),
            'scene': {'transforms': {'axisScale': 0.1, 'showLabel': False}},
            'topics': {f'{rig.node}/{DRAWING}': {'visible': True}},
        },
        'DiagnosticSummary!kinpole': {'topicToRender': '/diagnostics'},
    }
    plots = {
        f'Plot!kinpole{number}': _foxglove_plot(title, rows, rig.axis)
        for number, (title, rows) in enumerate(rig.curves().items())
    }
    first_column: Any = _split('column', [*panels], 70)
    columns = [first_column, _equal_column([*plots])] if plots else []
    layout = {
        'configById': panels | plots,
        'globalVariables': {},
        'userNodes': {},
        'playbackConfig': {'speed': 1},
        'layout': _split('row', columns, 50) if plots else first_column,
    }
    return json.dumps(layout, indent=2, ensure_ascii=False) + '\n'


def _foxglove_plot(title: str, rows: Sequence[tuple[str, str, str]], axis: str) -> Json:
    return {
        'foxglovePanelTitle': title,
        'lichtblickPanelTitle': title,
        'paths': [
            {
                'value': f'{topic}.vector.{axis}',
                'label': label,
                'enabled': True,
                'timestampMethod': 'headerStamp',
                'color': color,
                'lineSize': 1 if label.endswith('σ') else 2,
            }
            for label, topic, color in rows
        ],
        'showPlotValuesInLegend': True,
        'followingViewWidth': 10,
    }


def _split(direction: str, panels: Sequence[Any], percentage: float) -> Json:
    first, second = panels
    return {'direction': direction, 'first': first, 'second': second, 'splitPercentage': percentage}


def _equal_column(panels: Sequence[str]) -> Any:
    """Return panels below each other, of equal height."""
    if len(panels) == 1:
        return panels[0]
    return _split('column', [panels[0], _equal_column(panels[1:])], 100 / len(panels))


def plotjuggler(rig: RigTopics) -> str:
    """Return a layout for PlotJuggler: XML, as version 3 saves it."""
    root = ET.Element('root')
    tabs = ET.SubElement(root, 'tabbed_widget', {'name': 'Main Window', 'parent': 'main_window'})
    rates = {
        title: [(color, {'name': f'{topic}/vector/{rig.axis}'}) for _, topic, color in rows]
        for title, rows in rig.curves().items()
    }
    _add_tab(tabs, 'rates', rates, 'TimeSeries')
    x, y = (axis for axis in 'xyz' if axis != rig.axis)
    poles: dict[str, list[tuple[str, dict[str, str]]]] = {}
    for pole in POLE_NAMES:
        poles[pole.upper()] = []
        for number, body in enumerate(rig.bodies):
            if (topic := f'{rig.node}/{body}/{pole}') in rig.kinds:
                curve = {'curve_x': f'{topic}/point/{x}', 'curve_y': f'{topic}/point/{y}'}
                named = {'name': f'{topic}/point [{body}]', **curve}
                poles[pole.upper()].append((color_of(number), named))
    _add_tab(tabs, 'poles', poles, 'XYPlot')
    states = rig.node + _JOINTS
    joints = {
        f'joint {name}': [('#444444', {'name': f'{states}/{joint}/{name}'})]
        for joint in rig.joints
        for name in ('position', 'velocity')
        if states in rig.kinds
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
    """Add a tab with plots below each other, if any has a curve."""
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
        style = {'mode': mode, 'style': 'Lines', 'flip_x': 'false', 'flip_y': 'false'}
        plot = ET.SubElement(area, 'plot', style)
        ET.SubElement(plot, 'limitY')
        for color, curve in curves:
            ET.SubElement(plot, 'curve', {**curve, 'color': color})


LAYOUTS: dict[str, Callable[[RigTopics], str]] = {'foxglove': foxglove, 'plotjuggler': plotjuggler}


def write_layout(viewer: str, config: str | None, output: str) -> RigTopics:
    """Write the layout of a viewer, a key of LAYOUTS; return the topics that it shows."""
    rig = topics_of(config)
    with in_place_of(output) as part:
        part.write_text(LAYOUTS[viewer](rig), encoding='utf-8')
    return rig
