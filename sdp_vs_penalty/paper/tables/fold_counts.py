"""Table "folds": whether the SDP predicts unseen motion better than least squares, and how
much of the answer is the number of folds."""

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators import DEFAULT_METHOD
from sdp_vs_penalty.paper.tables.folds import difference, fold_errors
from sdp_vs_penalty.paper.tables.study import FOLDS, Study
from sdp_vs_penalty.paper.tables.table import Row, Table, notes, register_table
from sdp_vs_penalty.paper.tables.unseen import ADDED_EFFECTS

#: Into how many stretches the motion is cut.
FOLD_COUNTS = (FOLDS, 8, 10, 20)


@register_table("folds", "panda", slow=True)
def fold_counts(study: Study) -> Table:
    """Fold table: the SDP's error on unseen motion less that of least squares, by number
    of folds and effects.

    Parameters
    ----------
    study : Study
        The robot's data sets and every method's estimate, computed on demand.

    Returns
    -------
    Table
        Rows, notes and headline.

    Raises
    ------
    InputError
        Without the real run.
    """
    if study.run is None:
        raise InputError(
            "table folds is about the real run, which is not at hand",
            "name the folder of the measurements by SDP_VS_PENALTY_DATA",
        )
    rows = list[Row]()
    for added in ADDED_EFFECTS:
        for count in FOLD_COUNTS:
            study.progress(f"{count} folds, {added or 'the usual effects'}")
            rows.append(_row(study, added, count))
    sentences = [
        f"{row['less_ols_points']:+.2f} points (t = {row['t']:.2f}) with"
        f" {row['added_effects'] or 'the usual effects'}"
        for row in rows
        if row["folds"] == FOLDS
    ]
    return Table(
        f"{DEFAULT_METHOD} less least squares on unseen motion of"
        f" {study.problem.title}",
        rows,
        notes("folds", method=DEFAULT_METHOD),
        f"On {FOLDS} folds: {'; '.join(sentences)}.",
        digits=3,
        caption=f"Measured: the authors' real run ({len(study.run.t)} samples).",
    )


def _row(study: Study, added: str, count: int) -> Row:
    """Return the row that compares SDP and least squares on ``count`` folds.

    added : effects that join the problem's own, separated by ", ".
    """
    effects = [*study.problem.default_effects]
    if added:
        effects += added.split(", ")
    sdp = study.unseen(DEFAULT_METHOD, effects, count)
    squares = study.unseen("ols", effects, count)
    less = difference(sdp, squares)
    return {
        "data": "measured",
        "added_effects": f"+ {added}" if added else "",
        "folds": count,
        "sdp_error_percent": sdp.relative_error_percent,
        "ols_error_percent": squares.relative_error_percent,
        "less_ols_points": less.mean,
        "interval_points": less.in_words,
        "t": less.t,
        "folds_won_by_sdp": int((fold_errors(sdp) < fold_errors(squares)).sum()),
    }
