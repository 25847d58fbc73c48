"""A driver to start from: the class that a rig file names as ``device.converter``.

It stands for a device with three inputs, and answers as a mass on a hardening spring does. Put the calls of your device
in place of what is marked; nothing here needs nmt. `test_laboratory_driver.py` holds it to the contract.
"""

import math
import time

import numpy as np


class LaboratoryDriver:
    """One output that drives a mass, inputs for force, acceleration and the output itself.

    Args:
        sample_rate: Hz, of all channels.
        outputs, inputs: (port, range in V) of each, as in the rig file.
        mass_kg, frequency_hz, damping_ratio, cubic_n_m3: of the mass. Everything behind the first three comes from
            ``device.arguments`` of the rig file.
        newton_per_volt: force for a volt at the output.
        sensitivities_v: volts at the inputs for a newton, a m/s² and a volt.

    Attributes:
        delay: samples between the input of an index and that under which the output of the same index acts; negative =
            not known, then it is measured at each start, by an input that measures the output.
    """

    delay = 0

    def __init__(
        self,
        sample_rate,
        outputs,
        inputs,
        mass_kg=1.0,
        frequency_hz=20.0,
        damping_ratio=0.02,
        cubic_n_m3=0.0,
        newton_per_volt=1.0,
        sensitivities_v=(0.5, 0.1, 1.0),
    ):
        if len(outputs) != 1 or len(inputs) != 3:
            raise ValueError(f"it has one output and three inputs, not {len(outputs)} and {len(inputs)}")
        # Your device: open it here, with its output at zero, all channels on one clock, at sample_rate.
        self._rate = sample_rate
        self._omega = 2.0 * math.pi * frequency_hz
        self._mass, self._damping, self._cubic = mass_kg, damping_ratio, cubic_n_m3 / mass_kg
        self._newton_per_volt = newton_per_volt
        self._sensitivities = np.array(sensitivities_v, dtype=float)[:, np.newaxis]
        self._state = (0.0, 0.0)
        self._due = time.monotonic()

    def exchange(self, volts):
        """Put out the samples; return when they have been taken, with what was measured meanwhile.

        Args:
            volts: at the output's port, shape (outputs, n).

        Returns:
            Volts at the inputs' ports, shape (inputs, n). Give (volts, True) where samples were lost.
        """
        # Your device: write the samples, wait until it has taken them, read as many.
        measured = self._answer(volts[0])
        self._due = max(self._due, time.monotonic() - 0.05) + volts.shape[1] / self._rate
        time.sleep(max(0.0, self._due - time.monotonic()))
        return measured

    def close(self):
        """Release the device, its output at zero; may be called twice."""

    def _answer(self, volts):
        """Force, acceleration and output of the mass, x'' + 2 D w x' + w² x + c x³ = F / m, by leapfrog steps."""
        step, (x, v) = 1.0 / self._rate, self._state
        accelerations = []
        for force in self._newton_per_volt * volts / self._mass:
            # The damping force is implicit in the velocity at the middle of the step.
            a = (force - 2.0 * self._damping * self._omega * v - self._omega**2 * x - self._cubic * x**3) / (
                1.0 + self._damping * self._omega * step
            )
            v += step * a
            x += step * v
            accelerations.append(a)
        self._state = (x, v)
        return self._sensitivities * np.array([self._newton_per_volt * volts, accelerations, volts])
