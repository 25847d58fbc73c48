"""Error bars of very many points: one path in place of one a point, which is drawn and written far faster."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.container import ErrorbarContainer
from matplotlib.path import Path

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class JoinedSegments(LineCollection):
    """Straight segments of one look, kept as one path.

    Args:
        ends: (n, 2, 2) segment, end, coordinate; NaN where a segment is not drawn.
        **look: as a ``LineCollection`` takes it.
    """

    def __init__(self, ends: Any, **look: Any) -> None:
        super().__init__([], **look)
        self._ends = np.asarray(ends, dtype=np.float64)
        path = Path(self._ends.reshape(-1, 2), np.tile([Path.MOVETO, Path.LINETO], len(self._ends)))
        path.should_simplify = False
        self._paths = [path]

    def get_segments(self) -> list[Any]:
        """(2, 2) ends of each segment, as they were given."""
        return list(self._ends)


def joined_error_bars(axes: Axes, x: Any, y: Any, y_std: Any, x_std: Any = None, *, colour: str, width: float) -> None:
    """What ``axes.errorbar`` draws without marks and caps.

    Args:
        axes: where to draw.
        x, y: (n,) points.
        y_std, x_std: (n,) half lengths of the bars; None = no such bars.
        colour: of the bars.
        width: of the bars, points.
    """
    bars: list[LineCollection] = []
    for along, std in enumerate((x_std, y_std)):
        if std is None:
            continue
        ends = np.repeat(np.column_stack((x, y))[:, None, :], 2, axis=1)
        ends[:, 0, along] -= std
        ends[:, 1, along] += std
        bars.append(JoinedSegments(ends, colors=colour, linewidths=width))
        axes.add_collection(bars[-1])
    lines: Any = (None, (), tuple(bars))  # the hints of matplotlib leave out that there may be no marks
    axes.add_container(ErrorbarContainer(lines, has_xerr=x_std is not None, has_yerr=True))
