"""Time integration of an electromechanical system, block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from nmt_rig.model.assembly import ElectromechanicalSystem
from nmt_rig.model.couplings import COUPLING_PARAMETERS
from nmt_rig.model.exciter import OutputRow
from nmt_rig.model.integration_kernel import (
    CORNERS,
    SUB_STEPS,
    LinearMotion,
    PortForces,
    PortMemory,
    integrate,
    port_forces,
)
from nmt_rig.model.local_elements.element import PARAMETER_COUNT, LocalElement
from nmt_rig.model.local_elements.friction import Jenkins
from nmt_rig.model.propagator import propagator, state_space
from nmt_rig.model.structure import Array

# A corner is timed to step / 2^8; its error in impulse falls with the square of that.
CORNER_LEVELS = 8
_LINE = 8  # numbers


class IntegrationError(ArithmeticError):
    """The motion stopped being finite, or a local force could not be solved for."""


class TimeIntegrator:
    """Steps a system at a fixed sample rate.

    The result for a sample does not depend on the length of the blocks it is computed in, bit for bit.

    Args:
        system: assembled structure, local elements and exciter.
        sample_rate: Hz.
        outputs: rows of the outputs.
        substeps: steps per sample; the input stays straight between samples.
        corner_levels: halvings used to locate a corner of a local element.
        dense: keep the physical state and full transition matrices instead of the modal form (for checks).

    Raises:
        ValueError: a rate or number of steps that is not positive.
    """

    def __init__(
        self,
        system: ElectromechanicalSystem,
        sample_rate: float,
        outputs: Sequence[OutputRow],
        substeps: int = 1,
        corner_levels: int = CORNER_LEVELS,
        dense: bool = False,
    ) -> None:
        if not (np.isfinite(sample_rate) and sample_rate > 0):
            raise ValueError(f"sample_rate must be positive, got {sample_rate}")
        if substeps < 1:
            raise ValueError(f"substeps must be at least 1, got {substeps}")
        self.sample_rate = float(sample_rate)
        self.substeps = int(substeps)
        self._levels = int(corner_levels)
        self._outputs = list(outputs)
        self._dense = bool(dense or system.couplings)
        self._affine = not system.couplings and all(hasattr(element, "piece") for element in _local(system))
        self._take(system)
        elements, couplings = self._space.elements, self._space.couplings
        self._kinds = np.array([element.kind for element in elements], dtype=np.int64)
        self._parameters = np.array([element.parameters for element in elements]).reshape(-1, PARAMETER_COUNT)
        self._coupling_kinds = np.array([coupling.kind for coupling in couplings], dtype=np.int64)
        self._coupling_parameters = np.array([coupling.parameters for coupling in couplings]).reshape(
            -1, COUPLING_PARAMETERS
        )
        self._history = np.empty((0, 0))
        self._force_history = np.empty((0, 0))
        self.reset()

    def _take(self, system: ElectromechanicalSystem) -> None:
        """Matrices of `system`; the state stays as it is."""
        self.system = system
        self._space = state_space(system)
        self._propagator = propagator(self._space, 1.0 / (self.sample_rate * self.substeps), self._levels, self._dense)
        c, self._d_ports, self._d_inputs = self._space.output(self._outputs)
        self._c = np.ascontiguousarray(c @ self._propagator.from_working)
        self.__dict__.pop("_tables", None)

    @property
    def _acting(self) -> PortForces:
        return PortForces(
            self._kinds, self._parameters, self._space.element_port, self._coupling_kinds, self._coupling_parameters,
            self._affine,
        )  # fmt: skip

    @cached_property
    def _tables(self) -> tuple[tuple[Any, ...], tuple[Any, ...], tuple[Array, Array, Array]]:
        """`LinearMotion`, `PortForces` and `OutputMatrices` of the last state, as plain tuples."""
        p = self._propagator
        motion = LinearMotion(
            p.modal, p.pair, p.dense, p.start_weights, p.end_weights, p.port_rows, p.port_inputs, p.compliance,
        )  # fmt: skip
        return tuple(motion), tuple(self._acting), (self._c, self._d_ports, self._d_inputs)

    def change(self, system: ElectromechanicalSystem) -> None:
        """Go on with slightly different matrices or parameters of elements; motion and memory stay as they are.

        Raises:
            ValueError: a system of other unknowns or elements.
        """
        before = self.system
        kinds = [element.kind for element in system.elements]
        if system.size != before.size or kinds != [element.kind for element in before.elements]:
            raise ValueError("only a system of the same unknowns and elements can be changed to")
        physical = self.physical_state
        same = all(
            np.array_equal(getattr(system, name), getattr(before, name)) for name in ("mass", "damping", "stiffness")
        ) and [e.linear_stiffness for e in system.elements] == [e.linear_stiffness for e in before.elements]
        if same:
            self.system = system
            self._space = replace(self._space, elements=tuple(_local(system)))
        else:
            self._take(system)
            # A new array: the modal form may have another size.
            self._state = self._propagator.to_working @ physical
            self._history = np.empty((0, 0))
        for row, element in enumerate(self._space.elements):
            self._parameters[row] = element.parameters

    def reset(self) -> None:
        """Return to rest at time zero, sliders at zero."""
        p, n = self._propagator, self._kinds.size
        ports = p.port_feedthrough.shape[1]
        self._state = np.zeros(p.to_working.shape[0])
        self._memory = PortMemory(
            np.zeros(2 * ports),
            np.zeros(p.port_rows.shape[0]),
            np.zeros(n, dtype=np.int64),
            np.zeros(n),
            np.zeros(n),
            np.zeros(2, dtype=np.int64),
        )
        self._settle_branches()
        self.samples = 0

    def _settle_branches(self) -> None:
        """Branches, forces and kinematics that fit the present state (sliders yield where they must)."""
        p = self._propagator
        forces, kinematics, branch, slider, _, _ = self._memory
        total = forces.size // 2
        ports = self._space.directions.shape[0]
        if total == 0:
            return
        kinematics[:] = p.port_rows @ self._state
        forces[:] = 0.0
        for e, element in enumerate(self._space.elements):
            q = self._space.element_port[e]
            w, v = kinematics[q], kinematics[ports + q]
            branch[e] = 0
            if isinstance(element, Jenkins):
                reach = element.slip_force / element.tangential_stiffness
                if abs(w - slider[e]) > reach:
                    side = 1 if w > slider[e] else -1
                    slider[e] = w - side * reach
                    branch[e] = side if side * v > 0 else 0
            elif hasattr(element, "next_branch"):
                branch[e] = element.next_branch(*element.values, 0, w, v, 0.0)
        # Twice: the accelerations in the slopes depend on the forces.
        for _ in range(2):
            port_forces(self._acting, branch, slider, kinematics, forces, np.zeros((total, 2)))
            kinematics[:] = p.port_rows @ self._state + p.port_feedthrough @ forces[:total]

    def advance(self, inputs: Array) -> Array:
        """Integrate over one block.

        Args:
            inputs: (exciters, n + 1) input of each exciter at the n samples of the block and at the first of the next,
                straight between; of one exciter (n + 1,) will do.

        Returns:
            (outputs, n) outputs at the n samples; the state moves on to the next block's first sample.

        Raises:
            IntegrationError: the motion is not finite any more.
            ValueError: inputs of a wrong shape or not finite.
        """
        inputs = np.ascontiguousarray(inputs, dtype=np.float64)
        if inputs.ndim == 1:
            inputs = inputs[None, :]
        exciters = tuple(range(len(self.system.exciters)))
        if inputs.ndim != 2 or inputs.shape[0] != len(exciters) or inputs.size < 1:
            raise ValueError(f"inputs must be of shape ({len(exciters)}, 1 or more), got {inputs.shape}")
        if not np.isfinite(inputs).all():
            raise ValueError("inputs must be finite")
        n = inputs.shape[1] - 1
        p = self._propagator
        if self._history.shape[1] < n:
            # Rows an odd number of cache lines apart: at a power of two a sample's values share one place of the cache.
            width = n + (_LINE - n) % (2 * _LINE)
            self._history = np.empty((self._state.size, width))
            self._force_history = np.empty((p.port_feedthrough.shape[1], width))
        result = np.empty((self._c.shape[0], n))
        try:
            good = integrate(
                *self._tables,
                tuple(self._memory),
                exciters,
                self.substeps,
                inputs,
                self._state,
                self._history,
                self._force_history,
                result,
            )
        except ZeroDivisionError:  # a force without bound has no slope
            good = False
        self.samples += n
        if not good:
            raise IntegrationError(
                f"the motion is not finite near sample {self.samples}; check the local elements' parameters"
            )
        return result

    @property
    def modal(self) -> bool:
        """Whether the state is kept in modal form."""
        return self._propagator.modal

    @property
    def physical_state(self) -> Array:
        """Present state: displacements (m,), velocities (m,), current if any."""
        result: Array = self._propagator.from_working @ self._state
        return result

    @property
    def slider_dissipation(self) -> Array:
        """(elements,) energy lost in the sliders of Jenkins elements since the start, J; 0 for others."""
        return self._memory.dissipated.copy()

    @property
    def steps(self) -> int:
        """Sub-steps taken since the start."""
        return int(self._memory.counters[SUB_STEPS])

    @property
    def corners(self) -> int:
        """Corners of local elements passed since the start."""
        return int(self._memory.counters[CORNERS])


def _local(system: ElectromechanicalSystem) -> list[LocalElement]:
    """Elements that are not part of the linear motion."""
    return [element for element in system.elements if not element.linear]
