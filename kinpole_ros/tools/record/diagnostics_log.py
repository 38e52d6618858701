"""The diagnostics of a node over time: its warnings, and why it withheld what."""

from typing import Any

import numpy as np

from kinpole_ros.messages import RECEIVED, RESTARTS, stamp_to_ns

# Levels of diagnostic_msgs/DiagnosticStatus.
_WARN, _ERROR = 1, 2
_NO_REASON = 'not published'
_MOST_NOTES = 20


class DiagnosticsLog:
    """
    The diagnostics in a bag, message by message.

    `restarted` is whether the node restarted during the recording.
    """

    def __init__(self) -> None:
        self.restarted = False
        self._stamps: list[int] = []
        self._received = 0  # frames, as counted last by the node
        # By body and quantity ('' for all of them), the reason by index of the message.
        self._reasons: dict[tuple[str, str], dict[int, str]] = {}
        self._warnings: dict[str, None] = {}

    @property
    def notes(self) -> tuple[str, ...]:
        """The warnings, each once."""
        return tuple(self._warnings)[:_MOST_NOTES]

    def add(self, message: Any) -> None:
        """Append a DiagnosticArray."""
        for status in message.status:
            self._add_status(status)
        self._stamps.append(stamp_to_ns(message.header.stamp))

    def _add_status(self, status: Any) -> None:
        body, level, text, reasons = parse_status(status)
        for pair in status.values:
            if pair.key == RECEIVED and pair.value.isdecimal():
                self.restarted |= int(pair.value) < self._received
                self._received = int(pair.value)
            elif pair.key.startswith(RESTARTS):
                self.restarted |= pair.value != '0'
        if level in (_WARN, _ERROR):
            self._warnings.setdefault(f'{body}: {text}')
            reasons[''] = text
        for quantity, reason in reasons.items():
            self._reasons.setdefault((body, quantity), {})[len(self._stamps)] = reason

    def reasons(self, body: str, quantity: str, stamp: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Return the reasons (T,) in the next diagnostics where `mask` is set, '' elsewhere."""
        texts = np.full(len(stamp), '', object)
        by_message = self._reasons.get((body.rpartition('/')[2], quantity), {})
        stamps = np.array(self._stamps, np.int64)
        following = np.minimum(stamps.searchsorted(stamp), max(len(stamps) - 1, 0))
        for k in mask.nonzero()[0].tolist():
            texts[k] = by_message.get(int(following[k]), _NO_REASON)
        return texts


def parse_status(status: Any) -> tuple[str, int, str, dict[str, str]]:
    """Return the subject, level and text of a DiagnosticStatus, and reasons by quantity."""
    end = ' undetermined'
    reasons = {p.key.removesuffix(end): p.value for p in status.values if p.key.endswith(end)}
    text = status.message.partition('; undetermined: ')[0]
    return status.name.rpartition(': ')[2], int(status.level), text, reasons
