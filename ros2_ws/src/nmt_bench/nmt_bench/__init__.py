"""Rig files, command line, run orchestration, launch-free harness, reports.

Import what you need from its module, so that ``./nmt --help`` loads none of it:

* :mod:`nmt_bench.harness`: ``Bench``, the nodes from Python.
* :mod:`nmt_bench.cli`: the commands; one module each, ``*_command``.
* :mod:`nmt_report.run_report`: ``report_data_from_bag``, ``write_report``.
* :mod:`nmt_study`: the paper's studies.
"""
