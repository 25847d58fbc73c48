"""``./nmt repair``: what can be saved of a damaged or cut bag, as a regular one, and what was lost."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from nmt_bench.commands.output_folder import OutputFolder, check_output
from nmt_bench.commands.shared_options import dated_folder_option, replace_option
from nmt_core.options import argument


@dataclass(frozen=True, kw_only=True)
class RepairOptions:
    """Writes every message that can be read to a regular rosbag2 folder, with a record of the losses, and prints
    it. A damaged chunk costs its own messages only."""

    bag: Path = argument("rosbag2 folder, .mcap file, or the results folder of a run", metavar="BAG")
    out: Path = dated_folder_option("bag/, repair.json", "repair")
    force: bool = replace_option()


def run(options: RepairOptions) -> int:
    """Repair, print what was kept and what was lost.

    Raises:
        BenchError: nothing can be read, or the copy cannot be written.
    """
    check_output(options.out, options.force)

    from nmt_bench.commands.console import make_console
    from nmt_bench.commands.work_display import WorkDisplay
    from nmt_record.bag.bag_reader import Bag

    console = make_console()
    with WorkDisplay(console, ("opening the bag",)), OutputFolder(options.out, options.force) as folder:
        bag = Bag.open(options.bag)
        record = bag.repair_record()
        bag.repair(folder / "bag")
        (folder / "repair.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    if bag.loss:
        console.print(bag.loss, style="yellow", soft_wrap=True)
    else:
        console.print(f"The bag {options.bag} is whole; the copy equals it.", soft_wrap=True)
    kept = ", ".join(f"{count} of {topic}" for topic, count in sorted(record["kept"].items()))
    console.print(f"Kept messages: {kept}.", soft_wrap=True)
    console.print(f"Results in {options.out}: bag, repair.json", soft_wrap=True)
    return 0
