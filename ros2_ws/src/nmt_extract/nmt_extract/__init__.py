"""Modal properties from locked windows, linear modal tests and synthesis; extraction node.

Public names, each loaded when it is asked for. From a recording: :func:`extract_bag`, :func:`evaluate_linear_test`;
from its results: :func:`synthesise`, :func:`write_results`, :func:`frf_table`; the rest are their parts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nmt_core.public_names import loaded

if TYPE_CHECKING:
    from nmt_core.messages.modal_point import ModalPoint
    from nmt_core.messages.records import LockEvent
    from nmt_core.vocabulary import PointStatus as Status
    from nmt_extract.extraction_settings import ExtractionSettings
    from nmt_extract.extractor import Extractor
    from nmt_extract.linear.evaluation import LinearTestResult, evaluate_linear_test
    from nmt_extract.linear.file import frf_table
    from nmt_extract.modal.quantities import estimated_mass
    from nmt_extract.modal.table import write_results
    from nmt_extract.modal.window import SpoiledWindow, Window, WindowAssembler
    from nmt_extract.offline import ExtractionResult, extract_bag
    from nmt_extract.synthesis.synthesised_responses import SynthesisResult, synthesise
    from nmt_signals.harmonics import harmonic_amplitudes

__all__ = [
    "ExtractionResult",
    "ExtractionSettings",
    "Extractor",
    "LinearTestResult",
    "LockEvent",
    "ModalPoint",
    "SpoiledWindow",
    "Status",
    "SynthesisResult",
    "Window",
    "WindowAssembler",
    "estimated_mass",
    "evaluate_linear_test",
    "extract_bag",
    "frf_table",
    "harmonic_amplitudes",
    "synthesise",
    "write_results",
]


def __getattr__(name: str) -> Any:
    return loaded(__name__, name)
