"""A computer with no audio and no NI: each command says in one sentence what is missing, with exit code 2."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tiers import with_quick

GONE = {
    "no PortAudio": {"sounddevice": "raise OSError('PortAudio library not found')"},
    "no sounddevice": {"sounddevice": "raise ModuleNotFoundError('sounddevice')"},
    "no libjack": {"jack": "raise OSError('libjack.so.0 is not there')"},
    "no JACK-Client": {"jack": "raise ModuleNotFoundError('jack')"},
    "no nidaqmx": {"nidaqmx": "raise ModuleNotFoundError('nidaqmx')"},
    "nothing changed": {},
}


def said(words: str, gone: str, folder: Path) -> tuple[int, str, str]:
    """Exit code, output and errors of a command where libraries are gone; no sound server, no programs."""
    for name, line in GONE[gone].items():
        (folder / f"{name}.py").write_text(f"{line}\n")
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(folder), *(part for part in sys.path if part)]),
        "PATH": str(folder),
        "XDG_STATE_HOME": str(folder / "state"),
        "JACK_DEFAULT_SERVER": f"nobody-{os.getpid()}",
        "JACK_NO_START_SERVER": "1",
    }
    out = folder / "out"
    command = [sys.executable, "-m", "nmt_bench", *words.replace("OUT", str(out)).split()]
    done = subprocess.run(
        command, capture_output=True, text=True, env=environment, cwd=folder, stdin=subprocess.DEVNULL
    )
    assert not out.exists(), "nothing half-written"
    return done.returncode, done.stdout, done.stderr


CASES = [
    ("check beam --device portaudio --out OUT", "no PortAudio", "type 'sudo apt install libportaudio2'"),
    ("run beam --device portaudio --out OUT", "no PortAudio", "type 'sudo apt install libportaudio2'"),
    ("check beam --device portaudio --out OUT", "no sounddevice", "type: pip install sounddevice"),
    ("specimen beam", "no libjack", "type 'sudo apt install jackd2'"),
    ("specimen beam", "no JACK-Client", "type: pip install JACK-Client"),
    ("specimen beam", "nothing changed", "type 'sudo apt install jackd2'"),
    ("check beam --device nidaqmx --out OUT", "no nidaqmx", "type: pip install 'nidaqmx[grpc]'"),
    ("run beam --device nidaqmx --out OUT", "nothing changed", "install it from ni.com"),
    ("linear beam --device nidaqmx --out OUT", "nothing changed", "install it from ni.com"),
    ("sweep beam --force 1 --from 20 --to 22 --device nidaqmx@127.0.0.1:9 --out OUT", "nothing changed", "answers at"),
    ("specimen beam --device nidaqmx --address 127.0.0.1:0", "no nidaqmx", "type: pip install 'nidaqmx[grpc]'"),
]


@pytest.mark.parametrize(("words", "gone", "sentence"), with_quick(CASES, CASES[0]))
def test_what_is_missing_is_one_sentence_with_exit_code_2(words, gone, sentence, tmp_path):
    code, output, errors = said(words, gone, tmp_path)
    assert code == 2, errors
    assert output == ""
    (line,) = errors.strip().splitlines()
    assert line.startswith(f"./nmt {words.partition(' ')[0]}: ")
    assert sentence in line
    assert line.count(". ") == 0
    assert line.endswith(".")
