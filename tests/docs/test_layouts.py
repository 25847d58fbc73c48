"""The layouts for other tools: built as those tools write them, and every curve is a number of a message."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from nmt_record.bag.bench_topics import BENCH_TOPICS
from nmt_record.bag.message_definitions import local_definitions

LAYOUTS = Path(__file__).resolve().parents[2] / "docs" / "layouts"
TYPES = {topic.name: topic.message_type for topic in BENCH_TOPICS}


def is_number(topic: str, field: str) -> bool:
    """Whether a field of a topic holds one number."""
    definition = LAYOUTS.parents[1] / "ros2_ws" / "src" / "nmt_msgs" / "msg" / f"{TYPES[topic].split('/')[-1]}.msg"
    assert field in local_definitions().fields(TYPES[topic]), (topic, field)
    kind = re.search(rf"^(\S+) +{field}\b", definition.read_text(), re.M)
    return kind is not None and kind[1] in ("float64", "uint8", "uint32", "uint64", "bool")


def tiles(node: Any) -> Iterator[str]:
    """Panels of a Foxglove layout: a name, or a split into two."""
    if isinstance(node, str):
        yield node
        return
    assert set(node) <= {"direction", "first", "second", "splitPercentage"}
    assert node["direction"] in ("row", "column")
    yield from tiles(node["first"])
    yield from tiles(node["second"])


def test_the_layout_for_foxglove() -> None:
    layout = json.loads((LAYOUTS / "foxglove.json").read_text(encoding="utf-8"))
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    shown = list(tiles(layout["layout"]))
    assert sorted(shown) == sorted(layout["configById"])  # each panel once, none without a place
    for name, panel in layout["configById"].items():
        assert re.fullmatch(r"(Plot|RawMessages|DiagnosticSummary)!\w+", name)
        curves = [path["value"] for path in panel.get("paths", ())]
        if "xAxisPath" in panel:
            assert panel["xAxisVal"] == "custom"
            curves.append(panel["xAxisPath"]["value"])
        for curve in curves:
            topic, _, field = curve.removeprefix("/").partition(".")
            assert is_number(topic, field), curve
        assert panel.get("topicPath", "/run_state").removeprefix("/") in TYPES


def test_the_layout_for_plotjuggler() -> None:
    root = ET.parse(LAYOUTS / "plotjuggler.xml").getroot()
    assert root.tag == "root"
    tabs = root.findall("tabbed_widget/Tab")
    assert len(tabs) == 3
    for tab in tabs:
        containers = tab.findall("Container")
        assert len(containers) == int(tab.attrib["containers"])
        for splitter in tab.iter("DockSplitter"):
            sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
            assert len(sizes) == len(splitter) == int(splitter.attrib["count"])
            assert sum(sizes) == pytest.approx(1.0, abs=1e-5)
            assert splitter.attrib["orientation"] in "-|"
        for plot in tab.iter("plot"):
            over = plot.attrib["mode"] == "XYPlot"
            assert over or plot.attrib["mode"] == "TimeSeries"
            assert {child.tag for child in plot} == {"range", "limitY", "curve"}
            for curve in plot.findall("curve"):
                for name in ("curve_x", "curve_y") if over else ("name",):
                    _, topic, field = curve.attrib[name].split("/")
                    assert is_number(topic, field), curve.attrib[name]
                assert re.fullmatch(r"#[0-9a-f]{6}", curve.attrib["color"])
    assert root.find("tabbed_widget/currentTabIndex") is not None
