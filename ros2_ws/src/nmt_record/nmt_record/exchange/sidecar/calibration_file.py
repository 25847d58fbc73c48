"""Calibration file: the uncertainties of a set-up's sensitivities, as their calibration sheets state them."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from nmt_core.errors import BenchError
from nmt_core.files.validation_sentence import validation_sentence
from nmt_core.files.yaml_document import read_document
from nmt_record.exchange.sidecar.import_sidecar import QuantityName

Share = Annotated[float, Field(ge=0, lt=1)]


class _CalibrationSection(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class CalibratedChannel(_CalibrationSection):
    """A channel of a calibration sheet, or all of a quantity where no point is given.

    Attributes:
        quantity: what it measures.
        point: measurement point.
        gain_std: relative standard uncertainty of the sensitivity (half of the sheet's expanded one, for k = 2).
        phase_std_deg: standard uncertainty of the phase, degrees.
        delay_std_s: standard uncertainty of the delay against the other channels, s.
        calibrated: date of the sheet.
        serial: serial number of the sensor.
        certificate: number of the sheet.
    """

    quantity: QuantityName
    point: Annotated[int, Field(ge=0)] | None = None
    gain_std: Share | None = None
    phase_std_deg: Annotated[float, Field(ge=0, lt=90)] | None = None
    delay_std_s: Annotated[float, Field(ge=0, lt=1)] | None = None
    calibrated: Annotated[datetime.date, Field(strict=False)] | None = None
    serial: str = ""
    certificate: str = ""

    @property
    def source(self) -> str:
        """Where its values come from, for reports."""
        words = [f"serial {self.serial}"] if self.serial else []
        words += [f"certificate {self.certificate}"] if self.certificate else []
        words += [str(self.calibrated)] if self.calibrated else []
        return "calibration sheet" + (f" ({', '.join(words)})" if words else "")


class CalibrationSheet(_CalibrationSection):
    """Sensitivities' uncertainties of a set-up, as their calibration sheets state them.

    Attributes:
        channels: by channel, or by quantity.
        clock_std: relative standard uncertainty of the sampling clock.
        shapes_with_same_sensors: the linear modes were measured with the sensors of the run.
    """

    channels: Annotated[list[CalibratedChannel], Field(min_length=1)]
    clock_std: Share | None = None
    shapes_with_same_sensors: bool = True


def read_calibration(path: Path | str) -> CalibrationSheet:
    """Read a calibration file.

    Raises:
        BenchError: not there, not YAML, or the first thing that is wrong in it, with its line.
    """
    document = read_document(Path(path), "calibration file", "channels")
    try:
        sheet = CalibrationSheet.model_validate(document.values)
    except ValidationError as failure:
        errors = failure.errors(include_url=False)
        raise BenchError(validation_sentence(errors, document, CalibrationSheet, "the calibration")) from failure
    seen: set[tuple[str, int | None]] = set()
    for number, channel in enumerate(sheet.channels):
        if (channel.quantity, channel.point) in seen:
            raise BenchError(
                f"{document.place(('channels', number))}: {channel.quantity} at point {channel.point} stands twice; "
                "leave one out."
            )
        seen.add((channel.quantity, channel.point))
    return sheet
