"""The modal point of a window of any kind of test, and that of a window that must not be used."""

from __future__ import annotations

from nmt_core.errors import BenchError
from nmt_core.messages.cdr import bench_time_ns
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.messages.modal_point import ModalPoint
from nmt_core.messages.records import LockEvent
from nmt_core.vocabulary import PointStatus
from nmt_extract.extraction_settings import ExtractionSettings
from nmt_extract.judgement.channel_history import ChannelHistory
from nmt_extract.modal.evaluation import WindowEvaluation
from nmt_extract.modal.free_motion import FreeMotion, is_free_motion
from nmt_extract.modal.window import Window


def modal_point(
    window: Window,
    linear: LinearDescription,
    settings: ExtractionSettings | None = None,
    history: ChannelHistory | None = None,
) -> ModalPoint:
    """Modal properties of a window of any kind of test, with their standard uncertainties.

    Displacements come from displacement sensors if all points of the linear modes have one, else from
    velocity sensors, else from accelerometers. If the window's excitation phase is not known, the frequency
    is fitted to the force.

    Uncertainties: delete-one jackknife over sub-windows of whole periods, see
    :mod:`nmt_extract.judgement.uncertainty`.
    That of the frequency is the scatter of the oscillator's mean frequency over the sub-windows or, for a
    fitted frequency, the uncertainty of the slope of the force's phase over them; ``omega_rad_s_std`` adds
    that phase resonance is met to the phase error only: Δω ≈ δ̃ ω̃ Δφ, and ``frequency_hz_std`` is the same in Hz. The
    uncertainty of the linear shapes is not included.

    Every channel is judged, see :mod:`nmt_extract.judgement`. One that is faulty is left out: what its point does is
    taken from the shape of the last level without a fault, fitted to the other channels. How badly it fits them, and
    how much the result differs with the linear modes in its place, is part of each uncertainty. Without such a level,
    without a force or without a response at the drive point the window is rejected.

    The window as a whole is judged, see :mod:`nmt_extract.judgement.window_judge`: phase, sign of the power, harmonics,
    drift (a slow polynomial is taken out), steadiness, clocks that run apart, drop-outs. No standard uncertainty is
    below what the resolution of the channels allows.

    Args:
        window: from :class:`nmt_extract.modal.window.WindowAssembler`.
        linear: linear modes Φ at the response points.
        settings: None = defaults.
        history: last level without a fault, which a window without one replaces; None = there is none.

    Returns:
        The point; with status ``REJECTED`` and the reason if the window cannot be evaluated. A point with values names
        the channels that were left out, and what was found of the window, as its reason.
    """
    settings = settings or ExtractionSettings()
    try:
        if is_free_motion(window):
            return FreeMotion(window, linear).point()
        return WindowEvaluation(window, linear, settings, history or ChannelHistory()).point()
    except BenchError as error:
        return rejected_point(window.lock, window.sample_rate, str(error))


def rejected_point(lock: LockEvent, sample_rate: float, reason: str) -> ModalPoint:
    """The point of a window that must not be used."""
    return ModalPoint(
        level_index=lock.level_index,
        status=PointStatus.REJECTED,
        reason=reason,
        level=lock.level,
        level_unit=lock.level_unit,
        time_ns=bench_time_ns(max(0, lock.window_end - 1), sample_rate),
        window_first_sample=lock.window_first_sample,
        window_samples=lock.window_samples,
        window_periods=lock.window_periods,
        held_phase=lock.held_phase,
        parameter=lock.parameter,
    )
