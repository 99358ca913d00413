"""The data, compressed: triangular factors that merge, base parameters, black boxes."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    black_box="BlackBox compress_black_box load_answers",
    regression="compress Factor LeastSquares Regression triangular",
    products="ProductRegression",
    base_parameters="base_rows",
    evidence=(
        "deviance independent_rows jackknifed log_odds rows_worth_one "
        "standard_errors_above_zero student_95"
    ),
)
