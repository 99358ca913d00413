"""Known truth: simulated runs, hidden effects, physics engines."""

from sdp_vs_penalty.plugins import lazy_exports

__getattr__ = lazy_exports(
    __name__,
    experiments="Experiment experiment innovation_share Sensor sigmoid_torque",
    hidden_runs="HiddenRuns true_world",
    engines="engine_types",
    worlds=(
        "DryFriction Hidden LEVELS MAKERS TrueMotion World at_joint bristles log_uniform "
        "misplaced shifted torques"
    ),
    **{"engines.engine": "Engine"},
)
