"""Settings of the extraction and of its node; the former travel as the ``extraction`` entry of a run's description."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.nodes.node_settings import NodeSettings
from nmt_core.settings import group, setting
from nmt_extract.modal.hysteresis import HysteresisLayout

_TOPICS = tuple(quantity.topic for quantity in Quantity if quantity is not Quantity.UNKNOWN)


@dataclass(frozen=True)
class ExtractionSettings:
    """How windows become modal points.

    Attributes:
        harmonics: H: harmonics 0..H are extracted (fewer where the sampling rate does not resolve them).
        topics: sample topics that must be complete over a window; ``force`` and at least one response.
        sub_windows: K, sub-windows for the standard uncertainties.
        minimum_periods: windows of fewer whole periods are rejected.
        power_balance: the level may still change over a window: frequency, damping and amplitude from the balance of
            power instead of a steady state.
        hysteresis: masses and points of a chain of three masses; None = no hysteresis damping.
    """

    harmonics: int = setting(10, "Number of harmonics H; 0..H are extracted.", low=1, high=200)
    topics: tuple[str, ...] = setting(
        ("force", "acceleration"), "Sample topics a window needs: force and the rig's response topics."
    )
    sub_windows: int = setting(10, "Sub-windows for the standard uncertainties.", low=3, high=1000)
    minimum_periods: int = setting(3, "Windows of fewer whole periods are rejected.", unit="periods", low=3)
    power_balance: bool = setting(False, "Balance of power for windows whose level still changes.")
    hysteresis: HysteresisLayout | None = None

    def __post_init__(self) -> None:
        for name, low, high in (
            ("harmonics", 1, 200),
            ("sub_windows", 3, 1000),
            ("minimum_periods", 3, 10**9),
        ):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
                raise BenchError(f"Extraction setting '{name}' must be a whole number in {low}..{high}, got {value!r}.")
        if not isinstance(self.power_balance, bool):
            raise BenchError(f"Extraction setting 'power_balance' must be true or false, got {self.power_balance!r}.")
        unknown = [topic for topic in self.topics if topic not in _TOPICS]
        if unknown or len(set(self.topics)) != len(self.topics):
            raise BenchError(
                f"Extraction setting 'topics' must list different topics out of {', '.join(_TOPICS)}, "
                f"got {', '.join(map(repr, self.topics))}."
            )
        if "force" not in self.topics or not {"displacement", "velocity", "acceleration"} & set(self.topics):
            raise BenchError(
                "Extraction setting 'topics' must hold force and one of displacement, velocity, acceleration."
            )

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for JSON."""
        values = asdict(self)
        values["topics"] = list(self.topics)
        values["hysteresis"] = None if self.hysteresis is None else self.hysteresis.to_mapping()
        return values

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> ExtractionSettings:
        """Build from parsed JSON.

        Raises:
            BenchError: a key is unknown or a value not acceptable.
        """
        known = {field.name for field in fields(cls)}
        for key in values:
            if key not in known:
                raise BenchError(f"Extraction setting '{key}' is not known; there are {', '.join(sorted(known))}.")
        data = dict(values)
        if "topics" in data:
            if not isinstance(data["topics"], (list, tuple)) or not all(isinstance(t, str) for t in data["topics"]):
                raise BenchError(f"Extraction setting 'topics' must be a list of names, got {data['topics']!r}.")
            data["topics"] = tuple(data["topics"])
        if data.get("hysteresis") is not None:
            data["hysteresis"] = HysteresisLayout.from_mapping(data["hysteresis"])
        return cls(**data)


@dataclass(frozen=True)
class ExtractSettings(NodeSettings):
    """What the extraction node needs to know: the linear description, and how windows become points."""

    linear_json: str = setting("", "Linear description (linear.json); empty = no extraction.")
    extraction: ExtractionSettings = group(ExtractionSettings)
    bundled: tuple[str, ...] = setting(("",), "Topics taken from the bundles; empty = none.")
    hysteresis_json: str = setting("", "Masses and points of the three-mass chain as JSON; empty = none.")
    rig: str = setting("", "Name of the rig, for the log.")

    @property
    def whole_extraction(self) -> ExtractionSettings:
        """Settings of the extraction with the layout that is given as JSON.

        Raises:
            BenchError: it is not a layout.
        """
        if not self.hysteresis_json:
            return self.extraction
        try:
            layout = json.loads(self.hysteresis_json)
        except json.JSONDecodeError as error:
            raise BenchError(f"Parameter 'hysteresis_json' of extract is not JSON: {error}.") from error
        if not isinstance(layout, dict):
            raise BenchError("Parameter 'hysteresis_json' of extract must be a JSON object.")
        return replace(self.extraction, hysteresis=HysteresisLayout.from_mapping(layout))
