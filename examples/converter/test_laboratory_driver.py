"""Holds the driver to the contract of a converter: python -m pytest test_laboratory_driver.py."""

from pathlib import Path

from nmt_plant.check.converter_contract import check_driver

HERE = Path(__file__).parent
INPUTS = [(1, 5.0), (2, 5.0), (3, 5.0)]


def test_the_driver_keeps_the_contract():
    """The driver keeps it, with an output of zeros."""
    result = check_driver("laboratory_driver:LaboratoryDriver", HERE, 5000.0, [(1, 5.0)], INPUTS)
    assert result.passed, str(result)
