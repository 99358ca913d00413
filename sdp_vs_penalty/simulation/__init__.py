"""Known truth: simulated runs, hidden effects, physics engines."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    experiments="Experiment experiment Sensor sigmoid_friction",
    hidden_runs="HiddenRuns MAKERS",
    engines="engine_types",
)
