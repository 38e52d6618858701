"""
The page docs/course_notes.md: the results of three sets of course notes, next to those of kinpole.

`python docs/_course_notes.py` writes it, and test/test_course_notes.py compares it with a new one.
An entry is a command with a pattern for numbers in its output, or a Python expression after
`SETUP`.
"""

import contextlib
import io
import os
import re
import shlex
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.tools.cli import main

PAGE = Path(__file__).parent / 'course_notes.md'
NUMBER = re.compile(r'-?\d+(?:\.\d+)?(?:e[-+]?\d+)?')

HEAD = """# Course notes

Does kinpole reproduce the results of a course? Yes. This page lists every result, formula and
method of three sets of course notes, with the command or Python expression for it. The column
"printed" is the value in the notes, "result" the value of kinpole. `True` means equal within 1e-9.
A test makes this page again and compares all numbers.

| notes | cited in the code as |
| --- | --- |
| *Two-Dimensional Experimental Kinematics*, Notes 05 02, with MATLAB functions | seed 000 |
| *Theory of Mechanisms*, Lecture 4, *Poisson's decomposition of general planar motion* | seed 001 |
| ME 3610 *Course Notes*, Part VI, *Velocity and Acceleration Analysis of Mechanisms* | seed 003 |

All Python expressions follow this block:

```python
"""

SETUP = """\
import numpy as np
from numpy.linalg import inv, norm
from kinpole_ros import planar
from kinpole_ros.mechanism import *
from kinpole_ros.planar import *


def close(one, other):
    return bool(np.allclose(one, other, rtol=1e-9, atol=1e-9))


# Seed 000, page 7: the web cutter, points B3 and C3, to the jerk. Page 6: link 3, in mm.
f = [1, 1]
r, rd = [[3.7588, 3.9407], [1.3681, 29.3675]], [[-5.4874, 22.5296], [15.0764, 14.8943]]
rdd = [[-60.4716, -42.8075], [-22.0098, -50.1604]]
rddd = [[88.2815, -673.2083], [-242.5514, -291.1768]]
link3 = [[43, 90], [56, 80]], [[83.38, 53.56], [-38.88, 19.50]]
rbk = im2kin2d(f, *link3, np.zeros((2, 2)), np.zeros((2, 2)))
v_C = rbk[0] * np.array([[0, -1], [1, 0]]) @ (np.array([27, 121]) - rbk[1])

# A coupler in exact motion, its three landmarks, their means, and the matrices of seed 000.
scene = load_scene('four_bar')
coupler, crank = (scene.motion(0.1)[name] for name in ('coupler', 'crank'))
z, angle = coupler.position, coupler.angle
arms = np.array([0.03 - 0.04j, 0.33 - 0.03j, 0.26 + 0.17j])
landmarks = to_plane(z[:, None] + rotation_derivatives(angle)[:, None] * arms)
k = landmark_kinematics(*landmarks, weights=[1, 1, 1])
m, (w, a, j, s) = landmarks.mean(axis=1), angle[1:]
R, P = np.array([[0, -1], [1, 0]]), np.array([0.2, 0.1])
B = a * R + w**2 * R @ R
H = j * R + 3 * w * a * R @ R + w**3 * R @ R @ R
G = s * R + 6 * w**2 * a * R @ R @ R + 4 * w * j * R @ R + 3 * a**2 * R @ R + w**4 * R @ R @ R @ R
dICR = (w * R @ m[2] - B @ m[1]) / w**2
K = w**3 * np.eye(2) - 2 * w * a * R
ddICR = (-(w * j - 2 * a**2) * R @ m[1] + K @ m[2] + w**2 * R @ m[3]) / w**3
at_unit_rate = scene.mechanism.sweep([0.2 * np.pi])
kappa = (dICR[0] * ddICR[1] - dICR[1] * ddICR[0]) / norm(dICR) ** 3

# Seed 001: the points A (the crank pin) and B of the coupler.
r_A, v_A, a_A = (to_plane(part) for part in z[:3])
r_BA, v_BA, a_BA = (to_plane(0.36 * part) for part in rotation_derivatives(angle)[:3])
u_fixed, u_moving = centrode_velocities(v_A, a_A, w, a)
icr = poles(scene.mechanism, scene.mechanism.motion([0.1])).icr[1, 0]
turned_back = to_plane((icr - z[0]) * np.exp(-1j * angle[0]))
centers, unit = np.array([0, icr, z[0]]), np.full((3, 2, 2), np.eye(2))

# Seed 003: the loader at its printed position, and a matrix A with b of its loop.
loader = load_scene('loader')
at_45 = loader.mechanism.sweep(np.radians([45.0]))
at_limit = loader.mechanism.sweep(np.radians([71.33339598]))
statics = Statics(loader.mechanism, at_45.values[0], loader.loads)
borne = statics.force
forces = [-one.way * one.powers.sum(axis=0) for one in statics.releases]
released = np.array(forces).reshape(-1, 2, 1).sum(axis=1)


def matrix(t3, t4):
    return np.array([[-1.2 * np.sin(t3), -np.sin(t4)], [1.2 * np.cos(t3), np.cos(t4)]])


t2, t3, t4 = at_45.values[0][:, 0]
v = inv(matrix(t3, t4 + np.pi)) @ [0.5 * 1.41 * np.sin(t2), -0.5 * 1.41 * np.cos(t2)]
"""


class Entry(NamedTuple):
    """A row; `pick` finds numbers in the output of a command, which are multiplied by `times`."""

    where: str
    what: str
    how: str
    printed: str = ''
    pick: str = ''
    times: float = 1.0


def _row(name: str, column: int) -> str:
    """Return the pattern for one number of a row with five numbers."""
    return rf'^(?:{name})' + r' +\S+' * column + r' +(-?\d\S*)' + r' +\S+' * (4 - column) + '$'


_POINT = r'\s+\S+\s+\S+\s+(\S+)\s+(\S+)'
LOADER, TREBUCHET = 'kinpole solve loader --at "45 deg"', 'kinpole solve trebuchet'
POISSON = 'kinpole solve slider_crank --at "75 deg" --decompose rod:A,B poisson.svg'
ROLLED = '^(the curves .* roll on each other), arc lengths equal'

COURSE_NOTES: dict[str, list[Entry]] = {
    'Experimental kinematics (seed 000)': [
        Entry(
            'p. 1',
            'landmarks with weights f; an unavailable landmark has no influence',
            'close(landmark_kinematics(*landmarks, weights=[1, 0, 1]).icr, k.icr)',
        ),
        Entry('p. 1', 'ω = Σ f (c × ṙ) / S', 'close(k.angular_velocity, w)'),
        Entry('p. 1', 'ICR = r̄ − [ω]⁻¹ ṙ̄', 'close(k.icr, m[0] - inv(w * R) @ m[1])'),
        Entry(
            'p. 1',
            'ṙ_P = [ω] (r_P − ICR)',
            'close(point_derivatives(k, P)[0], w * R @ (P - k.icr))',
        ),
        Entry('p. 2', 'α = Σ f (c × r̈) / S', 'close(k.angular_acceleration, a)'),
        Entry('p. 2', 'IAP = r̄ − [β]⁻¹ r̈̄, β = [ω̇] + [ω]²', 'close(k.iap, m[0] - inv(B) @ m[2])'),
        Entry(
            'p. 2', 'r̈_P = [β] (r_P − IAP)', 'close(point_derivatives(k, P)[1], B @ (P - k.iap))'
        ),
        Entry('p. 2', 'angular jerk ω̈ = ω³ + Σ f (c × r⃛) / S', 'close(k.angular_jerk, j)'),
        Entry('p. 2', 'IJP = r̄ − [η]⁻¹ r⃛̄', 'close(k.ijp, m[0] - inv(H) @ m[3])'),
        Entry(
            'p. 2', 'r⃛_P = [η] (r_P − IJP)', 'close(point_derivatives(k, P)[2], H @ (P - k.ijp))'
        ),
        Entry('p. 2', 'angular snap ω⃛ = 6 ω² α + Σ f (c × r⁗) / S', 'close(k.angular_snap, s)'),
        Entry('p. 2', 'ISP = r̄ − [σ]⁻¹ r⁗̄', 'close(k.isp, m[0] - inv(G) @ m[4])'),
        Entry(
            'p. 2', 'r⁗_P = [σ] (r_P − ISP)', 'close(point_derivatives(k, P)[3], G @ (P - k.isp))'
        ),
        Entry(
            'p. 3',
            'fixed centrode: the locus of the ICR; its velocity ([ω] r̈̄ − [β] ṙ̄) / ω²',
            'close(k.icr_velocity, dICR)',
        ),
        Entry(
            'p. 3',
            'moving centrode: the locus seen from the body, which rolls on the fixed one',
            'kinpole solve four_bar --pitch ground coupler curves.svg',
            '',
            ROLLED,
        ),
        Entry('p. 3', 'curvature κ of the fixed centrode', 'close(k.centrode_curvature, kappa)'),
        Entry(
            'p. 3',
            'κ of a mechanism of mobility one does not depend on its speed',
            'close(poles(scene.mechanism, at_unit_rate).curvature[1], kappa)',
        ),
        Entry(
            'p. 3',
            'relative angular velocity, and RICR = (ω_j ICR_j − ω_i ICR_i) / ω_ji: here the pin A',
            'close(relative_center(w, k.icr, crank.angle[1], [0, 0]), r_A)',
        ),
        Entry(
            'p. 4', 'rigid link 3 by hand: v_B/A (mm/s)', 'np.diff(link3[1])[:, 0]', '-29.82, 58.38'
        ),
        Entry(
            'p. 4',
            'its magnitude and direction',
            'norm(np.diff(link3[1])), np.degrees(np.arctan2(58.38, -29.82))',
            '65.55, 117.1',
        ),
        Entry(
            'p. 4',
            'AB (mm) and ω = |v_B/A| / AB (rad/s)',
            'norm(np.diff(link3[0])), norm(np.diff(link3[1])) / norm(np.diff(link3[0]))',
            '52.77, 1.242',
        ),
        Entry(
            'p. 4',
            'v_C/A = ω [R] r_C/A (mm/s)',
            'relative_velocity(1.242, [-16, 65])',
            '-80.73, -19.87',
        ),
        Entry(
            'p. 4',
            'v_C = v_A + v_C/A (mm/s)',
            'np.array([83.38, -38.88]) + relative_velocity(1.242, [-16, 65])',
            '2.65, -58.75',
        ),
        Entry(
            'p. 4',
            'its magnitude and direction',
            'norm([2.65, -58.75]), np.degrees(np.arctan2(-58.75, 2.65))',
            '58.81, -87.4',
        ),
        Entry('p. 5–6', '`rbk`: ω of link 3', 'rbk[0]', '1.2422'),
        Entry('p. 5–6', '`rbk`: ICR (mm)', 'rbk[1]', '74.3006, 123.1197'),
        Entry('p. 5–6', '`rbk`: v_C (mm/s)', 'v_C', '2.633, -58.7571'),
        Entry(
            'p. 5–6',
            '`rbk`: its magnitude and direction',
            'norm(v_C), np.degrees(np.arctan2(v_C[1], v_C[0]))',
            '58.82, -87.43',
        ),
        *(
            Entry('p. 7', f'`t_lm2kin2d`: {what}', f'im2kin2d(f, r, rd, rdd, rddd)[{n}]', printed)
            for n, (what, printed) in enumerate(
                (
                    ('w', '-1.0006'),
                    ('rICR', '18.8257, 6.8520'),
                    ('wd', '-0.6374'),
                    ('rIAP', '-49.1784, 13.0846'),
                    ('wdd', '26.1823'),
                    ('rIJP', '12.8647, 3.9747'),
                    ('rdICR', '-37.0807, 72.0169'),
                    ('kappa', '-0.0151'),
                )
            )
        ),
        Entry(
            'p. 7',
            'the same four-bar as a scene: ICR of its coupler (cm)',
            'kinpole solve web_cutter',
            '18.8257, 6.8520',
            r'ICR x m.*\n.*\n^coupler\s+(\S+)\s+(\S+)',
            100,
        ),
        Entry(
            'p. 8–9',
            'the function with its eight outputs',
            'len(im2kin2d(f, r, rd, rdd, rddd))',
            '8',
        ),
    ],
    "Poisson's decomposition (seed 001)": [
        Entry(
            'S1 eq. 1',
            'r_B = r_A + r_BA',
            'close(r_A + r_BA, to_plane(z[0] + 0.36 * np.exp(1j * angle[0])))',
        ),
        Entry(
            'Fig. 1',
            'decomposition with A and with B: the same rotation (deg)',
            POISSON,
            '',
            r'^[AB]  .* (\S+)$',
        ),
        Entry(
            'S1 eq. 2, 3',
            'v_B = v_A + v_BA, v_BA = ω × r_BA',
            'close(v_BA, relative_velocity(w, r_BA))',
        ),
        Entry(
            'Fig. 2',
            'graphical construction of v_B = v_A + v_BA: magnitudes of v_A, v_BA, v_B (m/s)',
            'kinpole solve slider_crank --at "75 deg" --polygon polygons.svg',
            '',
            r'^v_\w+\s+\w+\s+(\S+)',
        ),
        Entry(
            'S1 eq. 4',
            'a_B = a_A + α × r_BA + ω × v_BA',
            'close(a_BA, relative_acceleration(w, a, r_BA))',
        ),
        Entry(
            'S2 eq. 1, 2',
            'r_P = r_A + r_P3',
            'close(r_A + pole_from_reference(v_A, w), to_plane(icr))',
        ),
        Entry(
            'Fig. 3',
            'slider-crank with k_P, k_H, their tangent and u: the pole (m)',
            POISSON,
            '',
            r'^r_P \(eq. 23\)\s+(\S+)\s+(\S+)',
        ),
        Entry(
            'S2 eq. 3–8',
            'derivative of a vector in rotating axes',
            'close(transport([0, 0], w, r_BA), v_BA)',
        ),
        Entry(
            'S2 eq. 9, 10',
            'di/dt = ω × i, dj/dt = ω × j',
            'close(transport(np.zeros((2, 2)), w, np.eye(2)), w * R.T)',
        ),
        Entry(
            'S2 eq. 11, 12',
            'the derivative of r_P3 in space 1 is v_P3 + ω × r_P3',
            'close(u_moving, u_fixed - v_A - relative_velocity(w, pole_from_reference(v_A, w)))',
        ),
        Entry(
            'S2 eq. 13',
            'ω × r_P3 = −v_A',
            'close(relative_velocity(w, pole_from_reference(v_A, w)), -v_A)',
        ),
        Entry(
            'S2 eq. 14, 15',
            'the pole moves along both centrodes with the same velocity u',
            'close(u_fixed, u_moving)',
        ),
        Entry(
            'S2 eq. 15',
            'u along the tangent t_P (m/s), on the fixed and the moving centrode',
            POISSON,
            '',
            r'^u along \D+(\S+)\s+(\S+)',
        ),
        Entry(
            'S2 eq. 16',
            'the derivative seen from b is that seen from a plus ω_ab × r',
            'close(transport(v_BA, -w, r_BA), [0, 0])',
        ),
        Entry(
            'S3 eq. 17–19',
            '0 = v_A + ω × r_P3',
            'close(v_A + relative_velocity(w, pole_from_reference(v_A, w)), [0, 0])',
        ),
        Entry(
            'S3 eq. 20, 21',
            'r_P3 = ω × v_A / ω²',
            'close(pole_from_reference(v_A, w), R @ v_A / w)',
        ),
        Entry(
            'S3 eq. 22',
            'moving centrode k_H: r_P3 in axes of the body',
            'close(moving_centrode_from_reference(v_A, w, angle[0]), turned_back)',
        ),
        Entry(
            'S3 eq. 23',
            'fixed centrode k_P: r_P in axes of the ground',
            'close(fixed_centrode_from_reference(r_A, v_A, w), to_plane(icr))',
        ),
    ],
    'Velocity and acceleration analysis (seed 003)': [
        Entry(
            '2, process',
            'the derivative of the loop equations is linear in the unknown rates',
            'close(v, 0.5 * at_45.values[1, 1:, 0])',
        ),
        Entry(
            '2, summary',
            'derivative of r e^{iθ} by its parts ṙ e^{iθ}, i r θ̇ e^{iθ}: the cylinder r5 (m/s)',
            'kinpole solve loader_cylinder --polygon polygons.svg',
            '',
            r'^v_r5\^\w\s+\w+\s+(\S+)',
        ),
        Entry(
            '2, example 1',
            'mobility 3 (4 − 1) − 2 · 4',
            'mobility(loader.mechanism.assembly, at_45.values[0][:, 0])[0]',
            '1',
        ),
        Entry(
            '2, example 1',
            'the position: θ2, θ3, θ4 (deg; of link 4 from its other end)',
            LOADER,
            '',
            _row('arm|lift|link', 0),
        ),
        Entry('2, example 1 (II-6)', 'r2 θ̇2 sin θ2 (cm/s)', '141 * 0.5 * np.sin(t2)', '49.85'),
        Entry('2, example 1 (II-6)', 'θ̇4 (rad/s)', LOADER, '0.4985', _row('link', 1)),
        Entry('2, example 1 (II-6)', 'θ̇3 = θ̇3p (rad/s)', LOADER, '-0.4154', _row('lift', 1)),
        Entry(
            '2, example 1 (II-6)', 'V_P (cm/s)', LOADER, '8.896, 108.6', rf'^lift.P{_POINT}', 100
        ),
        Entry(
            '2, example 1',
            'loop L1 as vectors, with the printed r1: sides of its polygon (m/s)',
            'kinpole solve loader_loop --at "45 deg" --polygon loop.svg',
            '',
            r'^v_r[234]\s+\w+\s+(\S+)',
        ),
        Entry(
            '2, discussion',
            'twice the input velocity is twice the output velocity',
            'close(inv(matrix(t3, t4 + np.pi)) @ [1.41 * np.sin(t2), -1.41 * np.cos(t2)], 2 * v)',
        ),
        Entry('2, example 2 (II-7)', 'r3 cos θ3 (cm)', '200 * np.cos(np.radians(150))', '-173.2'),
        Entry('2, example 2 (II-7)', 'ṙ1 (cm/s)', TREBUCHET, '-144.3', _row('shift', 1), 100),
        Entry('2, example 2 (II-7)', 'θ̇3 = θ̇3b (rad/s)', TREBUCHET, '-1.443', _row('bar', 1)),
        Entry(
            '2, example 2 (II-7)',
            'V_P (cm/s)',
            TREBUCHET,
            '360.75, 374.84',
            rf'^bar.P{_POINT}',
            100,
        ),
        Entry(
            '2, example 3',
            'A v = b at any position, V_P over the range: limits of the input (deg)',
            'kinpole solve loader --sweep --csv loader.csv',
            '',
            r'^dead point at arm = (\S+)',
        ),
        Entry(
            '2, example 3',
            'no solution where A is singular: its determinant there is below 1e-4',
            'bool(abs(np.linalg.det(matrix(*at_limit.values[0][1:, 0]))) < 1e-4)',
        ),
        Entry(
            '2, example 3',
            'the pseudo code as a program: plot of V_P',
            'kinpole solve loader --sweep --plot loader.png',
            '',
            r'written to (\S+)',
        ),
        Entry(
            '2, example 4 (II-12)',
            'two loops, the cylinder as input: θ̇2, θ̇3, θ̇4, θ̇5 (rad/s)',
            'kinpole solve loader_cylinder',
            '',
            _row('r[2345]', 1),
        ),
        Entry(
            '2, example 5',
            'pool lift: ω of its arm (rad/s) at R3 = 20 in',
            'kinpole solve pool_lift --at "20 in"',
            '',
            _row('arm', 1),
        ),
        Entry(
            '2, exercise',
            'exercise machine with the seat Q: θ̇3, θ̇4 (rad/s)',
            'kinpole solve exercise_seat',
            '',
            _row('link_[34]', 1),
        ),
        Entry(
            '2, exercise',
            'V_Q (cm/s)',
            'kinpole solve exercise_seat',
            '',
            rf'^link_3.Q{_POINT}',
            100,
        ),
        *(
            Entry('schematics', what, f'kinpole solve {name} --plot {name}.png', '', r'(\w+\.png)$')
            for name, what in (
                ('loader', 'Bobcat loader'),
                ('loader_cylinder', 'the same with its cylinder'),
                ('trebuchet', 'floating-arm trebuchet'),
                ('pool_lift', 'pool lift'),
                ('exercise_seat', 'exercise machine with a seat'),
                ('bike_suspension', 'rear suspension of a bike'),
                ('exercise_machine', 'exercise machine with a resisting torque'),
            )
        ),
        Entry(
            '3',
            'c = n (n − 1) / 2 instant centers: of four bodies',
            'len(instant_centers(scene.mechanism, at_45.values[0][:, :1]).pairs)',
            '6',
        ),
        Entry(
            '3',
            'the center of a pin is the pin; that of a slide is at infinity, normal to it',
            'kinpole solve slider_crank --centers',
            '',
            r'^(I\d\d: pin \w+)',
        ),
        Entry(
            '3',
            "Kennedy's theorem: three centers on a line",
            'close(kennedy_residual(centers, unit)[0], 0)',
        ),
        Entry(
            '3',
            'Kennedy for a four-bar',
            'kinpole solve four_bar --at "45 deg" --centers',
            '',
            r'^(I\d\d: line.*)',
        ),
        Entry(
            '3',
            'ratio of rates from the centers of a four-bar',
            'kinpole solve four_bar --at "45 deg" --centers',
            '',
            r'^ω4/ω2 = I12I24 / I14I24 = .* = (\S+)$',
        ),
        Entry(
            '3',
            'Kennedy for a slider-crank',
            'kinpole solve slider_crank --centers',
            '',
            r'^(I\d\d: line.*)',
        ),
        Entry(
            '3',
            'velocity polygons',
            'kinpole solve loader --at "45 deg" --polygon polygons.svg',
            '',
            r'^v_\w+\s+\w+\s+(\S+)',
        ),
        Entry(
            '3',
            'centrodes that roll on each other without slip, as non-circular gears',
            'kinpole solve elliptic_gears --pitch crank follower gears.svg',
            '',
            ROLLED,
        ),
        Entry(
            '4',
            'bearing forces of example 4 (velocities): pivots of arm, link and cylinder (N)',
            'kinpole solve loader_cylinder --statics',
            '',
            r'^(?:r2-ground|r4-ground|r5) +\S+ +\S+ +(\S+) +0$',
        ),
        Entry(
            '4',
            'power in is power out: torque times θ̇2 and weight times V_Py (W)',
            f'{LOADER} --work',
            '',
            r'^(-?[\d.]+) W \+ .* = 0$',
        ),
        Entry(
            '4',
            'mechanical advantage, load over input (N/(N m))',
            f'{LOADER} --work',
            '',
            r'^1 load, force at lift.P\s+\S+\s+(\S+)$',
        ),
        Entry(
            '4',
            'virtual work Σ F·v + Σ T ω = 0',
            f'{LOADER} --work',
            '',
            r'^(the effort of arm = \S+ N m)',
        ),
        Entry(
            '4',
            'superposition: the share of each load, and their sum (N m)',
            'kinpole solve slider_crank --work',
            '',
            r'^(?:\d \w+, \w+ \w+ [\w.]+|sum)\s+(-?[\d.]+)(?:\s+(?:infinite|-|-?[\d.]+))?$',
        ),
        Entry(
            '4',
            'each bearing force by releasing the bearing: O and C of the loader (N)',
            f'{LOADER} --work',
            '',
            r'^[OC]\s+90 deg .* (\S+)  N$',
        ),
        Entry(
            '4',
            'the same by Lagrange multipliers',
            'close(borne, released)',
        ),
        Entry(
            '4, example 1',
            'input torque of the loader for 1000 kg at P (N m)',
            f'{LOADER} --statics',
            '',
            r'balances the loads with (\S+)',
        ),
        Entry(
            '4, bike',
            'spring-over-shock force for 500 N at P (N)',
            'kinpole solve bike_suspension --work',
            '',
            r'^the effort of spring = (\S+)',
        ),
        Entry(
            '4, bike',
            'V_P (cm/s)',
            'kinpole solve bike_suspension',
            '5, 125',
            rf'^swing.P{_POINT}',
            100,
        ),
        Entry(
            '4, trebuchet',
            'force across the bar at P for 100 kg (N)',
            'kinpole solve trebuchet --work',
            '',
            r'^force at bar.P = (\S+)',
        ),
        Entry(
            '4, exercise machine',
            'force at P, horizontal and to the left (N)',
            'kinpole solve exercise_machine --work',
            '',
            r'^force at link_2.P = (\S+)',
        ),
        Entry(
            '5',
            'acceleration analysis: loop equations differentiated twice, of the loader (rad/s²)',
            LOADER,
            '',
            _row('lift|link', 2),
        ),
        Entry(
            '6',
            'acceleration polygons, normal and tangential parts (m/s²)',
            'kinpole solve loader --at "45 deg" --polygon polygons.svg',
            '',
            r'^a_BA?\^\w\s+\w+\s+(\S+)',
        ),
    ],
}


def page() -> str:
    """Return the page as Markdown."""
    names: dict[str, Any] = {}
    exec(SETUP, names)
    lines = [HEAD + SETUP + '```']
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            lines += rows(names)
        finally:
            os.chdir(before)
    return '\n'.join(lines) + '\n'


def rows(names: dict[str, Any]) -> list[str]:
    """Return all entries as tables."""
    lines: list[str] = []
    outputs: dict[str, str] = {}
    for title, entries in COURSE_NOTES.items():
        head = ['where', 'what', 'how', 'printed', 'result']
        lines += [
            '',
            f'## {title}',
            '',
            f'| {" | ".join(head)} |',
            '| --- | --- | --- | --- | --- |',
        ]
        for entry in entries:
            shown = result(entry, names, outputs)
            cells = entry.where, entry.what, f'`{entry.how}`', entry.printed, shown
            lines.append('| ' + ' | '.join(cell.replace('|', r'\|') for cell in cells) + ' |')
    return lines


def result(entry: Entry, names: dict[str, Any], outputs: dict[str, str]) -> str:
    """Return the result as text; raise AssertionError if it differs from the printed value."""
    if entry.how.startswith('kinpole '):
        if entry.how not in outputs:
            outputs[entry.how] = printed_by(entry.how)
        found = re.findall(entry.pick, outputs[entry.how], re.M)
        assert found, f'{entry.how}: no match of {entry.pick} in {outputs[entry.how]}'
        cells = [cell for one in found for cell in ([one] if isinstance(one, str) else one)]
    else:
        value = eval(entry.how, names)
        cells = [str(value)] if isinstance(value, bool) else [f'{x:.12g}' for x in np.ravel(value)]
    numbers = [float(x) * entry.times if NUMBER.fullmatch(x) else 0.0 for x in cells]
    # Smaller numbers are rounding errors, also of the lengths in a scene.
    smallest = 1e-6 * max(map(abs, numbers))
    shown = [
        f'{x if abs(x) > smallest else 0.0:.5g}' if NUMBER.fullmatch(cell) else cell
        for x, cell in zip(numbers, cells, strict=True)
    ]
    if entry.printed:
        for cell, printed in zip(shown, entry.printed.split(', '), strict=True):
            # The printed inputs and intermediate values are rounded.
            last = 10.0 ** -len(printed.partition('.')[2])
            assert abs(float(cell) - float(printed)) <= max(1e-3 * abs(float(printed)), last), (
                entry,
                shown,
            )
    assert 'False' not in shown, entry
    return ', '.join(shown)


def printed_by(command: str) -> str:
    """Return the output of a command."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        assert main(shlex.split(command)[1:]) == 0, command
    return out.getvalue()


if __name__ == '__main__':
    PAGE.write_text(page(), encoding='utf-8')
