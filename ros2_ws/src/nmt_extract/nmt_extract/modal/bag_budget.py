"""Uncertainty budget of an extraction from a bag."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.vocabulary import MOTIONS
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.judgement.uncertainty_budget import BudgetInputs, MethodError, PointBudget, uncertainty_budget
from nmt_record.exchange.sidecar.channel_tolerances import is_simulated, tolerances

if TYPE_CHECKING:
    from nmt_record.bag.bag_reader import Bag
    from nmt_record.exchange.sidecar.calibration_file import CalibrationSheet


def bag_budget(
    bag: Bag,
    points: Sequence[ModalPoint],
    linear: LinearDescription,
    settings: ExtractionSettings,
    sheet: CalibrationSheet | None = None,
    method: MethodError | None = None,
    expected: Callable[[float], tuple[float, float]] | None = None,
) -> tuple[list[PointBudget], BudgetInputs]:
    """Budgets of points that were extracted from a bag.

    Args:
        bag: an opened bag.
        points: extracted from it.
        linear: linear modes that were used.
        settings: of the extraction.
        sheet: calibration sheet of the sensors; None = what the bag says, else ordinary tolerances.
        method: error of single-point excitation by a run of a model; None = none, or that of the bag itself.
        expected: modal amplitude (m√kg) -> ω̃ (rad/s) and δ̃ of the nonlinear mode of the rig; a bag that the bench
            simulated tells the method's error by it.

    Raises:
        BenchError: the bag has no response at the points of the linear modes.
    """
    run = bag.run_start or {}
    if method is None and expected is not None and is_simulated(run):
        method = MethodError.of(points, expected)
    inputs = BudgetInputs(
        linear,
        tolerances(run, bag.rig_yaml, sheet),
        _response(bag, linear),
        method,
        settings.sub_windows,
    )
    return uncertainty_budget(points, inputs), inputs


def _response(bag: Bag, linear: LinearDescription) -> Quantity:
    """The kind of sensor that gave the shape: the first that covers all points, as in the extraction."""
    for quantity in MOTIONS:
        if quantity.topic in bag.topics:
            block = next(iter(bag.blocks(quantity.topic)), None)
            if block is not None and set(linear.points) <= set(block.points):
                return quantity
    raise BenchError(f"The bag {bag.path} has no response at all points of the linear modes.")
