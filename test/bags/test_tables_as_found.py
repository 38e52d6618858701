"""Tables as ROS tools, trackers and spreadsheets write them: places are read, all else is named."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pytest
from test_formats import bring
from test_layouts_of_trackers import poses_in

from kinpole_ros.bags import BagError, import_points, read_messages
from kinpole_ros.messages import deserialize_message
from kinpole_ros.messages._types import MarkerArray

COUNT, STEP = 12, 0.01
TIMES = np.arange(COUNT) * STEP
EPOCH = 1_652_345_678
# Two points of a body that turns, by row and axis.
ANGLES = 3.0 * TIMES
A = np.stack((0.7 + 0.2 * np.cos(ANGLES), 0.5 + 0.2 * np.sin(ANGLES)), axis=-1)
B = A + [0.1, -0.05]
AXES = 'xyzw'


class Table(NamedTuple):
    """A table as some program writes it, and what is in it."""

    text: str
    markers: tuple[str, ...] = ('point',)
    points: tuple[np.ndarray, ...] = (A,)
    unread: tuple[str, ...] = ()
    options: Mapping[str, Any] = MappingProxyType({})
    bodies: tuple[str, ...] = ()
    start: float = 0.0  # s
    down: bool = False
    span: float = TIMES[-1]


def rows(head: str, *columns: Any, mark: str = ',') -> str:
    """A table of columns: arrays (T,) or (T, n), or one text for all rows."""
    lines = [head]
    for k in range(COUNT):
        cells: list[str] = []
        for column in columns:
            cell = column[k] if isinstance(column, (np.ndarray, list)) else column
            cells += [str(one) for one in np.atleast_1d(cell).tolist()]
        lines.append(mark.join(cells))
    return '\n'.join(lines) + '\n'


def long(head: str, row: Callable[[int, int], str], order: str = 'frames') -> str:
    """A table with a row for each of two points, frame by frame or point by point."""
    pairs = [(k, p) for k in range(COUNT) for p in (0, 1)]
    if order == 'points':
        pairs.sort(key=lambda pair: pair[1])
    return '\n'.join([head, *(row(k, p) for k, p in pairs)]) + '\n'


def xy(k: int, p: int, factor: float = 1.0) -> str:
    return ','.join(f'{value * factor:.9f}' for value in (A, B)[p][k])


def titles(before: str, axes: str, mark: str = '.') -> str:
    return ','.join(f'{before}{mark}{axis}' for axis in axes)


ZERO = np.zeros(COUNT)
QUATERNIONS = np.stack((ZERO, ZERO, np.sin(ANGLES / 2), np.cos(ANGLES / 2)), axis=-1)
SPEED = np.gradient(A, STEP, axis=0)
STAMPS = [EPOCH * 10**9 + k * 10_000_000 for k in range(COUNT)]
ARRIVALS = [stamp + 1_234_567 for stamp in STAMPS]
POSE = f'{titles("field.pose.position", "xyz")},{titles("field.pose.orientation", AXES)}'
ECHO = f'%time,field.header.seq,field.header.stamp,field.header.frame_id,{POSE}'
TF = 'field.transforms0.'
TF_ECHO = (
    f'%time,{TF}header.stamp,{TF}header.frame_id,{TF}child_frame_id,'
    f'{titles(f"{TF}transform.translation", "xyz")},{titles(f"{TF}transform.rotation", AXES)}'
)
TRACKMATE = (
    'LABEL,ID,TRACK_ID,QUALITY,POSITION_X,POSITION_Y,POSITION_Z,POSITION_T,FRAME,RADIUS\n'
    'Label,Spot ID,Track ID,Quality,X,Y,Z,T,Frame,Radius\n'
    'Label,Spot ID,Track ID,Quality,X,Y,Z,T,Frame,R\n'
    ',,,(quality),({0}),({0}),({0}),({1}),,({0})'
)
PX = {'scale': 1e-3, 'rate': 100.0}
DOWN = np.array([1.0, -1.0])


def spot(k: int, p: int, time: float) -> str:
    return f'ID{2 * k + p + 7},{2 * k + p + 7},{p},5.1,{xy(k, p, 1e3)},0.0,{time},{k},2.5'


TABLES: dict[str, Table] = {
    'velocities beside x and y': Table(
        rows('t,x,y,v_x,v_y,a_x,a_y', TIMES, A, SPEED, SPEED),
        unread=('v_x', 'v_y', 'a_x', 'a_y'),
    ),
    'velocities of markers': Table(
        rows('t,A_x,A_y,A_v_x,A_v_y,B_x,B_y,B_v_x,B_v_y', TIMES, A, SPEED, B, SPEED),
        ('A', 'B'), (A, B), ('A_v_x', 'A_v_y', 'B_v_x', 'B_v_y'),
    ),
    'velocities by their words': Table(
        rows('t,pos_x,pos_y,vel_x,vel_y,force1_x,force1_y', TIMES, A, SPEED, SPEED),
        unread=('vel_x', 'vel_y', 'force1_x', 'force1_y'),
    ),
    'velocities before their markers': Table(
        rows('t,A_x,A_y,v_A_x,v_A_y', TIMES, A, SPEED), ('A',), unread=('v_A_x', 'v_A_y'),
    ),
    'velocities before their markers, places too': Table(
        rows('t,pos_A_x,pos_A_y,vel_A_x,vel_A_y', TIMES, A, SPEED), ('pos_A',),
        unread=('vel_A_x', 'vel_A_y'),
    ),
    'a force and a moment beside markers': Table(
        rows('t,A_x,A_y,B_x,B_y,F_x,F_y,M_z', TIMES, A, B, SPEED, ZERO), ('A', 'B'), (A, B),
        ('F_x', 'F_y', 'M_z'),
    ),
    'a marker F': Table(rows('t,E_x,E_y,F_x,F_y', TIMES, A, B), ('E', 'F'), (A, B)),
    'velocities beside p': Table(
        rows('t,p_x,p_y,v_x,v_y', TIMES, A, SPEED), ('p',), unread=('v_x', 'v_y'),
    ),
    'velocities by their unit': Table(
        rows('Time (s),tip x (m),tip y (m),u x (m/s),u y (m/s)', TIMES, A, SPEED),
        ('tip',), unread=('u x (m/s)', 'u y (m/s)'),
    ),
    'markers a and v': Table(rows('t,a_x,a_y,v_x,v_y', TIMES, A, B), ('a', 'v'), (A, B)),
    'axis first': Table(
        rows('Time (s),X Position (m),Y Position (m),X Velocity (m/s)', TIMES, A, ZERO),
        unread=('X Velocity (m/s)',),
    ),
    'rostopic echo -p': Table(
        rows(ECHO, ARRIVALS, ZERO, STAMPS, 'lab', A, ZERO, QUATERNIONS),
        ('body',), unread=('%time', 'field.header.seq', 'field.header.frame_id'),
        bodies=('body',), start=EPOCH,
    ),
    'rostopic echo -p, no stamps': Table(
        rows(ECHO, STAMPS, ZERO, '0', 'lab', A, ZERO, QUATERNIONS), ('body',),
        unread=('field.header.seq', 'field.header.stamp', 'field.header.frame_id'),
        bodies=('body',), start=EPOCH,
    ),
    'rostopic echo -p /tf': Table(
        long(TF_ECHO, lambda k, p: (
            f'{ARRIVALS[k]},{STAMPS[k]},lab,{("crank", "rod")[p]},{xy(k, p)},0,'
            + ','.join(map(str, QUATERNIONS[k]))
        )),
        ('crank', 'rod'), (A, B), ('%time', f'{TF}header.frame_id'),
        bodies=('crank', 'rod'), start=EPOCH,
    ),
    'bagpy': Table(
        rows(
            'Time,header.stamp.secs,header.stamp.nsecs,child_frame_id,'
            f'{titles("pose.pose.position", "xyz")},{titles("pose.pose.orientation", AXES)},'
            f'{titles("twist.twist.linear", "xy")}',
            [str(EPOCH + 0.001 + time) for time in TIMES], str(EPOCH),
            [str(k * 10_000_000) for k in range(COUNT)], 'rod', A, ZERO, QUATERNIONS, SPEED,
        ),
        ('rod',), unread=('Time', 'child_frame_id', 'twist.twist.linear.x', 'twist.twist.linear.y'),
        bodies=('rod',), start=EPOCH,
    ),
    'PlotJuggler': Table(
        rows(
            ','.join(['__time', *(
                f'{titles(f"/{body}/pose/position", "xyz", "/")},'
                f'{titles(f"/{body}/pose/orientation", AXES, "/")}' for body in ('rod', 'crank')
            )]),
            TIMES, A, ZERO, QUATERNIONS, B, ZERO, QUATERNIONS,
        ),
        ('rod', 'crank'), (A, B), bodies=('rod', 'crank'),
    ),
    'TUM': Table(
        rows('# timestamp tx ty tz qx qy qz qw', TIMES, A, ZERO, QUATERNIONS, mark=' '),
        ('body',), bodies=('body',),
    ),
    'quaternion of a marker': Table(
        rows('t,A1_x,A1_y,A1_z,A1_qx,A1_qy,A1_qz,A1_qw', TIMES, A, ZERO, QUATERNIONS),
        ('A1',), bodies=('A1',),
    ),
    'nanoseconds since 1970': Table(
        rows('timestamp,A_x,A_y', STAMPS, A), ('A',), start=EPOCH,
    ),
    'long': Table(
        long('t,id,x,y', lambda k, p: f'{TIMES[k]:.2f},{p},{xy(k, p)}'), ('0', '1'), (A, B),
    ),
    'long, by a rate': Table(
        long('t,id,x,y', lambda k, p: f'{TIMES[k]:.2f},{p},{xy(k, p)}'), ('0', '1'), (A, B),
        options={'rate': 50.0}, span=2 * TIMES[-1],
    ),
    'trackpy': Table(
        long(',y,x,mass,frame,particle', lambda k, p: (
            f'{k},{xy(k, p, 1e3).split(",")[1]},{xy(k, p, 1e3).split(",")[0]},9.5,{k},{p}.0'
        ), 'points'),
        ('0', '1'), (A, B), ('mass',), PX, down=True,
    ),
    'TrackMate, pixels': Table(
        long(TRACKMATE.format('pixel', 'frame'), lambda k, p: spot(k, p, k), 'points'),
        ('0', '1'), (A, B), ('LABEL', 'POSITION_T (frame)'), PX, down=True,
    ),
    'TrackMate, microns': Table(
        long(TRACKMATE.format('micron', 'sec'), lambda k, p: spot(k, p, TIMES[k])),
        ('0', '1'), (A * 1e-3, B * 1e-3), ('LABEL', 'ID'), down=True,
    ),
    'napari': Table(
        long('track_id,t,y,x', lambda k, p: f'{p},{k},' + ','.join(xy(k, p, 1e3).split(',')[::-1])),
        ('0', '1'), (A, B), options=PX, down=True,
    ),
    'idtracker.ai': Table(
        rows('seconds,x1,y1,x2,y2', TIMES, A * 1e3, B * 1e3),
        ('point1', 'point2'), (A, B), options={'scale': 1e-3}, down=True,
    ),
    'idtracker': Table(
        rows('X1\tY1\tProbId1', A * 1e3, ZERO, mark='\t'), ('point1',), unread=('ProbId1',),
        options=PX, down=True,
    ),
    'ArUco, corners': Table(
        long('time_MS,frame,ID,top_left,top_right', lambda k, p: (
            f'{1e3 * TIMES[k]},{k + 1}.0,{7 - p},"({xy(k, p, 1e3)})","({xy(k, p, 1e3)})"'
        )),
        ('6.top_left', '6.top_right', '7.top_left', '7.top_right'), (B, B, A, A),
        options={'scale': 1e-3}, down=True,
    ),
    'ArUco, centers': Table(
        long('frame,marker_id,cX,cY', lambda k, p: f'{k},{p},{xy(k, p, 1e3)}'),
        ('0', '1'), (A, B), options=PX, down=True,
    ),
    'ArUco, centers by their word': Table(
        long('frame,marker_id,center_x,center_y', lambda k, p: f'{k},{p},{xy(k, p, 1e3)}'),
        ('0', '1'), (A, B), options=PX, down=True,
    ),
    'ArUco, numbered corners': Table(
        long('frame,id,x1,y1,x2,y2,x3,y3,x4,y4', lambda k, p: (
            f'{k},{p},' + ','.join(4 * [xy(k, p, 1e3)])
        )),
        tuple(f'{tag}.point{k}' for tag in '01' for k in range(1, 5)), (*4 * [A], *4 * [B]),
        options=PX, down=True,
    ),
    'ArUco, places': Table(
        long('time,id,tvec_x,tvec_y,tvec_z,rvec_x,rvec_y,rvec_z', lambda k, p: (
            f'{TIMES[k]:.2f},{p},{xy(k, p)},0,1,2,3'
        )),
        ('0', '1'), (A, B), ('rvec_x', 'rvec_y', 'rvec_z'),
    ),
    'long, two names': Table(
        long('time,individuals,keypoints,x,y', lambda k, p: (
            f'{TIMES[k]:.2f},a,tip,{xy(k, p)}' if p == 0 else f'{TIMES[k]:.2f},b,tip,{xy(k, p)}'
        )),
        ('a', 'b'), (A, B), ('keypoints',),
    ),
    'Logger Pro, text': Table(
        'Vernier Format 2\nUntitled.cmbl 5/5/2019 9:37:43 .\nRun 1\n'
        + rows('Time\tX\tY\tX Velocity\nt\tX\tY\tVx\ns\tcm\tcm\tm/s\n', TIMES, A * 100, ZERO,
               mark='\t'),
        unread=('X Velocity (m/s)',),
    ),
    'Logger Pro': Table(
        rows('"Latest: Time (s)","Latest: X (m)","Latest: Y (m)","Latest: X Velocity (m/s)"',
             TIMES, A, ZERO),
        unread=('X Velocity (m/s)',),
    ),
    'Graphical Analysis': Table(rows('Run 1: Time (s),Run 1: X (m),Run 1: Y (m)', TIMES, A)),
    'NDI': Table(
        'Number of frames:\t12\nFrequency:\t100.0\nUnits:\tmm\n\n'
        + rows('Frame\tmarker_1 x\tmarker_1 y\tmarker_1 z', np.arange(COUNT), A * 1e3, ZERO,
               mark='\t'),
        ('marker_1',),
    ),
    'NDI, cells': Table(
        'Number of frames:,12\nFrequency:,100.0\nUnits:,mm\n\n'
        + rows('Frame,marker_1 x,marker_1 y,marker_1 z', np.arange(COUNT), A * 1e3, ZERO),
        ('marker_1',),
    ),
    'Visual3D': Table(
        '\trun.c3d\trun.c3d\trun.c3d\n\tA\tA\tKnee\n\tTARGET\tTARGET\tLINK_MODEL_BASED\n'
        '\tORIGINAL\tORIGINAL\tORIGINAL\n'
        + rows('ITEM\tX\tY\tX', np.arange(COUNT), A, ZERO, mark='\t'),
        ('A',), unread=('Knee X [LINK_MODEL_BASED]',), options={'rate': 100.0},
    ),
    'keys above': Table(
        '# unit: cm\n# fps = 100\n' + rows('frame,A_x,A_y', np.arange(COUNT), A * 100), ('A',),
    ),
    'units below': Table('t,A_x,A_y\n' + rows('s,mm,mm', TIMES, A * 1e3), ('A',)),
    'units in the titles': Table(
        rows('time_ms,marker,x_mm,y_mm', TIMES * 1e3, 'A', A * 1e3), unread=('marker',),
    ),
    'a marker A beside x and y': Table(
        rows('Zeit (s),x (m),y (m),A x (m),A y (m)', TIMES, A, B), ('point', 'A'), (A, B),
    ),
    'MTrackJ': Table(
        long('Nr,TID,PID,x [pixel],y [pixel],t [frame]', lambda k, p: (
            f'{2 * k + p},{p + 1},{k + 1},{xy(k, p, 1e3)},{k + 1}'
        ), 'points'),
        ('1', '2'), (A, B), ('Nr', 'PID'), PX, down=True,
    ),
    'ImageJ, tracking by hand': Table(
        long('Track n°,Slice n°,X,Y,Distance,Velocity', lambda k, p: (
            f'{p + 1},{k + 1},{xy(k, p, 1e3)},1.0,2.0'
        ), 'points'),
        ('1', '2'), (A * DOWN, B * DOWN), ('Distance', 'Velocity'), PX | {'y_down': True},
    ),
    'shares by the unit': Table(
        rows('t,tip x (0-1),tip y (0-1)', TIMES, A), ('tip',), (A * [1.6, 0.9],),
        options={'scale': (1.6, 0.9)}, down=True,
    ),
    'landmarks in pixels': Table(
        rows('t,x_0,y_0,x_1,y_1,visibility_0,visibility_1', TIMES, A * 1e3, B * 1e3, ZERO, ZERO),
        ('point0', 'point1'), (A, B), ('visibility_0',), {'scale': 1e-3}, down=True,
    ),
    'MediaPipe': Table(
        rows('frame,timestamp,nose_x,nose_y,nose_z,nose_visibility', np.arange(COUNT), TIMES,
             A, ZERO - 0.3, ZERO + 0.9),
        ('nose',), (A * [1.6, 0.9],), options={'scale': (1.6, 0.9)}, down=True,
    ),
    'MediaPipe, long': Table(
        long('frame,landmark,x,y,z,visibility', lambda k, p: f'{k},{p},{xy(k, p)},-0.3,0.9'),
        ('0', '1'), (A * [1.6, 0.9], B * [1.6, 0.9]),
        options={'scale': (1.6, 0.9), 'rate': 100.0}, down=True,
    ),
}  # fmt: skip


@pytest.mark.parametrize('name', TABLES)
def test_a_table_has_its_places_and_times_and_names_the_rest(tmp_path, name) -> None:
    table = TABLES[name]
    done, stamps, got = bring(tmp_path, table.text, **table.options)
    assert done.markers == table.markers
    np.testing.assert_allclose(np.ptp(stamps), table.span, rtol=0, atol=2e-6)
    assert abs(stamps[0] - table.start) < 1e-6
    expected = np.stack(table.points, axis=1) * (DOWN if table.down else 1)
    np.testing.assert_allclose(got[..., :2], expected, rtol=0, atol=1e-6)
    assert not got[..., 2].any()
    notes = ' '.join(done.notes)
    unread = notes.partition('columns that are not read: ')[2]
    assert bool(unread) == bool(table.unread)
    assert all(title in unread for title in table.unread)
    assert ('y points down' in notes) == table.down
    assert ('y points up' in notes) == ('y_down' in table.options)
    if table.bodies:
        _, axes = poses_in(tmp_path / 'out.mcap', table.bodies)
        turned = np.arctan2(axes[..., 0, 1], axes[..., 0, 0])
        np.testing.assert_allclose(turned.T, [ANGLES] * len(table.bodies), atol=1e-9)


MEDIAPIPE = TABLES['MediaPipe'].text


@pytest.mark.parametrize(
    ('text', 'options', 'complaint'),
    [
        (MEDIAPIPE, {}, 'is in shares of the picture, 0 to 1; fix: give --scale WIDTH,HEIGHT, the'),
        (MEDIAPIPE, {'scale': 0.5}, 'fix: give --scale WIDTH,HEIGHT, the size of the picture'),
        (rows('t,a_x,a_y', TIMES, A), {'scale': (1.0, 2.0)}, 'fix: give --scale one number'),
        (rows('t,a x (px),a y (px)', TIMES, A), {}, 'is in shares of the picture'),
        (long('t,x,y', lambda k, p: f'{TIMES[k]},{xy(k, p)}'), {}, 'no column names the point'),
        (long('t,x,y', lambda k, p: f'{k},{xy(k, p)}'), {'rate': 9.0}, 'no column names the point'),
        (long('t,id,x,y', lambda k, p: f'{k},{k % 2},{xy(k, p)}'), {}, "'id' name some twice"),
        (rows('t,vel_x,vel_y', TIMES, A), {}, 'no column is named NAME_x'),
        (long('t,id,x,y', lambda k, p: f'{k},{p},{xy(k, p, 1e3)}'), {}, 'give --scale.* --rate'),
        (rows(f't,{titles("/tf/lab/a/translation", "xyz", "/")},'
              f'{titles("/tf/lab/a/rotation", AXES, "/")},'
              f'{titles("/tf/a/b/translation", "xyz", "/")},'
              f'{titles("/tf/a/b/rotation", AXES, "/")}',
              TIMES, *(A, ZERO, QUATERNIONS) * 2), {}, 'has b in a frame that moves; fix: give'),
        (rows('Run 1: Time (s),Run 1: X (m),Run 1: Y (m),Run 2: Time (s),Run 2: X (m),Run 2: Y (m)',
              TIMES, A, TIMES, A), {}, 'has several data sets, Run 1, Run 2'),
        ('rate: 100 Hz\n' + rows('frame,a_x,a_y', np.arange(COUNT), A), {}, 'does not say; fix: '),
        ('My tip\n' + rows('t,a_x,a_y', TIMES, A), {}, 'give the unit and the rate that they say'),
        (long(TF_ECHO, lambda k, p: (
            f'1,{STAMPS[k]},{("lab", "crank")[p]},{("crank", "rod")[p]},{xy(k, p)},0,0,0,0,1'
        )), {}, 'has bodies in several frames, crank, lab; fix: give the bag itself'),
    ],
)  # fmt: skip
def test_a_table_that_lacks_something_is_refused_with_the_fix(
    tmp_path, text, options, complaint
) -> None:
    with pytest.raises(BagError, match=complaint) as error:
        bring(tmp_path, text, **options)
    assert '; fix: ' in str(error.value)


def test_points_of_a_long_table_may_be_absent_from_frames(tmp_path) -> None:
    text = long('t,id,x,y', lambda k, p: f'{TIMES[k]:.2f},{p},{xy(k, p)}').splitlines(True)
    del text[8], text[1]
    (tmp_path / 'a.csv').write_text(''.join([*text, '0.05,-1,9,9\n', '0.05,,9,9\n']))
    done = import_points(tmp_path / 'a.csv', tmp_path / 'a.mcap')
    assert (done.frames, done.markers) == (COUNT, ('0', '1'))
    arrays = [deserialize_message(m.data, MarkerArray) for m in read_messages(tmp_path / 'a.mcap')]
    seen = [[marker.ns for marker in one.markers] for one in arrays]
    assert seen[:5] == [['1'], ['0', '1'], ['0', '1'], ['0'], ['0', '1']]


def test_the_rate_of_rounded_times_is_that_of_their_grid(tmp_path) -> None:
    times = ''.join(f'{k / 60:.4f},{0.1 * k},2\n' for k in range(200) if k % 17)
    done, *_ = bring(tmp_path, 't,a_x,a_y\n' + times)
    assert abs(done.rate - 60) < 0.001
