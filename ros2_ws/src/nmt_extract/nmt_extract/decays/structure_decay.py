"""Modal properties of the structure alone along a free decay, with its linear modes and the recorded force.

The coordinate of the target mode, of Φ⁺ψ, is read as the channels of :mod:`nmt_extract.decays.free_decay` are. A shaker
that is switched off still adds the mass of table and coil, and its coil, closed over the amplifier, brakes. What it
does is in the force: with F ψ̄_d / q² the result is of the structure; without it it is *apparent*, of structure
and exciter together. q is the norm of Φ⁺ψ, as at phase resonance (paper, eq. 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nmt_core.errors import BenchError
from nmt_core.messages.blocks import Quantity
from nmt_core.messages.linear_description import LinearDescription
from nmt_core.numerics.arrays import ComplexArray, FloatArray
from nmt_core.vocabulary import MOTIONS
from nmt_extract.decays.free_decay import decaying_mode, strongest_ridge
from nmt_record.windows.segments import Signals
from nmt_signals.decays.decay_nodes import Node, ratio_at
from nmt_signals.decays.decay_reading import read_decay
from nmt_signals.decays.decay_signal import demodulated

_AMPLITUDES = 24  # of a decay, at most
_WORST_DAMPING = 0.25  # relative standard uncertainty of the damping ratio at which a decay has reached the noise
_FLOOR = 1e-6  # uncertainty of ln ω below which a narrower band tells nothing more


@dataclass(frozen=True, eq=False)
class Decay:
    """Modal properties along a decay, with standard uncertainties; every array of shape ``(segments,)``.

    Attributes:
        time: middle of each segment after the first sample, s.
        modal_amplitude: q, m√kg.
        omega_rad_s, omega_rad_s_std: ω̃ of the structure, rad/s.
        damping_ratio, damping_ratio_std: δ̃ of the structure.
        apparent_omega_rad_s, apparent_omega_rad_s_std: ω̃ of structure and exciter, rad/s.
        apparent_damping_ratio, apparent_damping_ratio_std: δ̃ of structure and exciter.
    """

    time: FloatArray
    modal_amplitude: FloatArray
    omega_rad_s: FloatArray
    omega_rad_s_std: FloatArray
    damping_ratio: FloatArray
    damping_ratio_std: FloatArray
    apparent_omega_rad_s: FloatArray
    apparent_omega_rad_s_std: FloatArray
    apparent_damping_ratio: FloatArray
    apparent_damping_ratio_std: FloatArray


def structure_decay(signals: Signals, linear: LinearDescription, quantity: Quantity) -> Decay:
    """Modal properties along a recorded free decay.

    Args:
        signals: samples from the switch-off on.
        linear: linear modes at the response points, for q.
        quantity: of the responses: displacement, velocity or acceleration.

    Raises:
        BenchError: a channel is missing, samples are missing, or the decay cannot be read.
    """
    force = signals.named(Quantity.FORCE, linear.drive_point)
    names = [signals.named(quantity, point) for point in linear.points]
    if not force or not all(names):
        raise BenchError(
            f"A ring-down needs the force at point {linear.drive_point} and the {quantity.name.lower()} at the points "
            f"{', '.join(map(str, linear.points))}; the recording has {', '.join(signals.channels)}."
        )
    data = np.stack([signals.channels[name] for name in (force[0], *(row[0] for row in names))])
    return decay_of(data, signals.sample_rate, linear, quantity)


def decay_of(data: FloatArray, sample_rate: float, linear: LinearDescription, quantity: Quantity) -> Decay:
    """Modal properties along a free decay given as an array.

    Args:
        data: force at the drive point, then the responses at the points of ``linear``, shape ``(1 + points, samples)``.
        sample_rate: Hz.
        linear: linear modes at the response points.
        quantity: of the responses.

    Raises:
        BenchError: samples are missing, or the decay cannot be read.
    """
    if not np.all(np.isfinite(data)):
        raise BenchError("Samples are missing in the decay; record it again.")
    order, target = MOTIONS[quantity], linear.target_mode
    data = data - data.mean(axis=1, keepdims=True)
    modal = np.linalg.pinv(linear.shape_matrix) @ data[1:]
    try:
        decay = read_decay(modal[target], sample_rate, quantity, strongest_ridge, _AMPLITUDES, _FLOOR)
    except BenchError as error:
        raise BenchError(f"The decay cannot be read: {error}.") from None
    slow, nodes = decay.slow, decay.good

    def over_target(samples: FloatArray) -> tuple[ComplexArray, FloatArray]:
        """Phasors over the target's at each node, and the standard uncertainty of each part."""
        values = demodulated(samples, slow.cycles, slow.width)[:: slow.stride]
        ratios, relative = zip(*(ratio_at(node, slow, values) for node in nodes), strict=True)
        return np.array(ratios), np.array(relative) * np.abs(ratios)

    others = [over_target(row)[0] for mode, row in enumerate(modal) if mode != target]
    size = np.sqrt(1.0 + sum((np.abs(row) ** 2 for row in others), np.zeros(len(nodes))))
    force, force_std = over_target(data[0])
    drive, drive_std = over_target(data[1 + linear.points.index(linear.drive_point)])
    # The displacement is the response over this operator.
    operator = np.array([complex(-node.rate, node.omega) for node in nodes]) ** order
    pull = operator * force * drive.conj() / size**2
    pull_std = np.abs(operator) * np.hypot(force_std * np.abs(drive), drive_std * np.abs(force)) / size**2
    amplitude = np.array([node.amplitude for node in nodes]) * size / np.abs(operator)
    columns = [np.array([node.time_s for node in nodes]), amplitude]
    for acting, std in ((pull, pull_std), (0.0 * pull, 0.0 * pull_std)):
        columns += _with_uncertainties(nodes, order, acting, std)
    certain = columns[5] < _WORST_DAMPING * np.abs(columns[4])
    if not certain.any():
        raise BenchError("The decay does not stand out of the noise.")
    return Decay(*(column[certain] for column in columns))


def _with_uncertainties(nodes: Sequence[Node], order: int, pull: ComplexArray, std: FloatArray) -> list[FloatArray]:
    """ω̃ and δ̃, each with its standard uncertainty."""
    omega, damping, damping_std = decaying_mode(nodes, order, pull)
    hertz_std = np.array([node.omega_std * node.omega for node in nodes])
    return [omega, np.hypot(hertz_std, 0.5 * std) / omega, damping, np.hypot(damping_std, 0.5 * std / omega**2)]
