from kinpole_ros.tracking.tracker import Tracker  # noqa
from kinpole_ros.tracking.results import TOO_FEW, NO_POSE, TOO_CLOSE, NOISY_POSES, AMBIGUOUS  # noqa
