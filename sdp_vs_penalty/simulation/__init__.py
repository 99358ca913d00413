"""Known truth: simulated runs, hidden effects, physics engines."""

from sdp_vs_penalty.plugins import surface

__getattr__ = surface(
    __name__,
    {
        "Experiment": "experiments",
        "experiment": "experiments",
        "HiddenRuns": "hidden_runs",
        "MAKERS": "hidden_runs",
        "Sensor": "experiments",
        "engine_types": "engines",
        "sigmoid_friction": "experiments",
    },
)
