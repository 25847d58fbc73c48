"""Every statement that the bench makes about data, with the plain check that stops it.

Each inference needs a plain look at the data that could contradict it. Each statement names that look in code, the
sentence that is reported where it fails, and the test that shows it. The page docs/reference/statements.md comes from
here.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Statement:
    """A statement and what stops it.

    Attributes:
        name: of the statement.
        says: what it says.
        check: what has to hold in the data for it to be said.
        otherwise: what is said where that fails.
        function: that looks, ``module:name``; empty where there is none yet.
        test: that fails without it, ``file::test``; empty where there is none yet.
    """

    name: str
    says: str
    check: str
    otherwise: str
    function: str = ""
    test: str = ""


_DIAGNOSE = "tests/diagnose/"

STATEMENTS = (
    Statement(
        "no gap",
        "Noise and repeatability explain what lies between model and data.",
        "No channel leaves half of its signal, and where the data lie two standard deviations off, no row leaves what "
        "matters; the noise does not exceed the scatter of neighbouring rows.",
        "`unknown`, with the channel, or the size and place of the residual.",
        "nmt_diagnose.ledger.size:contradiction",
        f"{_DIAGNOSE}court/test_no_gap.py::test_no_gap_is_said_beside_no_figure_that_contradicts_it",
    ),
    Statement(
        "calibration",
        "Parameters that the model already has were off.",
        "Re-fitting them changes predictions by what matters and lowers the cost by 25.",
        "`none`, with the parameters that moved, or an effect.",
        "nmt_diagnose.ledger.rules:verdict_of",
        f"{_DIAGNOSE}test_rules.py::test_the_rules_make_a_verdict",
    ),
    Statement(
        "effect",
        "An effect of the library acts.",
        "Without it rows leave what matters, though model and measuring chain vary within their priors.",
        "The error of the chain or the parameter, with its size; no effect.",
        "nmt_diagnose.ledger.size:left_within_belief",
        f"{_DIAGNOSE}court/test_effects.py::test_a_healthy_table_has_no_effect",
    ),
    Statement(
        "missing mode",
        "The structure has a degree of freedom that the model lacks: a mass on a spring at a point.",
        "The responses show more resonances in their band than the model has there, and a pole that none of its modes "
        "is; the oscillator's frequency lies within the band.",
        "Other effects, such as an added mass; where nothing makes the resonance, that the model lacks it.",
        "nmt_diagnose.fit.low_level_modes:more_modes",
        f"{_DIAGNOSE}test_missing_mode.py::test_what_moves_modes_adds_none",
    ),
    Statement(
        "second effect",
        "Another effect acts with the first.",
        "The same, compared with the first effect alone.",
        "The first alone.",
        "nmt_diagnose.ledger.size:needed",
        f"{_DIAGNOSE}test_what_is_asked.py::test_an_effect_is_needed_where_the_fit_without_it_leaves_something_that_matters",
    ),
    Statement(
        "place",
        "The effect acts at a point.",
        "Other points leave more than what 2 % of error of a model's shapes do, and a third of the gap closes.",
        "All points that are as likely, with their probabilities; that the place could not be told.",
        "nmt_diagnose.ledger.comparison:Hypotheses.compared",
        f"{_DIAGNOSE}test_place_probability.py::test_places_are_weighed_as_with_the_covariance_of_the_model_s_form",
    ),
    Statement(
        "closed",
        "The explanation closes so much of the gap.",
        "Rows that its fit did not see are predicted so much better; no better than silence counts as a gap.",
        "No share; what predicts them worse is not stated.",
        "nmt_diagnose.ledger.gap:closed",
        f"{_DIAGNOSE}test_held_out.py::test_closed_is_the_share_of_the_reachable_gap",
    ),
    Statement(
        "adequate",
        "The explanation is the whole of the gap.",
        "What it leaves is noise or smaller than what matters, and no parameter is implausible.",
        "A part, with the residual.",
        "nmt_diagnose.ledger.size:left_over",
        f"{_DIAGNOSE}test_rules.py::test_a_part_is_asked_after_the_whole",
    ),
    Statement(
        "partial",
        "The gap acts like an effect, which is a part of it.",
        "It closes 80 % of the gap on data held out, two effects 95 %; no law that was read closes more.",
        "`unknown`, with what comes nearest; or the law.",
        "nmt_diagnose.ledger.comparison:by_plain_effect",
        f"{_DIAGNOSE}test_plain_effect.py::test_what_closes_most_of_a_gap_alone_is_named_first",
    ),
    Statement(
        "unknown",
        "Something acts that the library lacks.",
        "Rows leave what matters beyond the noise, with model and chain within their priors.",
        "`none` or `calibration`.",
        "nmt_diagnose.ledger.size:leaves_something",
        f"{_DIAGNOSE}test_what_is_asked.py::test_an_error_of_the_chain_counts_where_rows_leave_what_matters_without_it",
    ),
    Statement(
        "law",
        "The missing force has this form.",
        "Levels that were left out, the top two among them, are predicted by it.",
        "The reason why it is not told.",
        "nmt_diagnose.law.reading:read_law",
        f"{_DIAGNOSE}test_law.py::test_a_wrong_gain_alone_is_no_law",
    ),
    Statement(
        "none of an investigation",
        "The plan shows no gap.",
        "Its levels were climbed to the top, and over them nothing moves by what matters beyond the model.",
        "`unknown`, with what moves; up to which level nothing was found.",
        "nmt_diagnose.investigation.checks:none_contradicted",
        f"{_DIAGNOSE}test_investigation_checks.py::test_a_course_over_the_levels_is_no_lack_of_a_gap",
    ),
    Statement(
        "end of an investigation",
        "The cause has a name.",
        "Its levels were climbed to the top, or the answer says up to which it holds.",
        "What is open, and the next test.",
        "nmt_diagnose.investigation.checks:end_contradicted",
        f"{_DIAGNOSE}test_investigation_checks.py::test_ends_that_their_own_record_contradicts_do_not",
    ),
    Statement(
        "fold",
        "The frequency turns back along a response curve.",
        "Measured points lie clearly on one side of the outermost one, before it and after it.",
        "No fold; a smaller one is not seen.",
        "nmt_extract.curves.curve_checks:turns",
        "tests/extract/test_curve_checks.py::test_a_frequency_that_rises_everywhere_has_no_fold",
    ),
    Statement(
        "unstable",
        "A point of a response curve is unstable in open loop.",
        "The frequency falls through it, clearly, from point to point; near a fold its place decides.",
        "Its stability is left open.",
        "nmt_extract.curves.curve_checks:rises",
        "tests/extract/test_curve_checks.py::test_points_in_the_noise_of_a_flat_branch_are_left_open",
    ),
    Statement(
        "isola",
        "A closed branch is born at a force.",
        "A held amplitude lies on it: amplitudes below and above need clearly more force.",
        "No isola is foretold.",
        "nmt_extract.curves.curve_checks:reached_minima",
        "tests/extract/test_curve_checks.py::test_of_viscous_damping_no_isola_is_foretold",
    ),
    Statement(
        "force surface",
        "The force between measured amplitudes.",
        "The frequency was measured at both neighbouring amplitudes.",
        "Between which amplitudes nothing is known.",
        "nmt_extract.curves.curve_checks:overlap",
        "tests/extract/test_curve_checks.py::test_nothing_is_said_of_the_force_where_measured_frequencies_do_not_overlap",
    ),
    Statement(
        "settled",
        "A point of a response curve is a steady state.",
        "Its response has less than 1 % to go, its frequency less than a tenth of the damping ratio.",
        "It has not settled.",
        "nmt_extract.judgement.window_judge:is_settled",
        "tests/extract/test_curve_checks.py::test_a_point_that_still_moves_has_not_settled",
    ),
    Statement(
        "limit cycle",
        "The structure moves by itself at an amplitude.",
        "Growth changes its sign between measured levels.",
        "Between which levels one may lie.",
        "nmt_extract.curves.limit_cycles:limit_cycles",
        "tests/extract/test_free_motion.py::test_a_limit_cycle_between_lost_levels_is_uncertain",
    ),
    Statement(
        "linear",
        "Modes of a random test are those of a passive structure.",
        "Residues have the phase that a passive structure can have, and peaks follow the excitation.",
        "The channel that is turned, late or hums.",
        "nmt_extract.linear.judge:phase_findings",
        "tests/extract/test_linear_judge.py::test_what_no_passive_structure_does_is_named",
    ),
    Statement(
        "hum",
        "A line of the mains is in a channel.",
        "It stands out of the noise at its frequency and at no order of the drive.",
        "Nothing; a line at an order is a harmonic.",
        "nmt_diagnose.ledger.size:large_lines",
        f"{_DIAGNOSE}test_spectral_lines.py::test_a_harmonic_at_the_mains_hides_it",
    ),
    Statement(
        "faulty channel",
        "A channel has another unit, sign or gain.",
        "All its rows are larger by one factor, and others are not.",
        "The gap is judged for effects.",
        "nmt_diagnose.ledger.plain_look:factors",
        f"{_DIAGNOSE}test_plain_look.py::test_a_factor_is_seen_and_an_ordinary_gain_is_not",
    ),
    Statement(
        "delay",
        "Channels of a kind are late.",
        "Their phases fall with frequency by one time, at all levels.",
        "A phase of single channels, or an effect.",
        "nmt_diagnose.chain.chain_columns:shared_delays",
        f"{_DIAGNOSE}test_late_channels.py::test_late_channels_are_no_gap",
    ),
)
"""All statements."""


def statements_table() -> str:
    """The statements as a table in Markdown."""
    lines = ["| statement | says | has to hold | else | check | test |", "|---|---|---|---|---|---|"]
    for statement in STATEMENTS:
        check = (
            f"`{statement.function.partition(':')[2]}` in `{statement.function.partition(':')[0]}`"
            if statement.function
            else "none yet"
        )
        test = (
            f"`{statement.test.partition('::')[2]}` in `{statement.test.partition('::')[0]}`"
            if statement.test
            else "none yet"
        )
        lines.append(
            f"| {statement.name} | {statement.says} | {statement.check} | {statement.otherwise} | {check} | {test} |"
        )
    return "\n".join(lines)
