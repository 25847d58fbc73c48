"""One case of a study: a test of a rig under stated conditions, as plain data."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from nmt_core.errors import BenchError

PAPER_JOINT = 8000.0
"""Tangential stiffness of the paper's joint, N/m."""

_EXCITATION = ("test", "frequencies_hz", "rate_hz_s", "frequency_end_hz", "duration", "band_hz")
_PLANNED = (
    "levels", "overrides", "exciter", "seed", "window_periods", "ramp", "timeout", "control", "test", "frequencies_hz",
)  # fmt: skip
_OF_KIND = (
    "strategy", "rate_hz_s", "frequency_end_hz", "duration", "band_hz", "harmonics_control", "harmonics_target",
)  # fmt: skip

JOINT_KEY = "local_elements.0.tangential_stiffness_n_m"


@dataclass(frozen=True)
class StudyCase:
    """A test of the rig and what to compare it with.

    Attributes:
        name: file name of the case: letters, digits, ``_``, ``-`` and ``.``.
        title: how figures and tables call it.
        rig: name of the rig.
        overrides: ``key=value`` texts applied to the rig file.
        exciter: drive point.
        levels: in the order of the test, in the unit of ``control``.
        loop: ``adaptive`` or ``paper``.
        loop_values: further parameters of the loop.
        extract_values: further parameters of the extraction.
        control: ``voltage``, ``response`` or ``force``.
        strategy: ``stepped`` or ``ramp``.
        test: kind of test, see :mod:`nmt_core.kinds`; its settings are the next five.
        frequencies_hz: one for each level; empty where the kind needs none.
        rate_hz_s: sweep rate.
        frequency_end_hz: where a sweep ends.
        duration: of a recorded decay or of random excitation, s.
        band_hz: of random excitation, Hz; None where there is none.
        harmonics_control: harmonics 2 to this one of the force are controlled; 0 = none, ``auto`` = as many as can be.
        harmonics_target: what they are brought to, ``force`` (zero) or ``modal``.
        window_periods: whole periods a window.
        ramp: half-cosine between levels, s.
        timeout: bench time a level may take to lock after its ramp, s.
        seed: seed of all noise.
        harmonics: highest harmonic order of the references.
        epmc: whether to compute the EPMC backbone.
        labels: what distinguishes the case within its study; columns of the table.
    """

    name: str
    title: str
    exciter: int
    levels: tuple[float, ...]
    rig: str = "beam"
    overrides: tuple[str, ...] = ()
    loop: str = "adaptive"
    loop_values: Mapping[str, Any] = field(default_factory=dict)
    extract_values: Mapping[str, Any] = field(default_factory=dict)
    control: str = "voltage"
    strategy: str = "stepped"
    test: str = "phase_resonance"
    frequencies_hz: tuple[float, ...] = ()
    rate_hz_s: float = 0.0
    frequency_end_hz: float = 0.0
    duration: float = 0.0
    band_hz: tuple[float, ...] | None = None
    harmonics_control: int | str = 0
    harmonics_target: str = "force"
    window_periods: int = 200
    ramp: float = 0.5
    timeout: float = 30.0
    seed: int = 1
    harmonics: int = 15
    epmc: bool = True
    labels: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z0-9_.-]+", self.name):
            raise BenchError(f"The case name '{self.name}' must consist of letters, digits, '_', '-' and '.'.")

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for JSON."""
        values: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return values

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> StudyCase:
        """Build from :meth:`to_mapping`.

        Raises:
            BenchError: a key is missing or unknown.
        """
        known = {item.name for item in fields(cls)}
        if unknown := sorted(set(values) - known):
            raise BenchError(f"A case has no '{unknown[0]}'; delete the file to run it again.")
        data = dict(values)
        for name in ("levels", "overrides", "frequencies_hz", "band_hz"):
            if data.get(name) is not None:
                data[name] = tuple(data[name])
        try:
            return cls(**data)
        except TypeError as error:
            raise BenchError(f"A case is not complete: {error}.") from error

    @property
    def planned(self) -> dict[str, Any]:
        """What `plan_test` takes by the same name; of the settings of a kind of test what is not a default."""
        usual = {item.name: item.default for item in fields(self)}
        settings = {name: getattr(self, name) for name in _OF_KIND}
        chosen = {name: value for name, value in settings.items() if value != usual[name]}
        return {name: getattr(self, name) for name in _PLANNED} | chosen

    @property
    def fingerprint(self) -> str:
        """Digest of all that decides the case's result; the title does not."""
        values = {key: value for key, value in self.to_mapping().items() if key not in ("title", "labels")}
        if not self.harmonics_control:
            # Results from before there was control of harmonics stay valid.
            del values["harmonics_control"], values["harmonics_target"]
        if self.band_hz is None:
            # Those from before there was random excitation, too.
            values.pop("band_hz", None)
        if self.test == "phase_resonance":
            # Results from before there were other kinds of test stay valid.
            for name in _EXCITATION:
                values.pop(name, None)
        return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:16]

    @property
    def joint_stiffness(self) -> float:
        """Tangential stiffness of the rig's first joint as overridden, N/m; the paper's if it is not."""
        for text in self.overrides:
            key, _, value = text.partition("=")
            if key == JOINT_KEY:
                return float(value)
        return PAPER_JOINT
