"""The rig as it was used, as the text of a rig file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from nmt_core.files.yaml_document import parse_document
from nmt_core.files.yaml_text import yaml_text
from nmt_rig.device_sections import CustomSection
from nmt_rig.rig import Rig, find_rig


def rig_text(rig: Rig, source: str | Path | None = None, overrides: Sequence[str] = ()) -> str:
    """Text of a rig file that loads to the same rig.

    Args:
        rig: the validated rig.
        source: name or path it was loaded from; without overrides its own text is kept, comments and
            all, unless its structure or its driver comes from files next to it.
        overrides: ``key=value`` texts that were applied.

    Raises:
        BenchError: a structure from files that is larger than a rig file may be.
    """
    # What a structure read from other files is written out: the text has to load without them, and from elsewhere.
    from_files = getattr(rig.structure, "source", "") or isinstance(rig.device, CustomSection)
    if source is not None and not overrides and not from_files:
        return find_rig(source).read_text(encoding="utf-8")
    values = rig.model_dump(mode="json", exclude_none=True)
    header = f"# {rig.name}"
    if overrides:
        header += " with " + ", ".join(overrides)
    text = header + "\n" + yaml_text(values)
    if from_files:
        # The nodes read this text: what they would refuse is refused before they start.
        parse_document(text, f"The rig {rig.name} with its structure written out")
    return text
