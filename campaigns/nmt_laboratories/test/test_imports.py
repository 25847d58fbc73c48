"""Every module of this package can be imported; nodes where ROS 2 is installed. This is what ``colcon test`` runs."""

from pathlib import Path

from nmt_core.import_check import check_imports


def test_modules_can_be_imported() -> None:
    check_imports(Path(__file__).resolve().parents[1])
