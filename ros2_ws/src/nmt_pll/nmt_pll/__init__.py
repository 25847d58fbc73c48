"""Phase-locked loops for phase resonance testing; the node is in :mod:`nmt_pll.pll_node`."""

from nmt_pll.detection.phase_detector import AdaptiveFourierFilter
from nmt_pll.level_loop import LevelLoop, LockWindow, LoopOutput
from nmt_pll.loop_settings import LoopSettings
from nmt_pll.open_loop.random_drive import RandomDrive
from nmt_pll.phase_loop.gains import ControllerGains, LoopPlant, closed_form_gains
from nmt_pll.phase_loop.loop import PhaseLockedLoop
from nmt_pll.phase_loop.paper_loop import PaperLoop
from nmt_pll.phase_loop.paper_settings import PaperSettings

__all__ = [
    "AdaptiveFourierFilter",
    "ControllerGains",
    "LevelLoop",
    "LockWindow",
    "LoopOutput",
    "LoopPlant",
    "LoopSettings",
    "PaperLoop",
    "PaperSettings",
    "PhaseLockedLoop",
    "RandomDrive",
    "closed_form_gains",
]
