"""What a replay came to, for whoever reports of it: the command line, a batch, Python."""

from typing import TYPE_CHECKING, NamedTuple

from kinpole_ros.bags._reader import Truncated
from kinpole_ros.tracking.outages import Outage
from kinpole_ros.tracking.space import SpaceReport
from kinpole_ros.tracking.stamps import StampState

if TYPE_CHECKING:
    from kinpole_ros.linkage.positions import PositionReport
    from kinpole_ros.linkage.theory import DeviationSummary


class Replayed(NamedTuple):
    """
    What a replay came to: frames in, estimates out, and the share of these with each pole.

    `unreadable` counts messages that could not be read, `problem` is the first one's;
    `truncated` says where a damaged bag ended, None for a sound one. `repeated` and `late` count
    frames left out, `resets` and `frame_changes` starts anew, as the tracker does. `noise` is that
    of a marker of each body at the end, per axis, m, NaN where it is not known. `rigidity_residual`
    is how far markers are off one rigid body, m, 0 where they may be of one, by what `causes`, ''
    where that is not known. `noise_underestimated` are the bodies whose noise is more than was
    measured. `first` and `last` are the earliest and the latest stamp, ns, 0 without frames.
    `absent` are the markers of each body that are in no message, and `identities` those of the last
    one. `unknown` are the bodies that were never estimated, and why not at the last instant (''
    where there is none). `concatenated` are the files that were read as one recording only because
    they lie in one folder. `scene_deviations` is how far the rates were from the scene, if any,
    and `scene_positions` how far the joints were off, and what of the scene is wrong;
    `space` is how the motion lay in space, as last known. `lost` are frames that never came, by the
    clock of the stamps, and `stamps` how these deviate from it, None where there are too few.
    `misnamed` says in words which markers are not what their names say. `erring` are
    the deviations of markers that count for less than others, m, by body and name; `wrong` is in
    how many frames a body as a whole was wrong and left out, and `outages` when a body, or '' for
    all, was not seen for a window or more.
    """

    frames: int
    estimates: int
    determined: dict[str, dict[str, float]]
    unreadable: int
    problem: str
    repeated: int
    late: int
    resets: int
    frame_changes: int
    truncated: Truncated | None
    noise: dict[str, float]
    rigidity_residual: dict[str, float]
    causes: dict[str, str]
    noise_underestimated: list[str]
    first: int
    last: int
    absent: dict[str, list[str]]
    identities: tuple[str, ...]
    unknown: dict[str, str]
    concatenated: list[str]
    scene_deviations: 'list[DeviationSummary]'
    scene_positions: 'PositionReport | None'
    space: SpaceReport
    lost: int
    stamps: StampState | None
    misnamed: list[str]
    erring: dict[str, dict[str, float]]
    wrong: dict[str, int]
    outages: dict[str, Outage]
