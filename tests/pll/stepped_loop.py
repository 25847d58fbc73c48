"""A loop and a device, block by block: the loop's answer becomes the drive command that the node would publish."""

from __future__ import annotations

from collections.abc import Callable

from nmt_core.messages.blocks import Quantity, SampleBlock
from nmt_plant.devices.simulated_rig import SimulatedRig
from nmt_pll.level_loop import LevelLoop, LoopOutput
from nmt_pll.loop_core import drive_command
from nmt_rig.rig import Rig

Pair = tuple[SampleBlock, SampleBlock]


class SteppedLoop:
    """Blocks pass from the device to the loop and commands back, as in lockstep.

    Args:
        rig: what is simulated.
        loop: made for the device's sample rate and block length.
        response: quantity whose phase is controlled.
        latency_blocks: blocks between command and excitation.
        spoil: changes the pair of blocks before the loop sees them; None drops them.
    """

    def __init__(
        self,
        rig: Rig,
        loop: LevelLoop,
        response: Quantity,
        latency_blocks: int = 0,
        spoil: Callable[[SampleBlock, SampleBlock], Pair | None] | None = None,
    ) -> None:
        self.device = SimulatedRig(rig)
        self.device.configure()
        self.device.start()
        self.loop = loop
        self.response = response
        self.spoil = spoil
        self.delay = latency_blocks * self.device.block_samples
        self.blocks: dict[Quantity, SampleBlock] = {}

    @property
    def next_sample(self) -> int:
        return self.device.next_sample

    def step(self) -> LoopOutput | None:
        """One block through rig and loop; None if it was dropped."""
        self.blocks = {block.quantity: block for block in self.device.read()}
        pair: Pair | None = (self.blocks[Quantity.FORCE], self.blocks[self.response])
        if self.spoil is not None:
            pair = self.spoil(*pair)
        if pair is None:
            return None
        output = self.loop.process(*pair)
        self.device.write(drive_command(output, self.delay))
        return output
