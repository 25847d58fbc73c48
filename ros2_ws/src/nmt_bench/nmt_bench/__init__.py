"""Rig files, command line, run orchestration, launch-free harness, reports."""
