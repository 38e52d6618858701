"""The warnings in the diagnostics of a bag."""

from typing import Any

# Levels of diagnostic_msgs/DiagnosticStatus.
_WARN, _ERROR = 1, 2
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
        if int(status.level) in (_WARN, _ERROR):
            self._warnings.setdefault(f'{status.name.rpartition(": ")[2]}: {status.message}')
