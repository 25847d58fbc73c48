"""The loaders: bounds, kinds of files, and that sound content comes through unchanged."""

from __future__ import annotations

import io
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.lib import format as npy

from nmt_core.errors import BenchError
from nmt_core.files.hardened import json_value, open_regular, read_arrays, read_json, read_text, yaml_value
from nmt_core.files.yaml_document import parse_document


def test_only_regular_files_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path, why in (
        (tmp_path, "it is a folder"),
        (tmp_path / "pipe", "a pipe or a device"),
        (Path("/dev/zero"), "a pipe or a device"),
        (tmp_path / "none", "No such file"),
        (tmp_path / ("x" * 300), "File name too long"),
        (tmp_path / "nul\0byte", "null byte"),
    ):
        with pytest.raises(BenchError, match=why):
            read_text(path, "table")


def test_size_and_encoding(tmp_path: Path) -> None:
    path = tmp_path / "t"
    path.write_bytes(b"abc\xc3\xbc")
    assert read_text(path, "table") == "abcü"
    with pytest.raises(BenchError, match="more than the"):
        read_text(path, "table", largest=4)
    with open_regular(path, "table", 5) as file:
        assert file.read() == b"abc\xc3\xbc"
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(BenchError, match="not a text file in UTF-8"):
        read_text(path, "table")


BOMB = "a: &a [1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"{b}: &{b} [{','.join(['*' + a] * 9)}]\n" for a, b in zip("abcdefg", "bcdefgh", strict=True)
)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("a: !!bool maybe", "line 1"),
        ("a: 1\nb: !!int ''", "line 2"),
        ("a: !!timestamp x", "line 1"),
        ("!!int x: 1", "line 1"),
        ("a: !!binary é", "line 1"),
        ("a: !!python/name:os.system x", "could not determine a constructor"),
        ("a: " + "[" * 2000 + "]" * 2000, "nested too deeply"),
        ("a: " + "{b: " * 300 + "1" + "}" * 300, "nested too deeply"),
        ("a: " + "9" * 400, "digits"),
        ("a: " + "9" * 5000, "cannot read this value"),
        ("a: 1e31", "beyond every quantity"),
        ("a: 1e-26", "too small"),
        ("a: [" + "1," * 30_000 + "]", "too many entries|repeats itself"),
        (BOMB, "repeats itself"),
        ("a: " + "x" * 2_000_000, "far too many"),
        ("a: *b", "undefined alias"),
        ("&a [*a]", "repeats itself|mapping"),
    ],
)
def test_what_no_yaml_file_should_hold_is_one_sentence(text: str, why: str) -> None:
    with pytest.raises(BenchError, match=why) as caught:
        parse_document(text, "rig.yaml")
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("rig.yaml")


def test_yaml_of_programs_equals_what_pyyaml_reads() -> None:
    text = yaml.safe_dump({"a": [1, 2.5, None, True, "x: y"], "b": {"c": "ü"}, "d": 10**40, "e": 1e-40})
    assert yaml_value(text, "metadata.yaml") == yaml.safe_load(text)
    assert yaml_value("", "metadata.yaml") is None
    for broken in ("[", BOMB, "a: !!bool maybe", "[" * 2000):
        with pytest.raises(BenchError, match=r"metadata\.yaml"):
            yaml_value(broken, "metadata.yaml")


def test_json(tmp_path: Path) -> None:
    assert json_value('{"a": [1, 2.5, null, NaN, 1e-300]}', "x")["a"][:3] == [1, 2.5, None]
    for text, why in (
        ("{", "not valid JSON"),
        ("[" * 100_000 + "]" * 100_000, "nested too deeply"),
        ("[" * 50 + "]" * 50, "nested too deeply"),
        ('{"m": 1e308}', "'m': 1e\\+308 is beyond"),
        ('{"m": ' + "9" * 400 + "}", "digits"),
        ('{"m": ' + "9" * 5000 + "}", "not valid JSON"),
    ):
        with pytest.raises(BenchError, match=why):
            json_value(text, "x")
    assert json_value('{"m": 1e308}', "x", bounded=False) == {"m": 1e308}
    (tmp_path / "list.json").write_text("[1]")
    with pytest.raises(BenchError, match="must be a JSON object"):
        read_json(tmp_path / "list.json", "table")


def member(shape: tuple[int, ...], data: bytes, kind: str = "<f8") -> bytes:
    head = io.BytesIO()
    npy.write_array_header_1_0(head, {"descr": kind, "fortran_order": False, "shape": shape})
    return head.getvalue() + data


def npz(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)
    return path


def test_arrays_come_through_to_the_bit(tmp_path: Path) -> None:
    arrays = {"x": np.random.default_rng(1).standard_normal(50), "n": np.arange(6).reshape(2, 3), "s": np.array(1.5)}
    np.savez_compressed(tmp_path / "a.npz", **arrays)
    read = read_arrays(tmp_path / "a.npz", "data file")
    assert list(read) == list(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(read[name], array)
        assert read[name].dtype == array.dtype


def test_claims_of_an_npz_are_checked_before_memory_is_taken(tmp_path: Path) -> None:
    for shape in ((10**15,), (10**9, 10**9), (3,), (2**62, 8)):
        path = npz(tmp_path / "claim.npz", x=member(shape, bytes(16)))
        with pytest.raises(BenchError, match="claims"):
            read_arrays(path, "data file")
    path = npz(tmp_path / "large.npz", x=member((4_000,), bytes(32_000)), y=member((4_000,), bytes(16_000), "<f4"))
    assert len(read_arrays(path, "data file", largest=64_000)) == 2
    with pytest.raises(BenchError, match="more than the"):
        read_arrays(path, "data file", largest=63_999)  # single precision grows to double
    path = npz(tmp_path / "object.npz", x=member((2,), bytes(16), "|O"))
    with pytest.raises(BenchError, match="plain numbers"):
        read_arrays(path, "data file")
    (tmp_path / "no.npz").write_bytes(b"PK\x03\x04" + bytes(100))
    with pytest.raises(BenchError, match="cut off or damaged"):
        read_arrays(tmp_path / "no.npz", "data file")
