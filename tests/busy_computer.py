"""Tests on converters in real time, again where the computer was too busy for them."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ATTEMPTS = 3  # a busy computer loses samples of its own; such a test shows nothing
BUSY = "it loses samples again and again"


def on_a_quiet_computer(environment: Callable[[Path], dict[str, str]]) -> Callable[[Any], Any]:
    """Do a test again, up to three times in all, where the converter did not start because the computer was busy.

    Args:
        environment: variables to set, by the folder of the attempt; that folder is the test's ``tmp_path``.
    """

    def repeated(test: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(test)
        def again(tmp_path: Path, **given: Any) -> None:
            for turn in range(1, ATTEMPTS + 1):
                folder = tmp_path / f"turn-{turn}"
                folder.mkdir()
                try:
                    with pytest.MonkeyPatch.context() as patch:
                        for name, value in environment(folder).items():
                            patch.setenv(name, value)
                        return test(tmp_path=folder, **given)
                except Exception as error:
                    if BUSY not in str(error) or turn == ATTEMPTS:
                        raise

        return again

    return repeated
