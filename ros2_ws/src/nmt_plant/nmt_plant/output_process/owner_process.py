"""The process in which `output_owner` works, as the side that feeds it sees it."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from nmt_plant.output_process.output_owner import OwnerSettings
from nmt_plant.output_process.shared_samples import SharedSamples

_EXCEPTION = re.compile(r"^(?:\w+\.)*\w*(?:Error|Exception): ")


class OwnerProcess:
    """Starts it.

    Args:
        settings: how the output is owned.
        channel: the owner's end of the socket (SOCK_SEQPACKET).
        samples: the shared memory.
        converter: ``module:class`` of the converter.
        arguments: keyword arguments of the converter, as JSON allows them.
        stop_input: descriptor of an external stop line; None = there is none.

    Attributes:
        pid: process id.
    """

    def __init__(
        self,
        settings: OwnerSettings,
        channel: socket.socket,
        samples: SharedSamples,
        converter: str,
        arguments: Mapping[str, Any],
        stop_input: int | None,
    ) -> None:
        descriptors = [channel.fileno(), samples.descriptor, *([] if stop_input is None else [stop_input])]
        command = [
            sys.executable,
            "-m",
            "nmt_plant.output_process.output_owner",
            *(str(number) for number in descriptors[:2]),
        ]
        command += [json.dumps(asdict(settings)), converter, json.dumps(arguments)]
        command += [str(number) for number in descriptors[2:]]
        self._process = subprocess.Popen(
            command,
            pass_fds=descriptors,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)},
            start_new_session=True,  # a terminal's signals are for the feeding side
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        self.pid = self._process.pid

    @property
    def has_ended(self) -> bool:
        """Whether it is not there any more."""
        return self._process.poll() is not None

    def wait(self, seconds: float) -> bool:
        """Wait for its end for at most so many seconds; whether it has come."""
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            return False
        return True

    def kill(self) -> None:
        """End it at once, also where it is stopped."""
        self._process.kill()
        self._process.wait()

    def last_words(self) -> str:
        """Why it has ended, for people."""
        if not self.has_ended or self._process.stderr is None:
            return "it does not answer"
        lines = self._process.stderr.read().decode(errors="replace").strip().splitlines()
        return _EXCEPTION.sub("", lines[-1]).rstrip(".") if lines else f"exit code {self._process.returncode}"

    def close(self) -> None:
        """Forget it; after its end."""
        if self._process.stderr is not None:
            self._process.stderr.close()
