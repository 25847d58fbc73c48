"""A laboratory's driver as a converter: ``device.kind: custom``.

The driver is a class of any module; it needs nothing of this package. It is made as ``Class(sample_rate, outputs,
inputs, **arguments)``, where outputs and inputs are (port, range in V) each, and has

* ``exchange(volts)``: put out (outputs, n) volts at the ports, return (inputs, n) volts at the ports when the device
  has taken them, or that array and whether samples were lost;
* ``close()``: release the device, its output at zero; may be called twice.

It may have ``delay`` and ``stated`` (samples), ``chunk_samples`` and ``stop_requested()`` of
:class:`nmt_plant.converters.converter.Converter`, whose meaning they share. A driver with a callback
has ``run(turn)`` in place of ``exchange``.

It is loaded in the process that owns the output and nowhere else: behind the same guard, ramp and watch as every other
converter. What it gives is looked at in each turn.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.numerics.arrays import FloatArray
from nmt_plant.converters.converter import Converter, Taken, Turn

if TYPE_CHECKING:
    from nmt_rig.device_sections import CustomSection
    from nmt_rig.rig import Rig

_TURN_TIME = 0.01  # s of a turn of a driver that says nothing


def load_driver(converter: str, folder: str) -> Callable[..., Any]:
    """The class of a driver.

    Args:
        converter: ``module:Class``.
        folder: where the module is searched for first; empty = Python's own places only.

    Raises:
        BenchError: no such module or class exists, or it cannot be imported.
    """
    module, _, name = converter.partition(":")
    if folder and folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        loaded = importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is not None and module.split(".")[0] == error.name.split(".")[0]:
            where = f"in {folder} and " if folder else ""
            raise BenchError(
                f"device.converter: there is no module {module} {where}on Python's path; look at device.folder."
            ) from error
        raise BenchError(
            f"device.converter: {module} needs the package {error.name}, which is not installed."
        ) from error
    except Exception as error:  # a module of somebody else raises whatever it likes
        raise BenchError(f"device.converter: {module} cannot be imported: {_words(error)}.") from error
    factory = getattr(loaded, name, None)
    if not callable(factory):
        classes = sorted(key for key, value in vars(loaded).items() if inspect.isclass(value))
        raise BenchError(f"device.converter: {module} has no class {name}; it has {', '.join(classes) or 'none'}.")
    return factory  # type: ignore[no-any-return]


def find_rig_driver(section: CustomSection, rig: Rig) -> None:
    """Refuse a driver whose module is not there; nothing of it is executed.

    Raises:
        BenchError: no such module exists.
    """
    module = section.converter.partition(":")[0].split(".")[0]
    module_folder = Path(section.folder)
    if (module_folder / f"{module}.py").is_file() or (module_folder / module).is_dir():
        return
    if importlib.util.find_spec(module) is None:
        raise BenchError(
            f"device.converter: there is no module {module} in {section.folder} and on Python's path; look at "
            "device.folder."
        )


class CustomConverter(Converter):
    """A driver behind the contract of a converter, which looks at all that it gives.

    Args:
        converter, folder: of :func:`load_driver`.
        sample_rate: Hz.
        outputs: (port, range in V, amplifier gain) of each.
        inputs: (port, range in V) of each.
        arguments: other keyword arguments of the driver.

    Raises:
        BenchError: the driver cannot be loaded or made, or lacks a method.
    """

    def __init__(
        self,
        converter: str,
        folder: str,
        sample_rate: float,
        outputs: Sequence[Sequence[Any]],
        inputs: Sequence[Sequence[Any]],
        arguments: Mapping[str, Any],
    ) -> None:
        self._name = converter.partition(":")[2]
        factory = load_driver(converter, folder)
        given = {
            "sample_rate": sample_rate,
            "outputs": [(port, float(reach)) for port, reach, _ in outputs],
            "inputs": [(port, float(reach)) for port, reach in inputs],
            **arguments,
        }
        try:
            inspect.signature(factory).bind(**given)
        except TypeError as error:
            raise BenchError(
                f"device.arguments do not fit {self._name}(sample_rate, outputs, inputs, ...): {error}."
            ) from error
        try:
            self._driver = factory(**given)
        except BenchError:
            raise
        except Exception as error:  # a driver of somebody else raises whatever it likes
            raise BenchError(f"The driver {self._name} does not start: {_words(error)}.") from error
        self._by_callback = self._has("run")
        lacking = [name for name in ("close",) if not self._has(name)]
        lacking += [] if self._by_callback or self._has("exchange") else ["exchange (or run)"]
        if lacking:
            raise BenchError(f"The driver {self._name} has no method {' and no method '.join(lacking)}; write it.")
        self._gain = np.array([[float(gain)] for *_, gain in outputs])
        self.outputs, self.inputs = len(outputs), len(inputs)
        self.delay = self._samples("delay", -1)
        self.stated = self._samples("stated", -1)
        self.chunk_samples = self._samples("chunk_samples", max(1, round(_TURN_TIME * sample_rate)))

    def _has(self, method: str) -> bool:
        """Whether the driver has a method of its own, not that of the base class."""
        return callable(getattr(self._driver, method, None)) and getattr(type(self._driver), method, None) not in (
            Converter.run, Converter.exchange,
        )  # fmt: skip

    def _samples(self, name: str, otherwise: int) -> int:
        value = getattr(self._driver, name, otherwise)
        try:
            return int(value)
        except (TypeError, ValueError):
            raise BenchError(f"{self._name}.{name} is {value!r}; it must be a number of samples.") from None

    def run(self, turn: Turn) -> None:
        """Put out and measure until ``turn`` gives None."""

        def ask(count: int, measured: Any = None) -> FloatArray | None:
            values = turn(count, None if measured is None else self._taken(measured))
            self.stated, self.delay = self._samples("stated", -1), self._samples("delay", -1)
            return None if values is None else values / self._gain

        if self._by_callback:
            self._driver.run(ask)
            return
        measured = None
        while (values := ask(self.chunk_samples, measured)) is not None:
            measured = self._driver.exchange(values)
            if measured is None and self.inputs:
                raise BenchError(f"{self._name}.exchange gave nothing; it must give ({self.inputs}, samples) volts.")

    def _taken(self, measured: Any) -> Taken:
        values, lost = measured if isinstance(measured, tuple) else (measured, False)
        try:
            volts = np.array(values, dtype=np.float64)  # a copy: a driver may use its buffer again
        except (TypeError, ValueError):
            raise BenchError(f"{self._name} gave {type(values).__name__}, no array of volts.") from None
        if volts.ndim != 2 or volts.shape[0] != self.inputs:
            raise BenchError(f"{self._name} gave an array of shape {volts.shape}; it must be ({self.inputs}, samples).")
        if not np.isfinite(volts).all():
            raise BenchError(f"{self._name} gave volts that are not finite.")
        return Taken(volts, bool(lost))

    def stop_requested(self) -> bool:
        """Whether the driver says that an external stop input asks for zero."""
        asked = getattr(self._driver, "stop_requested", None)
        return bool(asked()) if callable(asked) else False

    def close(self) -> None:
        """Release the device."""
        self._driver.close()


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".rstrip(": .")
