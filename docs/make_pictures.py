"""Makes the pictures of the documentation; runs the commands whose results are not there yet. Chromium draws the pages.

./nmt shell
python docs/make_pictures.py out/pictures              # make
python docs/make_pictures.py out/pictures --check      # exit code 1 if a stored picture is no longer what is made
python docs/make_pictures.py out/pictures --notebooks  # and the outputs of the notebooks

bench.svg: the nodes, and the backbone they measured. harmonics.svg: what control of the force's harmonics does.
self_excited.svg: a damping curve that passes through zero. resonances.svg: a jump of an internal resonance, an isola.
two_exciters.svg: close modes with one shaker and with two. law.svg: a missing force that was read from levels.
page.png: the live page replaying the demo. The others: the first screen of every kind of report, for docs/gallery.md.
"""

from __future__ import annotations

import argparse
import asyncio
import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib
import nbformat
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from nbclient import NotebookClient
from nonlinear_pictures import draw_exciters, draw_law, draw_resonances, draw_self_excited
from PIL import Image

from nmt_extract.modal.table import read_csv, read_json
from nmt_rig.reference import compute_reference
from nmt_rig.rig import load_rig

Place = tuple[float, float]
DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent / "tests"))
from node.browser import Browser  # noqa: E402

COLOURS = 96  # of a PNG: a third of the bytes, and nothing that the eye sees
STILL, MOVING = 0.002, 0.06  # shares of points that may differ: dates of a report; the cursor of a replay
INK, LINE, FILL, ACCENT = "#1c2733", "#5b6b7b", "#eef3f8", "#c0392b"

# Node: centre and what it does.
NODES = {
    "sequencer": ((1.5, 4.6), "levels, horizon"),
    "pll": ((5.4, 4.6), "phase resonance"),
    "plant": ((5.4, 2.5), "the rig"),
    "extract": ((1.5, 2.5), "modal properties"),
    "recorder": ((5.4, 0.55), "every topic"),
}


def draw_nodes(axes: Any) -> None:
    """The nodes as boxes and the topics as arrows."""
    axes.set(xlim=(-0.1, 8.0), ylim=(-0.15, 5.3))
    axes.axis("off")
    for name, ((x, y), role) in NODES.items():
        box = FancyBboxPatch((x - 1.1, y - 0.4), 2.2, 0.8, boxstyle="round,pad=0.02,rounding_size=0.12")
        box.set(facecolor=FILL, edgecolor=LINE, linewidth=1.0)
        axes.add_patch(box)
        axes.text(x, y + 0.13, name, ha="center", va="center", fontsize=10, weight="bold", color=INK)
        axes.text(x, y - 0.19, role, ha="center", va="center", fontsize=7.5, color=LINE)

    def arrow(start: Place, end: Place, label: str, place: Place, **text: Any) -> None:
        style = {"arrowstyle": "-|>", "color": LINE, "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", end, start, arrowprops=style)
        axes.text(*place, label, fontsize=7.5, color=INK, **text)

    arrow((2.62, 4.75), (4.28, 4.75), "level", (3.45, 4.82), ha="center")
    arrow((4.28, 4.45), (2.62, 4.45), "frequency, lock", (3.45, 4.2), ha="center")
    arrow((5.0, 4.18), (5.0, 2.92), "drive", (4.92, 3.5), ha="right")
    arrow((5.8, 2.92), (5.8, 4.18), "force, response", (5.88, 3.5), ha="left")
    arrow((4.28, 2.5), (2.62, 2.5), "samples", (3.45, 2.57), ha="center")
    arrow((1.5, 2.92), (1.5, 4.18), "modal_point", (1.42, 3.5), ha="right")
    arrow((5.4, 2.08), (5.4, 0.97), "all topics, raw", (5.48, 1.5), ha="left")
    axes.text(6.65, 0.55, "rosbag2\n(MCAP)", fontsize=8, va="center", color=INK)


def draw_backbone(axes: Any, measured: Any, computed: Any, scale: float, std: str, colour: str) -> None:
    """One modal property over modal amplitude: computed line, measured points."""
    name = std.removesuffix("_std")
    line = computed.omega_rad_s / (2.0 * np.pi) if name == "frequency_hz" else scale * computed.damping_ratio
    axes.plot(1e6 * computed.modal_amplitude, line, color=LINE, linewidth=1.2, label="computed (EPMC)")
    q, value, error = (np.array(measured[key]) for key in ("modal_amplitude", name, std))
    style = {"fmt": "o", "markersize": 4.5, "color": colour, "label": "measured (simulated rig)"}
    axes.errorbar(1e6 * q, scale * value, scale * error, **style)
    axes.set_xscale("log")
    axes.tick_params(labelsize=8, colors=INK)
    axes.grid(alpha=0.25, linewidth=0.5)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def draw_bench(results: Path, target: Path) -> None:
    """Nodes and backbone as one picture."""
    measured = read_csv(results / "modal.csv")
    q = np.array(measured["modal_amplitude"])
    rig = load_rig(results / "rig.yaml")
    computed = compute_reference(rig, 15, np.geomspace(0.7 * np.nanmin(q), 1.5 * np.nanmax(q), 200))

    matplotlib.rcParams.update({"svg.hashsalt": "nmt", "font.family": "DejaVu Sans"})
    figure = Figure(figsize=(9.6, 3.9), facecolor="white")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1.0), hspace=0.16, wspace=0.1)
    figure.subplots_adjust(left=0.01, right=0.985, top=0.95, bottom=0.13)
    draw_nodes(figure.add_subplot(grid[:, 0]))
    top, bottom = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    draw_backbone(top, measured, computed, 1.0, "frequency_hz_std", ACCENT)
    draw_backbone(bottom, measured, computed, 100.0, "damping_ratio_std", ACCENT)
    top.set_ylabel("modal frequency, Hz", fontsize=8, color=INK)
    top.tick_params(labelbottom=False)
    top.legend(fontsize=8, frameon=False, loc="lower left")
    bottom.set_ylabel("damping ratio, %", fontsize=8, color=INK)
    bottom.set_xlabel("modal amplitude, 10⁻⁶ m√kg", fontsize=8, color=INK)
    figure.savefig(target, metadata={"Date": None})


def draw_harmonics(without: Path, controlled: Path, target: Path) -> None:
    """Force harmonics where they are greatest, and the error of damping, without and with control of them."""
    matplotlib.rcParams.update({"svg.hashsalt": "nmt", "font.family": "DejaVu Sans"})
    figure = Figure(figsize=(9.6, 3.3), facecolor="white")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.25))
    figure.subplots_adjust(left=0.065, right=0.985, top=0.95, bottom=0.15, wspace=0.2)
    runs = [(without, "sine of voltage", LINE, -0.2), (controlled, "force harmonics controlled", ACCENT, 0.2)]
    points = {label: [p for p in read_json(folder / "modal.json")[0] if p.reason == ""] for folder, label, *_ in runs}
    worst = max(range(len(points[runs[0][1]])), key=lambda k: np.abs(points[runs[0][1]][k].force_harmonics[2:]).max()
                / abs(points[runs[0][1]][k].force_harmonics[1]))  # fmt: skip
    rig = load_rig(without / "rig.yaml")
    for _, label, colour, shift in runs:
        size = np.abs(points[label][worst].force_harmonics[:8])
        left.bar(np.arange(2, 8) + shift, 100.0 * size[2:] / size[1], 0.38, color=colour, label=label)
        q = np.array([point.modal_amplitude for point in points[label]])
        expected = compute_reference(rig, 15, np.unique(q))
        error = [p.damping_ratio / np.interp(p.modal_amplitude, expected.modal_amplitude, expected.damping_ratio) - 1.0
                 for p in points[label]]  # fmt: skip
        right.plot(1e6 * q, 100.0 * np.array(error), "o-", color=colour, markersize=4.5, linewidth=0.9, label=label)
    level = points[runs[0][1]][worst].level
    left.set_xlabel(f"harmonic n of the force at {level:.2g} V", fontsize=8, color=INK)
    left.set_ylabel("|Fₙ| / |F₁|, %", fontsize=8, color=INK)
    right.axhline(0.0, color=INK, linewidth=0.6)
    right.set_xscale("log")
    right.set_xticks((30, 50, 100, 200, 500), ("30", "50", "100", "200", "500"))
    right.minorticks_off()
    right.set_xlabel("modal amplitude, 10⁻⁶ m√kg", fontsize=8, color=INK)
    right.set_ylabel("damping ratio against EPMC, %", fontsize=8, color=INK)
    right.legend(fontsize=8, frameon=False, loc="lower right")
    for axes in (left, right):
        axes.tick_params(labelsize=8, colors=INK)
        axes.grid(alpha=0.25, linewidth=0.5)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    figure.savefig(target, metadata={"Date": None})


# Picture: results folder, height of the shown part, and the command that makes the folder beside the others.
EXAMPLES = DOCS.parent / "examples"
HEAVY = "structure.added_masses=[{point: 5, mass_kg: 0.004}]"
BOTH = ("--refine", "0.0005", "--direction", "both")
LIGHT = "structure.damping_factors=[0.2,0.2,0.2]"
ACROSS = "0.0016,0.0017,0.0018,0.00186,0.0019,0.00202,0.0021,0.0022,0.0024"
NOISE = ("2e-8", *["4.5e-15"] * 4, "1e-6")
NOISY = [w for k, n in enumerate(NOISE) for w in ("--set", f"sensors.{k}.noise_psd={n}")]
NOISY += ["--set", "sensors.3.gain=1.06"]
REPORTS: dict[str, tuple[str, int, tuple[str, ...]]] = {
    "report": ("demo", 1150, ("demo",)),
    "linear": ("linear", 800, ("linear", "joint_resonator")),
    "sweep": (
        "sweep",
        900,
        ("sweep", "joint_resonator", "--force", "14.65", "--from", "364", "--to", "372", "--stepped", "33"),
    ),
    "backbone": ("backbone", 900, ("run", "joint_resonator", "--linear", "linear/linear.json")),
    "synthesis": ("synthesis", 900, ("synthesis", "--backbone", "backbone", "--sweep", "sweep")),
    "reference": ("reference", 800, ("reference", "beam")),
    "controlled": ("controlled", 0, ("run", "beam", "--harmonics-control", "auto")),
    "self_excited": ("self_excited", 0, ("run", "subcritical", "--kind", "self_excited")),
    "internal": (
        "internal",
        0,
        ("run", "internal_resonance", "--control", "response", "--levels", "0.0005:0.0028:6", *BOTH),
    ),
    "jumping": (
        "jumping",
        0,
        ("run", "internal_resonance", "--control", "response", "--set", LIGHT, "--levels", ACROSS),
    ),
    "primary": ("primary", 0, ("run", "strong_cubic", "--control", "response", "--levels", "0.0002:0.0024:10")),
    "isola": ("isola", 900, ("synthesis", "--backbone", "primary", "--resonance", "1:3", "--levels", "9.6")),
    "subharmonic": (
        "subharmonic",
        0,
        ("run", "strong_cubic", "--resonance", "1:3", "--control", "force", "--levels", "9.6", "--release", "0.00075"),
    ),
    "frame": ("frame", 0, ("run", "frame", "--set", "test.window_periods=50")),
    "frame_one": ("frame_one", 0, ("run", "frame", "--exciter", "2", "--set", "test.window_periods=50")),
    "heavy": ("heavy", 0, ("run", "beam", "--set", HEAVY, "--levels", "0.05:1.5:8", "--periods", "60")),
    "diagnosis": ("diagnosis", 1150, ("diagnose", "--model", "beam", "--real", "heavy")),
    "investigation": (
        "investigation",
        1150,
        ("investigate", "beam", "--rig", "beam", *NOISY, "--jobs", "1"),
    ),
    "differ_bench": (
        "differ_bench",
        610,
        ("diagnose", "--model", f"{EXAMPLES}/bench/one_mode.yaml", "--real", "measured_bench"),
    ),
    "differ_robot": (
        "differ_robot",
        1400,
        ("diagnose", "--model", f"{EXAMPLES}/robot/arm.xml", "--real", f"{EXAMPLES}/robot/log.npz"),
    ),
    "differ_strip": (
        "differ_strip",
        610,
        ("diagnose", "--model", f"{EXAMPLES}/strip/strip.yaml", "--real", "measured_strip"),
    ),
    "study": ("study", 1000, ("study", "exciter_location", "--quick")),
    "identification": ("identification", 1150, ("study", "identification")),
}


def make_results(base: Path) -> None:
    """Run the commands whose folders are not there, in the order of the table."""
    base.mkdir(parents=True, exist_ok=True)
    for name in ("bench", "strip"):
        if not (base / f"measured_{name}").exists():
            words = ("import", f"{EXAMPLES}/{name}/measured.yaml", "--out", f"measured_{name}")
            subprocess.run([sys.executable, "-m", "nmt_bench", *words], cwd=base, check=True)
    for folder, _, words in REPORTS.values():
        if not (base / folder / "report.html").exists():
            shutil.rmtree(base / folder, ignore_errors=True)
            subprocess.run([sys.executable, "-m", "nmt_bench", *words, "--out", folder], cwd=base, check=True)


async def screenshots(base: Path, folder: Path) -> None:
    """The first screen of every report."""
    async with Browser() as browser:
        for name, (source, height, _) in REPORTS.items():
            if height:
                await browser.size(1200, height)
                await browser.open((base / source / "report.html").resolve().as_uri())
                await browser.until("document.readyState === 'complete'", 120.0)
                await browser.picture(folder / f"{name}.png")


async def live_page(bag: Path, target: Path) -> None:
    """The live page in the middle of a replay."""
    command = [sys.executable, "-m", "nmt_bench", "page", str(bag)]
    player = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert player.stdout
        address = next(line for line in player.stdout if "http://" in line).split()[-1]
        async with Browser() as browser:
            await browser.size(1440, 885)
            await browser.open(address)
            await browser.until("document.body.dataset.sample", 120.0)
            faster = "var speed = document.getElementById('speed'); speed.value = '10';"
            await browser.value(f"{faster} speed.dispatchEvent(new Event('change'))")
            await browser.until("document.querySelectorAll('#points tbody tr').length > 7", 120.0)
            await browser.value(f"{faster.replace('10', '1')} speed.dispatchEvent(new Event('change'))")
            await asyncio.sleep(2.0)
            await browser.picture(target)
    finally:
        player.terminate()
        player.wait()


def shrink(folder: Path) -> None:
    """Fewer colours in every picture of a folder."""
    for path in folder.glob("*.png"):
        small = Image.open(io.BytesIO(path.read_bytes())).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
        small.save(path, optimize=True)


def stale(made: Path, stored: Path) -> list[str]:
    """Names of stored pictures that are missing or differ from those made; a date or a replay's cursor may differ."""
    found = []
    for path in sorted(made.glob("*.png")):
        new = Image.open(path).convert("L")
        old = Image.open(stored / path.name).convert("L") if (stored / path.name).exists() else None
        most = MOVING if path.name == "page.png" else STILL
        if old is None or old.size != new.size or _share(new, old) > most:
            found.append(path.name)
    return found


def _share(new: Image.Image, old: Image.Image) -> float:
    """Share of the points that differ clearly."""
    return float(np.mean(np.abs(np.asarray(new, dtype=int) - np.asarray(old, dtype=int)) > 64))


def run_notebooks() -> None:
    """Notebooks with the outputs of a run from top to bottom."""
    for path in sorted((DOCS.parent / "examples").glob("*.ipynb")):
        notebook = nbformat.read(path, as_version=4)
        with tempfile.TemporaryDirectory() as folder:
            NotebookClient(notebook, timeout=1800, resources={"metadata": {"path": folder}}).execute()
        for cell in notebook.cells:
            cell.metadata.pop("execution", None)  # times of a machine
        nbformat.write(notebook, path)


def main(arguments: list[str] | None = None) -> int:
    """Draw all pictures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("results", type=Path, help="folder of the results folders; what is missing is made")
    parser.add_argument("--check", action="store_true", help="write nothing; 1 if a picture is not current")
    parser.add_argument("--notebooks", action="store_true", help="run the notebooks, too")
    parser.add_argument("--out", type=Path, default=DOCS / "images", help="folder of the pictures")
    options = parser.parse_args(arguments)
    make_results(options.results)
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder)
        draw_bench(options.results / "demo", made / "bench.svg")
        draw_harmonics(options.results / "demo", options.results / "controlled", made / "harmonics.svg")
        draw_self_excited(options.results / "self_excited", made / "self_excited.svg")
        runs = [options.results / name for name in ("internal", "jumping", "primary", "isola", "subharmonic")]
        draw_resonances(*runs, made / "resonances.svg")
        draw_exciters(options.results / "frame", options.results / "frame_one", made / "two_exciters.svg")
        draw_law(made / "law.svg")
        asyncio.run(screenshots(options.results, made))
        asyncio.run(live_page(options.results / "demo" / "bag", made / "page.png"))
        shrink(made)
        old = stale(made, options.out)
        sys.stdout.write(f"Differ: {', '.join(old) or 'none'}\n")
        if options.check:
            return 1 if old else 0
        for path in made.iterdir():
            shutil.copy(path, options.out / path.name)
    if options.notebooks:
        run_notebooks()
    return 0


if __name__ == "__main__":
    sys.exit(main())
