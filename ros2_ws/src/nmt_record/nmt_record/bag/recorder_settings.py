"""Settings of the recorder node."""

from __future__ import annotations

from dataclasses import dataclass

from nmt_core.nodes.node_settings import NodeSettings
from nmt_core.settings import setting
from nmt_record.bag.bag_writer import COMPRESSIONS
from nmt_record.bag.bench_topics import BENCH_TOPICS


@dataclass(frozen=True)
class RecorderSettings(NodeSettings):
    """What is recorded, where, and when a bag closes."""

    output: str = setting("", "Folder of the first bag, which must not exist; further ones get '-2', '-3', ….")
    topics: tuple[str, ...] = setting(
        tuple(topic.name for topic in BENCH_TOPICS),
        "Topics to record; those that are not of the bench as 'name:package/msg/Type'.",
    )
    bundled: tuple[str, ...] = setting(("",), "Topics taken from the bundles; empty = none.")
    run_json: str = setting("", "Self-description of the run, a JSON object.")
    run_file: str = setting("", "File with the same, instead of run_json.")
    rig_yaml: str = setting("", "The rig file as used, its text.")
    rig_file: str = setting("", "File with the same, instead of rig_yaml.")
    chunk_messages: int = setting(500, "Messages after which a chunk is written.", low=1)
    flush_interval: float = setting(0.5, "Wall time after which a chunk is written.", unit="s", low=0.01)
    compression: str = setting("none", "Compression of the chunks.", choices=tuple(COMPRESSIONS))
    split_bytes: int = setting(
        2**30, "Size after which the bag goes on in another file; 0 = one file.", unit="byte", low=0
    )
    split_duration: float = setting(0.0, "Wall time after which it does so; 0 = one file.", unit="s", low=0.0)
    least_free_mb: int = setting(16, "Space on the disk without which no run can begin.", unit="MB", low=0)
    settle_time: float = setting(0.25, "In real time: silence before the bag of a done run closes.", unit="s", low=0.0)
    patience: float = setting(2.0, "Silence after which missing blocks are given up.", unit="s", low=0.1)
