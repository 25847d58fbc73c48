"""Harmonics and modal properties from locked windows, live and from bags; extraction node."""

from nmt_core.records import LockEvent
from nmt_extract.extractor import Extractor
from nmt_extract.harmonics import harmonic_amplitudes
from nmt_extract.modal import estimated_mass, modal_point
from nmt_extract.modal_point import ModalPoint, Status
from nmt_extract.offline import ExtractionResult, extract_bag
from nmt_extract.settings import ExtractionSettings
from nmt_extract.window import SpoiledWindow, Window, WindowAssembler

__all__ = [
    "ExtractionResult",
    "ExtractionSettings",
    "Extractor",
    "LockEvent",
    "ModalPoint",
    "SpoiledWindow",
    "Status",
    "Window",
    "WindowAssembler",
    "estimated_mass",
    "extract_bag",
    "harmonic_amplitudes",
    "modal_point",
]
