"""The words of the bench: every state, flag, kind and unit that its messages know, once.

The values are those of ``nmt_msgs``; a test compares every member with the constants of the message files.
"""

from __future__ import annotations

import math
from enum import IntEnum, IntFlag

from nmt_core.errors import BenchError


class Quantity(IntEnum):
    """What a channel measures; the values are those of ``nmt_msgs/SampleBlock``."""

    UNKNOWN = 0
    FORCE = 1
    DISPLACEMENT = 2
    VELOCITY = 3
    ACCELERATION = 4
    VOLTAGE = 5
    CURRENT = 6

    @property
    def unit(self) -> str:
        """SI unit of the quantity, empty for ``UNKNOWN``."""
        return _UNITS[self]

    def accepts(self, unit: str) -> bool:
        """Whether it is an SI unit of the quantity: its own, that of a rotation in its place, or 1 of a strain."""
        return unit in (self.unit, ROTATION_UNITS.get(self)) or (self is Quantity.DISPLACEMENT and unit == "1")

    @property
    def topic(self) -> str:
        """Name of the topic that carries the quantity."""
        return _TOPICS[self]

    @property
    def letter(self) -> str:
        """Letter that names of its channels begin with; none for ``UNKNOWN``."""
        return "_fxvaui"[self].strip("_")


QUANTITIES = {quantity.letter: quantity for quantity in Quantity if quantity is not Quantity.UNKNOWN}
"""Quantities by the letter that names of their channels begin with."""
MOTIONS = {Quantity.DISPLACEMENT: 0, Quantity.VELOCITY: 1, Quantity.ACCELERATION: 2}
"""Motions, and how many times each is the displacement differentiated by time."""
VELOCITY_LEAD = {motion: (1 - order) * 0.5 * math.pi for motion, order in MOTIONS.items()}
"""Phase by which the velocity of a harmonic vibration leads each motion, rad."""

_TOPICS = {quantity: quantity.name.lower() for quantity in Quantity}
_UNITS = {
    Quantity.UNKNOWN: "",
    Quantity.FORCE: "N",
    Quantity.DISPLACEMENT: "m",
    Quantity.VELOCITY: "m/s",
    Quantity.ACCELERATION: "m/s^2",
    Quantity.VOLTAGE: "V",
    Quantity.CURRENT: "A",
}

ROTATION_UNITS = {
    Quantity.FORCE: "N*m",
    Quantity.DISPLACEMENT: "rad",
    Quantity.VELOCITY: "rad/s",
    Quantity.ACCELERATION: "rad/s^2",
}
"""SI units where an angle stands for a displacement and a torque for a force."""

SAMPLE_TOPICS = tuple(quantity.topic for quantity in Quantity if quantity is not Quantity.UNKNOWN)


class BlockFlag(IntFlag):
    """Flags of a block; the values are those of ``nmt_msgs/SampleBlock``."""

    NONE = 0
    OVERLOAD = 1
    LIMIT = 2
    WATCHDOG = 4
    STOP = 8


class StopCause(IntEnum):
    """What stopped the drive; the values are those of ``nmt_msgs/DriveStop``.

    Attributes:
        LIMIT: a limit of the output or of something measured.
        WATCHDOG: drive commands stopped arriving.
        QUIET: the service ``quiet``.
        EMERGENCY_STOP: the topic ``emergency_stop``.
        EXTERNAL_INPUT: the external stop input of the device.
        OUTPUT: the process that owns the output was not fed, or was fed what it does not put out.
        NODE: another node has gone, a commanded topic has several publishers, or the plant ends.
        DEVICE: the device failed.
        RELEASED: no stop any more; the operator called ``reset``.
    """

    UNKNOWN = 0
    LIMIT = 1
    WATCHDOG = 2
    QUIET = 3
    EMERGENCY_STOP = 4
    EXTERNAL_INPUT = 5
    OUTPUT = 6
    NODE = 7
    DEVICE = 8
    RELEASED = 9


class OutputState(IntEnum):
    """What is known of an output; the values are those of ``nmt_msgs/DriveStop``.

    Attributes:
        NOT_KNOWN: it is unknown.
        AT_ZERO: at zero, ready to follow.
        FOLLOWING: follows what it is fed.
        RAMPING: on its way to zero.
        HELD: at zero until it is released.
        ENDED: at zero and given back.
    """

    NOT_KNOWN = 0
    AT_ZERO = 1
    FOLLOWING = 2
    RAMPING = 3
    HELD = 4
    ENDED = 5


class Waveform(IntEnum):
    """Drive waveform; the values are those of ``nmt_msgs/Drive``."""

    UNKNOWN = 0
    OFF = 1
    SINE = 2
    RANDOM = 3
    SWEEP = 4


class LoopState(IntEnum):
    """State of the loop; the values are those of ``nmt_msgs/Frequency``."""

    UNKNOWN = 0
    FIXED = 1
    ACQUIRING = 2
    LOCKED = 3
    LOCK_LOST = 4


AUTOMATIC = 1
"""Number of controlled harmonics: as many as can be."""


class HarmonicsTarget(IntEnum):
    """What controlled harmonics of the force are brought to; the values are those of ``nmt_msgs/Level``.

    Attributes:
        ZERO: zero; its name for users is ``force``.
        MODAL: the ratio to the fundamental that modal power needs; ``modal``.
    """

    ZERO = 0
    MODAL = 1

    @classmethod
    def named(cls, name: str) -> HarmonicsTarget:
        """Target by its name for users.

        Raises:
            BenchError: no such target.
        """
        targets = {"force": cls.ZERO, "modal": cls.MODAL}
        if name not in targets:
            raise BenchError(f"The harmonics' target '{name}' is not known; use {' or '.join(targets)}.")
        return targets[name]


class ControlKind(IntEnum):
    """What the amplitude of a level is; the values are those of ``nmt_msgs/Level``.

    Attributes:
        UNKNOWN: as recorded before there were others; read as VOLTAGE.
        VOLTAGE: drive voltage, V (RANDOM: V rms).
        RESPONSE: drive-point response, in the unit of its quantity.
        FORCE: fundamental of the force, N.
    """

    UNKNOWN = 0
    VOLTAGE = 1
    RESPONSE = 2
    FORCE = 3

    @classmethod
    def named(cls, name: str) -> ControlKind:
        """Kind by its name in small letters, such as ``response``.

        Raises:
            BenchError: no such kind.
        """
        kinds = {kind.label: kind for kind in cls if kind is not cls.UNKNOWN}
        if name not in kinds:
            raise BenchError(f"Control '{name}' is not known; use {', '.join(kinds)}.")
        return kinds[name]

    @classmethod
    def of_unit(cls, unit: str) -> ControlKind:
        """Kind of a level whose unit is one of ``LEVEL_UNITS``.

        Raises:
            BenchError: no level has this unit.
        """
        if unit not in LEVEL_UNITS:
            raise BenchError(f"A level cannot be in '{unit}'; use {', '.join(LEVEL_UNITS)}.")
        forces = dict.fromkeys((Quantity.FORCE.unit, ROTATION_UNITS[Quantity.FORCE]), cls.FORCE)
        return {Quantity.VOLTAGE.unit: cls.VOLTAGE, **forces}.get(unit, cls.RESPONSE)

    @property
    def label(self) -> str:
        """Name in small letters."""
        return self.name.lower()

    def level_unit(self, response: Quantity = Quantity.UNKNOWN) -> str:
        """Unit of a level.

        Args:
            response: quantity of the drive-point response; UNKNOWN: the unit of a controlled response is not known and
                stays empty.
        """
        if self is ControlKind.RESPONSE:
            return response.unit
        return Quantity.FORCE.unit if self is ControlKind.FORCE else Quantity.VOLTAGE.unit


LEVEL_UNITS = (
    *(quantity.unit for quantity in (Quantity.VOLTAGE, Quantity.FORCE, *MOTIONS)),
    *ROTATION_UNITS.values(),
)
"""Units that a level can have."""


class CurveParameter(IntEnum):
    """What a point of a response curve is held by, next to its amplitude; values as in ``nmt_msgs/Level``.

    Attributes:
        LAG: the phase lag.
        SECANT: a combination of lag and logarithm of the response, where the lag turns back.
        FREQUENCY: the frequency, where the lag turns back and the orbit is stable.
    """

    LAG = 0
    SECANT = 1
    FREQUENCY = 2


class TestKind(IntEnum):
    """Kind of test; values as in ``nmt_msgs/Level`` and ``nmt_msgs/LockEvent``. Its class is in :mod:`nmt_core.kinds`.

    Attributes:
        UNKNOWN: as recorded by benches that knew one kind only; read as PHASE_RESONANCE.
        PHASE_RESONANCE: phase-locked excitation, one window of whole periods at each level.
        RANDOM: band-limited random excitation, one window of a given duration.
        SWEEP: frequency moves at a given rate with an amplitude held; the window is the whole sweep.
        STEPPED_SINE: fixed frequency with an amplitude held; one window of whole periods.
        RING_DOWN: phase-locked excitation that is switched off at the lock; the window is the free decay.
        RECORD: any excitation, in imported data only; the bench does no such test.
        SELF_EXCITED: a motion that the structure feeds by itself is held at an amplitude of the response, or released
            and passed; one window each, of whole periods where it is held.
        SECONDARY_RESONANCE: the phase lag of a resonant order other than that of the force is held; whole periods.
        RESPONSE_CURVE: the phase lag of the response is held and stepped, so that the points follow the response at a
            held force or response amplitude past its folds; whole periods.
    """

    UNKNOWN = 0
    PHASE_RESONANCE = 1
    RANDOM = 2
    SWEEP = 3
    STEPPED_SINE = 4
    RING_DOWN = 5
    RECORD = 6
    SELF_EXCITED = 7
    SECONDARY_RESONANCE = 8
    RESPONSE_CURVE = 9

    @classmethod
    def of(cls, value: int) -> TestKind:
        """Kind of a message's number: UNKNOWN is PHASE_RESONANCE.

        Raises:
            BenchError: no such kind.
        """
        try:
            return cls(value or cls.PHASE_RESONANCE)
        except ValueError:
            raise BenchError(f"Test kind {value} is not known; known are 1 to {max(cls)}.") from None

    @classmethod
    def named(cls, name: str) -> TestKind:
        """Kind by its name in small letters, such as ``ring_down``.

        Raises:
            BenchError: no such kind.
        """
        kinds = {kind.label: kind for kind in cls if kind not in (cls.UNKNOWN, cls.RECORD)}
        if name not in kinds:
            raise BenchError(f"Test '{name}' is not known; use {', '.join(kinds)}.")
        return kinds[name]

    @property
    def label(self) -> str:
        """Name in small letters."""
        return self.name.lower()


TestKind.__test__ = False  # type: ignore[attr-defined]  # not a collection of tests


class PointStatus(IntEnum):
    """What became of a level; the values are those of ``nmt_msgs/ModalPoint``."""

    UNKNOWN = 0
    OK = 1
    REJECTED = 2
    NOT_LOCKED = 3


class RecordKind(IntEnum):
    """Kind of a run record; the values are those of ``nmt_msgs/RunRecord``."""

    UNKNOWN = 0
    START = 1
    STOP = 2


class RunPhase(IntEnum):
    """Phase of a run; the values are those of ``nmt_msgs/RunState``."""

    UNKNOWN = 0
    IDLE = 1
    RUNNING = 2
    PAUSED = 3
    STOPPING = 4
    DONE = 5


class SteeringAct(IntEnum):
    """How a run can be steered; the values are those of ``nmt_msgs/Steering``.

    Attributes:
        PAUSE: the present level is held; in lockstep bench time stands still.
        RESUME: goes on after a pause.
        SKIP_LEVEL: the level is given up and the next one begins.
        REPEAT_LEVEL: the level is measured again after the present one, which is given up if it is that level.
        CHANGE_LEVELS: the levels after the present one are replaced.
        END: the run ends by a ramp to zero.
    """

    UNKNOWN = 0
    PAUSE = 1
    RESUME = 2
    SKIP_LEVEL = 3
    REPEAT_LEVEL = 4
    CHANGE_LEVELS = 5
    END = 6

    @classmethod
    def named(cls, name: str) -> SteeringAct:
        """Act by its name in small letters, such as ``skip_level``.

        Raises:
            BenchError: no such act.
        """
        acts = {act.label: act for act in cls if act is not cls.UNKNOWN}
        if name not in acts:
            raise BenchError(f"A run cannot be steered by '{name}'; use {', '.join(acts)}.")
        return acts[name]

    @property
    def label(self) -> str:
        """Name in small letters."""
        return self.name.lower()


class ResultCode(IntEnum):
    """How a run ended; the values are those of ``nmt_msgs/RunLevels``."""

    UNKNOWN = 0
    SUCCEEDED = 1
    CANCELED = 2
    STOPPED = 3
    LOCK_LOST = 4
    LIMIT = 5
    NODE_LOST = 6
    REFUSED = 7
    INTERNAL_ERROR = 8
    POINTS_MISSING = 9
