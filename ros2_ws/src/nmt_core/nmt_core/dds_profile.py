"""Settings of the middleware that cannot be made through rclpy."""

from __future__ import annotations

from pathlib import Path

PROFILE = Path(__file__).with_name("fastdds.xml")


def dds_environment() -> dict[str, str]:
    """Environment variables that make Fast DDS read the bench's profile; see the comment in ``fastdds.xml``."""
    return {"FASTRTPS_DEFAULT_PROFILES_FILE": str(PROFILE), "RMW_FASTRTPS_USE_QOS_FROM_XML": "1"}
