"""Run by test_hostile_inputs.py in a process of its own: inputs that nobody sound would write, one after the other.

Prints one JSON object: what raised anything but BenchError, what took too long, and the memory that was needed.
"""

from __future__ import annotations

import io
import json
import os
import random
import resource
import shutil
import signal
import sys
import traceback
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import lz4.frame
import yaml
from mcap.writer import CompressionType, Writer
from numpy.lib import format as npy

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from record import foreign_data

from nmt_bench.commands.linear_input import read_linear
from nmt_core.errors import BenchError
from nmt_core.messages.records import LoopStatus
from nmt_extract.curves.response_table import read_response_csv
from nmt_extract.modal.table import read_csv, read_json
from nmt_record.bag.bag_reader import Bag
from nmt_record.bag.bag_writer import BagWriter, Storage
from nmt_record.exchange.arrays.uff import TIME_RESPONSE, Axis, UffFunction, write_uff
from nmt_record.exchange.imports.imported_run import read_import
from nmt_record.exchange.reduced.frf_table import read_frf_table
from nmt_record.exchange.sidecar.side_tables import read_block_table, read_records
from nmt_report.run_data import read_reference
from nmt_rig.rig import find_rig, load_rig

LIMIT = 10  # s for one input
SCALARS = (
    "1e308", "-1e308", "1e-300", "9e39", "0", "-0.0", "-1", ".nan", ".inf", "~", "''", "[]", "{}", "!!bool maybe",
    "!!int ''", "!!timestamp x", "!!binary '='", "!!float x", "9" * 400, "9" * 5000, "2001-01-01", "0x" + "f" * 99,
    "*a", "&a [*a]", "[" * 300 + "]" * 300, "'\\0'", "ü" * 300, "/dev/zero", "/dev/null", ".", "..", "pipe", "x" * 300,
    "1:2:3", "<<: 1", "!!set {a}", "!!omap [a]", "| \n x", "2e9", "1e15", "true",
)  # fmt: skip
WORDS = (b"1e308", b"nan", b"inf", b"", b"\0", b"9" * 400, b"-1", b"\xff\xfe", b"'", b'"', b",,,,", b"\n\n", b"[" * 999)


def mutated(generator: random.Random, content: bytes) -> bytes:
    """The same with a few bytes changed, taken out, doubled or put in."""
    data = bytearray(content)
    for _ in range(generator.randint(1, 4)):
        at = generator.randrange(len(data) + 1)
        end = min(len(data), at + generator.choice((1, 1, 4, 50, 5000)))
        kind = generator.randrange(5)
        if kind == 0 and at < len(data):
            data[at] ^= 1 << generator.randrange(8)
        elif kind == 1:
            del data[at:end]
        elif kind == 2:
            data[at:at] = data[at:end] * generator.choice((1, 3, 50))
        elif kind == 3:
            data[at:end] = generator.choice(WORDS)
        else:
            del data[at:]
    return bytes(data)


def spoiled_yaml(generator: random.Random, text: str) -> str:
    """The same with the value of one key replaced."""
    lines = text.splitlines()
    places = [i for i, line in enumerate(lines) if ":" in line and not line.lstrip().startswith("#")]
    place = generator.choice(places)
    key = lines[place].split(":", 1)[0]
    lines[place] = f"{key}: {generator.choice(SCALARS)}"
    return "\n".join(lines)


def spoiled_json(generator: random.Random, values: Any) -> str:
    """JSON with one number or entry replaced."""
    text = json.dumps(values)
    numbers = [i for i, c in enumerate(text) if c.isdigit() and not text[i - 1].isdigit()]
    at = generator.choice(numbers)
    end = at
    while end < len(text) and text[end] in "0123456789.e-":
        end += 1
    new = generator.choice(
        ("1e308", "-1", "NaN", "1e400", "9" * 400, "null", '"x"', "[]", "{}", "true", "[" * 60 + "]" * 60)
    )
    return text[:at] + new + text[end:]


def inputs(folder: Path, generator: random.Random) -> Iterator[tuple[str, Callable[[], object]]]:
    """Name and call of each input; the file is written when its turn comes."""
    os.mkfifo(folder / "pipe")
    sound = foreign_data.write(folder / "sound", data=foreign_data.recording(1.0))
    values = foreign_data.sidecar()
    values["segments"] = [{**values["segments"][0], "stop": 1.0, "window": [0.1, 0.9]}]
    side = yaml.safe_dump(values, sort_keys=False)
    npz = (sound.parent / "data.npz").read_bytes()
    table = foreign_data.write_csv(folder / "csv", data=foreign_data.recording(0.2)).parent / "data.csv"
    csv = table.read_bytes()
    uffs = []
    for binary in (True, False):
        axis = Axis(17, "time", "s")
        data = foreign_data.recording(0.1)
        functions = [
            UffFunction(TIME_RESPONSE, v, 0.0, 1 / 2000, abscissa_axis=axis, lines=(k,) * 5) for k, v in data.items()
        ]
        write_uff(folder / "x.uff", functions, binary)
        uffs.append((folder / "x.uff").read_bytes())
    rigs = [find_rig(name).read_text() for name in ("beam", "joint_resonator")]
    bag_bytes = (sound_bag(folder) / "sound_bag_0.mcap").read_bytes()

    def rig(text: str | bytes) -> object:
        path = folder / "rig.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_rig(path)

    def imported(text: str, name: str = "data.npz", content: bytes = npz) -> object:
        path = folder / "one"
        shutil.rmtree(path, ignore_errors=True)
        path.mkdir()
        os.mkfifo(path / "pipe")
        (path / name).write_bytes(content)
        (path / "linear.json").write_text(json.dumps(foreign_data.LINEAR))
        (path / "sidecar.yaml").write_bytes(text.encode(errors="surrogateescape"))
        return read_import(path / "sidecar.yaml")

    def of_file(reader: Callable[[Path], object], content: str | bytes) -> object:
        path = folder / "input"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return reader(path)

    def bag(content: bytes) -> object:
        path = folder / "bag.mcap"
        path.write_bytes(content)
        opened = Bag.open(path)
        return opened.loss, list(opened.messages())

    for number in range(150):
        text = rigs[number % 2]
        yield f"rig {number}", lambda text=text: rig(spoiled_yaml(generator, text))
    for number in range(20):
        yield f"rig bytes {number}", lambda: rig(mutated(generator, rigs[0].encode()))
    for number in range(80):
        yield f"sidecar {number}", lambda: imported(spoiled_yaml(generator, side))
    for number in range(40):
        yield f"npz {number}", lambda: imported(side, "data.npz", mutated(generator, npz))
    csv_side = side.replace("data.npz", "data.csv")
    for number in range(40):
        yield f"csv {number}", lambda: imported(csv_side, "data.csv", mutated(generator, csv))
    uff_side = side.replace("data.npz", "data.uff")
    for number in range(40):
        content = uffs[number % 2]
        yield f"uff {number}", lambda content=content: imported(uff_side, "data.uff", mutated(generator, content))
    for number in range(50):
        yield f"linear {number}", lambda: of_file(read_linear, spoiled_json(generator, foreign_data.LINEAR))
    for number in range(30):
        yield f"bag {number}", lambda: bag(mutated(generator, bag_bytes))
    readers: tuple[Callable[[Path], object], ...] = (
        read_linear, read_json, read_csv, read_response_csv, read_frf_table, partial(read_records, kind=LoopStatus),
        read_reference, lambda path: read_block_table(path, 0, 100), read_import, load_rig, Bag.open,
    )  # fmt: skip
    for number, reader in enumerate(readers):
        yield f"noise {number}", lambda reader=reader: of_file(reader, generator.randbytes(5000))
        for place in ("/dev/zero", str(folder / "pipe"), str(folder), str(folder / ("x" * 300)), "/dev/null", "a\0b"):
            yield f"{place[:20]} {number}", lambda reader=reader, place=place: reader(Path(place))
    yield from bombs(folder, imported, side, bag)


def bombs(
    folder: Path, imported: Callable[..., object], side: str, bag: Callable[[bytes], object]
) -> Iterator[tuple[str, Callable[[], object]]]:
    """Small files that claim or unpack to gigabytes."""

    def header(shape: tuple[int, ...]) -> bytes:
        head = io.BytesIO()
        npy.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": shape})
        return head.getvalue()

    def archive(head: bytes, zeros: int) -> bytes:
        file = io.BytesIO()
        target = zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
        with target, target.open("f.npy", "w", force_zip64=True) as entry:
            entry.write(head)
            for _ in range(zeros // 2**24):
                entry.write(bytes(2**24))
        return file.getvalue()

    for name, shape, zeros in (("npz claims", 10**15, 2**24), ("npz bomb", 2**27, 2**30)):
        content = archive(header((shape,)), zeros)
        yield name, lambda content=content: imported(side, "data.npz", content)

    def packed(compression: CompressionType, claimed: int | None) -> bytes:
        file = io.BytesIO()
        writer = Writer(file, chunk_size=2**62, compression=compression)
        writer.start("ros2")
        channel = writer.register_channel("/force", "cdr", writer.register_schema("a/msg/B", "ros2msg", b"uint8[] d"))
        writer.add_message(channel, 0, bytes(2**20), 0)
        writer.finish()
        return file.getvalue()

    def lz4_bomb() -> bytes:
        """A chunk whose lz4 frame goes on for gigabytes behind what the chunk says."""
        whole = packed(CompressionType.LZ4, None)
        compressor = lz4.frame.LZ4FrameCompressor()
        frame = compressor.begin() + b"".join(compressor.compress(bytes(2**24)) for _ in range(64)) + compressor.flush()
        begin = whole.index(b"\x04\x22\x4d\x18")
        head = bytearray(whole[:begin])
        head[-8:] = len(frame).to_bytes(8, "little")
        record = head.rindex(b"\x03\0\0\0lz4") - 37
        head[record + 1 : record + 9] = (len(head) - record - 9 + len(frame)).to_bytes(8, "little")
        return bytes(head) + frame

    content = lz4_bomb()
    yield "lz4 bomb", lambda: bag(content)


def sound_bag(folder: Path) -> Path:
    writer = BagWriter(folder / "sound_bag", run_json='{"run_id": "r"}', storage=Storage(chunk_messages=5))
    writer.add_topic("note", "std_msgs/msg/String")
    for index in range(40):
        writer.write("note", b"\0\1\0\0" + bytes([7, 0, 0, 0]) + b"note%02d\0" % index, index)
    writer.close()
    return writer.path


class TooSlow(BaseException):
    """An input that is not done in time."""


def main() -> None:
    folder = Path(sys.argv[1])
    resource.setrlimit(resource.RLIMIT_AS, (2**33, 2**33))

    def late(*_: object) -> None:
        raise TooSlow

    signal.signal(signal.SIGALRM, late)
    count, refused, traces, slow = 0, 0, [], []
    for name, call in inputs(folder, random.Random(20)):
        count += 1
        signal.alarm(LIMIT)
        try:
            call()
        except BenchError as error:
            refused += 1
            if "\n" in str(error):
                traces.append(f"{name}: more than one line: {error}")
        except TooSlow:
            slow.append(name)
        except BaseException:
            traces.append(f"{name}: {traceback.format_exc()}")
        finally:
            signal.alarm(0)
    # Not ru_maxrss: it keeps the size of the process that started this one.
    status = Path("/proc/self/status").read_text()
    peak = 1024 * int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM:")))
    print(json.dumps({"count": count, "refused": refused, "traces": traces, "slow": slow, "peak": peak}))


if __name__ == "__main__":
    main()
