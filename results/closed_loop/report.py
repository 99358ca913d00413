"""Tables of closed_loop.csv: means over draws with their 95 % intervals."""

import numpy as np
import pandas
from scipy.stats import t as student

from sdp_vs_penalty.results.table import markdown_lines

#: Columns of the table: what it is called, and whether its interval is shown.
COLUMNS = {
    "feedforward_excitation_rms": ("feedforward, excitation [mrad]", True),
    "feedforward_points_rms": ("feedforward, point to point [mrad]", True),
    "computed_rms": ("computed torque [mrad]", True),
    "computed_diverged": ("of 10 loops diverged", False),
    "positive_percent": ("M(q) > 0 [% of poses]", False),
    "free_seconds": ("free run [s]", True),
    "residual_rms": ("residual without contact [N m]", True),
    "push": ("least push found [N]", True),
    "false_alarm_percent": ("false alarms [% of time]", False),
}


def mean(values: pandas.Series, has_interval: bool) -> str:
    """Return the mean of the draws, with half its 95 % interval."""
    known = values.dropna()
    if known.empty:
        return "-"
    text = f"{known.mean():.3g}"
    if has_interval and len(known) > 1:
        error = known.sem() * student.ppf(0.975, len(known) - 1)
        text += f" ± {error:.2g}"
    return text + (f" ({len(known)} draws)" if len(known) < len(values) else "")


def report(rows: pandas.DataFrame) -> str:
    """Return the page: a row for each model of each kind of log."""
    both = rows[["computed_excitation_rms", "computed_points_rms"]]
    rows = rows.assign(
        computed_rms=np.sqrt((both**2).mean(axis=1, skipna=False)),
        motion=rows["motion"].fillna("none"),
        urdf=rows["urdf"].fillna("any"),
    )
    rows = rows.sort_values("motion", key=_order, kind="stable")
    table = []
    for key, draws in rows.groupby(["motion", "model", "urdf"], sort=False):
        cells = [str(x) for x in key]
        for column, (_, has_interval) in COLUMNS.items():
            if column == "computed_diverged" and draws[column].notna().any():
                cells.append(f"{draws[column].sum():.0f}")
            else:
                cells.append(mean(draws[column], has_interval))
        table.append(cells)
    heads = ["log", "model", "URDF", *(name for name, _ in COLUMNS.values())]
    begin = "# Models in a loop", "", "[What this is](README.md).", ""
    return "\n".join([*begin, *markdown_lines(heads, table), ""])


def _order(motion: pandas.Series) -> pandas.Series:
    return motion.map({"none": 0, "rich": 1, "little": 2})
