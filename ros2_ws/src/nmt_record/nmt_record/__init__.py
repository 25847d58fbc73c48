"""rosbag2 writer and reader of the bench, the windows of a recording, imports and exports; recorder node.

Public names, each loaded when it is asked for: :class:`Bag` reads, :class:`BagWriter` writes, :func:`export_run` hands
a recording to other tools. Data measured elsewhere become a bag with :func:`nmt_bench.import_data`, which knows rig
files too. The node is in :mod:`nmt_record.bag.recorder_node`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nmt_core.public_names import loaded

if TYPE_CHECKING:
    from nmt_record.bag.bag_reader import Bag
    from nmt_record.bag.bag_writer import BagWriter
    from nmt_record.exchange.export.exported_run import ExportedRun, export_run
    from nmt_record.windows.segments import read_signals

__all__ = [
    "Bag",
    "BagWriter",
    "ExportedRun",
    "export_run",
    "read_signals",
]


def __getattr__(name: str) -> Any:
    return loaded(__name__, name)
