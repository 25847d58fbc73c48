"""Drive watchdog: trips when blocks pass without a command while the drive is on."""

from __future__ import annotations


class DriveWatchdog:
    """Counts blocks since the last command.

    Args:
        blocks: blocks without a command that trip; 0 turns the watchdog off.
    """

    def __init__(self, blocks: int) -> None:
        self.blocks = blocks
        self.missed = 0

    def command(self) -> None:
        """A command arrived."""
        self.missed = 0

    def block(self, drive_is_on: bool) -> bool:
        """A block passed; True while tripped. A drive at zero never trips."""
        if not drive_is_on and self.missed < self.blocks:
            self.missed = 0
            return False
        self.missed += 1
        return self.tripped

    @property
    def tripped(self) -> bool:
        """Whether `blocks` blocks have passed since the last command."""
        return 0 < self.blocks <= self.missed
