"""The data, compressed: triangular factors that merge, base parameters, black boxes."""

from sdp_vs_penalty.plugins import surface

__getattr__ = surface(
    __name__,
    {
        "BlackBox": "black_box",
        "LeastSquares": "regression",
        "Regression": "regression",
        "compress": "regression",
        "load_answers": "black_box",
        "triangular": "regression",
    },
)
