"""rosbag2 writer and reader of the bench; recorder node.

Public names: :class:`Bag` reads, :class:`BagWriter` writes. The node is in :mod:`nmt_record.recorder_node`.
"""

from nmt_record.bag_reader import Bag
from nmt_record.bag_writer import BagWriter

__all__ = ["Bag", "BagWriter"]
