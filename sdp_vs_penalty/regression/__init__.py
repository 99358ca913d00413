"""The data, compressed: triangular factors that merge, base parameters, black boxes."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    black_box="BlackBox load_answers",
    regression="LeastSquares Regression compress triangular",
)
