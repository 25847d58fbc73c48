"""Sample blocks, error type, ramps, parameter tables and the node base shared by the bench's nodes.

Vocabulary, errors and the base of the nodes stand here; the rest by theme: :mod:`nmt_core.messages`,
:mod:`nmt_core.nodes`, :mod:`nmt_core.processes`, :mod:`nmt_core.files`, :mod:`nmt_core.text`, :mod:`nmt_core.numerics`.

Public names, each loaded when it is asked for, so that a command line that only prints its help loads no numpy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nmt_core.public_names import loaded

if TYPE_CHECKING:
    from nmt_core.errors import BenchError
    from nmt_core.messages.blocks import OscillatorPhase, SampleBlock
    from nmt_core.nodes.parameters import Parameter
    from nmt_core.vocabulary import BlockFlag, Quantity

__all__ = ["BenchError", "BlockFlag", "OscillatorPhase", "Parameter", "Quantity", "SampleBlock"]


def __getattr__(name: str) -> Any:
    return loaded(__name__, name)
