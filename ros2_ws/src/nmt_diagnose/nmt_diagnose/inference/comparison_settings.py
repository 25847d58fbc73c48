"""How far a comparison of explanations goes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ComparisonSettings:
    """How far the comparison goes.

    Attributes:
        finalists: most effects that are fitted.
        placements: most placements (and starting shapes) of one effect that are fitted.
        least_gain: fall of χ² in the scan below which a candidate is not worth a fit.
        behind: fall of χ² in the scan by which a candidate may lie behind the best and still be fitted.
        share: share of the best fall from which a candidate is fitted all the same: the larger a gap, the less a linear
            scan can rank.
        first_of_pairs: best single explanations that get a second effect tried.
        second_of_pairs: second effects fitted for each.
        partners: best elastic or dissipative effects that are tried with all of the other kind; 0 = none.
        pair_gain: fall of χ² in the second scan from which a pair is tried.
        weak: strength in standard deviations up to which an effect leaves the directions of others as they are.
        settled: most explanations that are fitted to the end.
        close: logarithm of evidence by which one may lie behind the best to be fitted to the end.
        rounds: most times that a fit goes on which has not reached its optimum.
        restarts: whether one that has not reached it then starts again from the parameters as given.
    """

    finalists: int = 8
    placements: int = 2
    least_gain: float = 6.0
    behind: float = 60.0
    share: float = 0.05
    first_of_pairs: int = 3
    second_of_pairs: int = 3
    partners: int = 0
    pair_gain: float = 14.0
    weak: float = 30.0
    settled: int = 6
    close: float = 60.0
    rounds: int = 4
    restarts: bool = True
