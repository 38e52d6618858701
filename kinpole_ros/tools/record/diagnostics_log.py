"""The warnings in the diagnostics of a bag."""

from typing import Any

from kinpole_ros.findings import ERROR, WARN, finding_of
from kinpole_ros.messages import FINDING

_MOST_NOTES = 20


class DiagnosticsLog:
    """The warnings in the diagnostics of a bag, message by message."""

    def __init__(self) -> None:
        self._warnings: dict[str, None] = {}

    @property
    def notes(self) -> tuple[str, ...]:
        """The warnings, each once."""
        return tuple(self._warnings)[:_MOST_NOTES]

    def add(self, message: Any) -> None:
        """Append a DiagnosticArray."""
        for status in message.status:
            self.add_status(status)

    def add_status(self, status: Any) -> None:
        """Append a DiagnosticStatus."""
        for pair in status.values:
            if pair.key.startswith(FINDING):
                finding = finding_of(pair.value)
                if finding.level in (WARN, ERROR):
                    subject = finding.subject or 'markers'
                    self._warnings.setdefault(f'{subject}: {finding.words()}')
