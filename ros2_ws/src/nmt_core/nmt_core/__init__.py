"""Sample blocks, error type, ramps, parameter tables and the node base shared by the bench's nodes."""

from nmt_core.blocks import OscillatorPhase, SampleBlock
from nmt_core.errors import BenchError
from nmt_core.parameters import Parameter
from nmt_core.vocabulary import BlockFlag, Quantity

__all__ = ["BenchError", "BlockFlag", "OscillatorPhase", "Parameter", "Quantity", "SampleBlock"]
