"""A field of a struct says its shape and what it is; a quantity has one name, a code one place."""

import ast
import re
from collections import defaultdict
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinpole_ros import track
from kinpole_ros.core import bindings
from kinpole_ros.core.bindings import BodyTracks, Struct
from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.bodies import Bodies
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.step import Step
from kinpole_ros.tracking.tracker import Tracker

PACKAGE = Path(bindings.__file__).parents[1]
# Those that know the codes of C.
SHARING = 'core', 'derivatives', 'messages', 'tracking'
FIELDS = {field.name for field in fields(Bodies)}


def test_every_field_says_what_it_is() -> None:
    for struct in Struct.__subclasses__():
        for name, meaning in struct.meanings.items():
            assert meaning and not meaning.endswith('.'), (struct, name)


def test_a_quantity_has_one_name_and_a_name_one_unit() -> None:
    names, units = defaultdict(set), defaultdict(set)
    for struct in Struct.__subclasses__():
        for name, meaning in struct.meanings.items():
            unit, colon, _ = meaning.partition(': ')
            names[meaning].add(name)
            # Derivatives of a quantity have its name.
            unit = unit if colon else ''
            units[name].add((unit.partition('/s^')[0], struct.elements.get(name)))
    assert {meaning: found for meaning, found in names.items() if len(found) > 1} == {}
    assert {name: found for name, found in units.items() if len(found) > 1} == {}


def test_no_code_is_typed_twice() -> None:
    codes = {code for enum in bindings._CODES for code in bindings.codes_of(enum)}
    for package in SHARING:
        for path in (PACKAGE / package).rglob('*.py'):
            for statement in ast.parse(path.read_text()).body:
                if isinstance(statement, ast.Assign) and not isinstance(statement.value, ast.Call):
                    literals = [one for one in ast.walk(statement.value) if is_integer(one)]
                    names = [ast.walk(target) for target in statement.targets]
                    named = {one.id for part in names for one in part if isinstance(one, ast.Name)}
                    assert not literals or not named & codes, (path, ast.unparse(statement))
    for path in (PACKAGE / 'core' / 'include').glob('*.h'):
        for enum in re.findall(r'^enum \{(.*)\};', path.read_text(), re.MULTILINE):
            assert 'DECLARE_CODE' in enum, (path, enum)


def is_integer(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) is int


def check(struct: type[Struct], shapes: dict[str, tuple[int, ...]]) -> None:
    """Check shapes of arrays against those declared: a symbol stands for one size."""
    symbols = {s for declared in struct.shapes.values() for s in declared if s.isidentifier()}
    sizes = dict.fromkeys(symbols, 0)
    for name, shape in shapes.items():
        declared = struct.shapes[name]
        assert len(shape) == len(declared), (struct, name, shape)
        sizes |= {s: n for s, n in zip(declared, shape, strict=True) if s.isidentifier()}
    expected = struct.shapes_for(**sizes)
    for name, shape in shapes.items():
        assert shape == expected[name], (struct, name)


def test_arrays_have_the_shapes_that_are_declared(monkeypatch: pytest.MonkeyPatch) -> None:
    bound: dict[int, tuple[Struct, dict[str, tuple[int, ...]]]] = {}
    bind, pass_frames = Struct.bind, Step.pass_frames

    def keep(struct: Struct, name: str, array: np.ndarray | None) -> None:
        if array is not None:
            bound.setdefault(id(struct), (struct, {}))[1][name] = array.shape
        bind(struct, name, array)

    def keep_frames(step: Step, number: int, new_frames: Any, hidden_is_unusual: bool) -> None:
        names = list(step.incoming.elements)
        pairs = zip(names, new_frames, strict=False)
        arrays = {name: np.shape(array) for name, array in pairs if array is not None}
        bound[-len(bound)] = step.incoming, arrays
        pass_frames(step, number, new_frames, hidden_is_unusual)

    monkeypatch.setattr(Struct, 'bind', keep)
    monkeypatch.setattr(Step, 'pass_frames', keep_frames)
    time = np.arange(40) / 200
    turn = np.exp(1j * np.outer(time, (2.0, -3.0)))[..., None]
    flat = np.array((0.0, 1.0))[:, None] + turn * (0.1, 0.2j, -0.1)
    flat = flat.reshape(len(time), -1)
    found = track(
        np.stack((flat.real, flat.imag), axis=-1),
        (time * 1e9).astype(np.int64),
        bodies={'a': [0, 1, 2], 'b': [3, 4, 5]},
        window=0.1,
        lag=0.02,
    )
    assert np.isfinite(found['a'].icr).any()
    for struct, shapes in bound.values():
        check(type(struct), shapes)
    kinds = {type(struct).__name__ for struct, _ in bound.values()}
    assert kinds >= {'BodyArrays', 'BodyTracks', 'HistoryColumns', 'NewFrames', 'Slots'}


def test_bodies_are_stored_once_and_an_update_makes_new_arrays() -> None:
    angle = np.arange(60) / 30
    flat = np.exp(1j * angle)[:, None] * (0.1, 0.2j, -0.1)
    flat = flat + 1e-4 * np.random.default_rng(0).normal(size=flat.shape)
    points = np.stack((flat.real, flat.imag, 0 * flat.real), axis=-1)
    stamps = 1 + 5_000_000 * np.arange(len(angle))
    tracker = Tracker(settings_from({'lag': 0.0}))
    for first in range(0, len(angle), 20):
        before = tracker.state.bodies
        kept = {name: array.copy() for name, array in vars(before).items() if name in FIELDS}
        part = slice(first, first + 20)
        tracker.add(MarkerFrames(stamps[part], 'world', ('a', 'b', 'c'), points[part]), None)
        for name, array in kept.items():
            np.testing.assert_array_equal(getattr(before, name), array, err_msg=name)
        bodies, known = tracker.state.bodies, tracker.state.step.known
        assert bodies is not before
        for kept, computed in zip(bodies.fitting, replace(bodies).fitting, strict=True):
            np.testing.assert_array_equal(kept, computed)
        assert bodies.spectrum.shape == (1,)
        owners = vars(bodies), bodies.placement._asdict(), bodies.fitting._asdict()
        for name in known.elements:
            (array,) = (owner[name] for owner in owners if name in owner)
            assert getattr(known, name) == bindings.address_of(array), name


def test_shapes_are_those_of_the_sizes() -> None:
    shapes = BodyTracks.shapes_for(B=3)
    assert (shapes['outages'], shapes['wrong']) == ((4,), (3,))
