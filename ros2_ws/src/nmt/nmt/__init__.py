"""Results and functions of the bench for analysts; no ROS needed.

    import nmt

    run = nmt.open("out/demo")
    run.to_dataframe()
    run.plot()

:func:`open` reads the results folder of any command. The functions do what the commands of their names do and return
objects; they print nothing and write nothing unless asked. Everything is loaded when it is asked for.

A diagnosis, here of two effects only, compares a rig file with recordings:

>>> from nmt_diagnose.diagnose import DiagnosisSettings
>>> few = DiagnosisSettings(withheld=OTHERS, jobs=1, allow_own_model=True)
>>> diagnosis = nmt.diagnose("out/demo/rig.yaml", ["out/demo"], settings=few).diagnosis
>>> diagnosis.verdict.name
'NONE'
>>> nmt.open("out/diagnosis").verdict
'effect'
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nmt_core.public_names import loaded

if TYPE_CHECKING:
    from nmt.opening import open
    from nmt.reference_result import ReferenceResult
    from nmt.results import DiagnosisResult, FrequencyResponses, LinearResult, Results, RunResults
    from nmt.table_result import TableResult
    from nmt_bench.data_import import import_data
    from nmt_core.errors import BenchError
    from nmt_diagnose.diagnose import diagnose_bags as diagnose
    from nmt_extract.linear.evaluation import evaluate_linear_test as linear
    from nmt_extract.offline import extract_bag as extract
    from nmt_extract.synthesis.synthesised_responses import synthesise
    from nmt_record.bag.bag_reader import Bag
    from nmt_report.figure_files import write_figures
    from nmt_rig.reference import compute_reference as reference
    from nmt_rig.rig import load_rig

__all__ = [
    "Bag",
    "BenchError",
    "DiagnosisResult",
    "FrequencyResponses",
    "LinearResult",
    "ReferenceResult",
    "Results",
    "RunResults",
    "TableResult",
    "diagnose",
    "extract",
    "import_data",
    "linear",
    "load_rig",
    "open",
    "reference",
    "synthesise",
    "write_figures",
]


def __getattr__(name: str) -> Any:
    return loaded(__name__, name)


def __dir__() -> list[str]:
    return __all__
