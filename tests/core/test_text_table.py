"""Tables of parameters as text."""

from __future__ import annotations

from nmt_core.nodes.parameters import Parameter, parameter_table

TABLE = """\
ramp =0.5 (s) 0.0..  Half-cosine
    between levels.
pacing =lockstep lockstep|realtime  What paces the run.
device ="" |simulated  What is driven.
topics =["force","voltage"]  Topics.
blocks =200 (samples) 2..1000  Samples a block.
linked =False  Whether.
"""


def test_parameters_are_those_that_the_table_says() -> None:
    assert parameter_table(TABLE) == (
        Parameter("ramp", 0.5, "s", "Half-cosine between levels.", low=0.0),
        Parameter("pacing", "lockstep", "", "What paces the run.", choices=("lockstep", "realtime")),
        Parameter("device", "", "", "What is driven.", choices=("", "simulated")),
        Parameter("topics", ["force", "voltage"], "", "Topics."),
        Parameter("blocks", 200, "samples", "Samples a block.", low=2, high=1000),
        Parameter("linked", False, "", "Whether."),
    )
